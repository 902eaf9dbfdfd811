"""Noise of sensors: white, coloured, quantised; all of the same rms in one sample."""

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

Array = NDArray[np.float64]


def add_noise(rng: np.random.Generator, clean: Array, sigma: Array, kind: str) -> Array:
    """The reading (N, c) of a clean signal (N, c) with noise of rms `sigma` (c,)."""
    white = rng.normal(size=clean.shape)
    if kind == "white":
        return clean + sigma * white
    if kind == "coloured":
        # Half of the power is first-order with a memory of about 20 samples, half is white.
        pole = 0.95
        slow = lfilter([np.sqrt(1 - pole**2)], [1.0, -pole], white, axis=0)
        return np.asarray(clean + sigma * np.sqrt(0.5) * (slow + rng.normal(size=clean.shape)))
    if kind == "quantised":
        # A rounding step of 2.4 sigma has an rms of 0.69 sigma; the rest is white and dithers it.
        step = 2.4 * sigma
        dither = np.sqrt(sigma**2 - step**2 / 12)
        return np.round((clean + dither * white) / step) * step
    raise ValueError(kind)

"""Noise of sensors: white, coloured, quantised; all of the same rms in one sample."""

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

Array = NDArray[np.float64]


POLE = 0.95
"""Of coloured noise: a memory of about 20 samples."""


def add_noise(rng: np.random.Generator, clean: Array, sigma: Array, kind: str) -> Array:
    """The reading (N, c) of a clean signal (N, c) with noise of rms `sigma` (c,)."""
    white = rng.normal(size=clean.shape)
    if kind == "white":
        return clean + sigma * white
    if kind == "coloured":
        # Half of the power is first-order, half is white.
        slow = lfilter([np.sqrt(1 - POLE**2)], [1.0, -POLE], white, axis=0)
        return np.asarray(clean + sigma * np.sqrt(0.5) * (slow + rng.normal(size=clean.shape)))
    if kind == "quantised":
        # A rounding step of 2.4 sigma has an rms of 0.69 sigma; the rest is white and dithers it.
        step = 2.4 * sigma
        dither = np.sqrt(sigma**2 - step**2 / 12)
        return np.round((clean + dither * white) / step) * step
    raise ValueError(kind)


def spectrum(cycles: Array, kind: str) -> Array:
    """Power of that noise by cycles per sample, 1 throughout where it is white; a dithered rounding nearly is."""
    if kind != "coloured":
        return np.ones_like(cycles)
    return np.asarray(0.5 + 0.5 * (1 - POLE**2) / np.abs(1 - POLE * np.exp(-2j * np.pi * cycles)) ** 2)


def averaged(kind: str, rows: int) -> float:
    """Return the rms of means of so many neighbouring samples of that noise, over the rms of one."""
    if kind != "coloured":
        return float(rows**-0.5)
    lags = np.arange(1, rows)
    first_order = (rows + 2.0 * np.sum((rows - lags) * POLE**lags)) / rows**2
    return float(np.sqrt(0.5 / rows + 0.5 * first_order))

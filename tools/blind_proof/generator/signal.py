"""What sensors, time and temperature do to a signal (N, c): effects behind the mechanics."""

import numpy as np
from numpy.typing import NDArray
from scipy.signal import butter, lfilter

Array = NDArray[np.float64]


def random_walk(rng: np.random.Generator, n: int) -> Array:
    """A slow wander of unit rms."""
    b, a = butter(2, 0.002)
    walk = lfilter(b, a, np.cumsum(rng.normal(size=n)))
    walk -= walk.mean()
    return np.asarray(walk / walk.std())


def warm_up(t: Array, tau_s: float) -> Array:
    """Settling of a sensor that was switched on at t = 0, of unit final value."""
    return np.asarray(-np.expm1(-t / tau_s))


def room_temperature(rng: np.random.Generator, t: Array) -> Array:
    """Degrees Celsius near 23: a thermostat's cycle and a slow change."""
    period = rng.uniform(35.0, 60.0)
    return np.asarray(23.0 + 0.8 * np.sin(2 * np.pi * t / period + rng.uniform(0, 6)) + 0.6 * random_walk(rng, len(t)))


def delayed(t: Array, x: Array, seconds: float) -> Array:
    """The signal as it was `seconds` ago."""
    return np.stack([np.interp(t - seconds, t, column) for column in x.T], axis=1)


def lagged(x: Array, dt: float, tau_s: float) -> Array:
    """First-order low-pass, settled at the start; exact for what is straight between samples, however quick it is."""
    pole = np.exp(-dt / tau_s)
    share = (1 - pole) * tau_s / dt
    start = x[:1]
    return np.asarray(start + lfilter([1 - share, share - pole], [1.0, -pole], x - start, axis=0))


def preisach(x: Array, width: float, span: float, middle: float) -> Array:
    """What relays (Preisach) driven by x (N,) lag behind their own thresholds, about 1 between far reversals.

    Thresholds lie evenly over `span` about `middle`, their half widths evenly up to half of `width`; all in units of x.
    """
    at = middle + span * (np.arange(60) + 0.5 - 30.0)[:, None] / 60.0
    half = 0.5 * width * (np.arange(12) + 0.5)[None, :] / 12.0
    up = np.broadcast_to(x[0] > at, np.broadcast_shapes(at.shape, half.shape))
    out = np.empty_like(x)
    for i, value in enumerate(x):
        up = (up | (value > at + half)) & (value > at - half)
        out[i] = np.mean(up) - np.mean(value > at)
    return np.asarray(out * span / np.mean(half))


def narrow_band(rng: np.random.Generator, t: Array, hz: float) -> Array:
    """A hum of unit rms whose phase wanders slowly."""
    phase = 2 * np.pi * hz * t + 0.6 * random_walk(rng, len(t))
    return np.asarray(np.sqrt(2) * np.sin(phase))

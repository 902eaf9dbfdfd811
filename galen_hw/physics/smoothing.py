"""Derivatives of recorded positions by local polynomials, after a low-pass that suits the noise."""

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.signal import butter, savgol_filter, sosfiltfilt

from galen_hw.spatial import Array

ORDER = 4
NARROW = 5


def _rates(x: Array, dt: float) -> tuple[Array, Array]:
    options = {"window_length": NARROW, "polyorder": ORDER, "delta": dt, "mode": "interp"}
    return savgol_filter(x, deriv=1, **options), savgol_filter(x, deriv=2, **options)


def motion_band(x: Array, dt: float) -> float:
    """Highest frequency (Hz) at which a signal (N,) stands above its own noise; the Nyquist frequency where it does all along.

    The noise level is the median of the periodogram's upper half; the band ends where a smoothed periodogram last exceeds
    it eightfold.
    """
    n = len(x)
    if n < 64:
        return 0.5 / dt
    straight = x - np.linspace(x[0], x[-1], n)
    power = np.abs(np.fft.rfft(straight * np.hanning(n))) ** 2
    width = max(n // 400, 3)
    smooth = np.convolve(power, np.ones(width) / width, mode="same")
    level = float(np.median(power[n // 4 :])) / 0.69
    if level <= 1e-18 * float(smooth.max()):
        return 0.5 / dt
    above = np.flatnonzero(smooth > 8.0 * level)
    return float((above[-1] + 1 if len(above) else 1) / (n * dt))


def low_passed(x: Array, dt: float, band: float) -> Array:
    """Signal (N,) without what lies above 1.5 times the band (Hz): a Butterworth filter forth and back, no phase."""
    cut = 3.0 * band * dt
    if cut >= 0.8 or len(x) < 30:
        return x
    return np.asarray(sosfiltfilt(butter(3, max(cut, 1e-4), output="sos"), x, padlen=min(len(x) - 1, int(6.0 / cut))))


def derivatives(
    time: Array, x: Array, segments: list[slice], velocity: Array | None = None, band: float | None = None
) -> tuple[Array, Array]:
    """First and second derivative (N, n) of signals (N, n) over time (N,) in s, each segment by itself.

    A measured velocity is believed and differentiated once. Uneven samples go over an even grid. What lies above the band
    of the motion (found here unless given, Hz) is noise and filtered off. Segments of fewer than five samples get zeros.
    """
    first, second = np.zeros_like(x), np.zeros_like(x)
    for part in segments:
        t = time[part]
        if len(t) < NARROW or t[-1] <= t[0] or np.any(np.diff(t) <= 0):
            continue
        dt = float(np.median(np.diff(t)))
        grid = np.linspace(t[0], t[-1], max(round((t[-1] - t[0]) / dt) + 1, NARROW))
        step = float(grid[1] - grid[0])
        even = bool(len(grid) == len(t) and np.max(np.abs(grid - t)) < 0.02 * dt)
        for j in range(x.shape[1]):
            measured = None if velocity is None or np.isnan(velocity[part, j]).any() else velocity[part, j]
            source = x[part, j] if measured is None else measured
            on_grid = source if even else np.interp(grid, t, source)
            one, two = _rates(low_passed(on_grid, step, band or motion_band(on_grid, step)), step)
            if not even:
                one, two = CubicSpline(grid, one)(t), CubicSpline(grid, two)(t)
            first[part, j], second[part, j] = (
                (one, two) if measured is None else (_plain(on_grid, step, grid, t, even, band), one)
            )
    return first, second


def _plain(on_grid: Array, step: float, grid: Array, t: Array, even: bool, band: float | None) -> Array:
    """A measured velocity without its noise."""
    smooth = low_passed(on_grid, step, band or motion_band(on_grid, step))
    return smooth if even else np.asarray(np.interp(t, grid, smooth))

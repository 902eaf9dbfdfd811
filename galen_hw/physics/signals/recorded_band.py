"""Up to which frequency recorded channels were let through by a filter that somebody applied before they were stored.

Robot controllers and their users low-pass wrenches and torques, often forth and back. Above the cut-off nothing is left in
which physics could show, not even noise; a comparison that weighs each frequency by its noise would believe most in just that
band. Both sides are then compared below it (the parallel filter of dynamic identification: Gautier, Janot and Vandanjon 2013).
"""

from collections.abc import Sequence

import numpy as np
from scipy.signal.windows import dpss

from galen_hw.physics.signals.splines import SHORTEST
from galen_hw.spatial import Array


def recorded_band(
    x: Array, dt: float, units: Sequence[str], *, quietest: float = 0.0001, within: float = 0.999, most: int = 8192
) -> float | None:
    """Return the frequency (Hz) up to which channels x (N, C), a row each dt s, were let through; None: noise in all bands.

    Channels of one unit count together, and the widest of the bands is that of all. None too where it is most of what the
    rows can show, and where nothing moves.

    Args:
        quietest: white noise of the best analogue sensors over the standard deviation of what they read (13
            bits); a filter leaves less.
        within: share of the power of a channel's rate of change that lies in the band.
        most: rows, from the middle, of which the spectrum is taken: a filter is the same all along.
    """
    x = x[np.isfinite(x).all(axis=1)]
    middle = max(len(x) - most, 0) // 2
    x = x[middle : middle + most]
    if len(x) < 4 * SHORTEST:
        return None
    frequency, each = np.fft.rfftfreq(len(x), dt), _density(x, dt)
    alike = np.array([[u == unit for unit in dict.fromkeys(units)] for u in units], dtype=float)
    density, spread = each @ alike, np.var(x, axis=0) @ alike
    noise = np.median(density[frequency > 0.25 / dt], axis=0) / np.log(2.0) * 0.5 / dt
    if np.any(noise > quietest**2 * spread):
        return None
    moved = np.cumsum(density * frequency[:, None] ** 2, axis=0)
    band = float(frequency[np.argmax(moved >= within * moved[-1], axis=0)].max())
    return band if 0.0 < band < 0.25 / dt else None


def _density(x: Array, dt: float, *, bandwidth: float = 4.0) -> Array:
    """Return one-sided power densities (F, C) of signals (N, C), without the straight lines through their ends.

    Args:
        bandwidth: time half bandwidth of the window (Slepian 1978): it leaks 1e-10.
    """
    line = np.linspace(0.0, 1.0, len(x))[:, None]
    window = dpss(len(x), bandwidth)[:, None]
    straight = (x - x[0] - line * (x[-1] - x[0])) * window
    return np.asarray(np.abs(np.fft.rfft(straight, axis=0)) ** 2 * 2.0 * dt / np.sum(window**2))

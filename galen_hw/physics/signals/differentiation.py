"""Derivatives of recorded positions by splines or by local polynomials behind a low-pass; low-passes for forces."""

import math
from collections.abc import Iterator
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.ndimage import percentile_filter
from scipy.signal import butter, savgol_filter, sosfiltfilt

from galen_hw.physics.signals.rest_to_rest import moved
from galen_hw.physics.signals.splines import SHORTEST, motion_band, spline
from galen_hw.spatial import Array

NARROW = 5
CUT = 1.5
"""Cut-off of the low-pass over the band of the motion."""
MOST_KEPT = 24


def _rates(x: Array, dt: float, *, order: int = 4) -> tuple[Array, Array]:
    """Return the first and second derivative of a signal (N,), of which rows are dt apart, by local polynomials.

    Args:
        order: of the local polynomials.
    """
    options = {"window_length": NARROW, "polyorder": order, "delta": dt, "mode": "interp"}
    return savgol_filter(x, deriv=1, **options), savgol_filter(x, deriv=2, **options)


def denoised(time: Array, x: Array, segments: list[slice]) -> Array:
    """Return signals (N, n) over time (N,) in s without their white noise, each segment by itself: splines through them.

    A signal in which no noise can be told stays as it is.
    """
    out = x.copy()
    for part in segments:
        t = time[part] - time[part.start]
        if len(t) < NARROW or np.any(np.diff(t) <= 0):
            continue
        for j in range(x.shape[1]):
            found = _followed(t, x[part, j])
            if found is not None:
                out[part, j] = found[0]
    return out


def _followed(t: Array, x: Array, *, place: bool = True, longest: int = 50_000) -> Array | None:
    """Return `_through`; what was asked before is not computed again: premises and search simulate one recording many times.

    Args:
        longest: samples of a signal whose derivatives are kept.
    """
    if len(t) > longest:
        return _through(t, x, place=place)
    found = _kept(np.ascontiguousarray(t, dtype=float).tobytes(), np.ascontiguousarray(x, dtype=float).tobytes(), place)
    return None if found is None else found.copy()


@lru_cache(maxsize=MOST_KEPT)
def _kept(t: bytes, x: bytes, place: bool) -> Array | None:
    return _through(np.frombuffer(t), np.frombuffer(x), place=place)


def _through(t: Array, x: Array, *, place: bool = True) -> Array | None:
    """Return a signal (N,) at times (N,) in s without white noise, with two derivatives (3, N); None: no noise can be told.

    What is not a `place` (a speed) starts from rest in another way.
    """
    by_moves = moved(t, x) if place else None
    if by_moves is not None:
        return by_moves
    found = spline(t, x)
    return None if found is None else np.stack([found(t), found(t, 1), found(t, 2)])


def _filtered(x: Array, dt: float, band: float | None) -> Array:
    """Return the signal low-passed at a band (Hz; else its own), its first and second derivative (3, N)."""
    plain = low_passed(x, dt, band or motion_band(x, dt))
    return np.stack([plain, *_rates(plain, dt)])


def low_passed(x: Array, dt: float, band: float) -> Array:
    """Return signals (N, ...) without what lies above `CUT` times the band (Hz): Butterworth forth and back, no phase."""
    cut = 2.0 * CUT * band * dt
    if cut >= 0.8 or len(x) < 30:
        return x
    return np.asarray(sosfiltfilt(_low_pass(max(cut, 1e-4)), x, axis=0, padlen=min(len(x) - 1, int(6.0 / cut))))


@lru_cache(maxsize=MOST_KEPT)
def _low_pass(cut: float) -> Array:
    """Return second-order sections (2, 6) below a share of half the rate: designed once for thousands of columns."""
    return np.asarray(butter(3, cut, output="sos"))


def smoothed(time: Array, x: Array, segments: list[slice], band: float, *, bridge: bool = False) -> Array:
    """Return signals (N, k) through the low-pass of `derivatives`, by segment; what is not measured (NaN) stays so.

    Uneven samples go over an even grid. With `bridge`, isolated samples far off their neighbours do not spread.
    """
    out = x.copy()
    for part in segments:
        t = time[part]
        if len(t) < NARROW or t[-1] <= t[0] or np.any(np.diff(t) <= 0):
            continue
        dt = float(np.median(np.diff(t)))
        grid = np.linspace(t[0], t[-1], max(round((t[-1] - t[0]) / dt) + 1, NARROW))
        for j in np.flatnonzero(x[part].any(axis=0)).tolist():
            good = np.isfinite(x[part, j])
            if bridge:
                good &= ~isolated(x[part, j])
            if good.sum() < NARROW:
                continue
            smooth = low_passed(np.interp(grid, t[good], x[part, j][good]), float(grid[1] - grid[0]), band)
            out[part, j] = np.where(np.isfinite(x[part, j]), np.interp(t, grid, smooth), np.nan)
    return out


def has_line(
    x: Array, dt: float, above: float, *, foot: int = 5, over_median: float = 60.0, over_next: float = 4.0
) -> bool:
    """Return whether a signal (N,) holds one narrow line, and no row of lines, above a frequency (Hz).

    Args:
        foot: lines on either side that a line's window spreads it over, and that its phase's wander does.
        over_median: power of a line over the median of the spectrum that noise never has, exp(-40) in one place.
        over_next: power of a line over the next one.
    """
    n = len(x)
    first = max(int(np.ceil(above * n * dt)), 1)
    if n < SHORTEST or n // 2 - first < SHORTEST or not np.isfinite(x).all():
        return False
    power = np.abs(np.fft.rfft((x - np.mean(x)) * np.hanning(n)))[first:] ** 2
    peak = int(np.argmax(power))
    others = np.delete(power, np.s_[max(peak - foot, 0) : peak + foot + 1])
    return bool(power[peak] > max(over_median * float(np.median(others)), over_next * float(np.max(others))) > 0.0)


ALONE = 3
"""Samples in a row that may be isolated; more are an event."""


def isolated(x: Array, *, width: int = 101) -> NDArray[np.bool_]:
    """Return outliers (N,), at most three in a row, that stand out to one side of what lies before and after them.

    How far a sample stands out is the smaller of its distances to the third one before and after, where both have one sign;
    zero on slopes, steps and ramps. It must be six times what nine samples of ten around it stay below, and twice what the
    signal itself changes there from the sixth sample to the third (a cusp is no spike).

    Args:
        width: samples around, of which nine of ten say what is usual.
    """
    n = len(x)
    none = np.zeros(n, dtype=bool)
    if n < 20 or not np.isfinite(x).all():
        return none
    wide = np.pad(x, 2 * ALONE, mode="reflect")
    sixth, third, next_third, next_sixth = (wide[k * ALONE : k * ALONE + n] for k in (0, 1, 3, 4))
    before, after = x - third, x - next_third
    out = np.where(before * after > 0.0, np.minimum(np.abs(before), np.abs(after)), 0.0)
    if not out.any():
        return none
    # At an end its own value counts as all that lies beyond, unless that would be most of what there is.
    around = percentile_filter(out, 90, size=width, mode="nearest" if n >= width else "reflect")
    usual = np.maximum(around, max(float(np.quantile(out, 0.9)), float(out[out > 0.0].min())))
    needed = np.maximum(6.0 * usual, 2.0 * np.maximum(np.abs(third - sixth), np.abs(next_third - next_sixth)))
    edges = np.flatnonzero(np.diff(np.concatenate([[False], out > needed, [False]]).astype(int)))
    for a, b in edges.reshape(-1, 2):
        none[a:b] = b - a <= ALONE
    return none


def derivatives(
    time: Array,
    x: Array,
    segments: list[slice],
    velocity: Array | None = None,
    band: float | None = None,
    *,
    fine: bool = True,
) -> tuple[Array, Array]:
    """Return first and second derivative (N, n) of signals (N, n) over time (N,) in s, each segment by itself.

    A measured velocity is believed and differentiated once. Noise is smoothed away, by splines (if `fine`; commands
    have no noise to speak of) or by the low-pass of a given or found band (Hz), over an even grid where samples are uneven.
    Segments of fewer than five samples get zeros.
    """
    first, second = np.zeros_like(x), np.zeros_like(x)
    for part in segments:
        t = time[part] - time[part.start]
        if len(t) < NARROW or t[-1] <= 0.0 or np.any(np.diff(t) <= 0):
            continue
        for j in range(x.shape[1]):
            measured = None if velocity is None or np.isnan(velocity[part, j]).any() else velocity[part, j]
            source = x[part, j] if measured is None else measured
            found = _followed(t, source, place=measured is None) if fine and band is None else None
            derived = _on_grid(t, source, band) if found is None else found
            first[part, j], second[part, j] = derived[1:] if measured is None else derived[:2]
    return first, second


def _on_grid(t: Array, x: Array, band: float | None) -> Array:
    """Return what `_filtered` gives of a signal (N,) at times (N,), by way of an even grid where they are uneven."""
    dt = float(np.median(np.diff(t)))
    grid = np.linspace(t[0], t[-1], max(round((t[-1] - t[0]) / dt) + 1, NARROW))
    step = float(grid[1] - grid[0])
    if len(grid) == len(t) and np.max(np.abs(grid - t)) < 0.02 * dt:
        return _filtered(x, step, band)
    return np.asarray(CubicSpline(grid, _filtered(np.interp(grid, t, x), step, band), axis=1)(t))


STILL_ROWS = 8
"""Rows of which the mean is one value where a rest is sought."""


def at_rest(time: Array, x: Array, segments: list[slice], *, white_from: float = 0.75, shortest: float = 1.0) -> Array:
    """Return signals (N, n) over time (N,) in s with the mean of each rest in its place, as far as their noise can tell rests.

    At rest a reading holds noise alone (successive rows know nothing of each other); a whole segment may be one.

    Args:
        white_from: mean squared step over twice the variance from which a signal is noise: 1 for white noise,
            nothing for motion.
        shortest: rest that is worth finding, in s.
    """
    out = x.copy()
    for part in segments:
        if part.stop - part.start < SHORTEST:
            continue
        spread = np.var(x[part], axis=0)
        white = np.mean(np.diff(x[part], axis=0) ** 2, axis=0) > white_from * 2.0 * spread
        out[part] = np.where(white & (spread > 0.0), np.mean(x[part], axis=0), x[part])
        length = max(math.ceil(shortest / float(np.median(np.diff(time[part]))) / STILL_ROWS), 3)
        for j in np.flatnonzero(~white):
            for rest in _rests(x[part, j], length):
                at = slice(part.start + rest.start, part.start + rest.stop)
                out[at, j] = np.mean(x[at, j])
    return out


def row_noise(x: Array, segments: list[slice]) -> float:
    """Return the standard deviation of the white noise of a signal (N,), in its unit; nan where no segment has five rows.

    By the median of fourth differences, in which noise has 70 times its variance and what moves at the pace of an arm is gone.
    """
    every = np.concatenate([np.diff(x[part], 4) for part in segments])
    # Half of what is normal is smaller than 0.6745 standard deviations.
    return float(np.nanmedian(np.abs(every))) / (0.6745 * math.sqrt(70.0)) if len(every) else math.nan


def _rests(x: Array, shortest: int, *, still: float = 3.5) -> Iterator[slice]:
    """Yield runs of rows of a noisy signal (N,) that stays where it is, of at least `shortest` times `STILL_ROWS` rows.

    Means of a few rows each stay within what the noise of a row makes of them, each and as a whole.

    Args:
        still: standard errors by which a mean may be away from the rest that it is part of.
    """
    count = len(x) // STILL_ROWS
    sigma = row_noise(x, [slice(None)])
    if count < shortest or not sigma > 0.0:
        return
    means = np.mean(x[: count * STILL_ROWS].reshape(count, STILL_ROWS), axis=1) * math.sqrt(STILL_ROWS) / sigma
    first = 0
    while first + shortest <= count:
        last, total = first, 0.0
        while last < count:
            n = last - first
            if n and abs(means[last] - total / n) > still * math.sqrt(1.0 + 1.0 / n):
                break
            total, last = total + means[last], last + 1
        n = last - first
        if n >= shortest and _stays(means[first:last]):
            # The means at either end may hold the first of a move.
            yield slice((first + 1) * STILL_ROWS, (last - 1) * STILL_ROWS)
            first = last
        else:
            first += max(n // 4, 1)


def _stays(z: Array, *, most: float = 2.0) -> bool:
    """Return whether values (n,) of unit variance are that alone: no coarser means of them, down to two, are further apart.

    Args:
        most: standard deviations by which the sum of their squares may exceed what noise makes: a slow motion is
            no rest.
    """
    while len(z) >= 2:
        if float(np.sum((z - z.mean()) ** 2)) > len(z) - 1 + most * math.sqrt(2.0 * (len(z) - 1)):
            return False
        z = (z[: len(z) // 2 * 2].reshape(-1, 2).sum(axis=1)) / math.sqrt(2.0)
    return True


def ends(
    time: Array,
    x: Array,
    segments: list[slice],
    band: float | None = None,
    *,
    periods: float = 0.6,
    longest: float = 1.0,
    most: float = 0.05,
) -> NDArray[np.bool_]:
    """Return which rows (N,) are so near an end of their segment that derivatives of signals (N, n) over time (N,) are not known.

    The band is that of the low-pass in Hz; found here, the lowest of the signals counts. Few rows of each segment.

    Args:
        periods: of the low-pass's cut-off from an end of a segment in which derivatives are a guess: half of
            their rows are missing.
        longest: s, of such an end.
        most: share of a segment's time, at either end: a joint that rests has no band, and must not cost the
            recording.
    """
    out = np.zeros(len(x), dtype=bool)
    for part in segments:
        t = time[part]
        if len(t) < NARROW or t[-1] <= t[0] or np.any(np.diff(t) <= 0):
            continue
        dt = float(np.median(np.diff(t)))
        lowest = min((band or motion_band(column, dt) for column in x[part].T), default=0.5 / dt)
        reach = min(periods / (CUT * lowest), longest, most * float(t[-1] - t[0]))
        out[part] = (t < t[0] + reach) | (t > t[-1] - reach)
    return out

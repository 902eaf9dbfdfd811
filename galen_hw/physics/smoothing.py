"""Derivatives of recorded positions by penalised splines, or by local polynomials behind a low-pass; low-passes for forces."""

import math
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import BSpline, CubicSpline
from scipy.linalg import solveh_banded
from scipy.ndimage import percentile_filter
from scipy.optimize import minimize_scalar
from scipy.signal import butter, savgol_filter, sosfiltfilt
from scipy.sparse import diags_array, sparray

from galen_hw.spatial import Array

ORDER = 4
NARROW = 5
CUT = 1.5
"""Cut-off of the low-pass over the band of the motion."""


def _rates(x: Array, dt: float) -> tuple[Array, Array]:
    options = {"window_length": NARROW, "polyorder": ORDER, "delta": dt, "mode": "interp"}
    return savgol_filter(x, deriv=1, **options), savgol_filter(x, deriv=2, **options)


def motion_band(x: Array, dt: float) -> float:
    """Highest frequency (Hz) at which a signal (N,) stands above its own noise; the Nyquist frequency where it does all along.

    The noise level is the median of the periodogram's upper half, and at each frequency no less than the median of the tenth of
    the band above it, up to three times that level (samples that were brought to an even clock have less noise at the top, but
    what falls by more is a signal); the band ends where a smoothed periodogram last exceeds it eightfold.
    """
    n = len(x)
    if n < SHORTEST:
        return 0.5 / dt
    straight = x - np.linspace(x[0], x[-1], n)
    power = np.abs(np.fft.rfft(straight * np.hanning(n))) ** 2
    width = max(n // 400, 3)
    smooth = np.convolve(power, np.ones(width) / width, mode="same")
    level = float(np.median(power[n // 4 :])) / 0.69
    if level <= 1e-18 * float(smooth.max()):
        return 0.5 / dt
    above = np.flatnonzero(smooth > 8.0 * np.clip(_median_above(power) / 0.69, level, FALLING * level))
    return float((above[-1] + 1 if len(above) else 1) / (n * dt))


FALLING = 3.0
"""Times the noise at the top that noise further down may be: what rows left out do to it."""


def _median_above(power: Array) -> Array:
    """(F,) median of the tenth of a spectrum (F,) that lies above each line, read off at a hundred places."""
    wide = max(len(power) // 10, 8)
    places = np.unique(np.linspace(0, max(len(power) - wide, 0), 100).astype(int))
    tenths = np.lib.stride_tricks.sliding_window_view(power, min(wide, len(power)))
    return np.asarray(np.interp(np.arange(len(power)), places, np.median(tenths[places], axis=1)))


SHORTEST = 64
"""Rows too few to tell motion from noise."""
WHITE = 0.75
"""Mean squared step over twice the variance from which a signal is noise: 1 for white noise, nothing for motion."""
DEGREE = 5
"""Of the splines: their second derivative is still a cubic."""
KNOTS = (2.0, 3.0, 4.0, 6.0, 12.0)
"""Per period of the highest frequency of the motion, of which cross-validation takes one; few suit motion of a sharp band."""
MOST_KNOTS = 0.7
"""Of the rows; more would smooth nothing."""
DIFFERENCES = 4
"""Order of the penalised differences: two above the second derivative, which is wanted."""
PENALTIES = np.arange(-6.0, 7.0, 2.0)
"""Decades of the penalty over the weight of the rows on one coefficient."""
DECADE = 0.1
"""To which share of a decade the penalty is sought."""
CLOSE = 1e-12
"""Share of a signal's variance that a spline may leave, whatever it looks like."""
ROUGH = 0.4
"""Correlation of successive rows of what a spline leaves, beyond which that is motion that it could not follow."""


def _spline(t: Array, x: Array) -> BSpline | None:
    """Penalised spline through a signal (N,) under white noise at rising times (N,) in s; None: no noise can be told.

    Knots evenly over the rows and a penalty on differences of their coefficients; how many and how much generalised
    cross-validation says (Eilers and Marx 1996; Craven and Wahba 1979). With a penalty it falls off as the motion does. By knots
    alone all noise passes up to their band: differentiated twice, that is what a lag would seem to take away. Unlike a filter it
    needs no continuation beyond the ends. None for a signal without noise or too quick for its rows.
    """
    n = len(x)
    if n < SHORTEST:
        return None
    even = np.interp(np.linspace(t[0], t[-1], n), t, x)
    band = motion_band(even, 1.0)
    if band >= 0.5 or KNOTS[0] * band > MOST_KNOTS:
        return None
    counts = sorted({max(round(min(knots * band, MOST_KNOTS) * n), 4) for knots in KNOTS})
    _, found = min((_penalised(t, x, pieces) for pieces in counts), key=lambda one: one[0])
    left = x - found(t)
    close = float(left @ left) < CLOSE * n * float(np.var(x))
    return found if close or abs(float(left[1:] @ left[:-1])) < ROUGH * float(left @ left) else None


def _penalised(t: Array, x: Array, pieces: int) -> tuple[float, BSpline]:
    """What cross-validation says of the best penalty for a spline of so many pieces, and that spline."""
    n = len(x)
    inner = np.interp(np.linspace(0.0, n - 1.0, pieces + 1), np.arange(n), t)
    # Beyond the ends as at the ends: knots that coincide there would make a straight line rough.
    beyond = np.arange(1, DEGREE + 1)
    before, after = inner[0] - beyond[::-1] * (inner[1] - inner[0]), inner[-1] + beyond * (inner[-1] - inner[-2])
    places = np.concatenate([before, inner, after])
    basis = BSpline.design_matrix(t, places, DEGREE)
    count, onto = basis.shape[1], basis.T @ x
    rough = np.diff(np.eye(DIFFERENCES + 1), DIFFERENCES, axis=0)[0] if count > DIFFERENCES else np.zeros(1)
    differ = diags_array(list(rough), offsets=range(len(rough)), shape=(count - len(rough) + 1, count))
    gram, penalty = (_upper(matrix) for matrix in (basis.T @ basis, (n / pieces) * (differ.T @ differ)))
    told, charged = _spectra(count)

    def solved(decade: float) -> tuple[float, Array]:
        weight = 10.0**decade
        try:
            factors = solveh_banded(gram + weight * penalty, onto)
        except np.linalg.LinAlgError:  # knots without rows between them, and hardly a penalty
            return np.inf, np.zeros(count)
        free = float(np.sum(told / (told + weight * charged)))
        # By the rows' own products: the spline itself takes ten times as long to evaluate.
        left = x - basis @ factors
        return float(left @ left) / (1.0 - free / n) ** 2, factors

    first = float(min(PENALTIES, key=lambda decade: solved(float(decade))[0]))
    step = float(PENALTIES[1] - PENALTIES[0])
    near = first - step, first + step
    best = minimize_scalar(lambda at: solved(at)[0], bounds=near, method="bounded", options={"xatol": DECADE})
    score, factors = solved(float(best.x))
    return score, BSpline(places, factors, DEGREE)


def _upper(matrix: sparray) -> Array:
    """(DEGREE + 1, K) upper bands of a symmetric banded matrix, as LAPACK keeps them."""
    out = np.zeros((DEGREE + 1, matrix.shape[0]))
    for k in range(min(DEGREE + 1, matrix.shape[0])):
        out[DEGREE - k, k:] = matrix.diagonal(k)
    return out


def _spectra(count: int) -> tuple[Array, Array]:
    """(K,) eigenvalues of a spline's rows and of its penalty, per row on one coefficient, away from the ends.

    There both matrices say the same of every coefficient (Toeplitz), and what they do to a wave over these is a number.
    """
    wave = np.pi * np.arange(count) / count
    product = BSpline.basis_element(np.arange(2 * DEGREE + 3) - (DEGREE + 1.0))(np.arange(DEGREE + 1.0))
    told = product[0] + 2.0 * np.cos(np.outer(wave, np.arange(1, DEGREE + 1))) @ product[1:]
    return told, (2.0 - 2.0 * np.cos(wave)) ** DIFFERENCES


def denoised(time: Array, x: Array, segments: list[slice]) -> Array:
    """Signals (N, n) over time (N,) in s without their white noise, each segment by itself: penalised splines through them.

    A signal in which no noise can be told stays as it is.
    """
    out = x.copy()
    for part in segments:
        t = time[part] - time[part.start]
        if len(t) < NARROW or np.any(np.diff(t) <= 0):
            continue
        for j in range(x.shape[1]):
            found = _spline(t, x[part, j])
            if found is not None:
                out[part, j] = found(t)
    return out


def _filtered(x: Array, dt: float, band: float | None) -> Array:
    """(3, N) signal low-passed at a band (Hz; else its own), first and second derivative."""
    plain = low_passed(x, dt, band or motion_band(x, dt))
    return np.stack([plain, *_rates(plain, dt)])


def low_passed(x: Array, dt: float, band: float) -> Array:
    """Signal (N,) without what lies above `CUT` times the band (Hz): a Butterworth filter forth and back, no phase."""
    cut = 2.0 * CUT * band * dt
    if cut >= 0.8 or len(x) < 30:
        return x
    return np.asarray(sosfiltfilt(butter(3, max(cut, 1e-4), output="sos"), x, padlen=min(len(x) - 1, int(6.0 / cut))))


def smoothed(time: Array, x: Array, segments: list[slice], band: float, *, bridge: bool = False) -> Array:
    """Signals (N, k) through the low-pass of `derivatives`, each segment by itself; what is not measured (NaN) stays so.

    Uneven samples go over an even grid. With `bridge`, isolated samples far off their neighbours do not spread.
    """
    out = x.copy()
    for part in segments:
        t = time[part]
        if len(t) < NARROW or t[-1] <= t[0] or np.any(np.diff(t) <= 0):
            continue
        dt = float(np.median(np.diff(t)))
        grid = np.linspace(t[0], t[-1], max(round((t[-1] - t[0]) / dt) + 1, NARROW))
        for j in range(x.shape[1]):
            good = np.isfinite(x[part, j])
            if bridge:
                good &= ~isolated(x[part, j])
            if good.sum() < NARROW:
                continue
            smooth = low_passed(np.interp(grid, t[good], x[part, j][good]), float(grid[1] - grid[0]), band)
            out[part, j] = np.where(np.isfinite(x[part, j]), np.interp(t, grid, smooth), np.nan)
    return out


LINE, ALONE_BY = 60.0, 4.0
"""Power of a line over the median of the spectrum that noise never has, exp(-40) in one place; and over the next line."""
FOOT = 5
"""Lines on either side that a line's window spreads it over, and that its phase's wander does."""


def has_line(x: Array, dt: float, above: float) -> bool:
    """Whether a signal (N,) holds one narrow line, and no row of lines, above a frequency (Hz)."""
    n = len(x)
    first = max(int(np.ceil(above * n * dt)), 1)
    if n < SHORTEST or n // 2 - first < SHORTEST or not np.isfinite(x).all():
        return False
    power = np.abs(np.fft.rfft((x - np.mean(x)) * np.hanning(n)))[first:] ** 2
    peak = int(np.argmax(power))
    others = np.delete(power, np.s_[max(peak - FOOT, 0) : peak + FOOT + 1])
    return bool(power[peak] > max(LINE * float(np.median(others)), ALONE_BY * float(np.max(others))) > 0.0)


ALONE, AROUND = 3, 101
"""So many samples in a row may be isolated, more are an event; and of so many around nine of ten say what is usual."""


def isolated(x: Array) -> NDArray[np.bool_]:
    """(N,) samples, at most three in a row, that stand out to one side of what lies before and after them.

    How far a sample stands out is the smaller of its distances to the third one before and after, where both have one sign;
    zero on slopes, steps and ramps. It must be six times what nine samples of ten around it stay below, and twice what the
    signal itself changes there from the sixth sample to the third (a cusp is no spike).
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
    around = percentile_filter(out, 90, size=AROUND, mode="nearest" if n >= AROUND else "reflect")
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
    """First and second derivative (N, n) of signals (N, n) over time (N,) in s, each segment by itself.

    A measured velocity is believed and differentiated once. Noise is smoothed away, by a penalised spline (if `fine`; commands
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
            found = _spline(t, source) if fine and band is None else None
            derived = _on_grid(t, source, band) if found is None else [found(t), found(t, 1), found(t, 2)]
            first[part, j], second[part, j] = derived[1:] if measured is None else derived[:2]
    return first, second


def _on_grid(t: Array, x: Array, band: float | None) -> Array:
    """What `_filtered` gives of a signal (N,) at times (N,), by way of an even grid where they are uneven."""
    dt = float(np.median(np.diff(t)))
    grid = np.linspace(t[0], t[-1], max(round((t[-1] - t[0]) / dt) + 1, NARROW))
    step = float(grid[1] - grid[0])
    if len(grid) == len(t) and np.max(np.abs(grid - t)) < 0.02 * dt:
        return _filtered(x, step, band)
    return np.asarray(CubicSpline(grid, _filtered(np.interp(grid, t, x), step, band), axis=1)(t))


MEDIAN_OF_NORMAL = 0.6745
"""Median size of what is normal with a standard deviation of one."""
STILL_ROWS = 8
"""Rows of which the mean is one value where a rest is sought."""
STILL_S = 1.0
"""Shortest rest that is worth finding, in s."""
STILL = 3.5
"""Standard errors by which a mean may be away from the rest that it is part of."""
STILL_SUM = 2.0
"""And standard deviations by which the sum of their squares may exceed what noise makes: a slow motion is no rest."""


def at_rest(time: Array, x: Array, segments: list[slice]) -> Array:
    """Signals (N, n) over time (N,) in s with the mean of each rest in its place, as far as their own noise can tell rests.

    At rest a reading holds noise alone (successive rows know nothing of each other); a whole segment may be one.
    """
    out = x.copy()
    for part in segments:
        if part.stop - part.start < SHORTEST:
            continue
        spread = np.var(x[part], axis=0)
        white = np.mean(np.diff(x[part], axis=0) ** 2, axis=0) > WHITE * 2.0 * spread
        out[part] = np.where(white & (spread > 0.0), np.mean(x[part], axis=0), x[part])
        length = max(math.ceil(STILL_S / float(np.median(np.diff(time[part]))) / STILL_ROWS), 3)
        for j in np.flatnonzero(~white):
            for rest in _rests(x[part, j], length):
                at = slice(part.start + rest.start, part.start + rest.stop)
                out[at, j] = np.mean(x[at, j])
    return out


def row_noise(x: Array, segments: list[slice]) -> float:
    """Standard deviation of the white noise of a signal (N,), in its unit; nan where no segment has five rows.

    By the median of fourth differences, in which noise has 70 times its variance and what moves at the pace of an arm is gone.
    """
    every = np.concatenate([np.diff(x[part], 4) for part in segments])
    return float(np.nanmedian(np.abs(every))) / (MEDIAN_OF_NORMAL * math.sqrt(70.0)) if len(every) else math.nan


def _rests(x: Array, shortest: int) -> Iterator[slice]:
    """Runs of rows of a noisy signal (N,) that stays where it is, of at least `shortest` times `STILL_ROWS` rows.

    Means of a few rows each stay within what the noise of a row makes of them, each and as a whole.
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
            if n and abs(means[last] - total / n) > STILL * math.sqrt(1.0 + 1.0 / n):
                break
            total, last = total + means[last], last + 1
        n = last - first
        if n >= shortest and _stays(means[first:last]):
            # The means at either end may hold the first of a move.
            yield slice((first + 1) * STILL_ROWS, (last - 1) * STILL_ROWS)
            first = last
        else:
            first += max(n // 4, 1)


def _stays(z: Array) -> bool:
    """Whether values (n,) of unit variance are that alone: no coarser means of them, down to two, are further apart."""
    while len(z) >= 2:
        if float(np.sum((z - z.mean()) ** 2)) > len(z) - 1 + STILL_SUM * math.sqrt(2.0 * (len(z) - 1)):
            return False
        z = (z[: len(z) // 2 * 2].reshape(-1, 2).sum(axis=1)) / math.sqrt(2.0)
    return True


END = 0.6
"""So many periods of the low-pass's cut-off from an end of a segment derivatives are a guess: half of their rows are missing."""
LONGEST_END_S = 1.0
MOST_OF_SEGMENT = 0.05
"""Of a segment's time, at either end: a joint that rests has no band, and must not cost the recording."""


def ends(time: Array, x: Array, segments: list[slice], band: float | None = None) -> NDArray[np.bool_]:
    """(N,) rows so near to an end of their segment that derivatives of the signals (N, n) over time (N,) in s are not known.

    The band is that of the low-pass in Hz; found here, the lowest of the signals counts. Few rows of each segment.
    """
    out = np.zeros(len(x), dtype=bool)
    for part in segments:
        t = time[part]
        if len(t) < NARROW or t[-1] <= t[0] or np.any(np.diff(t) <= 0):
            continue
        dt = float(np.median(np.diff(t)))
        lowest = min((band or motion_band(column, dt) for column in x[part].T), default=0.5 / dt)
        reach = min(END / (CUT * lowest), LONGEST_END_S, MOST_OF_SEGMENT * float(t[-1] - t[0]))
        out[part] = (t < t[0] + reach) | (t > t[-1] - reach)
    return out

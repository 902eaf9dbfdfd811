"""Penalised splines through noisy signals, and up to which frequency a signal is motion."""

import numpy as np
from scipy.interpolate import BSpline
from scipy.linalg import solveh_banded
from scipy.optimize import minimize_scalar
from scipy.sparse import diags_array, sparray

from galen_hw.spatial import Array

SHORTEST = 64
"""Rows too few to tell motion from noise."""
DEGREE = 5
"""Of the splines: their second derivative is still a cubic."""
MOST_KNOTS = 0.7
"""Of the rows; more would smooth nothing."""
DIFFERENCES = 4
"""Order of the penalised differences: two above the second derivative, which is wanted."""


def motion_band(x: Array, dt: float, *, falling: float = 3.0) -> float:
    """Return the highest frequency (Hz) at which a signal (N,) stands above its noise; the Nyquist frequency if it always does.

    The noise level is the median of the periodogram's upper half, and at each frequency no less than the median of the tenth of
    the band above it, up to three times that level (samples that were brought to an even clock have less noise at the top, but
    what falls by more is a signal); the band ends where a smoothed periodogram last exceeds it eightfold.

    Args:
        falling: times the noise at the top that noise further down may be: what rows left out do to it.
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
    above = np.flatnonzero(smooth > 8.0 * np.clip(_median_above(power) / 0.69, level, falling * level))
    return float((above[-1] + 1 if len(above) else 1) / (n * dt))


def _median_above(power: Array) -> Array:
    """Return the median (F,) of the tenth of a spectrum (F,) that lies above each line, read off at a hundred places."""
    wide = max(len(power) // 10, 8)
    places = np.unique(np.linspace(0, max(len(power) - wide, 0), 100).astype(int))
    tenths = np.lib.stride_tricks.sliding_window_view(power, min(wide, len(power)))
    return np.asarray(np.interp(np.arange(len(power)), places, np.median(tenths[places], axis=1)))


def spline(
    t: Array,
    x: Array,
    *,
    counted: tuple[float, ...] = (2.0, 3.0, 4.0, 6.0, 12.0),
    exact: float = 1e-12,
    rough: float = 0.4,
) -> BSpline | None:
    """Return a penalised spline through a signal (N,) under white noise at rising times (N,) in s; None: no noise can be told.

    Knots evenly over the rows and a penalty on differences of their coefficients; how many and how much generalised
    cross-validation says (Eilers and Marx 1996; Craven and Wahba 1979). With a penalty it falls off as the motion does. By knots
    alone all noise passes up to their band: differentiated twice, that is what a lag would seem to take away. Unlike a filter it
    needs no continuation beyond the ends. None for a signal without noise or too quick for its rows.

    Args:
        counted: knots per period of the highest frequency of the motion, of which cross-validation takes one; few
            suit motion of a sharp band.
        exact: share of a signal's variance that a spline may leave, whatever it looks like.
        rough: correlation of successive rows of what a spline leaves, beyond which that is motion that it could
            not follow.
    """
    n = len(x)
    if n < SHORTEST:
        return None
    even = np.interp(np.linspace(t[0], t[-1], n), t, x)
    band = motion_band(even, 1.0)
    if band >= 0.5 or counted[0] * band > MOST_KNOTS:
        return None
    counts = sorted({max(round(min(knots * band, MOST_KNOTS) * n), 4) for knots in counted})
    _, found = min((_penalised(t, x, pieces) for pieces in counts), key=lambda one: one[0])
    left = x - found(t)
    close = float(left @ left) < exact * n * float(np.var(x))
    return found if close or abs(float(left[1:] @ left[:-1])) < rough * float(left @ left) else None


def _penalised(
    t: Array,
    x: Array,
    pieces: int,
    *,
    tolerance: float = 0.1,
    decades: tuple[float, ...] = (-6.0, -4.0, -2.0, 0.0, 2.0, 4.0, 6.0),
) -> tuple[float, BSpline]:
    """Return the cross-validation of the best penalty for a spline of so many pieces, and that spline.

    Args:
        tolerance: to which share of a decade the penalty is sought.
        decades: of the penalty over the weight of the rows on one coefficient.
    """
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

    first = float(min(decades, key=lambda decade: solved(float(decade))[0]))
    step = float(decades[1] - decades[0])
    near = first - step, first + step
    best = minimize_scalar(lambda at: solved(at)[0], bounds=near, method="bounded", options={"xatol": tolerance})
    score, factors = solved(float(best.x))
    return score, BSpline(places, factors, DEGREE)


def _upper(matrix: sparray) -> Array:
    """Return the upper bands (DEGREE + 1, K) of a symmetric banded matrix, as LAPACK keeps them."""
    out = np.zeros((DEGREE + 1, matrix.shape[0]))
    for k in range(min(DEGREE + 1, matrix.shape[0])):
        out[DEGREE - k, k:] = matrix.diagonal(k)
    return out


def _spectra(count: int) -> tuple[Array, Array]:
    """Return eigenvalues (K,) of a spline's rows and of its penalty, per row on one coefficient, away from the ends.

    There both matrices say the same of every coefficient (Toeplitz), and what they do to a wave over these is a number.
    """
    wave = np.pi * np.arange(count) / count
    product = BSpline.basis_element(np.arange(2 * DEGREE + 3) - (DEGREE + 1.0))(np.arange(DEGREE + 1.0))
    told = product[0] + 2.0 * np.cos(np.outer(wave, np.arange(1, DEGREE + 1))) @ product[1:]
    return told, (2.0 - 2.0 * np.cos(wave)) ** DIFFERENCES

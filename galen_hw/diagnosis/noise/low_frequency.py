"""The noise spectrum below the slowest measured band: a low-frequency plateau, flicker noise or a random walk.

Noise with a memory (a filter, a servo, a settling converter) is flat below its corner; flicker noise goes on rising. Both are
fitted to the measured bands by their likelihood (Whittle 1953), and a corner is accepted where it is significantly better. What
rises more steeply than flicker noise has its corner just below, or is a random walk. A random walk is a drift, not noise: its
slow end must not pass for noise. A correlation time above a thirtieth of the recording counts as a random walk.
"""

from typing import TYPE_CHECKING

import numpy as np
from scipy.fft import dct
from scipy.stats import chi2

from galen_hw.diagnosis.settings import RESOLUTION
from galen_hw.spatial import Array

if TYPE_CHECKING:
    from galen_hw.diagnosis.stats.sampling import Index, Mask


def plateaus(
    centres: Array,
    levels: Array,
    lines: Array,
    slowest: float,
    *,
    certain: float = 9.0,
    contrary: float = -2.0,
    hidden: float = 1.5,
    steps: int = 15,
    gentle_steps: int = 7,
) -> Array:
    """Return the low-frequency plateau (C,) of each spectrum, a standard error up, or NaN if it is not identified.

    What is significantly steeper than flicker noise gets the slowest corner that noise may have.

    Args:
        centres: (B,) of the bands, cycles a row; levels: (B, C); lines: (B,) of the spectrum in each band.
        slowest: cycles a row, of the slowest corner.
        certain: twice the log likelihood ratio, over all channels, from which a corner is believed; one of
            flicker noise reaches 6.
        contrary: the same ratio below which a channel speaks against what the others say.
        hidden: the same ratio from which there is flicker noise besides the corner: in doubt there is no plateau.
        steps: slopes that are tried, a quarter to two.
        gentle_steps: of these, none steeper than flicker noise.
    """
    if len(centres) < RESOLUTION.fewest:
        return np.full(levels.shape[1], np.nan)
    corners = np.geomspace(1.5 * centres[0], centres[-1], RESOLUTION.corners)
    bends = 1.0 / (1.0 + (centres / corners[:, None]) ** 2)
    slopes = (centres / centres[0]) ** -np.linspace(0.25, 2.0, steps)[:, None]
    white, flicker = np.ones_like(centres), centres[0] / centres
    weights = _independent(lines)
    corner, fitted, which = _likeliest(levels, weights, [np.stack([white, bend], axis=-1) for bend in bends])
    costs, models = _fitted(levels, weights, [np.stack([white, slope], axis=-1) for slope in slopes])
    both, _, _ = _likeliest(levels, weights, [np.stack([white, bend, flicker], axis=-1) for bend in bends])
    # The steepest of the slopes is that of a random walk.
    rising, gentle, walk, walked = costs.min(axis=0), costs[:gentle_steps].min(axis=0), costs[-1], models[-1]
    sure, noise = rising - corner, _like_noise(corner, centres)
    steep = (_like_noise(walk, centres)) & (gentle - walk >= certain)
    flat = noise & (np.sum(sure[noise]) >= certain) & (sure > contrary) & (corner - both < hidden)
    # The plateau is known from the bands below the corner alone; in doubt slow noise is stronger.
    known = np.array([np.sum(weights[centres <= corners[k]]) for k in which])
    plateau = np.where(flat, fitted[0] * (1.0 + 1.0 / np.sqrt(known)), np.nan)
    return np.where(steep & ~flat, walked[0] * (centres[0] / slowest) ** 2, plateau)


def walking(
    centres: Array, levels: Array, lines: Array, modes: Array, rows: int, slowest: float, *, needed: float = 22.0
) -> "Mask":
    """Return which channels (C,) contain a random walk: their spectrum rises as 1 / f^2 down to their slowest modes.

    Args:
        modes: (K, C) squares of the half cosines 1 to K over so many rows, below the bands.
        needed: twice the log likelihood ratio from which a channel contains a random walk, as of any effect.

    Other arguments as of `plateaus`. A random walk is compared with noise with a corner above `slowest`, and flicker noise.
    """
    f = np.concatenate([0.5 * np.arange(1, len(modes) + 1) / rows, centres])
    level = np.concatenate([np.maximum(modes, 1e-12 * np.max(levels, axis=0)), levels])
    # A single line is chi square of one, and so counts half.
    weights = np.concatenate([np.full(len(modes), 0.5), _independent(lines)])
    white, flicker = np.ones_like(f), f[0] / f
    bends = [1.0 / (1.0 + (f / corner) ** 2) for corner in np.geomspace(slowest, centres[-1], RESOLUTION.corners)]
    forgets, _, _ = _likeliest(level, weights, [np.stack([white, bend, flicker], axis=-1) for bend in bends])
    walk, walked, _ = _likeliest(level, weights, [np.stack([white, flicker**2], axis=-1)])
    like = _like_noise(_deviance(levels, walked[len(modes) :], weights[len(modes) :]), centres)
    return np.asarray(like & (forgets - walk > needed))


def deviances(residual: Array, runs: "list[slice]", slowest: float) -> Array:
    """Return the deviance (C,) of a residual (M, C) as noise: white, and where that pays with a memory or flicker noise too.

    Minus twice the log likelihood of the lines of the cosine transform of every run (Whittle 1953), in bands as fine as the
    corners that are tried, with the BIC penalty of the noise's own parameters; constants that all residuals share are left out.
    The mean of a run counts where there are several: of one alone it is the offset.

    Args:
        slowest: cycles a row, of the slowest corner.
    """
    first = 0 if len(runs) > 1 else 1
    cycles = [np.maximum(np.arange(run.stop - run.start), 0.5)[first:] / (2.0 * (run.stop - run.start)) for run in runs]
    f = np.concatenate(cycles)
    lines = np.concatenate([dct(residual[run], axis=0, norm="ortho")[first:] ** 2 for run in runs])
    edges = np.geomspace(f.min(), 0.5, RESOLUTION.corners)
    _, band = np.unique(np.searchsorted(edges, f, side="right"), return_inverse=True)
    count = np.bincount(band).astype(float)
    centres = np.exp(np.bincount(band, np.log(f)) / count)
    levels = np.stack([np.bincount(band, line) / count for line in lines.T], axis=-1)
    levels = np.maximum(levels, 1e-12 * levels.max(axis=0))
    white, flicker = np.ones_like(centres), centres[0] / centres
    bends = [1.0 / (1.0 + (centres / corner) ** 2) for corner in np.geomspace(slowest, 0.5, RESOLUTION.corners)]
    models = {
        1: [[white]],
        2: [[white, flicker]],
        3: [[white, bend] for bend in bends],
        4: [[white, bend, flicker] for bend in bends],
    }
    # A line of a cosine transform is chi square of one, and counts half.
    each = (
        _likeliest(levels, 0.5 * count, [np.stack(one, axis=-1) for one in shapes])[0] + number * np.log(len(f))
        for number, shapes in models.items()
    )
    return np.asarray(np.min(list(each), axis=0) + np.sum(count[:, None] * np.log(levels), axis=0))


def whitest(levels: Array, lines: Array, *, chance: float = 0.01) -> Array:
    """Return levels (B, C) of few bands, equal where white noise may well have them: whitening by scatter adds structure.

    Arguments as of `plateaus`. The deviance of one level for all bands is chi square of B - 1.

    Args:
        chance: with which white noise may look more coloured than that.
    """
    weights = _independent(lines)[:, None]
    one = np.sum(weights * levels, axis=0) / np.sum(weights)
    deviance = 2.0 * np.sum(weights * (levels / one - np.log(levels / one) - 1.0), axis=0)
    return np.where(deviance < chi2.isf(chance, len(levels) - 1), one, levels)


def smoothed(
    centres: Array, levels: Array, lines: Array, *, powers: tuple[float, float, int] = (-3.0, 5.0, 33)
) -> Array:
    """Return the smoothed levels (B, C) of a spectrum: the scatter of the bands is reduced, a power law is not.

    A smoothing spline of the logarithms, whose stiffness is the likeliest one (restricted likelihood; Wahba 1985), the scatter of
    a band being known from its number of lines. Arguments as of `plateaus`.

    Args:
        powers: first and last power of ten, and number, of stiffnesses against bending, per band: from none to a straight line.
    """
    count = len(centres)
    if count < RESOLUTION.fewest:
        return levels
    u, weights = np.log(centres), _independent(lines)
    bend = np.zeros((count - 2, count))
    for k in range(count - 2):
        left, right = u[k + 1] - u[k], u[k + 2] - u[k + 1]
        bend[k, k : k + 3] = [2.0 / (left * (left + right)), -2.0 / (left * right), 2.0 / (right * (left + right))]
    against = bend.T @ bend
    out = np.empty_like(levels)
    for c, y in enumerate(np.log(levels).T):
        best = np.inf
        for stiffness in 10.0 ** np.linspace(*powers):
            whole = np.diag(weights) + stiffness * against
            fit = np.linalg.solve(whole, weights * y)
            cost = float(np.linalg.slogdet(whole)[1] - (count - 2) * np.log(stiffness) + (y - fit) @ (weights * y))
            if cost < best:
                best, out[:, c] = cost, np.exp(fit)
    return out


def _independent(lines: Array) -> Array:
    """Return the number (B,) of independent lines in each band: of a Hann window's spectrum 1.94 lines are worth one.

    Neighbours correlate by 2/3, the next ones by 1/6: 1 + 2 (4/9 + 1/36).
    """
    return np.asarray(np.maximum(lines, 1.0) / 1.94)


def _like_noise(deviance: Array, centres: Array, *, most: float = 3.0) -> "Mask":
    """Return whether a deviance (C,) over bands is one of noise, about 1 a band; a residual with physics has humps.

    Args:
        most: deviance a band.
    """
    return np.asarray(deviance < most * len(centres))


def _likeliest(levels: Array, weights: Array, shapes: list[Array]) -> tuple[Array, Array, "Index"]:
    """Return the best of several sums of shapes (B, K), amplitudes >= 0: deviance (C,), levels (B, C), index (C,)."""
    costs, models = _fitted(levels, weights, shapes)
    best = np.argmin(costs, axis=0)
    each = np.arange(levels.shape[1])
    return np.asarray(costs[best, each]), np.asarray(models[best, :, each].T), best


def _fitted(levels: Array, weights: Array, shapes: list[Array], *, updates: int = 150) -> tuple[Array, Array]:
    """Fit several sums of shapes (B, K), amplitudes >= 0, and return deviances (S, C) and levels (S, B, C).

    Deviance: minus twice the log likelihood over that of the levels themselves, chi square of B less the fitted amplitudes.

    Multiplicative updates for the Itakura-Saito divergence, which is this likelihood (Fevotte, Bertin and Durrieu 2009).

    Args:
        updates: of the amplitudes.
    """
    parts = np.stack(shapes)
    peak = np.max(levels, axis=0)
    data = levels / peak
    amplitude = np.full((len(parts), parts.shape[2], levels.shape[1]), 1.0 / parts.shape[2])
    for _ in range(updates):
        model = np.maximum(parts @ amplitude, 1e-12)
        pull = np.swapaxes(parts, 1, 2) * weights
        amplitude *= (pull @ (data / model**2)) / (pull @ (1.0 / model))
    model = np.maximum(parts @ amplitude, 1e-12)
    return _deviance(data, model, weights), np.asarray(model * peak)


def _deviance(levels: Array, model: Array, weights: Array) -> Array:
    """Return minus twice the log likelihood (..., C) of levels (B, C) over that of the levels themselves."""
    ratio = levels / model
    return np.asarray(2.0 * np.sum(weights[:, None] * (ratio - np.log(ratio) - 1.0), axis=-2))

"""Estimation of every channel's noise spectrum from the residual of a rich fit (residual likelihood)."""

import numpy as np

from galen_hw.diagnosis.noise.low_frequency import whitest
from galen_hw.diagnosis.noise.spectrum import Noise
from galen_hw.diagnosis.settings import RESOLUTION
from galen_hw.diagnosis.stats.sampling import Rows
from galen_hw.spatial import Array


def estimate(
    residual: Array,
    basis: list[Array],
    rows: Rows,
    *,
    ordered: bool,
    steps: Array,
    above: float = 0.0,
    static_poses: bool = False,
) -> Noise:
    """Return the noise estimated from the residual (M, C) of a fit with an orthonormal basis (M, r) in each channel.

    Args:
        residual, basis: of the fit; rows: of the bench; ordered: if not, noise is white; steps: of rounded readings.
        above: cycles a row below which the residual may contain physics: there the level at that frequency is taken.
        static_poses: whether each row is a separate pose, so that what neighbouring rows share is no noise.
    """
    M, C = residual.shape
    freedom = np.array([max(M - b.shape[1], 2) for b in basis], dtype=float)
    sigma = np.sqrt(np.sum(residual**2, axis=0) / freedom)
    sigma = np.maximum(sigma, 1e-12 * (np.max(np.abs(residual)) + 1e-300) + 1e-15)
    with np.errstate(invalid="ignore"):  # of a channel that the fit leaves nothing of
        correlation = np.nan_to_num(np.corrcoef((residual / sigma).T)) if C > 1 else np.ones((1, 1))
    np.fill_diagonal(correlation, 1.0)
    long = [run for run in rows.runs if run.stop - run.start >= RESOLUTION.shortest]
    if not ordered or not long:
        sigma = np.minimum(sigma, _by_neighbours(residual, sigma, freedom, rows)) if static_poses else sigma
        return Noise(rows, np.empty(0), np.empty((0, C)), sigma, float(freedom.sum()), correlation, steps)
    lengths = [run.stop - run.start for run in long]
    edges = _bands(sum(lengths), max(lengths))
    levels = np.stack([_levels(residual[:, c], basis[c], long, edges, above) for c in range(C)], axis=-1)
    if len(levels) < RESOLUTION.fewest:
        levels = whitest(levels, sum(lengths) * np.diff(edges))
    noise = Noise(rows, edges, levels, sigma, float(freedom.sum()), correlation, steps)
    # The variance is the integral of the bands, so that sigma contains the slow part too, as far as it was measured.
    f = np.maximum((np.arange(4096) + 0.5) / 8192, np.sqrt(edges[0] * edges[1]))
    total = np.sqrt(np.mean(noise.spectrum(f), axis=0))
    # A reading is off by its rounding, however little it changes where the machine stands most of the time.
    least = np.maximum(steps / np.sqrt(12.0 * rows.stride) / total, 1.0)
    return Noise(rows, edges, levels * least**2, total * least, float(freedom.sum()), correlation, steps)


def _by_neighbours(residual: Array, sigma: Array, freedom: Array, rows: Rows, *, surely: float = 2.5) -> Array:
    """Return the standard deviation (C,) from differences of neighbours, where these are surely smaller than sigma's (C,).

    In white noise half the mean squared difference over the variance is 1, with a deviation of 1 / sqrt(n) (von Neumann 1941).

    Args:
        surely: standard deviations of that ratio by which the differences must be smaller.
    """
    difference = np.concatenate([np.diff(residual[run], axis=0) for run in rows.runs])
    square = 0.5 * np.mean(difference**2, axis=0) * len(residual) / freedom
    return np.where(square < (1.0 - surely / np.sqrt(freedom)) * sigma**2, np.sqrt(square), sigma)


def _bands(n: int, longest: int, *, lines: int = 18, per_decade: int = 6, slowest: float = 7.0) -> Array:
    """Return band limits in cycles a row: at least so many lines in a band, equal ratios where there are more.

    Args:
        n: rows of all runs; longest: of one.
        lines: in a band; per_decade: bands.
        slowest: cycles in all runs below which the spectrum is continued, not measured.
    """
    # A Hann window lets the mean of a run into its first line, and no further.
    edges, ratio = [max(slowest / n, 2.0 / longest)], 10.0 ** (1.0 / per_decade)
    while edges[-1] < 0.5:
        edges.append(max(edges[-1] * ratio, edges[-1] + max(lines / n, 1.0 / longest)))
    if len(edges) > 2 and 0.5 - edges[-2] < lines / n:
        edges.pop(-2)
    return np.array([*edges[:-1], 0.5])


def _levels(
    residual: Array, basis: Array, runs: list[slice], edges: Array, above: float, *, least: float = 5.0
) -> Array:
    """Return the level (B,) of each band: the residual's power over the share of the band outside the rich basis.

    The residual of a fit with an orthonormal basis Q has at frequency f the expected power (1 - t) S, t the basis' own power
    there (residual likelihood; Patterson and Thompson 1971, in the frequency domain).

    Args:
        least: lines of a band outside the rich basis; with fewer it is not measured, but interpolated.
    """
    lines, free, place = [], [], []
    for run in runs:
        n = run.stop - run.start
        window = np.hanning(n + 2)[1:-1]
        window /= np.sqrt(np.mean(window**2))
        f = np.fft.rfftfreq(n)
        lines.append(np.abs(np.fft.rfft(residual[run] * window)) ** 2 / n)
        taken = np.zeros(len(f))
        for start in range(0, basis.shape[1], 32):
            part = basis[run, start : start + 32] * window[:, None]
            taken += np.sum(np.abs(np.fft.rfft(part, axis=0)) ** 2, axis=1) / n
        free.append(np.clip(1.0 - taken, 0.0, 1.0))
        place.append(np.where(f * n > 1.5, np.searchsorted(edges, f, side="right") - 1, -1).clip(-1, len(edges) - 2))
    line, reachable, band = np.concatenate(lines), np.concatenate(free), np.concatenate(place)
    level = np.full(len(edges) - 1, np.nan)
    for b in range(len(level)):
        inside = (band == b) & (reachable > 0.02)
        if np.sum(reachable[inside]) < least or edges[b] < above:
            continue
        # A single line (mains, a periodic motion) must not pass for noise; of few lines one may well be large by chance.
        single, usable = line[inside] / reachable[inside], reachable[inside] > 0.3
        many = usable.sum() >= 12 and len(level) >= RESOLUTION.fewest
        usual = np.median(single[usable]) / 0.69 if many else np.inf
        good = single < 8.0 * usual
        level[b] = np.sum(line[inside][good]) / np.sum(reachable[inside][good])
    return _filled(level, edges)


def _filled(level: Array, edges: Array) -> Array:
    """Return levels with unmeasured bands interpolated in logarithms, as the nearest band at the ends.

    At the slow end this may be too little noise: what is then chosen too boldly goes when the noise is learnt again from the
    first model's residual.
    """
    centres, known = np.log(np.sqrt(edges[1:] * edges[:-1])), np.isfinite(level) & (level > 0.0)
    if not known.any():
        return np.full(len(level), 1e-30)
    level = np.exp(np.interp(centres, centres[known], np.log(level[known])))
    return np.asarray(np.maximum(level, 1e-7 * level.max() + 1e-30))


def quantisation(y: Array) -> Array:
    """Return the quantisation step (C,) of readings (N, C), 0 where they are not on a grid.

    The step is what the smallest distances of readings are; nearly all distances are whole numbers of it. Readings that are all
    different have the step of the digits that they were written with.
    """
    out = np.zeros(y.shape[1])
    for c in range(y.shape[1]):
        values = np.unique(y[np.isfinite(y[:, c]), c])
        if len(values) < 3:
            continue
        gaps = np.diff(values)
        step = float(np.median(gaps[gaps < 1.5 * np.quantile(gaps, 0.01)]))
        ratio = gaps / step
        if np.mean(np.abs(ratio - np.round(ratio)) < 0.05) > 0.9:
            out[c] = step
    return out

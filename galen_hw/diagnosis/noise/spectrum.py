"""The noise of every channel: its spectrum from what a rich fit leaves, whitening by it, and surrogates that look like it.

The spectrum is a level per logarithmic band, corrected for what the rich fit itself took out of each band. Below the slowest band
that a recording of this length can tell from drift it is continued: flat where it has a corner for certain, else as a power law.
"""

import itertools
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.fft import dct, idct, next_fast_len

from galen_hw.diagnosis.noise.low_frequency import shelves, smoothed, walking, whitest
from galen_hw.diagnosis.noise.resolution import RESOLUTION
from galen_hw.diagnosis.stats.criteria import CRITERIA
from galen_hw.diagnosis.stats.sampling import Mask, Rows
from galen_hw.lazy import cached_property
from galen_hw.spatial import Array


@dataclass(frozen=True)
class Noise:
    """Noise of C channels on M rows.

    Args:
        rows: the averaging that the rows went through.
        edges: (B + 1,) band limits in cycles a row, empty: white.
        levels: (B, C) spectral level, the variance of one row where white.
        sigma: (C,) standard deviation of one averaged row.
        degrees: degrees of freedom that the estimate rests on.
        correlation: (C, C) between channels.
        steps: (C,) quantisation step of the raw readings, 0 where there is none.
    """

    rows: Rows
    edges: Array
    levels: Array
    sigma: Array
    degrees: float
    correlation: Array
    steps: Array
    kept: dict[tuple[int, float], Array] = field(default_factory=dict, compare=False)

    def spectrum(self, frequency: Array) -> Array:
        """(F, C) level at frequencies in cycles a row."""
        if not len(self.edges):
            return np.tile(self.sigma**2, (len(frequency), 1))
        centres = np.log(self.centres)
        at = np.log(np.maximum(frequency, 0.07 * self.edges[0]))
        channels = zip(np.log(self.levels).T, np.log(self._shelves), strict=True)
        return np.exp(np.stack([_line(at, centres, level, shelf) for level, shelf in channels], axis=-1))

    @cached_property
    def centres(self) -> Array:
        """(B,) of the bands, cycles a row."""
        return np.asarray(np.sqrt(self.edges[1:] * self.edges[:-1]))

    @cached_property
    def lines(self) -> Array:
        """(B,) of the spectrum in each band."""
        return np.asarray(sum(self._lengths) * np.diff(self.edges))

    @property
    def _lengths(self) -> list[int]:
        """Of the runs that are long enough for a spectrum, rows."""
        return [run.stop - run.start for run in self.rows.runs if run.stop - run.start >= RESOLUTION.shortest]

    @property
    def slowest(self) -> float:
        """Corner of the longest memory that noise may have, cycles a row."""
        return RESOLUTION.forgets / (2.0 * np.pi * max(self._lengths))

    @cached_property
    def _shelves(self) -> Array:
        """(C,) level below the slowest band where the noise is known there for certain, else nan."""
        return shelves(self.centres, self.levels, self.lines, self.slowest)

    def walks(self, rest: Array, waves: int) -> Mask:
        """(C,) whether what is left (M, C) of a channel is no noise but a walk; `waves` half cosines lie below the bands."""
        if len(self.centres) < RESOLUTION.fewest or len(self.rows.runs) > 1:
            return np.zeros(len(self.sigma), dtype=bool)
        modes = dct(rest, axis=0, norm="ortho")[1 : 1 + waves] ** 2
        return walking(self.centres, self.levels, self.lines, modes, len(rest), self.slowest)

    def whiten(self, x: Array, channel: int) -> Array:
        """(M, k) columns of one channel, scaled and filtered so that its noise becomes white with unit variance."""
        return self.whitened(self.transformed(x), channel)

    def bridged(self, y: Array, good: Mask) -> Array:
        """(M, C) all channels whitened, rows (M,) that are not good bridged before."""
        out, at = np.empty_like(y), np.flatnonzero(good)
        for c in range(y.shape[1]):
            filled = y[:, c] if good.all() else np.interp(np.arange(len(y)), at, y[at, c])
            out[:, c] = self.whiten(filled[:, None], c)[:, 0]
        return out

    def colour(self, z: Array, channel: int) -> Array:
        """White noise (M, k) turned into noise like the channel's."""
        return self._filtered(self.transformed(z)[:, None], (channel,), 0.5)[:, 0]

    def as_smooth(self, white: Array, channel: int) -> Array:
        """(M, k) whitened columns of one channel, weighed by how much more noise a smooth spectrum has there (root of it).

        The scatter of the measured bands whitens too much here and too little there; what it makes of a fit is told by this.
        """
        if not len(self.edges):
            return white
        out, transformed = np.empty_like(white), self.transformed(white)
        centres = np.log(self.centres)
        for run, place in zip(self.rows.runs, self._places, strict=True):
            if self._coloured(run):
                n = place.stop - place.start
                at = np.log(np.maximum(np.arange(n) / (2.0 * n), 1e-9))
                root = np.exp(0.5 * np.interp(at, centres, self._roughness[:, channel]))
                out[run] = idct(transformed[place] * root[:, None], axis=0)[: run.stop - run.start]
            else:
                out[run] = white[run]
        return out

    @cached_property
    def _roughness(self) -> Array:
        """(B, C) logarithm of a smooth spectrum over the measured one."""
        smooth = smoothed(self.centres, self.levels, self.lines)
        return np.asarray(np.log(smooth / self.levels))

    def without(self, unread: Mask, *, beyond: float = 1e9) -> "Noise":
        """Let channels (C,) that read nothing count for nothing.

        Args:
            beyond: standard deviation of their noise, larger than all that could be in them, in any unit.
        """
        if not unread.any():
            return self
        levels = np.where(unread, beyond**2, self.levels) if len(self.levels) else self.levels
        return replace(self, sigma=np.where(unread, beyond, self.sigma), levels=levels, kept={})

    def flat(self) -> "Noise":
        """White noise at the lowest level of the spectrum: the least that the noise can be."""
        sigma = np.sqrt(np.min(self.levels, axis=0))
        return replace(self, edges=np.empty(0), levels=np.empty((0, len(sigma))), sigma=sigma, kept={})

    def transformed(self, x: Array) -> Array:
        """(P, ...) of rows (M, ...) as `whitened` takes them, P >= M: the part of the work that is the same for all channels.

        The cosine transform of a run is that of the signal with its mirror image behind it: the two ends stay apart. A run of
        an awkward length (a prime) goes on into its mirror image up to one that is transformed quickly.
        """
        out = np.empty((self._places[-1].stop, *x.shape[1:]))
        for run, place in zip(self.rows.runs, self._places, strict=True):
            beyond = (place.stop - place.start) - (run.stop - run.start)
            part = np.concatenate([x[run], x[run.stop - beyond : run.stop][::-1]]) if beyond else x[run]
            out[place] = dct(part, axis=0) if self._coloured(run) else part
        return out

    def whitened(self, transformed: Array, channel: int) -> Array:
        """(M, k) white columns from transformed ones (P, k)."""
        return self._filtered(transformed[:, None], (channel,), -0.5)[:, 0]

    def whitened_each(self, transformed: Array, channels: tuple[int, ...]) -> Array:
        """(M, c, k) white columns of several channels from transformed ones (P, c, k)."""
        return self._filtered(transformed, channels, -0.5)

    def _filtered(self, transformed: Array, channels: tuple[int, ...], power: float) -> Array:
        out = np.empty((len(self.rows), *transformed.shape[1:]))
        for run, place in zip(self.rows.runs, self._places, strict=True):
            if self._coloured(run):
                level = self._levels(place.stop - place.start, power)[:, list(channels)]
                out[run] = idct(transformed[place] * level[:, :, None], axis=0)[: run.stop - run.start]
            else:
                out[run] = transformed[place] * self.sigma[list(channels), None] ** (2.0 * power)
        return out

    def _coloured(self, run: slice) -> bool:
        return len(self.edges) > 0 and run.stop - run.start >= RESOLUTION.shortest

    @cached_property
    def _places(self) -> tuple[slice, ...]:
        """Where each run stands among the transformed rows."""
        lengths = [run.stop - run.start for run in self.rows.runs]
        quick = [int(next_fast_len(n, real=True)) if self._coloured(slice(0, n)) else n for n in lengths]
        edges = np.cumsum([0, *quick]).tolist()
        return tuple(slice(a, b) for a, b in itertools.pairwise(edges))

    def _levels(self, n: int, power: float) -> Array:
        """A power of the spectrum at the frequencies of a cosine transform of length n, kept."""
        if (n, power) not in self.kept:
            self.kept[n, power] = self.spectrum(np.arange(n) / (2.0 * n)) ** power
        return self.kept[n, power]

    def independent(self, rows: int) -> Array:
        """(C,) independent values among so many rows, for the error of a mean square."""
        level = self.spectrum((np.arange(2048) + 0.5) / 4096)
        return np.asarray(rows * np.mean(level, axis=0) ** 2 / np.mean(level**2, axis=0))

    @cached_property
    def slower(self) -> Array:
        """(C,) mean square over all rows, with what is too slow to be measured, over `sigma` squared."""
        return np.asarray(np.maximum(np.mean(self._all, axis=0) / self.sigma**2, 1.0))

    @property
    def wander(self) -> tuple[Array, Array]:
        """(C,) rms of what is slower than a fiftieth of the recording, (C,) of what is quicker."""
        if not len(self.edges):
            return np.zeros_like(self.sigma), self.sigma
        slow, quick = np.split(self._all / len(self.rows), [2 * RESOLUTION.wanders])
        return np.sqrt(slow.sum(axis=0)), np.sqrt(quick.sum(axis=0))

    @property
    def ringing(self) -> tuple[Array, Array]:
        """(C,) frequency, cycles a row, and rms of the band that rings: it holds more than all others and stands out of them.

        nan and 0 where none does. A band that rings is no slow memory: the spectrum falls from it to both sides.
        """
        frequency, size = np.full(len(self.sigma), np.nan), np.zeros(len(self.sigma))
        M = len(self.rows)
        at = np.linspace(0.25 / M, 0.5 - 0.25 / M, M)
        for c in range(len(self.sigma)) if len(self.centres) > 4 else ():
            top = int(np.argmax(self.levels[:, c]))
            far = np.abs(np.arange(len(self.centres)) - top) > 1
            beside = [
                self.levels[side & far, c]
                for side in (self.centres < self.centres[top], self.centres > self.centres[top])
            ]
            if min(map(len, beside)) == 0 or max(map(np.max, beside)) * CRITERIA.outstanding > self.levels[top, c]:
                continue
            own = (at > self.edges[max(top - 1, 0)]) & (at < self.edges[min(top + 2, len(self.edges) - 1)])
            power = self._all[:, c] / M
            if power[own].sum() > power[~own].sum():
                frequency[c], size[c] = self.centres[top], np.sqrt(power[own].sum())
        return frequency, size

    @cached_property
    def _all(self) -> Array:
        """(M, C) level at as many frequencies as there are rows."""
        M = len(self.rows)
        return self.spectrum(np.linspace(0.25 / M, 0.5 - 0.25 / M, M))

    @cached_property
    def slow(self) -> Array:
        """(C,) level that a slow regressor meets."""
        return np.asarray(self.spectrum(np.array([RESOLUTION.slow]))[0])

    @cached_property
    def effective(self) -> float:
        """Number of independent values that a slow regressor meets, over all channels."""
        return float(max(np.sum(len(self.rows) * np.minimum(1.0, self.sigma**2 / self.slow)), 20.0))


def _line(at: Array, centres: Array, level: Array, shelf: float, *, steepest: float = -1.0) -> Array:
    """Linear interpolation; below the first centre the shelf, else along the slope of the slowest decade (at most `steepest`).

    Args:
        steepest: power of the frequency of flicker noise: slower wander than a recording can tell from drift is
            called drift.
    """
    out = np.interp(at, centres, level)
    below = at < centres[0]
    if np.isfinite(shelf):
        out[below] = shelf
        return out
    slowest = centres < centres[0] + 1.5 * np.log(10.0)
    slope = _slope(centres[slowest], level[slowest]) if slowest.sum() >= 3 else 0.0
    out[below] = level[0] + min(max(slope, steepest), 0.0) * (at[below] - centres[0])
    return out


def _slope(x: Array, y: Array) -> float:
    """Least squares, less its own standard error: in doubt slow noise is stronger."""
    A = np.stack([np.ones_like(x), x - x[0]], axis=-1)
    inverse = np.linalg.inv(A.T @ A)
    value = inverse @ A.T @ y
    rest = y - A @ value
    return float(value[1] - np.sqrt(rest @ rest / max(len(x) - 2, 1) * inverse[1, 1]))


def estimate(
    rest: Array,
    basis: list[Array],
    rows: Rows,
    *,
    ordered: bool,
    steps: Array,
    above: float = 0.0,
    apart: bool = False,
) -> Noise:
    """Noise from what is left (M, C) after a fit with an orthonormal basis (M, r) in each channel.

    Args:
        rest, basis: of the fit; rows: of the bench; ordered: if not, noise is white; steps: of rounded readings.
        above: cycles a row below which physics may still be in the rest: there the noise is taken as at that frequency.
        apart: whether each row is a pose by itself, so that what rows next to each other share is no noise.
    """
    M, C = rest.shape
    freedom = np.array([max(M - b.shape[1], 2) for b in basis], dtype=float)
    sigma = np.sqrt(np.sum(rest**2, axis=0) / freedom)
    sigma = np.maximum(sigma, 1e-12 * (np.max(np.abs(rest)) + 1e-300) + 1e-15)
    with np.errstate(invalid="ignore"):  # of a channel that reads nothing
        correlation = np.nan_to_num(np.corrcoef((rest / sigma).T)) if C > 1 else np.ones((1, 1))
    np.fill_diagonal(correlation, 1.0)
    long = [run for run in rows.runs if run.stop - run.start >= RESOLUTION.shortest]
    if not ordered or not long:
        sigma = np.minimum(sigma, _by_neighbours(rest, sigma, freedom, rows)) if apart else sigma
        return Noise(rows, np.empty(0), np.empty((0, C)), sigma, float(freedom.sum()), correlation, steps)
    edges = _bands(max(run.stop - run.start for run in long))
    levels = np.stack([_levels(rest[:, c], basis[c], long, edges, above) for c in range(C)], axis=-1)
    if len(levels) < RESOLUTION.fewest:
        levels = whitest(levels, sum(run.stop - run.start for run in long) * np.diff(edges))
    noise = Noise(rows, edges, levels, sigma, float(freedom.sum()), correlation, steps)
    # What the bands say the variance is, so that one sample's sigma holds the slow part too, as far as it was measured.
    f = np.maximum((np.arange(4096) + 0.5) / 8192, np.sqrt(edges[0] * edges[1]))
    total = np.sqrt(np.mean(noise.spectrum(f), axis=0))
    return Noise(rows, edges, levels, total, float(freedom.sum()), correlation, steps)


def _by_neighbours(rest: Array, sigma: Array, freedom: Array, rows: Rows, *, surely: float = 2.5) -> Array:
    """(C,) standard deviation by the differences of neighbours, where these are surely smaller than noise of sigma (C,) has.

    In white noise half the mean squared difference over the variance is 1, with a deviation of 1 / sqrt(n) (von Neumann 1941).

    Args:
        surely: standard deviations of that ratio by which the differences must be smaller.
    """
    difference = np.concatenate([np.diff(rest[run], axis=0) for run in rows.runs])
    square = 0.5 * np.mean(difference**2, axis=0) * len(rest) / freedom
    return np.where(square < (1.0 - surely / np.sqrt(freedom)) * sigma**2, np.sqrt(square), sigma)


def _bands(n: int, *, lines: int = 18, per_decade: int = 6, slowest: float = 7.0) -> Array:
    """Limits in cycles a row: at least so many lines of the spectrum in a band, equal ratios where there are more.

    Args:
        n: rows of a segment.
        lines: in a band; per_decade: bands.
        slowest: cycles in a segment below which the spectrum is continued, not measured.
    """
    edges, ratio = [slowest / n], 10.0 ** (1.0 / per_decade)
    while edges[-1] < 0.5:
        edges.append(max(edges[-1] * ratio, edges[-1] + lines / n))
    if len(edges) > 2 and 0.5 - edges[-2] < lines / n:
        edges.pop(-2)
    return np.array([*edges[:-1], 0.5])


def _levels(rest: Array, basis: Array, runs: list[slice], edges: Array, above: float, *, least: float = 5.0) -> Array:
    """(B,) level a band: what the rich fit has left there over the share of the band that it could not reach.

    The rest of a fit with an orthonormal basis Q has at frequency f the expected power (1 - t) S, t the basis' own power
    there (residual likelihood; Patterson and Thompson 1971, in the frequency domain).

    Args:
        least: lines of a band that the rich fit must leave; else it is not measured, but read off its neighbours.
    """
    lines, free, place = [], [], []
    for run in runs:
        n = run.stop - run.start
        window = np.hanning(n + 2)[1:-1]
        window /= np.sqrt(np.mean(window**2))
        f = np.fft.rfftfreq(n)
        lines.append(np.abs(np.fft.rfft(rest[run] * window)) ** 2 / n)
        taken = np.zeros(len(f))
        for start in range(0, basis.shape[1], 32):
            part = basis[run, start : start + 32] * window[:, None]
            taken += np.sum(np.abs(np.fft.rfft(part, axis=0)) ** 2, axis=1) / n
        free.append(np.clip(1.0 - taken, 0.0, 1.0))
        place.append(np.where(f > 0, np.searchsorted(edges, f, side="right") - 1, -1).clip(-1, len(edges) - 2))
    line, left, band = np.concatenate(lines), np.concatenate(free), np.concatenate(place)
    level = np.full(len(edges) - 1, np.nan)
    for b in range(len(level)):
        inside = (band == b) & (left > 0.02)
        if np.sum(left[inside]) < least or edges[b] < above:
            continue
        # A single line (mains, a periodic motion) must not pass for noise; of few lines one may well be the largest.
        single, told = line[inside] / left[inside], left[inside] > 0.3
        many = told.sum() >= 12 and len(level) >= RESOLUTION.fewest
        usual = np.median(single[told]) / 0.69 if many else np.inf
        good = single < 8.0 * usual
        level[b] = np.sum(line[inside][good]) / np.sum(left[inside][good])
    return _filled(level, edges)


def _filled(level: Array, edges: Array) -> Array:
    """Bands that could not be measured: between their neighbours in logarithms, as the nearest one at the ends.

    At the slow end this may be too little noise: what is then chosen too boldly goes when the noise is learnt again from
    what the first model leaves.
    """
    centres, known = np.log(np.sqrt(edges[1:] * edges[:-1])), np.isfinite(level) & (level > 0.0)
    if not known.any():
        return np.full(len(level), 1e-30)
    level = np.exp(np.interp(centres, centres[known], np.log(level[known])))
    return np.asarray(np.maximum(level, 1e-7 * level.max() + 1e-30))


def quantisation(y: Array) -> Array:
    """(C,) step of readings (N, C) that stand on a grid, else 0."""
    out = np.zeros(y.shape[1])
    for c in range(y.shape[1]):
        values = np.unique(y[np.isfinite(y[:, c]), c])
        if len(values) < 3 or len(values) > 0.2 * len(y):
            continue
        gaps = np.diff(values)
        step = float(np.median(gaps[gaps <= np.quantile(gaps, 0.5)]))
        ratio = gaps / step
        if step > 0 and np.mean(np.abs(ratio - np.round(ratio)) < 0.05) > 0.9 and np.mean(np.round(ratio) == 1) > 0.3:
            out[c] = step
    return out

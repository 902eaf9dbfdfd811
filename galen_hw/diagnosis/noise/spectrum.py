"""The noise of every channel: its spectrum, whitening, and surrogates.

The spectrum is a level per logarithmic band. Below the slowest band that a recording of this length can tell from drift it is
continued: flat where a plateau is identified, else as a power law.
"""

import itertools
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.fft import dct, idct, next_fast_len

from galen_hw.diagnosis.noise.low_frequency import deviances, plateaus, smoothed, walking
from galen_hw.diagnosis.settings import RESOLUTION
from galen_hw.diagnosis.stats.criteria import CRITERIA
from galen_hw.diagnosis.stats.sampling import Mask, Rows
from galen_hw.lazy import cached_property
from galen_hw.spatial import Array

FOLLOWED = 0.2
"""Share of the rounding's variance that smooth functions of a signal can follow where no noise blurs it."""


def followed(steps: Array, sigma: Array) -> Array:
    """Return the variance (C,) of the part of a rounding error that follows its signal.

    Noise of s before the rounding blurs it to step^2 / (2 pi^2) sum_k exp(-(2 pi k s / step)^2) / k^2 (Widrow and Kollar,
    Quantization Noise, 2008, ch. 6: the characteristic function at multiples of 2 pi / step).

    Args:
        steps: (C,) of the readings; sigma: (C,) standard deviation with the rounding.
    """
    square, k = steps**2, np.arange(1, 6)[:, None]
    own = np.maximum(sigma**2 - square / 12.0, 0.0) / np.where(square > 0.0, square, 1.0)
    blurred = square / (2.0 * np.pi**2) * np.sum(np.exp(-((2.0 * np.pi * k) ** 2) * own) / k**2, axis=0)
    return np.asarray(np.minimum(FOLLOWED * square / 12.0, blurred))


@dataclass(frozen=True)
class Noise:
    """Noise of C channels on M rows.

    Args:
        rows: the averaging that the rows went through.
        edges: (B + 1,) band limits in cycles a row, empty: white.
        levels: (B, C) spectral level, the variance of one row where white.
        sigma: (C,) standard deviation of one averaged row.
        degrees: degrees of freedom of the estimate.
        correlation: (C, C) between channels.
        steps: (C,) quantisation step of the raw readings, 0 where there is none.
        without_data: (C,) channels without data; None: all have data.
    """

    rows: Rows
    edges: Array
    levels: Array
    sigma: Array
    degrees: float
    correlation: Array
    steps: Array
    without_data: Mask | None = None
    cache: dict[tuple[int, float], Array] = field(default_factory=dict, compare=False)

    def spectrum(self, frequency: Array) -> Array:
        """Return the level (F, C) at frequencies in cycles a row."""
        if not len(self.edges):
            return np.tile(self.sigma**2, (len(frequency), 1))
        centres = np.log(self.centres)
        at = np.log(np.maximum(frequency, 0.07 * self.edges[0]))
        channels = zip(np.log(self.levels).T, np.log(self._plateaus), strict=True)
        return np.exp(np.stack([_line(at, centres, level, plateau) for level, plateau in channels], axis=-1))

    @cached_property
    def centres(self) -> Array:
        """Centres (B,) of the bands, cycles a row."""
        return np.asarray(np.sqrt(self.edges[1:] * self.edges[:-1]))

    @cached_property
    def lines(self) -> Array:
        """Number of spectral lines (B,) in each band."""
        return np.asarray(sum(self._lengths) * np.diff(self.edges))

    @property
    def followed_rounding(self) -> Array:
        """Variance (C,) of the part of each channel's rounding error that follows its signal, at most: it is no physics.

        Blurred by what is left of the noise in the averaged rows alone, for what averages remove may be no noise of each reading.
        """
        return followed(self.steps, self.sigma)

    @property
    def blurred_rounding(self) -> Array:
        """The same (C,) where the noise is white: single readings are rounded, whose noise an average over rows has less of."""
        return followed(self.steps, self.sigma * np.sqrt(self.rows.stride))

    @property
    def _lengths(self) -> list[int]:
        """Lengths, rows, of the runs that are long enough for a spectrum."""
        return [run.stop - run.start for run in self.rows.runs if run.stop - run.start >= RESOLUTION.shortest]

    @property
    def slowest(self) -> float:
        """Corner frequency of the longest correlation time that noise may have, cycles a row."""
        return RESOLUTION.forgets / (2.0 * np.pi * sum(self._lengths))

    @cached_property
    def _plateaus(self) -> Array:
        """Low-frequency plateau (C,), NaN where it is not identified."""
        return plateaus(self.centres, self.levels, self.lines, self.slowest)

    def random_walks(self, residual: Array, waves: int) -> Mask:
        """Return which channels (C,) of a residual (M, C) contain a random walk; `waves` half cosines lie below the bands."""
        if len(self.centres) < RESOLUTION.fewest or len(self.rows.runs) > 1:
            return np.zeros(len(self.sigma), dtype=bool)
        modes = dct(residual, axis=0, norm="ortho")[1 : 1 + waves] ** 2
        return walking(self.centres, self.levels, self.lines, modes, len(residual), self.slowest)

    def deviance_as_noise(self, residual: Array) -> float:
        """Return the deviance of a residual (M, C) as noise of its own kind, with a memory or without, whatever this noise is.

        Over all runs that are long enough for a spectrum; there must be one.
        """
        long = [run for run in self.rows.runs if self._coloured(run)]
        return float(np.sum(deviances(residual, long, self.slowest)))

    def whiten(self, x: Array, channel: int) -> Array:
        """Return columns (M, k) of one channel, filtered so that its noise becomes white with unit variance."""
        return self.whitened(self.transformed(x), channel)

    def bridged(self, y: Array, good: Mask) -> Array:
        """Return all channels (M, C) whitened, with rows (M,) that are not good interpolated first."""
        out, at = np.empty_like(y), np.flatnonzero(good)
        for c in range(y.shape[1]):
            filled = y[:, c] if good.all() else np.interp(np.arange(len(y)), at, y[at, c])
            out[:, c] = self.whiten(filled[:, None], c)[:, 0]
        return out

    def colour(self, z: Array, channel: int) -> Array:
        """Colour white noise (M, k) by the channel's spectrum."""
        return self._filtered(self.transformed(z)[:, None], (channel,), 0.5)[:, 0]

    def as_smooth(self, white: Array, channel: int) -> Array:
        """Weight whitened columns (M, k) by the root of a smooth spectrum over the measured one.

        The scatter of the measured bands whitens too much here and too little there; this shows its effect on a fit.
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
        """Logarithm (B, C) of a smooth spectrum over the measured one."""
        smooth = smoothed(self.centres, self.levels, self.lines)
        return np.asarray(np.log(smooth / self.levels))

    def padded(self, without_data: Mask, *, above_noise: float = 1e9) -> "Noise":
        """Return this noise with channels without data (C,) inserted, which then have no weight.

        Args:
            beyond: standard deviation of their noise, larger than all that could be in them, in any unit.
        """
        if not without_data.any():
            return self

        def among(x: Array, fill: float) -> Array:
            out = np.full((*x.shape[:-1], len(without_data)), fill)
            out[..., ~without_data] = x
            return out

        correlation = np.eye(len(without_data))
        correlation[np.ix_(~without_data, ~without_data)] = self.correlation
        return replace(
            self,
            levels=among(self.levels, above_noise**2),
            sigma=among(self.sigma, above_noise),
            correlation=correlation,
            steps=among(self.steps, 0.0),
            without_data=without_data,
            cache={},
        )

    def flat(self) -> "Noise":
        """Return white noise at the lowest level of the spectrum: the least that the noise can be."""
        sigma = np.sqrt(np.min(self.levels, axis=0))
        return replace(self, edges=np.empty(0), levels=np.empty((0, len(sigma))), sigma=sigma, cache={})

    def transformed(self, x: Array) -> Array:
        """Return the cosine transform (P, ...) of each run of rows (M, ...), P >= M, for `whitened`; the same for all channels.

        The cosine transform of a run is that of the signal with its mirror image behind it: the two ends stay apart. A run of an
        awkward length (a prime) is extended into its mirror image to a length that is transformed quickly.
        """
        out = np.empty((self._places[-1].stop, *x.shape[1:]))
        for run, place in zip(self.rows.runs, self._places, strict=True):
            beyond = (place.stop - place.start) - (run.stop - run.start)
            part = np.concatenate([x[run], x[run.stop - beyond : run.stop][::-1]]) if beyond else x[run]
            out[place] = dct(part, axis=0) if self._coloured(run) else part
        return out

    def whitened(self, transformed: Array, channel: int) -> Array:
        """Return whitened columns (M, k) from transformed ones (P, k)."""
        return self._filtered(transformed[:, None], (channel,), -0.5)[:, 0]

    def whitened_each(self, transformed: Array, channels: tuple[int, ...]) -> Array:
        """Return whitened columns (M, c, k) of several channels from transformed ones (P, c, k)."""
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
        """Slice of each run among the transformed rows."""
        lengths = [run.stop - run.start for run in self.rows.runs]
        quick = [int(next_fast_len(n, real=True)) if self._coloured(slice(0, n)) else n for n in lengths]
        edges = np.cumsum([0, *quick]).tolist()
        return tuple(slice(a, b) for a, b in itertools.pairwise(edges))

    def _levels(self, n: int, power: float) -> Array:
        """Return a power of the spectrum at the frequencies of a cosine transform of length n, cached."""
        if (n, power) not in self.cache:
            self.cache[n, power] = self.spectrum(np.arange(n) / (2.0 * n)) ** power
        return self.cache[n, power]

    def independent(self, rows: int) -> Array:
        """Return the number (C,) of independent values among so many rows, for the error of a mean square."""
        level = self.spectrum((np.arange(2048) + 0.5) / 4096)
        return np.asarray(rows * np.mean(level, axis=0) ** 2 / np.mean(level**2, axis=0))

    @cached_property
    def slow_power_ratio(self) -> Array:
        """Mean square (C,) over all rows, with unmeasured low-frequency noise, over `sigma` squared."""
        return np.asarray(np.maximum(np.mean(self._all, axis=0) / self.sigma**2, 1.0))

    @property
    def slow_and_quick_rms(self) -> tuple[Array, Array]:
        """Rms (C,) below and rms (C,) above 50 cycles in the recording."""
        if not len(self.edges):
            return np.zeros_like(self.sigma), self.sigma
        slow, quick = np.split(self._all / len(self.rows), [2 * RESOLUTION.wanders])
        return np.sqrt(slow.sum(axis=0)), np.sqrt(quick.sum(axis=0))

    @property
    def ringing(self) -> tuple[Array, Array]:
        """Frequency (C,), cycles a row, and rms (C,) of a band that rings: it holds more power than all others.

        NaN and 0 where none does. The spectrum falls from it to both sides, unlike that of noise with a memory.
        """
        frequency, size = np.full(len(self.sigma), np.nan), np.zeros(len(self.sigma))
        M = len(self.rows)
        at = np.linspace(0.25 / M, 0.5 - 0.25 / M, M)
        for c in range(len(self.sigma)) if len(self.centres) > 4 else ():
            top = int(np.argmax(self.levels[:, c]))
            far = np.abs(np.arange(len(self.centres)) - top) > 1
            neighbours = [
                self.levels[side & far, c]
                for side in (self.centres < self.centres[top], self.centres > self.centres[top])
            ]
            if (
                min(map(len, neighbours)) == 0
                or max(map(np.max, neighbours)) * CRITERIA.outstanding > self.levels[top, c]
            ):
                continue
            own = (at > self.edges[max(top - 1, 0)]) & (at < self.edges[min(top + 2, len(self.edges) - 1)])
            power = self._all[:, c] / M
            if power[own].sum() > power[~own].sum():
                frequency[c], size[c] = self.centres[top], np.sqrt(power[own].sum())
        return frequency, size

    @cached_property
    def _all(self) -> Array:
        """Level (M, C) at as many frequencies as there are rows."""
        M = len(self.rows)
        return self.spectrum(np.linspace(0.25 / M, 0.5 - 0.25 / M, M))

    @cached_property
    def slow(self) -> Array:
        """Level (C,) at the frequency of a slow regressor."""
        return np.asarray(self.spectrum(np.array([RESOLUTION.slow]))[0])

    @cached_property
    def effective(self) -> float:
        """Effective sample size for a slow regressor, over all channels with data."""
        independent = len(self.rows) * np.minimum(1.0, self.sigma**2 / self.slow)
        return float(max(np.sum(independent, where=True if self.without_data is None else ~self.without_data), 20.0))


def _line(at: Array, centres: Array, level: Array, plateau: float, *, steepest: float = -1.0) -> Array:
    """Return a linear interpolation; below the first centre the plateau, else a line with the slope of the slowest decade.

    Args:
        steepest: power of the frequency of flicker noise: what rises more steeply counts as drift.
    """
    out = np.interp(at, centres, level)
    below = at < centres[0]
    if np.isfinite(plateau):
        out[below] = plateau
        return out
    slowest = centres < centres[0] + 1.5 * np.log(10.0)
    slope = _slope(centres[slowest], level[slowest]) if slowest.sum() >= 3 else 0.0
    out[below] = level[0] + min(max(slope, steepest), 0.0) * (at[below] - centres[0])
    return out


def _slope(x: Array, y: Array) -> float:
    """Return the least-squares slope less its own standard error: in doubt slow noise is stronger."""
    A = np.stack([np.ones_like(x), x - x[0]], axis=-1)
    inverse = np.linalg.inv(A.T @ A)
    value = inverse @ A.T @ y
    residual = y - A @ value
    return float(value[1] - np.sqrt(residual @ residual / max(len(x) - 2, 1) * inverse[1, 1]))

"""The frequency of a spectral line and its uncertainty by phase noise."""

import numpy as np
from scipy.stats import norm as normal
from scipy.stats import t as student
from scipy.stats import truncnorm

from galen_hw.diagnosis.estimation.candidate import Hypothesis
from galen_hw.diagnosis.estimation.model import Model
from galen_hw.diagnosis.stats.aliasing import folded
from galen_hw.physics.effects.traits import Line
from galen_hw.spatial import Array


def mean_frequency(model: Model, h: Hypothesis, line: Line, *, count: int = 16) -> tuple[float, float]:
    """Return the mean frequency of a line and its standard deviation by phase noise alone (0: none seen), Hz.

    A line with a wandering phase is as well fitted a little off its frequency: the mean frequency is where the phase has no
    trend.

    The phase of the measured line, piece by piece, is compared with that of the fitted one; the variance of its increments beyond
    the noise is taken for a random walk of s^2 rad^2 a second. Means over pieces of length d differ by 2/3 s^2 d in the mean
    square, and the slope of a random walk over a time T has the variance 6/5 s^2 / T (least squares; Durlauf and Phillips 1988).
    As s^2 rests on few increments, the deviation is wider by Student's t. For a weak line s^2 is its mean under a flat prior on
    non-negative values.

    Args:
        count: pieces.
    """
    bench, places = model.bench, list(h.raw.channels)
    time = bench.time
    run = max(bench.rows.runs, key=lambda r: r.stop - r.start)
    rows = np.arange(run.start, run.stop)[~bench.excluded_rows[run]]
    if len(rows) < 8 * count:
        return line.frequency, 0.0
    turning = np.exp(-2j * np.pi * line.frequency * time[rows])
    # The residual without the fitted line contains the oscillation itself.
    residual = _alone(model, line)[rows][:, places] / bench.noise.sigma[places]
    cycles = np.clip([folded(line.frequency * bench.period, 1.0)], 1e-6, 0.5)
    level = np.array([bench.noise.spectrum(cycles)[0, c] for c in places])
    weight = np.conj(np.sum(residual * turning[:, None], axis=0) / len(rows)) * bench.noise.sigma[places] ** 2 / level
    pieces = np.array_split(np.arange(len(rows)), count)
    z = np.array([np.sum(residual[p] * turning[p, None] @ weight) for p in pieces])
    noise = np.array([len(p) * np.sum(np.abs(weight) ** 2 * level / bench.noise.sigma[places] ** 2) for p in pieces])
    steps = np.angle(z[1:] * np.conj(z[:-1]))
    by_noise = float(np.mean(noise / np.maximum(np.abs(z) ** 2, 1e-300)))
    # Neighbouring increments share the noise of the piece between them: a correlation of minus a half.
    seen = _positive(float(np.mean(steps**2)) - by_noise, by_noise * np.sqrt(3.0 / len(steps)))
    span = float(time[rows[-1]] - time[rows[0]])
    walk = seen * 1.5 * count / span
    wider = float(student.isf(0.025, count - 1) / normal.isf(0.025))
    middle = np.array([time[rows[p]].mean() for p in pieces])
    beyond = float(np.polyfit(middle, np.unwrap(np.angle(z)), 1, w=np.abs(z))[0]) if line.wanders else 0.0
    return line.frequency + beyond / (2.0 * np.pi), float(wider * np.sqrt(1.2 * walk / span) / (2.0 * np.pi))


def _positive(value: float, error: float) -> float:
    """Return the posterior mean of a non-negative quantity, measured as `value` with a normal error."""
    if error <= 0.0:
        return max(value, 0.0)
    return float(truncnorm.mean(-value / error, np.inf, loc=value, scale=error))


def _alone(model: Model, line: Line) -> Array:
    """Return the residual (M, C) with the line, and others within its breadth, added back."""
    out = model.residual().copy()
    for h, s in zip(model.parts, model.slices(), strict=True):
        other = h.line(model.bench.scene)
        if other is not None and abs(other.frequency - line.frequency) <= line.breadth:
            out[:, list(h.raw.channels)] += h.contribution(model.theta[s])
    return out

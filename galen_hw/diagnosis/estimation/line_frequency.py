"""How far the phase of an oscillation wanders: a hum is no clock, and its frequency is not known as if it were."""

import numpy as np
from scipy.stats import norm as normal
from scipy.stats import t as student
from scipy.stats import truncnorm

from galen_hw.diagnosis.estimation.candidate import Hypothesis
from galen_hw.diagnosis.estimation.model import Model
from galen_hw.physics.effects.traits import Line
from galen_hw.spatial import Array


def mean_frequency(model: Model, h: Hypothesis, line: Line, *, count: int = 16) -> tuple[float, float]:
    """Frequency over the whole recording, and its standard deviation by the wander of the phase alone (0: none seen), Hz.

    A line whose phase may wander is as well fitted a little beside its frequency: the mean one is where the phase has no slope.

    The phase of what is measured, piece by piece, against the fitted line: what its steps from piece to piece show beyond
    noise is taken for a random walk of s^2 rad^2 a second. Means over pieces of length d differ by 2/3 s^2 d in the mean
    square, and the slope of a walk over a time T has the variance 6/5 s^2 / T (least squares; Durlauf and Phillips 1988). That
    s^2 rests on few steps widens the deviation as Student's t is wider than a normal law. Of a weak line noise may hide the
    walk: s^2 is what it is on average where it cannot be negative and every value was as likely before.

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
    # Without the effect, as it was fitted, the rest holds the oscillation itself.
    residual = _alone(model, line)[rows][:, places] / bench.noise.sigma[places]
    cycles = np.clip([line.frequency * bench.period], 1e-6, 0.5)
    level = np.array([bench.noise.spectrum(cycles)[0, c] for c in places])
    weight = np.conj(np.sum(residual * turning[:, None], axis=0) / len(rows)) * bench.noise.sigma[places] ** 2 / level
    pieces = np.array_split(np.arange(len(rows)), count)
    z = np.array([np.sum(residual[p] * turning[p, None] @ weight) for p in pieces])
    noise = np.array([len(p) * np.sum(np.abs(weight) ** 2 * level / bench.noise.sigma[places] ** 2) for p in pieces])
    steps = np.angle(z[1:] * np.conj(z[:-1]))
    by_noise = float(np.mean(noise / np.maximum(np.abs(z) ** 2, 1e-300)))
    # Neighbouring steps share the noise of the piece between them: a correlation of minus a half.
    seen = _positive(float(np.mean(steps**2)) - by_noise, by_noise * np.sqrt(3.0 / len(steps)))
    span = float(time[rows[-1]] - time[rows[0]])
    walk = seen * 1.5 * count / span
    wider = float(student.isf(0.025, count - 1) / normal.isf(0.025))
    middle = np.array([time[rows[p]].mean() for p in pieces])
    beyond = float(np.polyfit(middle, np.unwrap(np.angle(z)), 1, w=np.abs(z))[0]) if line.wanders else 0.0
    return line.frequency + beyond / (2.0 * np.pi), float(wider * np.sqrt(1.2 * walk / span) / (2.0 * np.pi))


def _positive(value: float, error: float) -> float:
    """Mean of what is not negative, of which a measurement with a normal error says `value`."""
    if error <= 0.0:
        return max(value, 0.0)
    return float(truncnorm.mean(-value / error, np.inf, loc=value, scale=error))


def _alone(model: Model, line: Line) -> Array:
    """(M, C) what is left with the effect put back, and whatever else hums within its breadth."""
    out = model.residual().copy()
    for h, s in zip(model.parts, model.slices(), strict=True):
        other = h.line(model.bench.scene)
        if other is not None and abs(other.frequency - line.frequency) <= line.breadth:
            out[:, list(h.raw.channels)] += h.contribution(model.theta[s])
    return out

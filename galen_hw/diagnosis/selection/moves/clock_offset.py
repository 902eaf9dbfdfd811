"""Search for a clock offset larger than the time scale of the motion, which the slope of a delay at zero cannot show.

The search goes by slopes: it would explain such a recording by nonlinear effects, and not find the offset later.
"""

from typing import TypeGuard

import numpy as np
from scipy.optimize import minimize_scalar

from galen_hw.diagnosis.estimation.dataset import Bench
from galen_hw.diagnosis.estimation.levenberg_marquardt import ConditionalGain
from galen_hw.diagnosis.estimation.linearisation import contribution, tangent
from galen_hw.diagnosis.estimation.model import Model
from galen_hw.diagnosis.estimation.normal_equations import Score, Scorer
from galen_hw.diagnosis.selection.kinds import in_each_joint
from galen_hw.diagnosis.stats.criteria import CRITERIA
from galen_hw.physics.effects.base import Effect
from galen_hw.physics.effects.columns import Columns
from galen_hw.physics.effects.registry import shifts
from galen_hw.spatial import Array

LEAST_ROWS = 200
"""In a run without a gap, for a shift to be more than a few coincidences."""
REACH = 0.25
"""Share of the longest run by which a clock may be off."""
SHIFTS = 300
"""Number of shifts that are tried each way, evenly spaced."""
LEFT = 0.5
"""Share of the mean square without a shift that one may leave at most."""
BY_SLOPE = 0.5
"""Share of what it takes that its slope at zero promises at most; else the search finds it by that."""
FINE = 1e-3
"""Tolerance of the best shift, of the distance to the next one."""


def clock_offset(bench: Bench, scorer: Scorer, chosen: list[int], scores: dict[int, Score]) -> int | None:
    """Return the number of a large delay of the whole stream that explains more than anything else does; None without one.

    Args:
        scores: of all hypotheses given the chosen ones; the delay joins the library, linearised at its optimum.
    """
    own = next((i for i in scores if _whole(scorer.library[i].effect)), None)
    if own is None or any((e := scorer.library[i].effect) is not None and e.SHIFT for i in chosen):
        return None
    shift = _shift(bench)
    if shift is None:
        return None
    plain = next(iter(shifts(bench.scene)))
    h, given, everywhere = scorer.library[own], ConditionalGain(bench, scorer, chosen), tuple(range(bench.width))

    def cost(late: float) -> float:
        change = contribution(bench, plain, np.array([late]))
        return -given.fixed_gain(bench.hypothesis_of(None, Columns(everywhere, change[:, :, None])))

    seconds, step = shift
    bounds = (seconds - step, seconds + step)
    found = minimize_scalar(cost, bounds=bounds, method="bounded", options={"xatol": FINE * step})
    others = [i for i in scores if i != own]
    most = max([in_each_joint(scorer, scores, others)[0], *(scores[i].gain for i in others)])
    if scores[own].gain > -BY_SLOPE * found.fun or -found.fun <= most + CRITERIA.log_odds:
        return None
    scorer.append([tangent(bench, h, np.array([float(found.x)]))])
    return len(scorer.library) - 1


def far_off(model: Model) -> list[Columns]:
    """Return contributions (M, C, 1) of delays of the whole stream that their slope at zero does not describe."""
    out, bench, everywhere = [], model.bench, tuple(range(model.bench.width))
    for h, s in zip(model.parts, model.slices(), strict=True):
        if _whole(h.effect):
            change = contribution(bench, h.effect, model.final[s])
            slope = bench.averaged(h.effect.columns(bench.scene)).values @ model.final[s]
            if np.sum((change - slope) ** 2) > BY_SLOPE * np.sum(change**2):
                out.append(Columns(everywhere, change[:, :, None]))
    return out


def _whole(effect: Effect | None) -> TypeGuard[Effect]:
    """Return whether it is a delay of the whole stream."""
    return effect is not None and effect.SHIFT and not effect.joints


def _shift(bench: Bench) -> tuple[float, float] | None:
    """Return the delay, s, with the best correlation between model and recording, and the step of the search.

    None where no delay leaves little enough.
    """
    run = max(bench.rows.runs, key=lambda part: part.stop - part.start)
    n = run.stop - run.start
    if n < LEAST_ROWS:
        return None
    step = max(int(REACH * n) // SHIFTS, 1)
    # Rows without a joint position have no simulation; the residual is interpolated there.
    whole = np.nan_to_num(bench.scene.simulated)
    carried = np.broadcast_to(bench.stream.carried, whole.shape)
    simulated, added = (bench.rows.average(x)[run] for x in (whole, carried))
    said, measured = simulated + added, simulated + bench.whole[run]
    said, measured = (x[: n // step * step].reshape(-1, step, bench.width).mean(axis=1) for x in (said, measured))
    most = int(REACH * len(said))
    costs = [_mean_square(measured, said, shift, bench.noise.sigma) for shift in range(-most, most + 1)]
    at = int(np.argmin(costs))
    if costs[at] > LEFT * costs[most]:
        return None
    row = step * float(np.median(np.diff(bench.time[run])))
    return (at - most) * row, row


def _mean_square(measured: Array, said: Array, shift: int, sigma: Array) -> float:
    """Return the mean square of the measured less the predicted (n, C), late by so many rows, apart from constants."""
    late, n = max(shift, 0), len(measured)
    residual = measured[late : n + min(shift, 0)] - said[late - shift : n - late]
    return float(np.mean(np.var(residual, axis=0) / sigma**2))

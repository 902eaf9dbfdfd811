"""Linearisation of nonlinear effects; the nonlinear remainder is taken off the residual while they are in a model."""

from contextlib import AbstractContextManager, nullcontext

import numpy as np

from galen_hw.diagnosis.estimation.candidate import Hypothesis
from galen_hw.diagnosis.estimation.dataset import Bench
from galen_hw.diagnosis.estimation.normal_equations import Scorer
from galen_hw.diagnosis.estimation.signal_chain import output_of
from galen_hw.physics.effects.base import Effect
from galen_hw.physics.effects.columns import Columns
from galen_hw.spatial import Array


def tangent(bench: Bench, h: Hypothesis, theta: Array) -> Hypothesis:
    """Return the hypothesis linearised at theta, with its nonlinear remainder there."""
    effect = h.effect
    assert effect is not None, "nuisances are linear"
    slopes = []
    for k, stride in enumerate(effect.strides(bench.scene, theta).tolist()):
        step = np.zeros(h.count)
        step[k] = stride
        slopes.append(
            (contribution(bench, effect, theta + step) - contribution(bench, effect, theta - step)) / (2.0 * stride)
        )
    raw = Columns(tuple(range(bench.width)), np.stack(slopes, axis=-1))
    out = bench.hypothesis_of(effect, raw, h.trials)
    out.theta, out.nonlinear = theta, contribution(bench, effect, theta) - raw.values @ theta
    return out


def contribution(bench: Bench, effect: Effect, theta: Array) -> Array:
    """Return the averaged contribution (M, C) of an effect at theta (k,), as it leaves the output stage."""
    shifted = effect.shifted(bench, bench.scene, theta)
    if shifted is not None:
        return shifted
    return bench.rows.average(output_of(bench.stream, effect, effect.change(bench.scene, theta), bench.timing))


def linear_residual(scorer: Scorer, chosen: list[int]) -> Array:
    """Return the residual (M, C) less the nonlinear remainders of a model and the interactions of the present one."""
    nonlinear = [b for i in chosen if (b := scorer.library[i].nonlinear) is not None]
    return np.asarray(
        scorer.bench.whole - scorer.bench.state.interaction - sum(nonlinear, np.zeros_like(scorer.bench.whole))
    )


def rebase(scorer: Scorer, chosen: list[int]) -> None:
    """Set the scorer's residual to that of a model, if it has another's."""
    y = linear_residual(scorer, chosen)
    if not _same(scorer, y):
        scorer.bench.update_state(y=y)
        scorer.retarget(y)


def as_if(scorer: Scorer, chosen: list[int]) -> AbstractContextManager[None]:
    """Use the residual that belongs to a model while the context lasts."""
    y = linear_residual(scorer, chosen)
    return nullcontext() if _same(scorer, y) else scorer.against(y)


def nonlinear_restored(scorer: Scorer, i: int) -> AbstractContextManager[None]:
    """Restore the nonlinear remainder of the chosen hypothesis i to the residual while the context lasts."""
    nonlinear = scorer.library[i].nonlinear
    return nullcontext() if nonlinear is None else scorer.against(scorer.bench.y + nonlinear)


def _same(scorer: Scorer, y: Array, *, rounding: float = 1e-6) -> bool:
    """Return whether the scorer is on this residual (M, C) already.

    Args:
        rounding: difference that is none, over the noise.
    """
    return bool(np.max(np.abs(y - scorer.bench.y) / scorer.bench.noise.sigma, initial=0.0) < rounding)

"""What an effect that is not linear does beyond its slope: taken off the residual while it is part of a model."""

from contextlib import AbstractContextManager, nullcontext

import numpy as np

from galen_hw.diagnosis.estimation.candidate import Hypothesis
from galen_hw.diagnosis.estimation.dataset import Bench
from galen_hw.diagnosis.estimation.normal_equations import Scorer
from galen_hw.diagnosis.estimation.signal_chain import arrived
from galen_hw.physics.effects.base import Effect
from galen_hw.physics.effects.columns import Columns
from galen_hw.spatial import Array


def tangent(bench: Bench, h: Hypothesis, theta: Array) -> Hypothesis:
    """The hypothesis linearised at theta, with what it predicts there beyond slope times theta."""
    effect = h.effect
    assert effect is not None, "nuisances are linear"
    slopes = []
    for k, stride in enumerate(effect.strides(bench.scene, theta).tolist()):
        step = np.zeros(h.count)
        step[k] = stride
        slopes.append((does(bench, effect, theta + step) - does(bench, effect, theta - step)) / (2.0 * stride))
    raw = Columns(tuple(range(bench.width)), np.stack(slopes, axis=-1))
    out = bench.made(effect, raw, h.looked)
    out.theta, out.bend = theta, does(bench, effect, theta) - raw.values @ theta
    return out


def does(bench: Bench, effect: Effect, theta: Array) -> Array:
    """(M, C) averaged change of an effect with parameters theta (k,), as it arrives through a late or lagging stream."""
    shifted = effect.shifted(bench, bench.scene, theta)
    if shifted is not None:
        return shifted
    return bench.rows.average(arrived(bench.stream, effect, effect.change(bench.scene, theta), bench.timing))


def straightened(scorer: Scorer, chosen: list[int]) -> Array:
    """(M, C) residual less what a model predicts beyond its slopes, and what the effects of the present one do to each other."""
    bends = [b for i in chosen if (b := scorer.library[i].bend) is not None]
    return np.asarray(
        scorer.bench.whole - scorer.bench.state.interaction - sum(bends, np.zeros_like(scorer.bench.whole))
    )


def rebase(scorer: Scorer, chosen: list[int]) -> None:
    """The scorer is given the residual that belongs to a model, if it has another's."""
    y = straightened(scorer, chosen)
    if not _same(scorer, y):
        scorer.bench.stand(y=y)
        scorer.retarget(y)


def as_if(scorer: Scorer, chosen: list[int]) -> AbstractContextManager[None]:
    """The scorer for a while on the residual that belongs to a model."""
    y = straightened(scorer, chosen)
    return nullcontext() if _same(scorer, y) else scorer.against(y)


def unbent(scorer: Scorer, i: int) -> AbstractContextManager[None]:
    """The scorer for a while on the residual as if the chosen hypothesis i had never been there."""
    bend = scorer.library[i].bend
    return nullcontext() if bend is None else scorer.against(scorer.bench.y + bend)


def _same(scorer: Scorer, y: Array, *, rounding: float = 1e-6) -> bool:
    """Return whether the scorer is on this residual (M, C) already.

    Args:
        rounding: difference that is none, over the noise.
    """
    return bool(np.max(np.abs(y - scorer.bench.y) / scorer.bench.noise.sigma, initial=0.0) < rounding)

"""Iterated linearisation of the nonlinear effects of a model (Gauss-Newton)."""

import numpy as np

from galen_hw.diagnosis.estimation.candidate import Hypothesis, with_parameters
from galen_hw.diagnosis.estimation.dataset import Bench
from galen_hw.diagnosis.estimation.levenberg_marquardt import ConditionalGain, descended
from galen_hw.diagnosis.estimation.linearisation import nonlinear_restored, rebase, tangent
from galen_hw.diagnosis.estimation.normal_equations import Scorer
from galen_hw.diagnosis.settings import BUDGET, LIMITS
from galen_hw.spatial import Array


def settle(bench: Bench, scorer: Scorer, chosen: list[int], *, anew: bool = False) -> None:
    """Linearise nonlinear effects again where their estimates have moved, until none has; their remainders leave the residual.

    `anew`: even where the estimates have not moved, since the output stage has changed.
    """
    rebase(scorer, chosen)
    for _ in range(3):
        theta = scorer.solve(chosen)[0]
        fresh = list[tuple[int, Hypothesis]]()
        for place, (h, t) in enumerate(with_parameters(scorer.parts(chosen), theta), -len(scorer.base)):
            if h.effect is None or not (anew or _moved(bench, h, t)) or not h.effect.bends(bench.scene, t):
                continue
            curved = h.effect.curved
            fresh.append((place, _settled(bench, scorer, chosen, chosen[place]) if curved else tangent(bench, h, t)))
        if not fresh:
            return
        anew = False
        scorer.append([h for _, h in fresh])
        for k, (place, _) in enumerate(fresh):
            chosen[place] = len(scorer.library) - len(fresh) + k
        rebase(scorer, chosen)


def _moved(bench: Bench, h: Hypothesis, theta: Array) -> bool:
    """Return whether an estimate (k,) is so far from where the hypothesis is linearised that the fit could differ."""
    if h.theta is None:
        return True
    step = h.white.values[bench.train] @ (theta - h.theta)
    return bool(np.sum(step**2) > LIMITS.tie)


def _settled(bench: Bench, scorer: Scorer, chosen: list[int], i: int) -> Hypothesis:
    """Return the chosen nonlinear hypothesis i at its optimum given the others."""
    h = scorer.library[i]
    assert h.theta is not None, "it is chosen as a tangent"
    with nonlinear_restored(scorer, i):
        given = ConditionalGain(bench, scorer, [j for j in chosen if j != i])
    return descended(bench, given, h, h.theta, BUDGET.settled)[1]

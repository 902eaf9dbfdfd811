"""Iterated linearisation of the nonlinear effects of a model (Gauss-Newton)."""

import numpy as np

from galen_hw.diagnosis.estimation.candidate import Hypothesis, with_parameters
from galen_hw.diagnosis.estimation.dataset import Bench
from galen_hw.diagnosis.estimation.levenberg_marquardt import ConditionalGain, descended
from galen_hw.diagnosis.estimation.linearisation import nonlinear_restored, rebase, tangent
from galen_hw.diagnosis.estimation.normal_equations import Scorer
from galen_hw.diagnosis.settings import BUDGET


def settle(bench: Bench, scorer: Scorer, chosen: list[int], *, anew: bool = False) -> None:
    """Linearise nonlinear effects again at their estimates until these converge; their remainders leave the residual.

    `anew`: even where the estimates have not moved, since the output stage has changed.
    """
    rebase(scorer, chosen)
    for _ in range(3):
        theta = scorer.solve(chosen)[0]
        beyond, fresh, moved = np.zeros_like(bench.y), [], False
        for place, (h, t) in enumerate(with_parameters(scorer.parts(chosen), theta), -len(scorer.base)):
            if h.effect is None or not h.effect.bends(bench.scene, t):
                continue
            new = _settled(bench, scorer, chosen, chosen[place]) if h.effect.curved else tangent(bench, h, t)
            assert new.nonlinear is not None, "a tangent has one"
            assert new.theta is not None, "a tangent has one"
            beyond += new.nonlinear
            moved = (
                moved or h.theta is None or bool(np.max(np.abs(h.theta - new.theta)) > 1e-3 * np.max(np.abs(new.theta)))
            )
            fresh.append((place, new))
        if not fresh or not (moved or anew):
            return
        anew = False
        bench.update_state(y=bench.whole - bench.state.interaction - beyond)
        scorer.append([h for _, h in fresh])
        for k, (place, _) in enumerate(fresh):
            chosen[place] = len(scorer.library) - len(fresh) + k
        scorer.retarget(bench.y)


def _settled(bench: Bench, scorer: Scorer, chosen: list[int], i: int) -> Hypothesis:
    """Return the chosen nonlinear hypothesis i at its optimum given the others."""
    h = scorer.library[i]
    assert h.theta is not None, "it is chosen as a tangent"
    with nonlinear_restored(scorer, i):
        given = ConditionalGain(bench, scorer, [j for j in chosen if j != i])
    return descended(bench, given, h, h.theta, BUDGET.settled)[1]

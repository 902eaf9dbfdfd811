"""Effects that stand together in the place of others, with values that they share: what each effect says of itself.

A creep beside the friction of its joint is one behind the other: apart, each is told wrong.
"""

import numpy as np
from scipy.optimize import minimize

from galen_hw.diagnosis.estimation.candidate import Hypothesis, told
from galen_hw.diagnosis.estimation.normal_equations import Scorer
from galen_hw.diagnosis.selection.acceptance import left_out, no_worse, plausible
from galen_hw.diagnosis.selection.search_state import Selection
from galen_hw.diagnosis.stats.criteria import CRITERIA
from galen_hw.physics.effects.traits import Alternative
from galen_hw.spatial import Array


def replaced(out: Selection) -> bool:
    """Return whether an effect, and others with it, gave way to better ones of which it knows, see `Effect.alternatives`."""
    scorer = out.scorer
    for i in out.chosen:
        effect = scorer.library[i].effect
        for other in () if effect is None else effect.alternatives([h.effect for h in out.hypotheses]):
            gone = [i, *(out.chosen[at] for at in other.instead_of)]
            tried = frozenset((told(scorer.library[k].effect), k in gone) for k in out.chosen)
            if tried in out.regrouped:
                continue
            out.regrouped.add(tried)
            if _taken(out, gone, other):
                return True
    return False


def _taken(out: Selection, gone: list[int], other: Alternative, *, tolerance: float = 3e-3, most: int = 60) -> bool:
    """Return whether the alternative was better, and stands in the place of those that are gone.

    What only made up for these being told from the wrong end goes with them.

    Args:
        tolerance: logarithm to which shared values are sought; most: points in which they are.
    """
    bench, scorer = out.bench, out.scorer
    others = [k for k in out.chosen if k not in gone]
    fewer = [k for k in others if out.chosen.index(k) not in other.may_go]
    rows = float(np.log(bench.noise.effective))

    def made(at: Array) -> list[Hypothesis]:
        return [bench.add(effect) for effect in other.made(at)]

    def ways(first: int) -> list[list[int]]:
        """Every form, beside all others or without those that may go."""
        return [[*kept, *(first + k for k in group)] for kept in (others, fewer) for group in other.groups]

    def left(at: Array) -> list[float]:
        """Of each way, price included; what its effects share is one number."""
        new = made(at)
        with scorer.trying(new):
            models = ways(len(scorer.library) - len(new))
            return [scorer.solve(m)[2] + (_owed(scorer, m) - other.shared) * rows for m in models]

    tried = np.array([left(at) for at in other.begun])
    best, way = np.unravel_index(int(np.argmin(tried)), tried.shape)
    first = other.begun[best] + other.steps
    options = {"xatol": tolerance, "fatol": 0.1, "maxfev": most, "initial_simplex": first}
    found = minimize(lambda at: left(at)[way], other.begun[best], method="Nelder-Mead", options=options)
    before = scorer.solve(out.chosen)[2] + rows * _owed(scorer, out.chosen)
    if found.fun + CRITERIA.log_odds >= before:
        return False
    errors = left_out(out, out.chosen)
    new = made(found.x)
    scorer.append(new)
    trial = ways(len(scorer.library) - len(new))[int(way)]
    fresh = trial[-len(other.groups[int(way) % len(other.groups)]) :]
    real = all(plausible(bench, scorer, [k for k in trial if k != own], own) for own in fresh)
    if real and no_worse(errors, left_out(out, trial)):
        out.chosen = trial
        return True
    return False


def _owed(scorer: Scorer, model: list[int]) -> int:
    return sum(scorer.library[k].owed() for k in model)

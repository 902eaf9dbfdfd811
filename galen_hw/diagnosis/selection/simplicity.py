"""Which of two look-alikes goes first: the plainer one, where the recording does not say otherwise."""

import numpy as np

from galen_hw.diagnosis.estimation.dataset import Bench
from galen_hw.diagnosis.estimation.normal_equations import Score, Scorer
from galen_hw.diagnosis.selection.comparison import ahead
from galen_hw.diagnosis.stats.significance import LOG_ODDS
from galen_hw.physics.effects.base import Effect

SLACK = 0.25
NOISE_ALONE = 1.1
"""Whitened mean square up to which a model is taken to leave noise alone: rounded readings are not quite white."""


def slack(misfit: float) -> float:
    """Share of a gain that is no evidence between look-alikes; none where hardly more than noise is left."""
    return SLACK * float(np.clip(misfit - NOISE_ALONE, 0.0, 1.0))


ALIKE = 0.002
"""Share of a gain, and of an error on blocks left out, that decides nothing unless the blocks agree on it."""
AGREED = 1.64
"""Standard errors over the blocks from which a small difference of likelihood is evidence (one side, 5 %)."""
TIE = 2.0
"""Difference of rank within which two hypotheses count as equal."""


def plainest(
    bench: Bench, scorer: Scorer, chosen: list[int], scores: dict[int, Score], able: list[int], misfit: float
) -> int:
    """The plainest hypothesis that reaches nearly the gain of the best: the margin grows with what the model misses.

    Where only noise is left (misfit 1) the likelihood decides, but for ties; where physics is missing, small differences of
    likelihood between look-alikes are that physics, not evidence.
    """
    best = able[0]
    nothing = slack(misfit) * scores[best].gain
    nothing = nothing if nothing > LOG_ODDS else TIE
    alike = max(nothing, ALIKE * scores[best].gain)

    def cost(i: int) -> tuple[int, int, float]:
        return (_plainness(scorer, i), scores[i].count, -scores[i].rank)

    for i in sorted((i for i in able if scores[i].rank >= scores[best].rank - alike), key=cost):
        if scores[i].rank >= scores[best].rank - nothing or ahead(bench, scorer, chosen, best, i) < AGREED:
            return i
    return best


def _plainness(scorer: Scorer, i: int) -> int:
    """The lower, the plainer."""
    effect = scorer.library[i].effect
    return Effect.COMPLEXITY if effect is None else effect.COMPLEXITY


def favour(scorer: Scorer, i: int, j: int) -> int:
    """1 where j is plainer than i, -1 where i is, 0 where neither is."""
    return int(np.sign(_plainness(scorer, i) - _plainness(scorer, j)))


def handicap(bench: Bench, scorer: Scorer, others: list[int], i: int, j: int, rivals: dict[int, Score]) -> float:
    """What is added to the rank of j in the place of i: the plainer is better where the blocks do not agree on the other."""
    side, alike = favour(scorer, i, j), max(TIE, ALIKE * rivals[i].gain)
    lead = side * (rivals[i].rank - rivals[j].rank)
    if not side or lead <= TIE or lead > alike:
        return side * alike
    plainer, leader = (j, i) if side > 0 else (i, j)
    return side * alike if ahead(bench, scorer, others, leader, plainer) < AGREED else 0.0

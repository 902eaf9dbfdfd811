"""Choice of the simplest of candidates that the recording cannot tell apart."""

from galen_hw.diagnosis.estimation.dataset import Bench
from galen_hw.diagnosis.estimation.least_squares import reduced_chi2
from galen_hw.diagnosis.estimation.normal_equations import Score, Scorer
from galen_hw.diagnosis.selection.comparison import vuong_statistic
from galen_hw.diagnosis.settings import LIMITS
from galen_hw.diagnosis.stats.criteria import CRITERIA
from galen_hw.physics.effects.base import Effect


def plainest(
    bench: Bench, scorer: Scorer, chosen: list[int], scores: dict[int, Score], able: list[int], *, unsure: float
) -> int:
    """Return the simplest hypothesis that the first of the significant ones leads by no more than a standard error.

    A likelihood ratio is compared with its own spread from block to block (Vuong 1989), and with the discrepancy of the laws:
    where noise alone is left with either, less than that is no evidence (a steady pull is a weight but for inertia).

    Args:
        able: best first.
        unsure: difference of rank that is no evidence, see `undecided`; 0 while more may be found.
    """
    best = able[0]
    nothing = max(LIMITS.tie, unsure)
    own = _cost(scorer, scores, best)
    near = [i for i in able[1:] if scores[best].rank - scores[i].rank <= max(LIMITS.near * scores[best].gain, nothing)]
    places: dict[object, int] = {}
    for i in near:
        effect = scorer.library[i].effect
        if effect is not None and _cost(scorer, scores, i) < own:
            places.setdefault(effect.location, i)
    for asked, i in enumerate(sorted(places.values(), key=lambda i: _cost(scorer, scores, i))):
        lead = scores[best].rank - scores[i].rank
        tied = lead <= nothing or (
            lead <= CRITERIA.least_share * scores[best].gain
            and reduced_chi2(bench, scorer, [*chosen, i]) <= CRITERIA.noise_alone
        )
        if tied or (asked < LIMITS.rivals and vuong_statistic(bench, scorer, chosen, best, i) < 1.0):
            return i
    return best


def undecided(bench: Bench, scorer: Scorer, model: list[int]) -> float:
    """Return the rank difference that model discrepancy explains: a part of what the better model leaves above the noise."""
    over = reduced_chi2(bench, scorer, model)
    return (
        CRITERIA.beside_unexplained * (over - 1.0) * bench.train.sum() * bench.live_channels
        if over > CRITERIA.noise_alone
        else 0.0
    )


def _cost(scorer: Scorer, scores: dict[int, Score], i: int) -> tuple[int, int]:
    """Return the complexity of a hypothesis: rarer kinds are more complex, then those with more parameters."""
    effect = scorer.library[i].effect
    return (Effect.COMPLEXITY if effect is None else effect.complexity, scores[i].count)

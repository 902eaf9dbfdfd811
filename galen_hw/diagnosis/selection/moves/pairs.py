"""Two effects that hide each other: neither is worth its place alone, both are together."""

from galen_hw.diagnosis.estimation.normal_equations import Scorer
from galen_hw.diagnosis.selection.acceptance import pays, plausible
from galen_hw.diagnosis.selection.limits import LIMITS
from galen_hw.diagnosis.selection.search_state import Selection, elsewhere
from galen_hw.diagnosis.stats.criteria import CRITERIA


def hidden(out: Selection) -> bool:
    """Return whether the first able hypothesis joined that takes what two must, once the likeliest partner stands beside it.

    An arm that is turned and late errs by the sum: what fits one of the two alone fits the other's half as well, and the
    rest is hardly smaller for it on blocks left out.
    """
    bench, scorer = out.bench, out.scorer
    if scorer.misfit(out.chosen) < CRITERIA.noise_alone:
        return False
    leaders: dict[str, int] = {}
    for i in out.turn.able:
        leaders.setdefault(scorer.library[i].effect.KEY, i)  # type: ignore[union-attr]
    for i in list(leaders.values())[: LIMITS.leaders]:
        j = _partner(scorer, out, i)
        if j is None:
            continue
        both = [*out.chosen, i, j]
        if pays(out, both)[0] and all(plausible(bench, scorer, [k for k in both if k != one], one) for one in (i, j)):
            out.chosen.append(i)
            return True
    return False


def _partner(scorer: Scorer, out: Selection, i: int) -> int | None:
    """The likeliest hypothesis beside the chosen ones and this one; None if chance explains it."""
    scores, _ = scorer.scores([*out.chosen, i])
    able = [j for j, s in scores.items() if s.rank > 0.0 and s.surprise > out.needed]
    return max(elsewhere(scorer, [*out.chosen, i], able), key=lambda j: scores[j].rank, default=None)

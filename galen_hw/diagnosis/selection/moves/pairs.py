"""Two effects that hide each other: neither is worth its place alone, both are together."""

from galen_hw.diagnosis.selection.limits import LIMITS
from galen_hw.diagnosis.selection.moves.add import with_partner
from galen_hw.diagnosis.selection.search_state import Selection
from galen_hw.diagnosis.stats.criteria import CRITERIA


def hidden(out: Selection) -> bool:
    """Return whether the first able hypothesis joined that takes what two must, once the likeliest partner stands beside it.

    An arm that is turned and late errs by the sum: what fits one of the two alone fits the other's half as well, and the
    rest is hardly smaller for it on blocks left out.
    """
    scorer = out.scorer
    if scorer.misfit(out.chosen) < CRITERIA.noise_alone:
        return False
    leaders: dict[str, int] = {}
    for i in out.turn.able:
        leaders.setdefault(scorer.library[i].effect.KEY, i)  # type: ignore[union-attr]
    for i in list(leaders.values())[: LIMITS.leaders]:
        if with_partner(out, i) is not None:
            out.chosen.append(i)
            return True
    return False

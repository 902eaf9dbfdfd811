"""Two or three plain effects in the place of a flexible one that took what none of them could take alone."""

from galen_hw.diagnosis.estimation.linearisation import as_if, unbent
from galen_hw.diagnosis.estimation.normal_equations import Score, Scorer
from galen_hw.diagnosis.selection.acceptance import left_out, no_worse, plausible
from galen_hw.diagnosis.selection.comparison import in_place
from galen_hw.diagnosis.selection.limits import LIMITS
from galen_hw.diagnosis.selection.search_state import Selection, elsewhere
from galen_hw.diagnosis.selection.simplicity import undecided
from galen_hw.diagnosis.stats.criteria import CRITERIA
from galen_hw.physics.effects.base import Effect


def split(out: Selection) -> bool:
    """Two or three plain effects in the place of a flexible one that took what none could take alone; whether that was better.

    Forward search takes the best single hypothesis first: a spring with four parameters for a tilt and a zero together.
    """
    bench, scorer = out.bench, out.scorer
    for i in list(out.chosen):
        effect = scorer.library[i].effect
        if effect is None or not effect.FLEXIBLE:
            continue
        others = [j for j in out.chosen if j != i]
        ranks = {j: s for j, s in in_place(bench, scorer, out.chosen, i).items() if i == j or _apart(scorer, i, j)}
        if i not in ranks:
            continue
        with unbent(scorer, i):
            firsts = _firsts(scorer, others, ranks, LIMITS.part * ranks[i].gain, effect)
            plain = {j: score for j, score in ranks.items() if j != i}
            chains = [_chain(scorer, others, a, plain, out.needed) for a in firsts]
        total, chain = max(chains, default=(0.0, []), key=lambda x: x[0])
        if len(chain) < 2 or total < ranks[i].rank + CRITERIA.log_odds + undecided(bench, scorer, out.chosen):
            continue
        real = all(plausible(bench, scorer, [*others, *(x for x in chain if x != one)], one) for one in chain)
        before = left_out(out, out.chosen)
        with as_if(scorer, [*others, *chain]):
            after = left_out(out, [*others, *chain])
        if real and no_worse(before, after):
            out.chosen = [*others, *chain]
            return True
    return False


def _chain(
    scorer: Scorer, others: list[int], first: int, able: dict[int, Score], needed: float
) -> tuple[float, list[int]]:
    """Up to three hypotheses out of the able ones that follow each other beside the others, and their ranks together."""
    chain, total = [first], able[first].rank
    while len(chain) < LIMITS.chain:
        model = [*others, *chain]
        scores = scorer.scores(model)[0]
        follow = elsewhere(scorer, model, [j for j in scores if j in able])
        best = max(follow, key=lambda j: scores[j].rank, default=None)
        if best is None or scores[best].rank <= 0.0 or scores[best].surprise <= needed:
            break
        chain.append(best)
        total += scores[best].rank
    return total, chain


def _apart(scorer: Scorer, i: int, j: int) -> bool:
    """Return whether j is plain beside the flexible i: lasting, nothing searched, and not flexible itself."""
    other = scorer.library[j]
    effect = other.effect
    plain = effect is not None and not effect.FLEXIBLE and not effect.EPISODIC and not effect.searched()
    return plain and other.looked == 1 and j != i


def _firsts(scorer: Scorer, others: list[int], ranks: dict[int, Score], least: float, own: Effect) -> list[int]:
    """The best hypothesis of each family, strongest first, that could be the first of a few."""
    out: dict[object, int] = {}
    for j in elsewhere(scorer, others, sorted(ranks, key=lambda j: -ranks[j].rank)):
        effect = scorer.library[j].effect
        if effect is not None and effect.KEY != own.KEY and ranks[j].gain >= least:
            out.setdefault(effect.family, j)
    return list(out.values())[: LIMITS.leaders]

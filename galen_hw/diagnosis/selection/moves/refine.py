"""Richer forms of a chosen effect, where these are supported."""

from galen_hw.diagnosis.estimation.candidate import identity_of
from galen_hw.diagnosis.selection.acceptance import pays, plausible
from galen_hw.diagnosis.selection.comparison import polished
from galen_hw.diagnosis.selection.moves.course import followed
from galen_hw.diagnosis.selection.search_state import Selection
from galen_hw.diagnosis.settings import LIMITS
from galen_hw.diagnosis.stats.criteria import CRITERIA
from galen_hw.physics.effects.base import Effect


def refined(out: Selection) -> bool:
    """Return whether a chosen effect got a richer form, a law between its parameters, or a finer time course."""
    return enriched(out) or _bound(out) or followed(out)


def enriched(out: Selection) -> bool:
    """Return whether a richer form of a chosen effect (friction with a viscous part, by direction) replaced it.

    Nested forms of one kind in one joint are judged by increment alone: likelihood beyond the penalty of the added parameters,
    and what a finding has to show on held-out blocks.
    """
    bench, scorer = out.bench, out.scorer
    changed = False
    for place, i in enumerate(list(out.chosen)):
        effect = scorer.library[i].effect
        forms = [] if effect is None else list(effect.richer(bench.scene))
        if effect is None or not (_nests(effect) or forms):
            continue
        others = [j for j in out.chosen if j != i]
        _grown(out, others, forms)
        scores, _ = scorer.scores(others)
        kin = [j for j in scores if i in scores and _same_kind(scorer.library[j].effect, effect) and j != i]
        best: dict[object, int] = {}
        for j in sorted(kin, key=lambda j: -scores[j].rank):
            if scores[j].rank > scores[i].rank + CRITERIA.log_odds:
                best.setdefault(scorer.library[j].effect.family, j)  # type: ignore[union-attr]
        for j in list(best.values())[: LIMITS.forms]:
            trial = [*out.chosen[:place], j, *out.chosen[place + 1 :]]
            if pays(out, trial, j)[0] and plausible(bench, scorer, trial[:place] + trial[place + 1 :], j):
                out.chosen, changed = trial, True
                break
    return changed


def _grown(out: Selection, others: list[int], forms: list[Effect]) -> None:
    """Add richer forms of one effect to the library, and the best of them at its optimum: once in a search."""
    if not forms or identity_of(forms[0]) in out.enriched:
        return
    out.enriched.add(identity_of(forms[0]))
    scorer = out.scorer
    known = {h.effect for h in scorer.library}
    scorer.append([out.bench.hypothesis(one) for one in forms if one not in known])
    scores = scorer.scores(others, [i for i, h in enumerate(scorer.library) if h.effect in forms])[0]
    if scores:
        polished(out.bench, scorer, others, max(scores, key=lambda j: scores[j].rank), LIMITS.forms)


def _nests(effect: Effect) -> bool:
    """Return whether all forms of its kind in its joint are richer or poorer than one another."""
    return bool(effect.joints) and not effect.EPISODIC


def _same_kind(other: Effect | None, effect: Effect) -> bool:
    """Return whether another is of the kind and in the joint of an effect; without a joint, the same at other searched values."""
    if other is None or other.KEY != effect.KEY:
        return False
    return other.joints == effect.joints if _nests(effect) else other.family == effect.family


def _bound(out: Selection) -> bool:
    """Return whether an effect bound by a law between its parameters replaced a freer one that it ranks above."""
    bench, scorer = out.bench, out.scorer
    changed = False
    for place, i in enumerate(list(out.chosen)):
        others, j = [k for k in out.chosen if k != i], i
        for _ in range(LIMITS.chain):
            effect = scorer.library[j].effect
            theta, at, _ = scorer.solve([*others, j])
            bound = None if effect is None else effect.told_by(theta[scorer.mask_of(at, j)])
            if bound is None:
                break
            scorer.append([bench.hypothesis(bound)])
            j = len(scorer.library) - 1
        if j == i:
            continue
        scores, _ = scorer.scores(others, [i, j])
        if j in scores and (i not in scores or scores[j].rank > scores[i].rank + LIMITS.tie):
            out.chosen[place], changed = j, True
    return changed

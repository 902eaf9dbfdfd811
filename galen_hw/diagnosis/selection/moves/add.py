"""Moves that add an effect: the best significant one, or two that are supported only together."""

from collections.abc import Iterator

import numpy as np

from galen_hw.diagnosis.estimation.dataset import Bench
from galen_hw.diagnosis.estimation.normal_equations import Score, Scorer
from galen_hw.diagnosis.selection.acceptance import pays, plausible
from galen_hw.diagnosis.selection.comparison import at_nonlinear_optimum, polished
from galen_hw.diagnosis.selection.kinds import kind_first
from galen_hw.diagnosis.selection.moves.clock_offset import clock_offset
from galen_hw.diagnosis.selection.moves.course import finest
from galen_hw.diagnosis.selection.moves.step_times import steps_split
from galen_hw.diagnosis.selection.moves.tighten import tightened
from galen_hw.diagnosis.selection.moves.timing import clocks_per_joint
from galen_hw.diagnosis.selection.search_state import Selection, elsewhere
from galen_hw.diagnosis.selection.simplicity import plainest, undecided
from galen_hw.diagnosis.settings import LIMITS
from galen_hw.diagnosis.stats.criteria import CRITERIA


def added(out: Selection) -> bool:
    """Return whether the best significant effect joined the model; a clock that is far off is tested first."""
    best = clock_offset(out.bench, out.scorer, out.chosen, out.turn.scores)
    joining = _best(out) if best is None else [best]
    for i in joining:
        _admit(out, i)
    return bool(joining)


def _admit(out: Selection, i: int) -> None:
    """Add a hypothesis to the model: a first clock per joint where that is better, a spring as a tendon where it is one."""
    out.chosen.append(i)
    steps_split(out)
    if not clocks_per_joint(out):
        tightened(out, i)


def _best(out: Selection) -> list[int]:
    """Return the best significant hypothesis that is supported on held-out blocks, with a partner where it needs one.

    The turn's `significant` is filled with the significant hypotheses, best first.
    """
    bench, scorer, scores, able, failed = out.bench, out.scorer, out.turn.scores, out.turn.significant, out.turn.failed
    fit = [i for i, s in scores.items() if s.surprise > out.needed and s.rank > 0.0 and i not in failed]
    fit = elsewhere(scorer, out.chosen, fit)
    fit.sort(key=lambda i: -scores[i].rank)
    if not fit:
        return []
    able += sharpened(bench, scorer, out.chosen, scores, fit)
    unsure = undecided(bench, scorer, [*out.chosen, able[0]])
    able.insert(0, plainest(bench, scorer, out.chosen, scores, able, unsure=unsure))
    able[:0] = kind_first(scorer, scores, able)
    tries = 0
    for i in _kinds_first(scorer, able):
        if i in failed:
            continue
        if tries == LIMITS.tries:
            break
        tries += 1
        share = 0.0
        for better, paid, share in _variants(out, i):
            if paid and plausible(bench, scorer, out.chosen, better):
                return [better]
            if paid:
                # Implausible at the optimum, it may be plausible with a partner, or beside its optimum.
                if (both := with_partner(out, better)) is not None:
                    return both
                near = _plausible_kin(bench, scorer, out.chosen, scores, i)
                if near is not None and pays(out, [*out.chosen, near], near)[0]:
                    return [near]
            elif share <= 0.0:
                break
        failed.update(kin(scorer, i))
        effect = scorer.library[i].effect
        if effect is not None:
            out.refused.append((effect, share))
    return []


def _kinds_first(scorer: Scorer, able: list[int]) -> list[int]:
    """Return the able in their order, the best of each kind before the second best of any.

    Refused one after the other, the many places of one kind would use up the tries, and another kind would not be asked.
    """
    first: dict[str, int] = {}
    for i in able:
        effect = scorer.library[i].effect
        if effect is not None:
            first.setdefault(effect.KEY, i)
    return list(dict.fromkeys([*first.values(), *able]))


def _variants(out: Selection, i: int) -> Iterator[tuple[int, bool, float]]:
    """Yield the hypothesis at its optimum, then in a finer form, each with what `pays` says of it.

    As it was proposed it shows whether the optimum is worth the time.
    """
    effect, proposed = out.scorer.library[i].effect, None
    if effect is not None and effect.searched():
        proposed = pays(out, [*out.chosen, i], i)
        if not proposed[0] and proposed[1] <= 0.0:
            return
    best = polished(out.bench, out.scorer, out.chosen, i)
    yield best, *(proposed if best == i and proposed is not None else pays(out, [*out.chosen, best], best))
    if (finer := finest(out.bench, out.scorer, out.chosen, i)) != i:
        yield finer, *pays(out, [*out.chosen, finer], finer)


def with_partner(out: Selection, i: int) -> list[int] | None:
    """Return a hypothesis and the likeliest one given it, if both are plausible and supported together; else None."""
    bench, scorer = out.bench, out.scorer
    model = [*out.chosen, i]
    scores, _ = scorer.scores(model)
    able = [j for j, s in scores.items() if s.rank > 0.0 and s.surprise > out.needed]
    j = max(elsewhere(scorer, model, able), key=lambda j: scores[j].rank, default=None)
    if j is None:
        return None
    both = [i, j]
    real = all(plausible(bench, scorer, [*out.chosen, *(k for k in both if k != one)], one) for one in both)
    return both if real and pays(out, [*out.chosen, *both])[0] else None


def hidden(out: Selection) -> bool:
    """Return whether an effect joined that is supported only together with the likeliest second one.

    An arm that is turned and late errs by the sum: what fits one of the two alone fits the other's half as well, and the
    residual is hardly smaller for it on held-out blocks.
    """
    scorer = out.scorer
    if scorer.misfit(out.chosen) < CRITERIA.noise_alone:
        return False
    leaders: dict[str, int] = {}
    for i in out.turn.significant:
        leaders.setdefault(scorer.library[i].effect.KEY, i)  # type: ignore[union-attr]
    for i in list(leaders.values())[: LIMITS.leaders]:
        if with_partner(out, i) is not None:
            out.chosen.append(i)
            return True
    return False


def _plausible_kin(bench: Bench, scorer: Scorer, chosen: list[int], scores: dict[int, Score], i: int) -> int | None:
    """Return the best plausible hypothesis of the same family at other searched values."""
    ranked = sorted((j for j in kin(scorer, i) if j in scores), key=lambda j: -scores[j].rank)
    return next((j for j in ranked if scores[j].rank > 0.0 and plausible(bench, scorer, chosen, j)), None)


def kin(scorer: Scorer, i: int) -> list[int]:
    """Return a hypothesis and all of its family: the same at other searched values."""
    effect = scorer.library[i].effect
    assert effect is not None, "nuisances are never candidates"
    return [j for j, h in enumerate(scorer.library) if h.effect is not None and h.effect.family == effect.family]


def sharpened(bench: Bench, scorer: Scorer, chosen: list[int], scores: dict[int, Score], able: list[int]) -> list[int]:
    """Return the significant ones ranked again, the leaders of up to four kinds at their optimum: a grid must not decide."""
    leaders: dict[str, int] = {}
    for i in able:
        effect = scorer.library[i].effect
        if effect is not None and scores[i].rank > (1.0 - LIMITS.near) * scores[able[0]].rank:
            leaders.setdefault(effect.KEY, i)
    fresh = []
    for i in list(leaders.values())[: LIMITS.leaders]:
        effect = scorer.library[i].effect
        if effect is not None and effect.bends(bench.scene, np.zeros(scorer.library[i].count)):
            scores[i] = at_nonlinear_optimum(bench, scorer, chosen, i, scores[i])
        elif effect is not None and effect.searched() and len(leaders) > 1:
            better = polished(bench, scorer, chosen, i)
            if better != i:
                scores.update(scorer.scores(chosen, [better])[0])
                fresh.append(better)
    return sorted([*able, *(i for i in fresh if i in scores)], key=lambda i: -scores[i].rank)

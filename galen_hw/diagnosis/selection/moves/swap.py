"""Each chosen effect against every rival in its place."""

import numpy as np

from galen_hw.diagnosis.estimation.cross_validation import crossed
from galen_hw.diagnosis.estimation.dataset import Bench
from galen_hw.diagnosis.estimation.interactions import cost_without
from galen_hw.diagnosis.estimation.least_squares import missed
from galen_hw.diagnosis.estimation.linearisation import as_if, rebase, unbent
from galen_hw.diagnosis.estimation.normal_equations import Scorer
from galen_hw.diagnosis.selection.acceptance import plausible
from galen_hw.diagnosis.selection.comparison import in_place, loosens
from galen_hw.diagnosis.selection.moves.add import TRIES, kin
from galen_hw.diagnosis.selection.moves.step_times import parted
from galen_hw.diagnosis.selection.search_state import Selection, elsewhere
from galen_hw.diagnosis.selection.simplicity import ALIKE, favour, handicap, slack
from galen_hw.diagnosis.stats.significance import LOG_ODDS


def swapped(out: Selection) -> bool:
    """Return whether any effect was exchanged for a rival in its place."""
    out.turn.swapped = _swap(out)
    return out.turn.swapped


def _swap(out: Selection) -> bool:
    """Each chosen effect against every rival in its place; whether any was exchanged."""
    bench, scorer = out.bench, out.scorer
    start = list(out.chosen)
    for i in list(out.chosen):
        others = [j for j in out.chosen if j != i]
        # A cable has shown by now whether a tendon does what its spring does.
        rivals = {
            j: scorer.in_full(j, s)
            for j, s in in_place(bench, scorer, out.chosen, i).items()
            if j not in out.turn.failed
        }
        rivals = {j: rivals[j] for j in elsewhere(scorer, others, rivals)}
        rivals = {j: s for j, s in rivals.items() if not loosens(scorer.library[j].effect, scorer.library[i].effect)}
        rivals = {j: s for j, s in rivals.items() if j == i or not _left_behind(scorer, i, j)}
        if i not in rivals:
            continue
        # A plainer one need not be better, only as good: what came first in an earlier turn must not decide.
        with unbent(scorer, i):
            able = {j: s.rank + handicap(bench, scorer, others, i, j, rivals) for j, s in rivals.items() if j != i}
        better = sorted((j for j in able if able[j] > rivals[i].rank), key=lambda j: -able[j])
        best = next((j for j in better[:TRIES] if plausible(bench, scorer, others, j)), i)
        margin = LOG_ODDS + slack(missed(bench, scorer, [*others, best])) * rivals[i].gain
        if best in kin(scorer, i) or (best != i and favour(scorer, i, best) > 0):
            margin = 1.0  # the same thing at a better value, or a plainer one that does as well
        if best == i or able[best] <= rivals[i].rank + margin:
            continue
        trial = [best if j == i else j for j in out.chosen]
        if able[best] - _flattered(bench, scorer, trial, i, best) <= rivals[i].rank + margin:
            continue
        before = crossed(bench, scorer, out.chosen)
        with as_if(scorer, trial):
            after = crossed(bench, scorer, trial)
        if float(np.mean(after / before)) <= 1.0 + ALIKE:
            out.chosen = trial
            parted(out)
            rebase(scorer, out.chosen)
    return out.chosen != start


def _flattered(bench: Bench, scorer: Scorer, trial: list[int], i: int, best: int) -> float:
    """How much less the trial leaves than it will without the delay or lag i, through which its columns came."""
    gone, come = scorer.library[i].effect, scorer.library[best].effect
    if gone is None or not gone.CLOCK or (come is not None and come.CLOCK):
        return 0.0
    with as_if(scorer, trial):
        promised = scorer.solve(trial)[2]
    return max(cost_without(bench, scorer, trial, gone) - promised, 0.0)


def swapped_again(out: Selection) -> bool:
    """Return whether one more round of swaps brings other hypotheses in, not only better values of the same.

    What was exchanged last may have made room for better: a wander beside a tool stood for a warm-up beside a cable.
    """
    if not out.turn.swapped:
        return False
    scorer = out.scorer
    families = _families(scorer, out.chosen)
    with out.attempt() as attempt:
        attempt.kept = _swap(out) and _families(scorer, out.chosen) != families
    return attempt.kept


def _left_behind(scorer: Scorer, i: int, j: int) -> bool:
    """Whether j is the chosen i where it stood before it was settled: a tangent says of itself that it reaches anywhere."""
    own, other = scorer.library[i], scorer.library[j]
    return other.theta is not None and own.effect == other.effect and own.effect is not None and own.effect.curved


def _families(scorer: Scorer, chosen: list[int]) -> set[object]:
    return {effect.family for i in chosen if (effect := scorer.library[i].effect) is not None}

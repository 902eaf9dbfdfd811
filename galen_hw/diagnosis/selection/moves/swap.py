"""Exchange of each chosen effect for a better one in its place."""

from galen_hw.diagnosis.estimation.dataset import Bench
from galen_hw.diagnosis.estimation.interactions import cost_without, settle_together
from galen_hw.diagnosis.estimation.linearisation import as_if, nonlinear_restored, rebase
from galen_hw.diagnosis.estimation.normal_equations import Score, Scorer
from galen_hw.diagnosis.selection.acceptance import as_good, held_out_errors, no_worse, plausible
from galen_hw.diagnosis.selection.comparison import in_place, loosens, vuong_statistic
from galen_hw.diagnosis.selection.kinds import with_its_kind
from galen_hw.diagnosis.selection.moves.add import kin
from galen_hw.diagnosis.selection.moves.step_times import steps_split
from galen_hw.diagnosis.selection.search_state import Selection, elsewhere
from galen_hw.diagnosis.selection.simplicity import plainest, undecided
from galen_hw.diagnosis.settings import LIMITS
from galen_hw.diagnosis.stats.criteria import CRITERIA


def swapped(out: Selection) -> bool:
    """Return whether any effect was exchanged for a rival in its place."""
    out.turn.swapped = _swap(out)
    return out.turn.swapped


def simplified(out: Selection) -> bool:
    """Return whether a simpler effect replaced one that is better by no more than model discrepancy explains.

    Tested when nothing else is found: what is missing before that is mostly what will be found.
    """
    return _swap(out, simpler=True)


def _swap(out: Selection, *, simpler: bool = False) -> bool:
    """Compare each chosen effect with every rival in its place; return whether any was exchanged."""
    bench, scorer = out.bench, out.scorer
    start = list(out.chosen)
    for i in list(out.chosen):
        if bench.deadline.passed():
            break
        others = [j for j in out.chosen if j != i]
        # A cable has been compared with a tendon by now.
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
        best = _best(out, others, i, rivals, simpler=simpler)
        if best == i:
            continue
        trial = [best if j == i else j for j in out.chosen]
        flattered = _flattered(bench, scorer, trial, i, best)
        if flattered > 0.0 and rivals[best].rank - flattered <= rivals[i].rank + CRITERIA.log_odds:
            continue
        before = held_out_errors(out, out.chosen)
        with out.attempt() as attempt:
            out.chosen = trial
            steps_split(out)
            rebase(scorer, out.chosen)
            # The others were at their optimum given the old effect, not the new one.
            settle_together(bench, scorer, out.chosen)
            attempt.kept = (as_good if simpler else no_worse)(before, held_out_errors(out, out.chosen))
    return out.chosen != start


def _best(out: Selection, others: list[int], i: int, rivals: dict[int, Score], *, simpler: bool) -> int:
    """Return the rival that is significantly better in the place of the chosen i, and the simplest of equals; else i.

    A simpler one need not be better, only as good: what came first in an earlier turn must not decide.
    """
    bench, scorer = out.bench, out.scorer
    own, ranked = set(kin(scorer, i)), sorted(rivals, key=lambda j: -rivals[j].rank)
    best, whole = i, with_its_kind(scorer, rivals, i)
    with nonlinear_restored(scorer, i):
        for j in ranked[: LIMITS.tries]:
            # An effect in several channels is compared with the kind in all joints: in one of them alone it explains less.
            lead = rivals[j].rank - (whole if len(scorer.library[j].raw.channels) > 1 else rivals[i].rank)
            if j == i or rivals[j].rank - rivals[i].rank <= LIMITS.tie:
                break
            better = j in own or (
                lead > CRITERIA.log_odds + undecided(bench, scorer, [*others, j])
                and vuong_statistic(bench, scorer, others, j, i) >= 1.0
            )
            if better and plausible(bench, scorer, others, j):
                best = j
                break
        able = [best, *(j for j in ranked if j != best)]
    unsure = undecided(bench, scorer, [*others, best]) if simpler else 0.0
    plain = plainest(bench, scorer, others, rivals, able, unsure=unsure)
    return plain if plain == best or plausible(bench, scorer, others, plain) else best


def _flattered(bench: Bench, scorer: Scorer, trial: list[int], i: int, best: int) -> float:
    """Return how much the trial's fit worsens without the delay or lag i, through which its columns came."""
    gone, come = scorer.library[i].effect, scorer.library[best].effect
    if gone is None or not gone.CLOCK or (come is not None and come.CLOCK):
        return 0.0
    with as_if(scorer, trial):
        promised = scorer.solve(trial)[2]
    return max(cost_without(bench, scorer, trial, gone) - promised, 0.0)


def swapped_again(out: Selection) -> bool:
    """Return whether one more round of swaps brings other hypotheses in, not only other values of the same.

    What was exchanged last may have made room for better: a wander beside a tool stood for a warm-up beside a cable.
    """
    if not out.turn.swapped:
        return False
    families = out.families
    with out.attempt() as attempt:
        attempt.kept = _swap(out) and out.families != families
    return attempt.kept


def _left_behind(scorer: Scorer, i: int, j: int) -> bool:
    """Return whether j is the chosen i as it was before it converged: a tangent seems to reach anywhere."""
    own, other = scorer.library[i], scorer.library[j]
    return own.effect is not None and own.effect.curved and other.theta is not None and own.effect == other.effect

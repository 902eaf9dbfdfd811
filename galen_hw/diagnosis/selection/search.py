"""The search for the effects of a model: a loop over a table of moves, until none improves it."""

from collections.abc import Sequence

import numpy as np

from galen_hw.diagnosis.estimation.candidate import Hypothesis, identity_of
from galen_hw.diagnosis.estimation.cross_validation import cross_validated
from galen_hw.diagnosis.estimation.dataset import Bench
from galen_hw.diagnosis.estimation.interactions import retime, settle_together
from galen_hw.diagnosis.estimation.linearisation import rebase, tangent
from galen_hw.diagnosis.estimation.normal_equations import Scorer, threshold
from galen_hw.diagnosis.selection.moves import MOVES
from galen_hw.diagnosis.selection.moves.clipping import limits_updated
from galen_hw.diagnosis.selection.moves.drop import alone, dropped
from galen_hw.diagnosis.selection.moves.step_times import steps_relocated
from galen_hw.diagnosis.selection.moves.swap import swapped
from galen_hw.diagnosis.selection.proposals import known, sought
from galen_hw.diagnosis.selection.search_state import Selection, Turn
from galen_hw.diagnosis.settings import LIMITS
from galen_hw.diagnosis.stats.criteria import CRITERIA
from galen_hw.physics.effects.base import Effect
from galen_hw.spatial import Array

Start = Sequence[tuple[Effect, Array]]
"""Effects with their parameters (k,), from which a search may begin."""


def select(bench: Bench, scorer: Scorer, *, start: Start = ()) -> Selection:
    """Search for the effects: in each turn the first move that finds a better model, then those that tidy it.

    Args:
        bench: the data; has the state of the model found afterwards.
        scorer: with all hypotheses.
        start: the model to begin with.
    """
    out, seen = Selection(scorer), set[frozenset[object]]()
    finding, tidying = ([one.make for one in MOVES if one.tidies is tidies] for tidies in (False, True))
    if start:
        _begin(out, start)
    for _ in range(LIMITS.turns):
        _look(out)
        if not any(make(out) for make in finding if not bench.deadline.passed()):
            break
        settle_together(bench, scorer, out.chosen)
        for make in tidying:
            if not bench.deadline.passed() and make(out):
                settle_together(bench, scorer, out.chosen)
        retime(bench, scorer, out.chosen)
        out.turn.failed.clear()
        # The search is in a cycle: what was added only to be exchanged again would be added again.
        if out.families in seen:
            break
        seen.add(out.families)
    _conclude(out)
    return out


def settled(scorer: Scorer, start: Start, needed: float, *, rivals: bool = False) -> Selection:
    """Return a start as a converged model, without further search.

    Args:
        scorer: with all hypotheses, which the start joins.
        needed: surprise that chance reaches, as a search has found it.
        rivals: whether each effect is asked for better ones in its place.
    """
    out = Selection(scorer, needed=needed)
    _start_from(out, start)
    if rivals and swapped(out):
        settle_together(out.bench, scorer, out.chosen)
    _restore_residual(out)
    return out


def _begin(out: Selection, start: Start) -> None:
    """Look at a model that has no effects, then put those of a start into it."""
    _look(out)
    out.initial_errors = cross_validated(out.bench, out.scorer.base, out.scorer.white) ** 2
    _start_from(out, start)


def _start_from(out: Selection, start: Start) -> None:
    """Put the effects of a start into a model that has none, and iterate to convergence."""
    bench, scorer = out.bench, out.scorer
    trials = {h.effect.family: h.trials for h in scorer.library if h.effect is not None}
    first = len(scorer.library)
    scorer.append([_placed(bench, effect, theta, trials.get(effect.family, 1)) for effect, theta in start])
    out.chosen = list(range(first, first + len(start)))
    rebase(scorer, out.chosen)
    settle_together(bench, scorer, out.chosen)
    retime(bench, scorer, out.chosen)


def _placed(bench: Bench, effect: Effect, theta: Array, trials: int) -> Hypothesis:
    """Return an effect as a hypothesis linearised at its parameters (k,)."""
    h = bench.hypothesis(effect, trials)
    return tangent(bench, h, theta) if effect.bends(bench.scene, np.zeros(h.count)) else h


def _look(out: Selection) -> None:
    """Begin a turn: add proposals from the residual, re-estimate limits and jumps, score all."""
    bench, scorer = out.bench, out.scorer
    _forget_superseded(out)
    fresh = [s for s in sought(bench, scorer, out.chosen) if not known(bench, scorer, s.effect)]
    scorer.append([bench.hypothesis(s.effect, s.trials) for s in fresh] + [*map(bench.hypothesis, _partners(out))])
    limits_updated(out)
    steps_relocated(out)
    out.turn.significant = []
    out.turn.scores, highest = scorer.scores(out.chosen, surrogates=True)
    out.needed = max(out.needed, threshold(highest, CRITERIA.chance))
    out.first = out.first or out.turn.scores


def _partners(out: Selection) -> list[Effect]:
    """Return the partners that the chosen effects name, of identities that are not in the library."""
    known = {identity_of(h.effect) for h in out.scorer.library}
    named = [one for h in out.hypotheses if h.effect is not None for one in h.effect.partners(out.bench.scene)]
    return [one for one in named if identity_of(one) not in known]


def _forget_superseded(out: Selection) -> None:
    """Take out of the library what a nonlinear effect was linearised at before: each convergence leaves several.

    Of an effect that is not in the model the last is kept. All were made later than what the first scores are of.
    """
    library, seen = out.scorer.library, {h.family for h in out.hypotheses}
    gone = np.zeros(len(library), dtype=bool)
    for i in reversed(range(len(library))):
        if library[i].theta is not None and i not in out.chosen:
            gone[i] = library[i].family in seen
            seen.add(library[i].family)
    if gone.any():
        numbers = out.scorer.forget(gone)
        out.chosen = [numbers[i] for i in out.chosen]
        out.evidence = {numbers[i]: score for i, score in out.evidence.items() if numbers[i] >= 0}


def _conclude(out: Selection) -> None:
    """Drop effects that the last turn made needless, score each given the others, and restore the model's residual."""
    bench, scorer = out.bench, out.scorer
    # The last turn changed searched values: effects may have become needless.
    if dropped(out):
        settle_together(bench, scorer, out.chosen)
    for i in out.chosen:
        # An effect that is collinear with the others has no score.
        score = alone(scorer, out.chosen, i)
        if score is not None:
            out.evidence[i] = score
    out.turn = Turn()
    _restore_residual(out)


def _restore_residual(out: Selection) -> None:
    """Set the residual to that of the model without interactions, which the model adds itself."""
    out.bench.update_state(interaction=0.0)
    rebase(out.scorer, out.chosen)

"""Replacement of a linear spring by the nonlinear tendon that explains it."""

import numpy as np

from galen_hw.diagnosis.estimation.candidate import Hypothesis
from galen_hw.diagnosis.estimation.dataset import Bench
from galen_hw.diagnosis.estimation.levenberg_marquardt import ConditionalGain, descended
from galen_hw.diagnosis.estimation.linearisation import as_if, rebase
from galen_hw.diagnosis.estimation.nonlinear import settle
from galen_hw.diagnosis.estimation.normal_equations import Scorer
from galen_hw.diagnosis.selection.acceptance import held_out_errors, improves, no_worse
from galen_hw.diagnosis.selection.search_state import Selection, elsewhere
from galen_hw.diagnosis.stats.criteria import CRITERIA
from galen_hw.physics.effects.base import Effect
from galen_hw.spatial import Array

FIRST_STEPS = 6
MOST_PER_SEARCH = 3
"""Times that a search asks for its tendon: where physics is missing its models never settle."""
Start = tuple[Effect, Array]
"""A tendon, and parameters (k,) from which it is sought."""
MOST_BESIDE = 3
"""Further effects that may become significant given a tendon before it is compared with the spring."""


def tightened(out: Selection, just: int | None = None) -> bool:
    """Return whether a tendon replaced a spring, with the effects that then become significant.

    A spring that is linear in all unknowns has fifteen parameters for a tendon's eight: it absorbs a tilt, a payload or a joint's
    zero. These are tested again given the tendon, and both models pay for every parameter. Of a spring that was `just` chosen the
    tendon alone is tested: what is still to be found, a drift, is not hidden by the spring.
    """
    scorer = out.scorer
    model = frozenset((just is None, *out.families))
    for i in out.chosen if just is None else [just]:
        effect = scorer.library[i].effect
        if effect is None or model in out.tightened or len(out.tightened) == MOST_PER_SEARCH:
            continue
        if effect.loose or (effect.curved and just is None):
            out.tightened.add(model)
            return _instead(out, i, MOST_BESIDE if just is None else 0)
    return False


def _instead(out: Selection, i: int, most: int) -> bool:
    """Return whether a better tendon, with so many further effects at most, replaced the chosen cable i."""
    bench, scorer = out.bench, out.scorer
    before, errors = scorer.solve(out.chosen)[2], held_out_errors(out, out.chosen)
    others = [j for j in out.chosen if j != i]
    starts = _starts(bench, scorer, others, i)
    if not starts:
        return False
    trial = _with_tendon(bench, scorer, out, others, starts, most)
    more = sum(_parameter_count(scorer, j) for j in trial) - sum(_parameter_count(scorer, j) for j in out.chosen)
    penalty = more * float(np.log(bench.noise.effective)) + (CRITERIA.log_odds if more == 0 else 0.0)
    if scorer.solve(trial)[2] + penalty < before and no_worse(errors, held_out_errors(out, trial)):
        out.chosen = trial
        return True
    rebase(scorer, out.chosen)
    return False


def _starts(bench: Bench, scorer: Scorer, others: list[int], i: int) -> list[Start]:
    """Return tendons that pull as springs do in the place of the cable i, wherever tied; and that cable if it is a tendon."""
    h, out = scorer.library[i], list[Start]()
    kind = None if h.effect is None else h.effect.KEY
    with as_if(scorer, others):
        for j, one in enumerate(scorer.library):
            if one.effect is not None and kind == one.effect.KEY and one.effect.loose:
                theta = scorer.solve([*others, j])[0][-one.count :]
                out += one.effect.starts(bench.scene, theta)
    return out if h.theta is None else [*out, _start(bench, h)]


def _start(bench: Bench, h: Hypothesis) -> Start:
    """Return a tendon with its parameters, to start from."""
    assert h.effect is not None, "a tendon is asked for"
    assert h.theta is not None, "a tangent has one"
    (start,) = h.effect.starts(bench.scene, h.theta)
    return start


def _with_tendon(
    bench: Bench, scorer: Scorer, out: Selection, others: list[int], starts: list[Start], most: int
) -> list[int]:
    """Return the others with the best tendon, and with further effects as long as each is accepted, best first."""
    rebase(scorer, others)
    while True:
        found = _best(bench, ConditionalGain(bench, scorer, others), starts)
        scorer.append([found])
        trial = [*others, len(scorer.library) - 1]
        settle(bench, scorer, trial)
        best = _most_significant(scorer, out, trial) if most else None
        if best is None or not _is_evidence(out, trial, best):
            return trial
        # The tendon is optimised again given the new effect, which it had partly absorbed.
        others, starts, most = [*trial[:-1], best], [_start(bench, found)], most - 1
        rebase(scorer, others)


def _most_significant(scorer: Scorer, out: Selection, trial: list[int]) -> int | None:
    """Return the best significant hypothesis given a model, of those that a spring can have absorbed."""
    scores = scorer.scores(trial)[0]
    able = [j for j, s in scores.items() if s.surprise > out.needed and s.rank > 0.0 and _is_plain(scorer, j)]
    return max(elsewhere(scorer, trial, able), key=lambda j: scores[j].rank, default=None)


def _is_evidence(out: Selection, trial: list[int], i: int) -> bool:
    """Return whether the likelihood of one more effect is evidence: beside missing physics held-out errors have to say so."""
    if out.scorer.misfit(trial) < CRITERIA.noise_alone:
        return True
    return improves(out, held_out_errors(out, trial), held_out_errors(out, [*trial, i]))


def _is_plain(scorer: Scorer, j: int) -> bool:
    """Return whether it lasts and has no searched value: a linear spring absorbs neither timing nor memory."""
    h = scorer.library[j]
    return h.effect is not None and not h.effect.EPISODIC and not h.effect.searched() and h.trials == 1


def _parameter_count(scorer: Scorer, i: int) -> int:
    """Return the number of parameters of a hypothesis, whatever its physics would need."""
    h = scorer.library[i]
    return h.count - int(np.sum(~np.isnan(h.fixed))) + (0 if h.effect is None else len(h.effect.searched()))


def _best(bench: Bench, given: ConditionalGain, starts: list[Start]) -> Hypothesis:
    """Return the tendon with the largest gain given a model, from several starts; one with friction where that pays."""
    cost, found = _least(bench, given, starts)
    effect, theta = _start(bench, found)
    best = found
    for starts_of_form in effect.richer_starts(bench.scene, theta):
        less, other = _least(bench, given, starts_of_form)
        penalty = (len(starts_of_form[0][1]) - len(theta)) * np.log(bench.noise.effective) + CRITERIA.log_odds
        if less + penalty < cost:
            cost, best = less + penalty, other
    return best


def _least(bench: Bench, given: ConditionalGain, starts: list[Start]) -> tuple[float, Hypothesis]:
    """Descend from the start that is best after a few steps; return cost and tendon."""
    tendons = {effect: bench.hypothesis(effect) for effect, _ in starts}
    effect, begun = starts[0]
    if len(starts) > 1:
        first = [(e, descended(bench, given, tendons[e], start, FIRST_STEPS)) for e, start in starts]
        effect, (_, found) = min(first, key=lambda end: end[1][0])
        begun = begun if found.theta is None else found.theta
    return descended(bench, given, tendons[effect], begun)

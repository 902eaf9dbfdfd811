"""Exchange of two errors of geometry or load for one or two others, where no single exchange is an improvement."""

from collections.abc import Sequence
from itertools import combinations

import numpy as np

from galen_hw.diagnosis.estimation.candidate import identity_of, place_of
from galen_hw.diagnosis.estimation.interactions import settle_together
from galen_hw.diagnosis.estimation.normal_equations import Score, Scorer
from galen_hw.diagnosis.selection.acceptance import held_out_errors, no_worse, plausible
from galen_hw.diagnosis.selection.search_state import Selection, elsewhere
from galen_hw.diagnosis.selection.simplicity import undecided
from galen_hw.diagnosis.settings import LIMITS
from galen_hw.diagnosis.stats.criteria import CRITERIA


def regrouped(out: Selection) -> bool:
    """Return whether two rigid errors were exchanged for others that explain as much with fewer parameters, or more.

    Forward search takes what is best alone. Of an axis turned about one direction beside a joint's zero that is a turned sensor
    with three parameters, and then the zero of the wrong joint: no single exchange is better, and each is the other's reason. A
    diverging model has no optimum with which others could be compared.
    """
    bench, scorer = out.bench, out.scorer
    if bench.state.diverging:
        return False
    able = [
        i
        for i in out.chosen
        if (effect := scorer.library[i].effect) is not None and (effect.RIGID or effect.MIMICS_RIGID)
    ]
    for pair in combinations(able, 2):
        tried = frozenset((scorer.library[i].family, i in pair) for i in out.chosen)
        if tried in out.regrouped:
            continue
        if bench.deadline.passed():
            return False
        out.regrouped.add(tried)
        others = [i for i in out.chosen if i not in pair]
        nonlinear = sum((b for i in pair if (b := scorer.library[i].nonlinear) is not None), np.zeros_like(bench.y))
        with scorer.against(bench.y + nonlinear):
            scores = scorer.scores(others)[0]
            penalty = {i: scores[i].gain - scores[i].rank for i in scores}
            if not all(i in scores for i in pair):
                continue
            whole = scorer.solve(others)[2] - scorer.solve([*others, *pair])[2]
            chains = [
                _chain(scorer, others, first, scores, out.needed)
                for first in _firsts(scorer, others, pair, scores, whole)
            ]
        unsure = undecided(bench, scorer, out.chosen)
        for chain in _best(scorer, pair, chains, penalty, whole, unsure):
            if _taken(out, pair, chain, penalty):
                return True
    return _reparametrised(out)


def _reparametrised(out: Selection) -> bool:
    """Return whether an effect in its equivalent form made another one needless that only covered the difference.

    What settles after a load is less at first than in the end: described by what is missing at first, it needs a heavier load.
    """
    bench, scorer = out.bench, out.scorer
    for i in list(out.chosen):
        h = scorer.library[i]
        other = None if h.effect is None else h.effect.otherwise()
        lasting = [j for j in out.chosen if j != i and (e := scorer.library[j].effect) is not None and not e.EPISODIC]
        tried = frozenset((identity_of(scorer.library[j].effect), j == i) for j in out.chosen)
        if other is None or not lasting or tried in out.regrouped:
            continue
        out.regrouped.add(tried)
        scorer.append([bench.hypothesis(other, h.trials)])
        instead = len(scorer.library) - 1
        for j in lasting:
            others = [k for k in out.chosen if k not in (i, j)]
            scores = scorer.scores(others, [i, j, instead])[0]
            penalty = {k: score.gain - score.rank for k, score in scores.items()}
            whole = scorer.solve(others)[2] - scorer.solve(out.chosen)[2]
            if len(penalty) < 3 or scores[instead].gain < (1.0 - LIMITS.near) * whole:
                continue
            if _taken(out, (i, j), [instead], penalty):
                return True
    return False


def _best(
    scorer: Scorer,
    pair: tuple[int, ...],
    chains: list[tuple[float, list[int]]],
    penalty: dict[int, float],
    whole: float,
    unsure: float,
) -> list[list[int]]:
    """Return the best chains of other kinds than the pair: better by more than `unsure`, or cheaper and nearly as good."""
    own = sum(penalty[i] for i in pair)
    ranked = sorted(((gain - sum(penalty[i] for i in chain), chain) for gain, chain in chains), reverse=True)
    found: dict[frozenset[object], list[int]] = {_kinds(scorer, pair): []}
    for rank, chain in ranked:
        plainer = _needed(pair, chain, penalty) < CRITERIA.log_odds
        if rank > whole - own + unsure - plainer * LIMITS.near * whole:
            found.setdefault(_kinds(scorer, chain), chain)
    return [chain for chain in found.values() if chain][: LIMITS.rivals]


def _needed(pair: Sequence[int], chain: Sequence[int], penalty: dict[int, float]) -> float:
    """Return by how much a chain must be better than the pair, penalties paid; negative for one body instead of two."""
    saved = sum(penalty[i] for i in pair) - sum(penalty[i] for i in chain)
    if len(chain) < len(pair) and saved > -LIMITS.tie:
        return -CRITERIA.log_odds
    return 0.0 if len(chain) <= len(pair) and saved > LIMITS.tie else CRITERIA.log_odds


def _kinds(scorer: Scorer, which: Sequence[int]) -> frozenset[object]:
    """Return the locations of hypotheses; a small body at another point counts as the same."""
    return frozenset(place_of(scorer.library[i].effect) for i in which)


def _firsts(
    scorer: Scorer, others: list[int], pair: tuple[int, ...], scores: dict[int, Score], whole: float
) -> list[int]:
    """Return the best of each kind of rigid error and place that could be the first of the others."""
    best: dict[object, int] = {}
    for i in elsewhere(scorer, others, sorted(scores, key=lambda i: -scores[i].rank)):
        effect = scorer.library[i].effect
        if effect is None or not effect.RIGID or scores[i].gain < LIMITS.part * whole:
            continue
        if scorer.library[i].theta is None and i not in pair:
            best.setdefault(place_of(effect), i)
    return list(best.values())[: LIMITS.leaders]


def _chain(
    scorer: Scorer, others: list[int], first: int, able: dict[int, Score], needed: float
) -> tuple[float, list[int]]:
    """Return the gain of the first rigid error with the best second one, where it adds anything, and the chain."""
    model, none = [*others, first], scorer.solve(others)[2]
    scores = scorer.scores(model, [i for i in able if _rigid(scorer, i) and scorer.library[i].theta is None])[0]
    second = max(elsewhere(scorer, model, scores), key=lambda i: scores[i].rank, default=None)
    chain = (
        [first]
        if second is None or scores[second].rank <= 0.0 or scores[second].surprise <= needed
        else [first, second]
    )
    return none - scorer.solve([*others, *chain])[2], chain


def _rigid(scorer: Scorer, i: int) -> bool:
    effect = scorer.library[i].effect
    return effect is not None and effect.RIGID


def _taken(out: Selection, pair: tuple[int, ...], chain: list[int], penalty: dict[int, float]) -> bool:
    """Return whether the chain, at its optimum, was better than the pair and replaced it."""
    bench, scorer = out.bench, out.scorer
    before, errors = scorer.solve(out.chosen)[2], held_out_errors(out, out.chosen)
    saved = sum(penalty[i] for i in pair) - sum(penalty[i] for i in chain)
    with out.attempt() as attempt:
        out.chosen = trial = [*(i for i in out.chosen if i not in pair), *chain]
        settle_together(bench, scorer, trial)
        new, fall = trial[len(trial) - len(chain) :], before - scorer.solve(trial)[2]
        margin = _needed(pair, chain, penalty) + undecided(bench, scorer, trial)
        converged = not bench.state.diverging
        real = converged and all(plausible(bench, scorer, [j for j in trial if j != i], i) for i in new)
        better = real and fall + saved > margin
        attempt.kept = better and no_worse(errors, held_out_errors(out, trial))
    return attempt.kept

"""Refinement of a contact's time course where a level and a few half waves leave much of it."""

import numpy as np

from galen_hw.diagnosis.estimation.dataset import Bench
from galen_hw.diagnosis.estimation.least_squares import residuals
from galen_hw.diagnosis.estimation.normal_equations import Scorer
from galen_hw.diagnosis.selection.search_state import Selection
from galen_hw.diagnosis.stats.criteria import CRITERIA
from galen_hw.physics.effects.traits import Span


def followed(out: Selection) -> bool:
    """Return whether a chosen contact got more half waves, doubled as long as the likelihood pays for them.

    A hand that pushes a thousand times harder than the noise leaves more than noise of any simple shape.
    """
    bench, scorer = out.bench, out.scorer
    changed = False
    for place, i in enumerate(list(out.chosen)):
        out.chosen[place] = finest(bench, scorer, [k for k in out.chosen if k != i], i)
        changed = changed or out.chosen[place] != i
    return changed


def finest(bench: Bench, scorer: Scorer, others: list[int], i: int) -> int:
    """Return the number of the same contact with as many half waves as pay given the others; of any other effect its own.

    The contact keeps its form where more than noise is left at all other times: other physics would pass for its time course.
    """
    effect = scorer.library[i].effect
    if effect is None or not effect.touches or not _quiet_else(bench, scorer, [*others, i], effect.touches):
        return i
    found, trials = None, scorer.library[i].trials
    best = scorer.scores(others, [i])[0].get(i)
    rank = -np.inf if best is None else best.rank
    for finer in effect.finer(bench.time):
        new = bench.hypothesis(finer, trials)
        with scorer.trying([new]):
            score = scorer.scores(others, [len(scorer.library) - 1])[0].get(len(scorer.library) - 1)
        if score is None or score.rank <= rank + CRITERIA.log_odds:
            break
        found, rank = new, score.rank
    if found is None:
        return i
    scorer.append([found])
    return len(scorer.library) - 1


def _quiet_else(bench: Bench, scorer: Scorer, model: list[int], touches: tuple[Span, ...]) -> bool:
    """Return whether the residual is hardly more than noise outside a contact's episodes."""
    time = bench.time
    outside = bench.train & ~np.any([(time >= start) & (time <= end) for start, end in touches], axis=0)
    residual = residuals(bench, scorer, model)[0][outside]
    return len(residual) > 0 and float(np.mean((residual / bench.noise.sigma) ** 2)) < CRITERIA.noise_alone

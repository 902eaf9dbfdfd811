"""The course of a touch: followed more finely where a level and a few half waves leave much of it."""

from dataclasses import replace

import numpy as np

from galen_hw.diagnosis.bench import Bench
from galen_hw.diagnosis.score import Scorer
from galen_hw.diagnosis.selection import Selection
from galen_hw.diagnosis.worth import PROVED
from galen_hw.physics.event_effects import Contact

HAND = 5
"""Half waves that a hand which swells and turns asks for at first, where a knock is a level and a bow."""
FINEST = 96
"""Half waves of an episode at most."""
ROWS_A_WAVE = 4
"""Rows of the shortest episode that a half wave has at least."""
MARGIN = 6.0


def followed(bench: Bench, scorer: Scorer, out: Selection) -> bool:
    """Whether a chosen touch was exchanged for the same with more half waves, twice as many while likelihood pays for them.

    A hand that pushes a thousand times harder than the noise leaves of any plain shape more than noise, which is its own.
    """
    changed = False
    for place, i in enumerate(list(out.chosen)):
        out.chosen[place] = finest(bench, scorer, [k for k in out.chosen if k != i], i)
        changed = changed or out.chosen[place] != i
    return changed


def finest(bench: Bench, scorer: Scorer, others: list[int], i: int) -> int:
    """The same touch, in the library, with as many half waves as pay beside the others; what is none stays as it is.

    So it does where noise alone is not left with them: what other physics does in an episode would pass for its course.
    """
    found = i
    while (finer := _finer(bench, scorer, others, found)) is not None:
        found = finer
    return found if found == i or scorer.misfit([*others, found]) < PROVED else i


def _finer(bench: Bench, scorer: Scorer, others: list[int], i: int) -> int | None:
    """The same touch with more half waves, in the library; None where they do not pay, or it is none."""
    effect = scorer.library[i].effect
    if not isinstance(effect, Contact):
        return None
    time = bench.rows.average(bench.scene.time)
    shortest = min(int(np.sum((time >= start) & (time <= end))) for start, end in effect.episodes)
    waves = max(2 * effect.waves, HAND)
    if waves > min(FINEST, shortest // ROWS_A_WAVE):
        return None
    new, j = bench.add(replace(effect, waves=waves), scorer.library[i].looked), len(scorer.library)
    with scorer.trying([new]):
        scores, _ = scorer.scores(others, [i, j])
    if j not in scores or (i in scores and scores[j].rank <= scores[i].rank + MARGIN):
        return None
    scorer.append([new])
    return j

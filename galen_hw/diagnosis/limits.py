"""Limits in the place of a touch: readings that clip at both ends, or in several channels, clip in the same episodes.

The search takes one hypothesis after the other. A touch with a level and a bow an episode does about what all the limits do
together, and more than any of them by itself; beside it none of them is worth anything.
"""

import numpy as np

from galen_hw.diagnosis.bench import Bench
from galen_hw.diagnosis.bends import as_if
from galen_hw.diagnosis.linear import crossed
from galen_hw.diagnosis.plainness import ALIKE
from galen_hw.diagnosis.score import Scorer
from galen_hw.diagnosis.selection import Selection, place_of
from galen_hw.physics.event_effects import Contact
from galen_hw.physics.sensor_effects import Saturation


def clipped(bench: Bench, scorer: Scorer, out: Selection) -> bool:
    """Whether limits at which readings pile up took the place of a chosen touch, and of limits that were found beside it."""
    piles = [j for j, h in enumerate(scorer.library) if isinstance(h.effect, Saturation) and h.looked == 1]
    touches = [i for i in out.chosen if isinstance(scorer.library[i].effect, Contact)]
    for i in touches if piles else ():
        kept = [j for j in out.chosen if j != i and not isinstance(scorer.library[j].effect, Saturation)]
        with as_if(scorer, kept):
            trial = _with_limits(scorer, out, kept, piles)
            cost = scorer.solve(trial)[2] + _price(bench, scorer, trial)
            after = crossed(bench, scorer, trial)
        better = cost < scorer.solve(out.chosen)[2] + _price(bench, scorer, out.chosen)
        if better and float(np.mean(after / crossed(bench, scorer, out.chosen))) <= 1.0 + ALIKE:
            out.chosen = trial
            return True
    return False


def _with_limits(scorer: Scorer, out: Selection, kept: list[int], piles: list[int]) -> list[int]:
    """A model with the limits that stand beside it, the strongest first."""
    trial = list(kept)
    while True:
        taken = {place_of(scorer.library[j].effect) for j in trial}
        scores = scorer.scores(trial, [j for j in piles if place_of(scorer.library[j].effect) not in taken])[0]
        able = [j for j, s in scores.items() if s.rank > 0.0 and s.surprise > out.needed]
        if not able:
            return trial
        trial.append(max(able, key=lambda j: scores[j].rank))


def _price(bench: Bench, scorer: Scorer, model: list[int]) -> float:
    return sum(h.count * h.price(bench) for h in (scorer.library[i] for i in model))

"""Limits: where they stand beside a model, and in the place of a touch.

Readings that clip at both ends, or in several channels, clip in the same episodes. The search takes one hypothesis after the
other. A touch with a level and a bow an episode does about what all the limits do together, and more than any of them by
itself; beside it none of them is worth anything.
"""

import numpy as np

from galen_hw.diagnosis.estimation.dataset import Bench
from galen_hw.diagnosis.estimation.interactions import retime, settle_together
from galen_hw.diagnosis.estimation.linearisation import as_if, rebase
from galen_hw.diagnosis.estimation.normal_equations import Scorer
from galen_hw.diagnosis.selection.acceptance import left_out, no_worse
from galen_hw.diagnosis.selection.search_state import Selection, elsewhere
from galen_hw.diagnosis.stats.criteria import CRITERIA


def clipped(out: Selection) -> bool:
    """Whether limits at which readings pile up took the place of a chosen touch, and of limits that were found beside it."""
    bench, scorer = out.bench, out.scorer
    piles = [j for j, h in enumerate(scorer.library) if h.effect is not None and h.effect.clips and h.looked == 1]
    touches = [i for i in out.chosen if (e := scorer.library[i].effect) is not None and e.touches]
    for i in touches if piles else ():
        kept = [j for j in out.chosen if j != i and ((e := scorer.library[j].effect) is None or not e.clips)]
        with as_if(scorer, kept):
            trial = _with_limits(scorer, out, kept, piles)
            cost = scorer.solve(trial)[2] + _price(bench, scorer, trial)
            after = left_out(out, trial)
        better = cost < scorer.solve(out.chosen)[2] + _price(bench, scorer, out.chosen)
        if better and no_worse(left_out(out, out.chosen), after):
            out.chosen = trial
            return True
    return False


def levelled(out: Selection) -> None:
    """Limits that were sought beside another model stand where the readings that clip beside the present one have their mean.

    With all columns told anew: what the other effects do is cut where the readings clip, and beside columns that one limit has
    cut no other is right; a limit too low stays, and leaves a share of what the others do, or a touch, to make up for it.
    """
    bench, scorer = out.bench, out.scorer
    measured = bench.whole + bench.rows.average(bench.scene.simulated)
    for i in list(out.chosen):
        effect = scorer.library[i].effect
        if effect is None or not effect.clips or scorer.library[i].looked == 1:
            continue
        name, limit = effect.clips
        c = bench.scene.channels.index(name)
        beyond = bench.train & (bench.rows.average(effect.at_limit(bench.stream).astype(float)) > 0.5)
        mean = float(measured[beyond, c].mean()) if beyond.any() else limit
        off, level = abs(mean - limit) * np.sqrt(beyond.sum()) / bench.noise.sigma[c], effect.levelled(mean)
        if off < CRITERIA.standard_errors() or any(h.effect == level for h in scorer.library):
            continue
        before, cost = list(out.chosen), scorer.solve(out.chosen)[2]
        scorer.append([bench.add(level, scorer.library[i].looked)])
        out.chosen = [len(scorer.library) - 1 if k == i else k for k in before]
        _told_anew(out)
        if scorer.solve(out.chosen)[2] > cost:
            out.chosen = before
            _told_anew(out)


def _told_anew(out: Selection) -> None:
    bench, scorer = out.bench, out.scorer
    rebase(scorer, out.chosen)
    settle_together(bench, scorer, out.chosen)
    retime(bench, scorer, out.chosen)


def _with_limits(scorer: Scorer, out: Selection, kept: list[int], piles: list[int]) -> list[int]:
    """A model with the limits that stand beside it, the strongest first."""
    trial = list(kept)
    while True:
        scores = scorer.scores(trial, elsewhere(scorer, trial, piles))[0]
        able = [j for j, s in scores.items() if s.rank > 0.0 and s.surprise > out.needed]
        if not able:
            return trial
        trial.append(max(able, key=lambda j: scores[j].rank))


def _price(bench: Bench, scorer: Scorer, model: list[int]) -> float:
    return sum(h.count * h.price(bench) for h in (scorer.library[i] for i in model))

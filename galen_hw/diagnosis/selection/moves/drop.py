"""Removal of effects that are no longer needed given the others."""

import numpy as np

from galen_hw.diagnosis.estimation.linearisation import nonlinear_restored, rebase
from galen_hw.diagnosis.estimation.normal_equations import Score, Scorer
from galen_hw.diagnosis.selection.search_state import Selection


def dropped(out: Selection) -> bool:
    """Return whether effects were removed that have no gain left given the others (backward elimination)."""
    scorer = out.scorer
    before = len(out.chosen)
    while len(out.chosen) > 1:
        each = {i: alone(scorer, out.chosen, i) for i in out.chosen}
        worst = min(out.chosen, key=lambda i: -np.inf if each[i] is None else each[i].rank)  # type: ignore[union-attr]
        score = each[worst]
        if score is not None and score.rank > 0.0:
            break
        out.chosen.remove(worst)
        rebase(scorer, out.chosen)
    return len(out.chosen) < before


def alone(scorer: Scorer, chosen: list[int], i: int) -> Score | None:
    """Return the score of a chosen hypothesis given the others."""
    with nonlinear_restored(scorer, i):
        return scorer.scores([j for j in chosen if j != i], [i])[0].get(i)

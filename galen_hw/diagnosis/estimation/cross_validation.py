"""Cross-validated errors of a model, with blocks of rows left out in turn."""

import numpy as np

from galen_hw.diagnosis.estimation.candidate import Hypothesis
from galen_hw.diagnosis.estimation.dataset import Bench
from galen_hw.diagnosis.estimation.least_squares import Normal, normal_equations, predicted, solved
from galen_hw.diagnosis.stats.sampling import Chosen, Index, folds
from galen_hw.spatial import Array


def cross_validated(
    bench: Bench,
    model: list[Hypothesis],
    white: Array,
    *,
    fine: bool = False,
    whitened: bool = False,
    pieces: int = 400,
    least: int = 8,
) -> Array:
    """Return the errors (n, C) of a model on the training rows, each block predicted from the others.

    Args:
        white: (M, C) whitened residual that the model is fitted to.
        fine: short pieces are left out instead of blocks.
        whitened: whitened errors, else raw ones.
        pieces: of a recording, every fifth of which is left out to judge momentary effects.
        least: rows of a piece of coloured noise.
    """
    train = np.flatnonzero(bench.train)
    if fine:
        # Coloured noise predicts one row from the next; static poses are independent.
        piece = max(len(bench.rows) // pieces, least if len(bench.noise.edges) else 1)
        fold = folds(np.asarray(train // piece))
    else:
        fold = folds(bench.block[train])
    held_out = [fold == k for k in range(int(fold.max(initial=0)) + 1)]
    # Once by folds: what is learnt without one of them is the sum of the others.
    normal = normal_equations(model, white, [train[rows] for rows in held_out], bench.width)
    stays = _of_moments(model, train, fold, normal, fine=fine)
    out, target = np.zeros((len(train), bench.width)), white if whitened else bench.y
    for k, rows in enumerate(held_out):
        theta = solved(model, [*normal[:k], *normal[k + 1 :]] or [(0.0 * G, 0.0 * b) for G, b in normal], stays)
        out[rows] = target[train[rows]] - predicted(model, theta, train[rows], bench.width, whitened=whitened)
    return out


def _of_moments(
    model: list[Hypothesis],
    rows: Chosen,
    fold: Index,
    normal: list[Normal],
    *,
    fine: bool,
    lives: float = 0.9,
) -> Array | None:
    """Return parameters (k,) that only one fold informs, as fitted on all rows, else NaN; None where there are none.

    A contact inside the left-out block cannot be predicted from the others: its residual would decide between models that all
    contain it. Nor can an initial transient; it may be shorter than a piece, which no contact is.

    Args:
        lives: share of the square of what belongs to a moment that must lie in held-out blocks for these to be
            all that tells of it.
    """
    held = np.zeros(sum(h.count for h in model), dtype=bool)
    done = 0
    for h in model:
        if h.effect is None or (h.effect.EPISODIC and not fine):
            square = np.stack([np.sum(h.white.values[rows[fold == k]] ** 2, axis=(0, 1)) for k in np.unique(fold)])
            held[done : done + h.count] = square.max(axis=0) > lives * square.sum(axis=0)
        done += h.count
    return np.where(held, solved(model, normal), np.nan) if held.any() else None

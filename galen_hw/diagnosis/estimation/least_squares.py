"""Models of hypotheses fitted by generalised least squares, on all rows or with blocks left out in turn."""

import numpy as np

from galen_hw.diagnosis.estimation.dataset import Bench, Hypothesis
from galen_hw.diagnosis.estimation.normal_equations import Scorer
from galen_hw.diagnosis.stats.linear_algebra import pinned_at
from galen_hw.diagnosis.stats.sampling import Chosen, Index, folds
from galen_hw.spatial import Array


def fit(model: list[Hypothesis], white: Array, rows: Chosen, width: int, stays: Array | None = None) -> Array:
    """Generalised least squares of a model on some rows; `stays`: (k,) values that parameters keep besides, else nan."""
    size = sum(h.count for h in model)
    G, b = np.zeros((size, size)), np.zeros(size)
    starts = np.cumsum([0, *(h.count for h in model)])
    for c in range(width):
        mine = [(h, s) for h, s in zip(model, starts, strict=False) if c in h.white.channels]
        if not mine:
            continue
        at = np.concatenate([np.arange(s, s + h.count) for h, s in mine])
        X = np.concatenate([h.white.values[:, h.white.channels.index(c)] for h, _ in mine], axis=1)[rows]
        G[np.ix_(at, at)] += X.T @ X
        b[at] += X.T @ white[rows, c]
    held = np.concatenate([np.empty(0), *(h.held for h in model)])
    return pinned_at(held if stays is None else np.where(np.isnan(held), stays, held), G, b)


def predicted(model: list[Hypothesis], theta: Array, rows: Chosen, width: int, *, whitened: bool = False) -> Array:
    """(len(rows), C) of a model in raw units, or whitened."""
    out, done = np.zeros((len(rows), width)), 0
    for h in model:
        columns = h.white if whitened else h.raw
        out[:, list(columns.channels)] += columns.values[rows] @ theta[done : done + h.count]
        done += h.count
    return out


def rests(bench: Bench, scorer: Scorer, chosen: list[int]) -> tuple[Array, Array]:
    """(M, C) rest of a model, raw and whitened."""
    theta = scorer.solve(chosen)[0]
    rest, white, done = bench.y.copy(), scorer.white.copy(), 0
    for i in [*range(len(scorer.base)), *chosen]:
        h = scorer.library[i]
        t = theta[done : done + h.count]
        done += h.count
        rest[:, list(h.raw.channels)] -= h.raw.values @ t
        white[:, list(h.white.channels)] -= h.white.values @ t
    return rest, white


def missed(bench: Bench, scorer: Scorer, chosen: list[int]) -> float:
    """Mean square of what a model leaves over the noise's, 1 where noise alone is left: whitened, or raw where that is more.

    Physics that is missing passes for slow noise in the weights of a short recording; a single sample knows better.
    """
    rest = rests(bench, scorer, chosen)[0][bench.train]
    return max(scorer.misfit(chosen), float(np.mean(rest**2 / (bench.noise.sigma**2 * bench.noise.slower))))


PIECES = 400
"""Of so many pieces of a recording every fifth is left out to judge what belongs to moments."""
LEAST_PIECE = 8
"""Rows of one where noise has a memory."""


def crossed(bench: Bench, scorer: Scorer, chosen: list[int], *, fine: bool = False) -> Array:
    """(C,) mean squared error of a model on training blocks left out in turn, see `left_out`."""
    return np.asarray(np.mean(errors(bench, scorer, chosen, fine=fine) ** 2, axis=0))


def errors(bench: Bench, scorer: Scorer, chosen: list[int], *, fine: bool = False, whitened: bool = False) -> Array:
    """(n, C) errors of a model on the training rows, raw or whitened, each predicted from blocks that it is not in."""
    model = [scorer.library[i] for i in [*range(len(scorer.base)), *chosen]]
    return _errors(bench, model, scorer.white, fine=fine, whitened=whitened)


def left_out(bench: Bench, model: list[Hypothesis], white: Array, *, fine: bool = False) -> Array:
    """(C,) mean squared error, raw, on training blocks left out in turn; `fine`: on short pieces left out in turn."""
    return np.asarray(np.mean(_errors(bench, model, white, fine=fine) ** 2, axis=0))


def white_left_out(bench: Bench, model: list[Hypothesis], white: Array) -> Array:
    """(n, C) white errors on the training rows, each block predicted from the others."""
    return _errors(bench, model, white, fine=False, whitened=True)


def _errors(bench: Bench, model: list[Hypothesis], white: Array, *, fine: bool, whitened: bool = False) -> Array:
    """(n, C) errors on the training rows, each block or piece predicted from the others."""
    train = np.flatnonzero(bench.train)
    if fine:
        # Noise with a memory would tell one row from the next; poses of a sweep know nothing of each other.
        piece = max(len(bench.rows) // PIECES, LEAST_PIECE if len(bench.noise.edges) else 1)
        fold = folds(np.asarray(train // piece))
    else:
        fold = folds(bench.block[train])
    out = np.zeros((len(train), bench.width))
    stays = _of_moments(model, white, train, fold, bench.width, fine=fine)
    for k in range(int(fold.max(initial=0)) + 1):
        learn, aside = fold != k, fold == k
        theta = fit(model, white, train[learn], bench.width, stays)
        target = white if whitened else bench.y
        out[aside] = target[train[aside]] - predicted(model, theta, train[aside], bench.width, whitened=whitened)
    return out


LIVES = 0.9
"""Share of the square of what belongs to a moment that must lie in blocks left out for these to be all that tells of it."""


def _of_moments(
    model: list[Hypothesis], white: Array, rows: Chosen, fold: Index, width: int, *, fine: bool
) -> Array | None:
    """(k,) parameters of what lies in one fold alone, as learnt on all rows, else nan; None where nothing does.

    A touch that lies in the blocks left out cannot be foretold from the others: what then stands there would decide between
    models that have the same one. Nor can what fades from a beginning; it may be quicker than a short piece, which no touch is.
    """
    held = np.zeros(sum(h.count for h in model), dtype=bool)
    done = 0
    for h in model:
        if h.effect is None or (h.effect.EPISODIC and not fine):
            square = np.stack([np.sum(h.white.values[rows[fold == k]] ** 2, axis=(0, 1)) for k in np.unique(fold)])
            held[done : done + h.count] = square.max(axis=0) > LIVES * square.sum(axis=0)
        done += h.count
    return np.where(held, fit(model, white, rows, width), np.nan) if held.any() else None

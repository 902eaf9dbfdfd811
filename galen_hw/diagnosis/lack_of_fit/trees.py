"""Regression trees on the inputs, for structure that no family of functions describes."""

from dataclasses import replace
from typing import TYPE_CHECKING, Final

import numpy as np
from threadpoolctl import threadpool_limits

from galen_hw.diagnosis.estimation.model import Model
from galen_hw.diagnosis.lack_of_fit.basis_functions import Inputs
from galen_hw.diagnosis.lack_of_fit.gram import Functions
from galen_hw.diagnosis.lack_of_fit.residual_model import Remainder
from galen_hw.diagnosis.lack_of_fit.structure_test import T_NEEDED, Structure, t_statistic
from galen_hw.diagnosis.settings import BUDGET
from galen_hw.diagnosis.stats.sampling import Index, folds
from galen_hw.spatial import Array

if TYPE_CHECKING:
    from sklearn.ensemble import ExtraTreesRegressor, HistGradientBoostingRegressor

TOGETHER: Final = "all inputs together, as no function that was tried does"
"""What trees depend on, in words."""


def boosted_trees() -> "HistGradientBoostingRegressor":
    """Return gradient-boosted trees (Friedman 2001) with the library's settings and a fixed seed."""
    # Half a second to import, which most recordings never ask for.
    from sklearn.ensemble import HistGradientBoostingRegressor

    return HistGradientBoostingRegressor(early_stopping=False, random_state=0)


# Threads of several diagnoses at once would spin and wait for one another: seven times as long on two cores.
@threadpool_limits.wrap(limits=1)  # type: ignore[untyped-decorator]
def blended(remainder: Remainder, model: Model, functions: Functions) -> Remainder:
    """Return a remainder averaged with trees on the inputs, in channels where that predicts held-out blocks better.

    Never trees alone: beyond the range of the motion they are constant. Errors of so different a kind partly cancel in the mean
    (Bates and Granger 1969).
    """
    rows, X = functions.rows, remainder.inputs.seen
    residual, cross_validated, trees = model.residual(), remainder.cross_validated.copy(), {}
    for c in remainder.parts:
        y, linear, own = residual[rows, c], remainder.cross_validated[rows, c], np.zeros(len(rows))
        every = np.arange(len(rows))
        for fold in functions.folds:
            others = np.delete(every, fold)
            own[fold] = boosted_trees().fit(X[rows[others]], y[others]).predict(X[rows[fold]])
        both = 0.5 * (linear + own)
        if _sum_of_squares(y - both) < _sum_of_squares(y - linear):
            trees[c] = boosted_trees().fit(X[rows], y)
            cross_validated[rows, c] = both
    return replace(remainder, trees=trees, cross_validated=cross_validated)


@threadpool_limits.wrap(limits=1)  # type: ignore[untyped-decorator]
def hidden(model: Model, *, slower: float = 2.0, most_by_time: float = 0.5) -> list[Structure]:
    """Return structure of a model's residual that passes for slow noise: what trees predict of held-out blocks.

    A law of several inputs at once that is in no family passes for noise by its own slowness. What trees on the time alone
    predict is slow noise, or drift: where a motion does not repeat, its position is a clock.

    Args:
        slower: ratio of the highest to the lowest noise level from which a channel is tested.
        most_by_time: share of the gain that trees on the time alone may have.
    """
    bench, good = model.bench, np.flatnonzero(~model.bench.excluded_rows)
    levels = bench.noise.levels
    slow = np.flatnonzero(levels.max(axis=0) > slower * levels.min(axis=0)) if len(levels) else np.empty(0, dtype=int)
    if not len(slow):
        return []
    inputs = Inputs.of(bench.scene, bench.rows)
    X = np.concatenate([inputs.position, inputs.rate, inputs.second], axis=1)
    if not X.shape[1]:  # nothing moves
        return []
    time = bench.time[:, None]
    residual = model.residual()[:, slow] / bench.noise.sigma[slow]
    fold = folds(bench.block)
    number = np.unique(bench.block[good], return_inverse=True)[1]

    def asked(of: Array) -> tuple[Array, Array]:
        predicted = _predicted(of, residual, fold, good)
        each = (predicted * (2.0 * residual - predicted))[good]
        return predicted, np.stack([np.bincount(number, column) for column in each.T], axis=-1)

    predicted, gain = asked(X)
    if max(map(t_statistic, gain.T)) < T_NEEDED:
        return []
    out, by_time = [], asked(time)[1].sum(axis=0)
    for k, c in enumerate(slow):
        own, sure = float(gain[:, k].sum()), t_statistic(gain[:, k])
        if sure >= T_NEEDED and by_time[k] <= most_by_time * own:
            basis = np.linalg.qr(np.stack([np.ones(len(residual)), predicted[:, k]], axis=-1))[0]
            share, size = (
                own / float(residual[good, k] @ residual[good, k]),
                np.sqrt(own / len(good)) * bench.noise.sigma[c],
            )
            out.append(Structure(int(c), TOGETHER, sure, share, float(size), basis))
    return sorted(out, key=lambda left: -left.z)


def _predicted(X: Array, y: Array, fold: Index, good: Index) -> Array:
    """Return residuals (M, m) predicted from inputs (M, k) by trees learnt on some good rows of other folds."""
    out, seen = np.zeros(y.shape), good[:: max(len(good) // BUDGET.coarse, 1)]
    for f in range(int(fold.max()) + 1):
        learn, aside = seen[fold[seen] != f], fold == f
        if len(learn) and aside.any():
            learnt = _many().fit(X[learn], y[learn] if y.shape[1] > 1 else y[learn, 0])
            out[aside] = learnt.predict(X[aside]).reshape(-1, y.shape[1])
    return out


def _many(*, number: int = 30, leaf: int = 10) -> "ExtraTreesRegressor":
    """Return extremely randomised trees (Geurts, Ernst and Wehenkel 2006): all channels at once, and quick.

    Args:
        number: trees.
        leaf: rows that one of their leaves holds at least.
    """
    from sklearn.ensemble import ExtraTreesRegressor

    return ExtraTreesRegressor(number, min_samples_leaf=leaf, random_state=0)


def _sum_of_squares(residual: Array) -> float:
    return float(residual @ residual)

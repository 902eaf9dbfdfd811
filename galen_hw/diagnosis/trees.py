"""Trees beside linear regressions of what has no name: they bend where no family does, and know nothing beyond the motion."""

from dataclasses import replace

import numpy as np
from sklearn.ensemble import HistGradientBoostingRegressor
from threadpoolctl import threadpool_limits

from galen_hw.diagnosis.final import Model
from galen_hw.diagnosis.inner_products import Functions
from galen_hw.diagnosis.remainder import Remainder
from galen_hw.spatial import Array


def new() -> HistGradientBoostingRegressor:
    """Gradient-boosted trees (Friedman 2001) as the library sets them, the same ones every time."""
    return HistGradientBoostingRegressor(early_stopping=False, random_state=0)


# Threads of several diagnoses at once would spin and wait for one another: seven times as long on two cores.
@threadpool_limits.wrap(limits=1)  # type: ignore[untyped-decorator]
def beside(remainder: Remainder, model: Model, functions: Functions) -> Remainder:
    """A remainder's mean with trees on the inputs and their past, in the channels where it predicts blocks left out better.

    Never trees alone: where another motion goes further they stay as they are. Errors of so different a kind partly cancel
    in the mean (Bates and Granger 1969).
    """
    rows, X = functions.rows, remainder.inputs.seen
    rest, crossed, trees = model.rest(), remainder.crossed.copy(), {}
    for c in remainder.parts:
        y, linear, own = rest[rows, c], remainder.crossed[rows, c], np.zeros(len(rows))
        every = np.arange(len(rows))
        for fold in functions.folds:
            others = np.delete(every, fold)
            own[fold] = new().fit(X[rows[others]], y[others]).predict(X[rows[fold]])
        both = 0.5 * (linear + own)
        if _left(y - both) < _left(y - linear):
            trees[c] = new().fit(X[rows], y)
            crossed[rows, c] = both
    return replace(remainder, trees=trees, crossed=crossed)


def _left(rest: Array) -> float:
    return float(rest @ rest)

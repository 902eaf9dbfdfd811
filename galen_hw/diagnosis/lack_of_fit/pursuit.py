"""Few of many generic functions: where a rest follows one product of two inputs, a family that holds it says too much."""

import warnings
from dataclasses import dataclass, field

import numpy as np
from sklearn.linear_model import orthogonal_mp

from galen_hw.diagnosis.lack_of_fit.regression import Regression
from galen_hw.diagnosis.stats.sampling import Index
from galen_hw.spatial import Array


@dataclass
class Pursuit(Regression):
    """Orthogonal matching pursuit by single functions (Pati, Rezaiifar and Krishnaprasad 1993).

    How many functions it takes is what predicts blocks left out best.

    Args:
        most: functions.
        enough: of the best number's gain; the smallest number that reaches it is taken.
        alive: share of a function's size that must lie in the rows that it is learnt on.
    """

    most: int = field(default=4, kw_only=True)
    enough: float = field(default=0.98, kw_only=True)
    alive: float = field(default=0.1, kw_only=True)
    _count: int = field(init=False, default=0)
    _parts: dict[str, Array] = field(init=False, default_factory=dict)

    def __post_init__(self) -> None:
        """Chooses how many functions, then which."""
        names = list(self.plain.columns)
        self._X, self._white = self.plain.joined(names), self.white.joined(names)
        self._learnt, self._target = (self._white, self.white_rest) if self.weighed else (self._X, self.rest)
        size = np.linalg.norm(self._learnt, axis=0)
        self._size = np.where(size > 1e-9 * max(float(size.max(initial=0.0)), 1e-300), size, np.inf)
        every = np.arange(len(self.rest))
        self._folds = [self._path(np.delete(every, f)) for f in self.plain.folds]
        raw = self._gains(self._X, self.rest)
        best = float(raw.max())
        if best <= self.least * float(self.rest @ self.rest):
            return
        # Another motion is where more functions than are needed differ.
        self._count = int(np.flatnonzero(raw >= self.enough * best)[0])
        self.reached, self.white_gain = (
            float(g[self._count]) for g in (raw, self._gains(self._white, self.white_rest))
        )
        theta, ends = self._path(every)[:, self._count], np.cumsum([0, *map(self._width, names)])
        parts = {n: theta[a:b] for n, a, b in zip(names, ends[:-1], ends[1:], strict=True)}
        self._parts = {n: part for n, part in parts.items() if part.any()}
        self.chosen = list(self._parts)

    def coefficients(self) -> dict[str, Array]:
        """Of every function of the families that one was chosen from, in the channel's unit."""
        return self._parts

    def crossed(self, *, white: bool = False) -> Array:
        """(n,) what the functions predict of each row from other folds, over the noise's deviation."""
        out, X = np.zeros(len(self.rest)), self._white if white else self._X
        for rows, theta in zip(self.plain.folds, self._folds, strict=True):
            out[rows] = X[rows] @ theta[:, self._count]
        return out

    def _width(self, name: str) -> int:
        return int(self.plain.columns[name].shape[1])

    def _path(self, rows: Index) -> Array:
        """(k, most) coefficients of one, two and more functions, learnt on some rows."""
        X, y = self._learnt[rows] / self._size, self._target[rows]
        norms = np.linalg.norm(X, axis=0)
        # Of a function that hardly lives in these rows nothing can be learnt from them.
        alive = norms > self.alive
        out = np.zeros((X.shape[1], self.most))
        if not alive.any():
            return out
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # It warns when the functions left depend on those taken; it then stops.
            most = min(self.most, int(alive.sum()))
            path = orthogonal_mp(X[:, alive] / norms[alive], y, n_nonzero_coefs=most, return_path=True)
        path = np.reshape(path, (int(alive.sum()), -1))
        out[alive, : path.shape[1]] = path / norms[alive, None]
        out[:, path.shape[1] :] = out[:, path.shape[1] - 1 : path.shape[1]]
        return out / self._size[:, None]

    def _gains(self, X: Array, y: Array) -> Array:
        """(most,) falls of a sum of squares on folds left out in turn."""
        total = np.zeros(self.most)
        for rows, theta in zip(self.plain.folds, self._folds, strict=True):
            predicted = X[rows] @ theta
            total += 2.0 * y[rows] @ predicted - np.einsum("nm,nm->m", predicted, predicted)
        return total

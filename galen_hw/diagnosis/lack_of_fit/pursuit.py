"""Sparse regression on generic functions: where a residual follows one product of two inputs, a family says too much."""

from dataclasses import dataclass, field

import numpy as np

from galen_hw.diagnosis.lack_of_fit.gram import Sums
from galen_hw.diagnosis.lack_of_fit.regression import Regression
from galen_hw.spatial import Array


@dataclass
class Pursuit(Regression):
    """Orthogonal matching pursuit by single functions (Pati, Rezaiifar and Krishnaprasad 1993), from inner products.

    How many functions it takes is what predicts held-out blocks best. Inner products of all functions with each other are as
    many as their number squared, and with the few that are taken a handful: these alone are computed.

    Args:
        most: functions.
        enough: of the best number's gain; the smallest number that reaches it is taken.
        alive: share of a function's size that must lie in the rows that it is learnt on.
    """

    most: int = field(default=4, kw_only=True)
    enough: float = field(default=0.98, kw_only=True)
    alive: float = field(default=0.1, kw_only=True)
    _taken: list[list[int]] = field(init=False, default_factory=list)
    _theta: list[Array] = field(init=False, default_factory=list)
    _parts: dict[str, Array] = field(init=False, default_factory=dict)

    def __post_init__(self) -> None:
        """Choose the number of functions, then the functions."""
        self._places = [(name, k) for name, X in self.plain.columns.items() for k in range(X.shape[1])]
        self._products: dict[int, Array] = {}
        self._learnt = self.white if self.weighed else self.plain
        inner = self._learnt.against(self.white_residual if self.weighed else self.residual)
        self._b, self._squares = np.concatenate(list(inner.values()), axis=1), self._learnt.squares()
        size = np.sqrt(self._squares.sum(axis=0))
        self._size = np.where(size > 1e-9 * max(float(size.max(initial=0.0)), 1e-300), size, np.inf)
        paths = [self._path(fold) for fold in range(len(self.plain.folds))]
        raw = self._gains(paths, self.plain, self.residual)
        best = float(raw.max())
        if best <= self.least * float(self.residual @ self.residual):
            return
        # More functions than needed would differ on another motion.
        count = int(np.flatnonzero(raw >= self.enough * best)[0])
        self.reached, self.white_gain = (
            float(raw[count]),
            float(self._gains(paths, self.white, self.white_residual)[count]),
        )
        self._taken, self._theta = [taken for taken, _ in paths], [theta[:, count] for _, theta in paths]
        taken, theta = self._path(None)
        whole = np.zeros(len(self._places))
        whole[taken] = theta[:, count]
        ends = np.cumsum([0, *(X.shape[1] for X in self.plain.columns.values())])
        parts = {n: whole[a:b] for n, a, b in zip(self.plain.columns, ends[:-1], ends[1:], strict=True)}
        self._parts = {n: part for n, part in parts.items() if part.any()}
        self.chosen = list(self._parts)

    def coefficients(self) -> dict[str, Array]:
        """Return the coefficients of all functions of the families with a chosen one, in the channel's unit."""
        return self._parts

    def cross_validated(self, *, white: bool = False) -> Array:
        """Return predictions (n,) of each row from other folds, over the noise's standard deviation."""
        out = np.zeros(len(self.residual))
        for rows, taken, theta in zip(self.plain.folds, self._taken, self._theta, strict=True):
            out[rows] = self._columns(self.white if white else self.plain, taken)[rows] @ theta
        return out

    def _columns(self, sums: Sums, which: list[int]) -> Array:
        """Return functions (n, len(which)) by their numbers."""
        each = [sums.columns[name][:, k] for name, k in (self._places[j] for j in which)]
        return np.stack(each, axis=-1) * sums.scale if each else np.zeros((len(self.residual), 0))

    def _with(self, j: int) -> Array:
        """Return inner products (folds, k) of all functions with one of them."""
        if j not in self._products:
            own = self._learnt.against(self._columns(self._learnt, [j])[:, 0])
            self._products[j] = np.concatenate(list(own.values()), axis=1)
        return self._products[j]

    def _path(self, fold: int | None) -> tuple[list[int], Array]:
        """Return functions in their order of selection without a fold (None: on all rows), coefficients (taken, most).

        One column for each number of functions; the last is repeated where no more are selected.
        """

        def without_fold(each: Array) -> Array:
            return np.asarray(each.sum(axis=0) - (0.0 if fold is None else each[fold]))

        b, squares = without_fold(self._b), np.maximum(without_fold(self._squares), 0.0)
        norm = np.sqrt(squares)
        # A function that is nearly zero in these rows cannot be learnt from them.
        able = norm > self.alive * self._size
        taken: list[int] = []
        found: list[Array] = []
        correlation = b.copy()
        while len(taken) < self.most and able.any():
            j = int(np.argmax(np.where(able, np.abs(correlation) / np.where(able, norm, 1.0), -1.0)))
            trial = [*taken, j]
            G = np.stack([without_fold(self._with(i))[trial] for i in trial])
            # A function that is collinear with those before it has no gain.
            if np.linalg.matrix_rank(G / np.outer(norm[trial], norm[trial]), hermitian=True) < len(trial):
                break
            taken, theta = trial, np.linalg.solve(G, b[trial])
            able[j] = False
            found.append(np.asarray(theta))
            correlation = b - sum(t * without_fold(self._with(i)) for i, t in zip(taken, theta, strict=True))
        out = np.zeros((len(taken), self.most))
        for count in range(self.most if found else 0):
            theta = found[min(count, len(found) - 1)]
            out[: len(theta), count] = theta
        return taken, out

    def _gains(self, paths: list[tuple[list[int], Array]], sums: Sums, y: Array) -> Array:
        """Return the falls (most,) of a sum of squares on held-out folds."""
        total = np.zeros(self.most)
        for rows, (taken, theta) in zip(self.plain.folds, paths, strict=True):
            predicted = self._columns(sums, taken)[rows] @ theta
            total += 2.0 * y[rows] @ predicted - np.einsum("nm,nm->m", predicted, predicted)
        return total

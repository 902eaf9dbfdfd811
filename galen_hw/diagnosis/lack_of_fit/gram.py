"""Inner products of generic functions, fold by fold, for the regressions of a model's residual."""

import itertools
from dataclasses import dataclass

import numpy as np

from galen_hw.diagnosis.estimation.dataset import Bench
from galen_hw.diagnosis.lack_of_fit.basis_functions import Inputs, dictionaries, factors
from galen_hw.diagnosis.stats.sampling import folds
from galen_hw.spatial import Array


def by_name(inputs: Inputs) -> dict[str, Array]:
    """Return functions (M, k) of all families by name, products with their factors, simple ones first.

    All resonances share one name.
    """
    out: dict[str, list[Array]] = {}
    for name, X in dictionaries(inputs):
        out.setdefault(name, []).append(X)
    for name, X in factors(inputs).items():
        if name in out:
            out[name].append(X)
    return {name: np.concatenate(parts, axis=1) for name, parts in out.items()}


class Functions:
    """Hold the generic functions of a bench with their inner products, fold by fold, for many residuals.

    Args:
        bench: whose training rows they are learnt on.
    """

    def __init__(self, bench: Bench) -> None:
        self.bench, self.inputs = bench, Inputs.of(bench.scene, bench.rows)
        whole = by_name(self.inputs)
        self.means = {name: X[bench.train].mean(axis=0) for name, X in whole.items()}
        self.columns = {name: X - self.means[name] for name, X in whole.items()}
        fold = folds(bench.block[bench.train])
        order = np.argsort(fold, kind="stable")
        self.rows = np.flatnonzero(bench.train)[order]
        edges = np.searchsorted(fold[order], np.arange(int(fold.max(initial=0)) + 2)).tolist()
        self.folds = [slice(a, b) for a, b in itertools.pairwise(edges)]
        self._plain: dict[tuple[str, str], Array] = {}
        self._white: dict[int, dict[tuple[str, str], Array]] = {}

    def plain(self, names: list[str], channel: int) -> "Sums":
        """Return sums of some families over a channel's standard deviation."""
        sigma = float(self.bench.noise.sigma[channel])
        return Sums({n: self.columns[n][self.rows] for n in names}, self.folds, self._plain, 1.0 / sigma)

    def white(self, names: list[str], channel: int) -> "Sums":
        """Return sums of some families, whitened by a channel's noise."""
        columns = {n: self.bench.noise.whiten(self.columns[n], channel)[self.rows] for n in names}
        return Sums(columns, self.folds, self._white.setdefault(channel, {}))

    def level(self, parts: dict[str, Array], channel: int, white_residual: Array) -> float:
        """Return the constant, in the channel's unit, beside functions with coefficients (k,), for a whitened residual (n,).

        The model's own constant was fitted without these functions, by weights that take them for slow noise: it is biased.
        """
        said = sum(self.columns[n] @ theta for n, theta in parts.items())
        both = np.stack([np.ones(len(self.bench.rows)), said], axis=-1)
        one, white = self.bench.noise.whiten(both, channel)[self.rows].T
        return float(one @ (white_residual - white) / (one @ one))


@dataclass(frozen=True)
class Sums:
    """Inner products of families of functions over each fold's rows.

    Args:
        columns: (n, k) by name, the folds' rows one after the other.
        folds: where each fold's rows are.
        known: (folds, k, k) products of pairs of families, cached for all residuals.
        scale: factor of all columns.
    """

    columns: dict[str, Array]
    folds: list[slice]
    known: dict[tuple[str, str], Array]
    scale: float = 1.0

    def pair(self, a: str, b: str) -> Array:
        """Return inner products (folds, k, l) of two families."""
        if (b, a) in self.known:
            return np.swapaxes(self.known[b, a], 1, 2) * self.scale**2
        if (a, b) not in self.known:
            X, Y = self.columns[a], self.columns[b]
            self.known[a, b] = np.stack([X[f].T @ Y[f] for f in self.folds])
        return self.known[a, b] * self.scale**2

    def gram(self, names: list[str]) -> Array:
        """Return the Gram matrices (folds, k, k) of several families together."""
        return np.concatenate([np.concatenate([self.pair(a, b) for b in names], axis=2) for a in names], axis=1)

    def against(self, y: Array) -> dict[str, Array]:
        """Return inner products (folds, k) of each family with a target (n,)."""
        return {n: np.stack([X[f].T @ y[f] for f in self.folds]) * self.scale for n, X in self.columns.items()}

    def squares(self) -> Array:
        """Return the squares (folds, k) of all functions."""
        each = [np.stack([np.einsum("nk,nk->k", X[f], X[f]) for f in self.folds]) for X in self.columns.values()]
        return np.concatenate(each, axis=1) * self.scale**2

    def joined(self, names: list[str]) -> Array:
        """Return columns (n, k) of several families."""
        return np.concatenate([self.columns[n] for n in names], axis=1) * self.scale

"""Held-out errors of linear models from sums over blocks: many candidates are judged at the price of one pass.

The rows of every set are freed of the tracker's frame (a small motion of the whole set), weighted by the tracker's
noise and summed up to Gram matrices, one a block of some seconds; a model is fitted without a configuration's sets by
adding blocks up.
"""

from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from galen_hw.identification.deflection.compare import judged
from galen_hw.identification.deflection.data import DeflectionSet
from galen_hw.spatial import Array

BLOCK_S = 10.0
EVERY = 3
"""Rows of a 60 Hz tracker that are summed: their noise is white, the model's part is slow."""


def noise_of(sets: Sequence[DeflectionSet]) -> Array:
    """(d,) one sigma of the tracker's noise, from the differences of neighbouring rows."""
    steps = [np.diff(s.give, axis=0) for s in sets if len(s) > 10]
    middle = np.nanmedian(np.abs(np.concatenate(steps)), axis=0) / (0.6745 * np.sqrt(2.0))
    return np.asarray(np.maximum(middle, 1e-9))


@dataclass
class Rows:
    """Which rows of a set are summed, their frame's basis and their blocks."""

    index: NDArray[np.intp]
    basis: Array
    edges: list[int]
    y: Array

    @classmethod
    def of(cls, data: DeflectionSet, tip: Array, noise: Array) -> "Rows":
        """Rows with a seen tip, thinned; the frame's six small motions orthonormalised.

        Rows before the first hold are left out: what the friction remembers there is not known.
        """
        seen = np.isfinite(data.give).all(axis=1) & np.isfinite(data.force).all(axis=1)
        index = np.flatnonzero(seen & judged(data))[::EVERY]
        d = data.give.shape[1]
        columns = np.zeros((len(index), d, 6))
        columns[:, :3, :3] = np.eye(3)
        for k, axis in enumerate(np.eye(3)):
            columns[:, :3, 3 + k] = np.cross(axis, tip[index])
            if d == 6:
                columns[:, 3 + k, 3 + k] = 1.0
        flat = np.reshape(columns / noise[:, None], (len(index) * d, 6))
        U, size, _ = np.linalg.svd(flat / np.maximum(np.linalg.norm(flat, axis=0), 1e-300), full_matrices=False)
        basis = U[:, size > 1e-6 * size[0]]
        t = data.time[index]
        number = ((t - t[0]) // BLOCK_S).astype(int)
        edges = [0, *(np.flatnonzero(np.diff(number)) + 1).tolist(), len(index)]
        rows = cls(index, basis, [d * e for e in edges], np.empty(0))
        rows.y = rows.free(data.give / noise)
        return rows

    def free(self, values: Array) -> Array:
        """(n d,) of values (N, d), without the frame's motion."""
        v = values[self.index].reshape(-1)
        return np.asarray(v - self.basis @ (self.basis.T @ v))


@dataclass
class Blocks:
    """Sums over blocks for a list of columns, by key.

    Args:
        keys: of the columns; G: (B, K, K); g: (B, K); yy, rows: (B,).
        fold: (B,) which blocks are held out together; owner: (B,) number of the block's set.
    """

    keys: list[Hashable]
    G: Array
    g: Array
    yy: Array
    rows: Array
    fold: NDArray[np.intp]
    owner: NDArray[np.intp]
    _place: dict[Hashable, int] = field(init=False)

    def __post_init__(self) -> None:
        self._place = {key: i for i, key in enumerate(self.keys)}

    @classmethod
    def of(cls, rows: Sequence[Rows], columns: Mapping[Hashable, Sequence[Array]], folds: Sequence[int]) -> "Blocks":
        """Add up columns given as one freed array (n d,) a set."""
        keys = list(columns)
        G, g, yy, count, fold, owner = [], [], [], [], [], []
        for s, r in enumerate(rows):
            X = np.stack([columns[key][s] for key in keys], axis=1)
            for a, b in zip(r.edges, r.edges[1:], strict=False):
                part, y = X[a:b], r.y[a:b]
                G.append(part.T @ part)
                g.append(part.T @ y)
                yy.append(float(y @ y))
                count.append(b - a)
                fold.append(folds[s])
                owner.append(s)
        return cls(
            keys, np.array(G), np.array(g), np.array(yy), np.array(count, float), np.array(fold), np.array(owner)
        )

    def solve(self, keys: Sequence[Hashable], without: int | None = None) -> Array:
        """Parameters (k,) of some columns by all blocks but one fold's."""
        k = [self._place[key] for key in keys]
        take = np.ones(len(self.yy), bool) if without is None else self.fold != without
        return _solve(self.G[take].sum(axis=0)[np.ix_(k, k)], self.g[take].sum(axis=0)[k], self._energy(k))

    def held_out(self, keys: Sequence[Hashable]) -> Array:
        """(B,) mean square of each block's error, in noise units, by parameters of the other folds."""
        k = [self._place[key] for key in keys]
        out = np.empty(len(self.yy))
        sum_G, sum_g = self.G[:, k][:, :, k].sum(axis=0), self.g[:, k].sum(axis=0)
        energy = self._energy(k)
        for f in np.unique(self.fold):
            mine = self.fold == f
            G, g = self.G[mine][:, k][:, :, k], self.g[mine][:, k]
            theta = _solve(sum_G - G.sum(axis=0), sum_g - g.sum(axis=0), energy)
            out[mine] = self.yy[mine] - 2.0 * g @ theta + np.einsum("i,bij,j->b", theta, G, theta)
        return out / self.rows

    def _energy(self, k: Sequence[int]) -> Array:
        """(k,) squares of some columns over all blocks."""
        return np.asarray(self.G[:, k, k].sum(axis=0))

    def gain(self, old: Array, new: Array) -> tuple[float, float]:
        """Mean fall of the held-out square and its standard error, sets as units."""
        weight = self.rows
        sets = np.unique(self.owner)
        each = np.array([np.average((old - new)[self.owner == s], weights=weight[self.owner == s]) for s in sets])
        return float(each.mean()), float(each.std(ddof=1) / np.sqrt(len(each))) if len(each) > 1 else float("inf")

    def robust_covariance(self, keys: Sequence[Hashable]) -> Array:
        """(k, k) of the parameters, errors of a block taken to be of one piece (sandwich; Liang and Zeger 1986)."""
        k = [self._place[key] for key in keys]
        G, g = self.G[:, k][:, :, k], self.g[:, k]
        inverse = np.linalg.pinv(G.sum(axis=0), rcond=1e-12, hermitian=True)
        theta = _solve(G.sum(axis=0), g.sum(axis=0), self._energy(k))
        score = g - G @ theta
        count = len(g)
        return np.asarray(inverse @ (score.T @ score) @ inverse * count / max(count - len(k), 1))


UNSEEN = 1e-10
"""Share of a column's squares below which the blocks learnt from hold rounding alone: its parameter is zero, not noise."""


def _solve(G: Array, g: Array, energy: Array) -> Array:
    """Least squares of normal equations; energy: (k,) squares of the columns over all blocks, learnt from or not."""
    mine = np.diag(G)
    scale = np.where(mine > UNSEEN * energy, 1.0 / np.sqrt(np.maximum(mine, 1e-300)), 0.0)
    values, vectors = np.linalg.eigh(G * np.outer(scale, scale))
    keep = values > 1e-10 * values[-1]
    return np.asarray(scale * (vectors[:, keep] @ ((vectors[:, keep].T @ (scale * g)) / values[keep])))

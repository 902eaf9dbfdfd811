"""What physics left over, and where: whether any function of the known inputs and their past explains it."""

from dataclasses import dataclass

import numpy as np
from scipy.stats import chi2

from galen_hw.diagnosis.algebra import orthonormal, scaled
from galen_hw.diagnosis.bench import Bench, rich_basis
from galen_hw.diagnosis.generic import Inputs, dictionaries
from galen_hw.diagnosis.rows import Index
from galen_hw.physics.effect import Columns
from galen_hw.spatial import Array

Z_NEEDED = 4.5
CHANCE = 2e-4
LEAST_RIDGE = 0.1
"""Of a function a tenth at least must lie in the blocks that it is learnt on before it is half believed in the others."""
T_NEEDED = 3.0
"""Standard errors by which generic functions must win on blocks that they were not fitted on."""


@dataclass(frozen=True)
class Left:
    """One kind of structure that is left in one channel.

    Args:
        channel: place.
        kind: what the generic functions were of; place: of that family, the plain ones first.
        z: (T - k) / sqrt(2 k); for a model that does not hold on held-out data, its mean square over the noise's.
        share: of the whitened rest's mean square, on blocks left out.
        size: rms in raw units; basis: (M, k) the functions.
    """

    channel: int
    kind: str
    z: float
    share: float
    size: float
    basis: Array
    place: int = 0


def families(bench: Bench) -> list[tuple[str, Array]]:
    """The generic functions of a bench as orthonormal bases (M, k), a constant first, the strongest directions next."""
    ones, most = np.ones((len(bench.rows), 1)), max(int((~bench.dropped).sum()) // 6, 3)
    all_of_them = dictionaries(Inputs.of(bench.scene, bench.rows))
    return [(kind, rich_basis(ones, [X], 12 * min(most, X.shape[1]))) for kind, X in all_of_them if X.shape[1]]


def compact(bench: Bench, generic: list[tuple[str, Array]]) -> list[Columns]:
    """The leading directions of every family, in all channels: what they explain must not pass for noise."""
    if len(bench.rows) < 2000:
        return []
    return [Columns((c,), X[:, None, 1:9]) for _, X in generic for c in range(bench.width)]


def leftovers(
    bench: Bench, generic: list[tuple[str, Array]], model: list[Columns], rest: Array, white: Array
) -> list[Left]:
    """Structure in the rest (M, C) of a model, strongest first; only what also predicts blocks it was not fitted on.

    Args:
        generic: `families` of the bench.
        model: whitened columns of nuisances and effects, so that generic functions get no credit for what these could do.
        rest, white: the model's rest, raw and whitened.
    """
    good = ~bench.dropped
    block = bench.block[good]
    out: list[Left] = []
    transformed = [bench.noise.transformed(X) for _, X in generic]
    for c in range(bench.width):
        own = [x.values[:, x.channels.index(c)] for x in model if c in x.channels and x.count]
        base = orthonormal(scaled(np.concatenate([*own, np.zeros((len(rest), 0))], axis=1)[good]), weakest=1e-12)
        y = white[good, c] - base @ (base.T @ white[good, c])
        for place, ((kind, X), known) in enumerate(zip(generic, transformed, strict=True)):
            Xw = bench.noise.whitened(known, c)[good]
            V, A = _beside(Xw, base)
            k = V.shape[1]
            if not k:
                continue
            projected = V.T @ (A.T @ y)
            T = float(projected @ projected)
            z = (T - k) / np.sqrt(2.0 * k)
            if z < Z_NEEDED or chi2.sf(T, k) > CHANCE / (len(generic) * bench.width):
                continue
            sure, gain = _crossed(A @ V, y, block, ridge=LEAST_RIDGE + k / T)
            if sure >= T_NEEDED:
                share = gain / max(float(y @ y), 1e-300)
                w = V @ projected  # slow structure is larger in raw units than the whitening makes it look
                size = float(np.sqrt(gain / len(y)) * np.std(X[good] @ w) / max(np.std(Xw @ w), 1e-300))
                out.append(Left(c, kind, z, share, size, X, place))
    return sorted(out, key=lambda left: -left.z)


def _beside(Xw: Array, base: Array) -> tuple[Array, Array]:
    """Columns less what the model can do, A (n, k), and V so that A V is orthonormal."""
    A = Xw - base @ (base.T @ Xw)
    size = np.linalg.norm(A, axis=0)
    own = size > 1e-3 * np.linalg.norm(Xw, axis=0)
    if not own.any():
        return np.zeros((A.shape[1], 0)), A
    value, vector = np.linalg.eigh((A[:, own].T @ A[:, own]) / np.outer(size[own], size[own]))
    good = value > 1e-6 * max(float(value[-1]), 1e-300)
    V = np.zeros((A.shape[1], int(good.sum())))
    V[own] = vector[:, good] / np.sqrt(value[good]) / size[own, None]
    return V, A


def _crossed(U: Array, y: Array, block: Index, *, ridge: float, folds: int = 5) -> tuple[float, float]:
    """How surely orthonormal functions U (n, k) predict blocks that they were not fitted on: mean gain over its error; gain.

    Ridge regression, so that many functions of which few matter may win and none is trusted that mostly lives in the blocks
    left out. Blocks are the unit: slow noise inside a block is one piece of luck.
    """
    fold = np.unique(block, return_inverse=True)[1] % folds
    gain = np.zeros(len(y))
    for f in range(folds):
        learn, judge = fold != f, fold == f
        if not judge.any() or not learn.any():
            continue
        G = U[learn].T @ U[learn] + ridge * np.eye(U.shape[1])
        predicted = U[judge] @ np.linalg.solve(G, U[learn].T @ y[learn])
        gain[judge] = predicted * (2.0 * y[judge] - predicted)
    each = np.bincount(block, gain)[np.unique(block)]
    spread = float(np.std(each, ddof=1)) / np.sqrt(len(each)) if len(each) > 1 else np.inf
    return float(np.mean(each)) / max(spread, 1e-300), float(gain.sum())

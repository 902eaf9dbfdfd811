"""Test for structure in a model's residual: whether any function of the known inputs and their past explains it."""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np
from joblib import Parallel, delayed
from scipy.stats import chi2

from galen_hw.diagnosis.estimation.dataset import Bench, rich_basis
from galen_hw.diagnosis.lack_of_fit.basis_functions import Inputs, broad, local
from galen_hw.diagnosis.stats.criteria import CRITERIA
from galen_hw.diagnosis.stats.linear_algebra import orthonormal, scaled
from galen_hw.diagnosis.stats.sampling import Index, folds
from galen_hw.physics.effects.columns import Columns
from galen_hw.spatial import Array

FALSE_ALARM: Final = CRITERIA.chance / 10.0
"""Probability that noise is called structure, over all families and channels: of the budget a tenth."""
T_NEEDED: Final = 3.0
"""Standard errors by which generic functions, or trees, must win on held-out blocks."""


@dataclass(frozen=True)
class Structure:
    """Structure of one kind in the residual of one channel.

    Args:
        channel: place.
        kind: what the generic functions depend on; place: number of that family, simple ones first.
        z: (T - k) / sqrt(2 k); for a model that does not hold on held-out data, its mean square over the noise's.
        share: of the whitened residual's mean square, on held-out blocks.
        size: rms in raw units; basis: (M, k) the functions.
        elsewhere: it is in the residual of another recording than the model was fitted on.
    """

    channel: int
    kind: str
    z: float
    share: float
    size: float
    basis: Array
    place: int = 0
    elsewhere: bool = False


class Family(NamedTuple):
    """Generic functions of one kind: what they depend on, an orthonormal basis (M, k) of them, whether they are local."""

    kind: str
    basis: Array
    local: bool


def families(bench: Bench) -> list[Family]:
    """Return the generic functions of a bench; in each family a constant first, the strongest directions next."""
    ones, most = np.ones((len(bench.rows), 1)), max(int((~bench.excluded_rows).sum()) // 6, 3)
    inputs = Inputs.of(bench.scene, bench.rows)

    def of(kind: str, X: Array, is_local: bool) -> Family:
        return Family(kind, rich_basis(ones, [X], 12 * min(most, X.shape[1])), is_local)

    functions = (
        (kind, X, is_local) for is_local, every in ((False, broad), (True, local)) for kind, X in every(inputs)
    )
    return list(Parallel(n_jobs=2, require="sharedmem")(delayed(of)(*one) for one in functions if one[1].shape[1]))


def leading_directions(bench: Bench, generic: list[Family]) -> list[Columns]:
    """Return the leading directions of every broad family in all channels, which are not to be taken for noise."""
    if len(bench.rows) < 2000:
        return []
    return [Columns((c,), one.basis[:, None, 1:9]) for one in generic if not one.local for c in range(bench.width)]


@dataclass(frozen=True)
class Fitted:
    """Residual of a model with the columns that are projected out of it.

    Args:
        columns: whitened, of nuisances and effects, so that generic functions get no credit for what these could do.
        residual, white: (M, C) raw and whitened.
    """

    columns: list[Columns]
    residual: Array
    white: Array


def leftovers(bench: Bench, generic: list[Family], models: Sequence[Fitted]) -> list[list[Structure]]:
    """Return the structure in each model's residual, strongest first; only what also predicts held-out blocks.

    All models of one bench are tested together: most of the work is to whiten the generic functions.

    Args:
        generic: `families` of the bench.
    """
    good, known = ~bench.excluded_rows, [bench.noise.transformed(one.basis) for one in generic]

    def of(c: int) -> list[list[Structure]]:
        asked: list[tuple[list[Structure], Array, Array]] = []
        for model in models:
            own = [x.values[:, x.channels.index(c)] for x in model.columns if c in x.channels and x.count]
            whole = np.concatenate([*own, np.zeros((len(model.residual), 0))], axis=1)[good]
            base = orthonormal(scaled(whole), weakest=1e-9)
            asked.append(([], base, model.white[good, c] - base @ (base.T @ model.white[good, c])))
        for place, (one, transformed) in enumerate(zip(generic, known, strict=True)):
            Xw = bench.noise.whitened(transformed, c)[good]
            G = Xw.T @ Xw
            for out, base, y in asked:
                found = _found(Xw, G, base, y, bench.block[good], FALSE_ALARM / (len(generic) * bench.width))
                if found is not None:
                    z, gain, w = found
                    # Slow structure is larger in raw units than the whitening makes it look.
                    size = np.sqrt(gain / len(y)) * np.std(one.basis[good] @ w) / max(np.std(Xw @ w), 1e-300)
                    share = gain / max(float(y @ y), 1e-300)
                    out.append(Structure(c, one.kind, z, share, float(size), one.basis, place))
        return [out for out, _, _ in asked]

    each = Parallel(n_jobs=2, require="sharedmem")(delayed(of)(c) for c in range(bench.width))
    return [sorted(itertools.chain(*(mine[m] for mine in each)), key=lambda left: -left.z) for m in range(len(models))]


def _found(
    Xw: Array,
    squared: Array,
    base: Array,
    y: Array,
    block: Index,
    chance: float,
    *,
    part: float = 0.1,
    least_z: float = 4.5,
    own_part: float = 1e-6,
    least_t: float = 1.2,
) -> tuple[float, float, Array] | None:
    """Test whether columns (n, k) explain the residual (n,) beyond chance, by chi square and by cross-validation.

    Return z, the cross-validated gain, and the weights (k,) of the columns; None where they do not.

    Args:
        squared: (k, k) inner products of the columns; base: (n, r) orthonormal basis of the model, projected out of the
            residual.
        part: of a function, that must lie in the blocks that it is learnt on before it is half believed in the
            others.
        least_z: standard deviations above what chance explains, below which nothing else is asked.
        own_part: share of a function's square that must be outside the model's span.
        least_t: standard errors that are enough where shuffled blocks show that no order of the same blocks is
            predicted nearly so well.
    """
    B = base.T @ Xw
    squares, V = np.diag(squared), np.zeros((Xw.shape[1], 0))
    own = squares - np.einsum("rk,rk->k", B, B) > own_part * squares
    if own.any():
        # Inner products of the columns with the model projected out.
        G = squared[np.ix_(own, own)] - B[:, own].T @ B[:, own]
        size = np.sqrt(np.diag(G))
        value, vector = np.linalg.eigh(G / np.outer(size, size))
        good = value > own_part * float(value[-1])
        V = np.zeros((Xw.shape[1], int(good.sum())))
        V[own] = vector[:, good] / np.sqrt(value[good]) / size[:, None]
    k, projected = V.shape[1], V.T @ (Xw.T @ y)
    T = float(projected @ projected)
    z = (T - k) / np.sqrt(2.0 * max(k, 1))
    if not k or z < least_z or chi2.sf(T, k) > chance:
        return None
    U, ridge = (Xw - base @ B) @ V, part + k / T
    each = _cross_validated_gains(U, y[:, None], block, ridge=ridge)[:, 0]
    sure = t_statistic(each)
    if sure < T_NEEDED and not (sure >= least_t and _beyond_shuffled(U, y, block, ridge=ridge)):
        return None
    return z, float(each.sum()), V @ projected


def _cross_validated_gains(U: Array, Y: Array, block: Index, *, ridge: float) -> Array:
    """Return falls (blocks, m) of the sums of squares of residuals Y (n, m) by functions U (n, k) learnt on other blocks.

    U is orthonormal. Ridge regression lets many functions win of which few matter, and trusts none that mostly lives in the
    held-out blocks. Blocks are the unit: slow noise is correlated inside a block.
    """
    number = np.unique(block, return_inverse=True)[1]
    fold, gain = folds(block), np.zeros(Y.shape)
    for f in range(int(fold.max()) + 1):
        learn, judge = fold != f, fold == f
        G = U[learn].T @ U[learn] + ridge * np.eye(U.shape[1])
        predicted = U[judge] @ np.linalg.solve(G, U[learn].T @ Y[learn])
        gain[judge] = predicted * (2.0 * Y[judge] - predicted)
    return np.stack([np.bincount(number, column) for column in gain.T], axis=-1)


def t_statistic(each: Array) -> float:
    """Return the mean gain of the blocks over its standard error."""
    spread = float(np.std(each, ddof=1)) / np.sqrt(len(each)) if len(each) > 1 else np.inf
    return float(np.mean(each)) / max(spread, 1e-300)


def _beyond_shuffled(
    U: Array, y: Array, block: Index, *, ridge: float, beyond: float = 8.0, orders_asked: int = 60, first: int = 10
) -> bool:
    """Return whether functions predict held-out blocks far better than the same blocks in another order.

    What acts in a few corners of the motion lies in a few blocks: their gains differ so much that a mean over its error says
    little. That the residual is large at just the moments that the motion predicts is no chance.

    Args:
        beyond: standard deviations between orders.
        orders_asked: orders of the blocks.
        first: orders that are asked first, by half as many deviations.
    """
    rng = np.random.default_rng(len(y))
    pieces = [np.flatnonzero(block == b) for b in np.unique(block)]
    shuffled = [np.concatenate([pieces[i] for i in rng.permutation(len(pieces))]) for _ in range(orders_asked)]
    # A few orders reject most of the candidates.
    for count, needed in ((first, 0.5 * beyond), (orders_asked, beyond)):
        orders = np.stack([y, *(y[order] for order in shuffled[:count])], axis=-1)
        gains = _cross_validated_gains(U, orders, block, ridge=ridge).sum(axis=0)
        if gains[0] <= np.mean(gains[1:]) + needed * np.std(gains[1:]):
            return False
    return True

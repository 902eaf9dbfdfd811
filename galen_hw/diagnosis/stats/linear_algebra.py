"""Linear algebra on Gram matrices of long columns, without weak directions; tails of chi square and F."""

import numpy as np
from scipy.special import betainc, gammaincc, gammaln

from galen_hw.diagnosis.stats.sampling import Index
from galen_hw.spatial import Array

WEAK = 1e-5
"""Share of a direction, projected orthogonally to the model, below which it is not identifiable."""
MANY = 4000.0
"""Degrees of freedom of the noise from which F is as good as chi square."""


def inverse_root(A: Array) -> Array:
    """Return W (k, r) with W W' = A^-1 for a symmetric positive semidefinite A (k, k), scaled to a unit diagonal.

    Weak and empty directions are left out.
    """
    size = np.sqrt(np.diag(A).clip(0.0))
    size[size <= 0.0] = np.inf
    if not len(size):
        return np.zeros((0, 0))
    value, vector = np.linalg.eigh(A / np.outer(size, size))
    good = value > 1e-9 * max(value[-1], 1e-300)
    return np.asarray(vector[:, good] / size[:, None] / np.sqrt(value[good]))


def solve_sym(A: Array, B: Array) -> Array:
    """Return A^-1 B for a symmetric positive semidefinite A, see `inverse_root`."""
    W = inverse_root(A)
    return np.asarray(W @ (W.T @ B))


def quadratic(A: Array, before: Array, r: Array, fakes: Array) -> tuple[Array, Array, Index]:
    """Return r' A^-1 r of m hypotheses with k columns each, over the directions that are identifiable given the model.

    Args:
        A: (m, k, k) inner products given the model; before: (m, k) squares of the columns themselves.
        r: (m, k) inner products with the residual; fakes: (m, k, B) with surrogates.

    Returns:
        (m,) gains, (m, B) gains on the surrogates, (m,) number of directions; gain 0 where there is none.
    """
    size = np.sqrt(np.maximum(before, 1e-300))
    value, vector = np.linalg.eigh(A / (size[:, :, None] * size[:, None, :]))
    good = value > WEAK
    V = vector * np.where(good, 1.0 / np.sqrt(np.where(good, value, 1.0)), 0.0)[:, None, :] / size[:, :, None]
    turned = np.swapaxes(V, 1, 2)
    gains = np.sum((turned @ r[:, :, None])[:, :, 0] ** 2, axis=1)
    return gains, np.sum((turned @ fakes) ** 2, axis=1), good.sum(axis=1)


def pinned_at(at: Array, A: Array, r: Array) -> Array:
    """Return least-squares parameters (k,) from A (k, k), r (k,), some of them fixed: `at`, NaN where free."""
    free = np.isnan(at)
    if not free.any():
        return at
    out = np.where(free, 0.0, at)
    out[free] = solve_sym(A[np.ix_(free, free)], (r - A @ out)[free][:, None])[:, 0]
    return out


def orthonormal(X: Array, *, weakest: float = 1e-7, most: int | None = None) -> Array:
    """Return an orthonormal basis (M, r) of the strongest directions of columns (M, k), from their Gram matrix."""
    if not X.shape[1]:
        return X
    value, vector = np.linalg.eigh(X.T @ X)
    order = np.argsort(value)[::-1][:most]
    order = order[value[order] > weakest * max(float(value[order[0]]), 1e-300)]
    return np.asarray(X @ (vector[:, order] / np.sqrt(value[order])))


def scaled(X: Array, keep: float = 0.0) -> Array:
    """Return the columns scaled to unit length, without those not longer than `keep`."""
    size = np.linalg.norm(X, axis=0)
    good = size > max(keep, 1e-300)
    return np.asarray(X[:, good] / size[good])


def log_tail(gain: Array, count: Index, degrees: float) -> Array:
    """Return the log of the probability that noise reaches gains with `count` parameters (shapes that broadcast).

    The noise estimate has `degrees` of freedom. Where the tail is too small for a double, its leading term (Abramowitz and Stegun
    6.5.32, 26.5.4).
    """
    if degrees > MANY:
        a, z = 0.5 * count, 0.5 * np.maximum(gain, 0.0)
        with np.errstate(divide="ignore"):
            plain = np.log(gammaincc(a, z))
            far = -z + (a - 1.0) * np.log(np.maximum(z, 1e-300)) - gammaln(a)
        return np.asarray(np.where(z > 600.0 + 2.0 * a, far, plain))
    half, b = 0.5 * degrees, 0.5 * count
    x = degrees / (degrees + np.maximum(gain, 0.0))
    with np.errstate(divide="ignore"):
        plain = np.log(betainc(half, b, x))
        far = half * np.log(x) + b * np.log1p(-x) - np.log(half) - gammaln(half) - gammaln(b) + gammaln(half + b)
    return np.asarray(np.where(np.isfinite(plain), plain, far))

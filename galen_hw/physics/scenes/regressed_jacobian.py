"""The Jacobian of a machine whose simulation is given and whose kinematics are not: of polynomials through the simulation."""

import itertools

import numpy as np
from numpy.polynomial import legendre
from scipy.linalg import solve_triangular

from galen_hw.spatial import Array


def jacobian(q: Array, simulated: Array, within: Array) -> Array | None:
    """Return d(channel)/d(joint), (N, C, J), of simulated channels (N, C) and joint positions (N, J).

    None where the joints do not tell the channels.

    A closed chain has no joint screws, but where it moved its simulation is a smooth function of its joints: Legendre polynomials
    of total degree, of the lowest that misses left-out rows (Allen's PRESS, Technometrics 16, 1974) by little enough.

    Args:
        within: (C,) rms that the function may miss the simulation by: what that misses the recording by.
    """
    good = np.asarray(np.isfinite(q).all(axis=1) & np.isfinite(simulated).all(axis=1))
    if not good.any():
        return None
    low, high = q[good].min(axis=0), q[good].max(axis=0)
    if not np.all(high > low):
        return None
    half = 0.5 * (high - low)
    u = np.where(good[:, None], (q - low) / half - 1.0, 0.0)
    y = simulated[good] - simulated[good].mean(axis=0)
    missed = y.std(axis=0)
    degree, totals = 0, [float(np.sum(missed**2))]
    while np.any(missed > within):
        degree += 1
        terms = [e for e in itertools.product(range(degree + 1), repeat=q.shape[1]) if sum(e) <= degree]
        if 2 * len(terms) > len(y):
            return None
        factors = np.asarray(legendre.legvander(u, degree), dtype=float)
        made = _products(factors, terms)
        Q, R = np.linalg.qr(made[good])
        fitted = Q.T @ y
        left_out = (y - Q @ fitted) / (1.0 - np.sum(Q**2, axis=1))[:, None]
        missed = np.sqrt(np.mean(left_out**2, axis=0))
        totals.append(float(np.sum(missed**2)))
        # A function that is even or odd gains by every other degree alone.
        if degree > 1 and totals[-1] >= totals[-3]:
            return None
    if not degree:
        return None
    weights = solve_triangular(R, fitted)
    steps = factors @ _derivative(degree) / half[:, None]
    return np.stack([_products(_with(factors, steps, j), terms) @ weights for j in range(q.shape[1])], axis=-1)


def _products(factors: Array, terms: list[tuple[int, ...]]) -> Array:
    """Return the products (N, T) of one polynomial a joint; factors (N, J, degree + 1)."""
    return np.stack([np.prod([factors[:, j, e] for j, e in enumerate(term)], axis=0) for term in terms], axis=-1)


def _with(factors: Array, steps: Array, joint: int) -> Array:
    """Return the factors (N, J, degree + 1), of one joint their slopes instead."""
    out = factors.copy()
    out[:, joint] = steps[:, joint]
    return out


def _derivative(degree: int) -> Array:
    """Return what (degree + 1, degree + 1) makes of the Legendre polynomials their slopes."""
    out = np.zeros((degree + 1, degree + 1))
    for k in range(1, degree + 1):
        out[:k, k] = legendre.legder(np.eye(degree + 1)[k])[:k]
    return out

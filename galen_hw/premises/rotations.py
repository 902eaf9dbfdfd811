"""Rotations between two sets of vectors: orthogonal Procrustes with either determinant, and how to read what it finds."""

from dataclasses import dataclass
from itertools import permutations, product

import numpy as np

from galen_hw.premises.base import Claim
from galen_hw.spatial import Array, rotation_log

AXES = "xyz"


@dataclass(frozen=True)
class Similarity:
    """Holds the least-squares map y = scale Q x + constant of two sets of vectors.

    Args:
        scale: never negative: what turns round is in Q.
        Q: (3, 3) orthogonal.
        unexplained: share of the squared deviation of y that is left, 0 to 1.
        residual: (N, 3).
        rank: directions in which x varies by more than a hundredth of its largest.
    """

    scale: float
    Q: Array
    unexplained: float
    residual: Array
    rank: int


def similarity(x: Array, y: Array, *, determinant: int = 0) -> Similarity:
    """Return the best scale, rotation and constant from x (N, 3) to y (N, 3).

    Kabsch 1976, Umeyama 1991; both sets centred by their means.

    Args:
        x: where the vectors should be.
        y: where they were read.
        determinant: +1 a rotation, -1 a mirror, 0 whichever is nearer.
    """
    x, y = x - x.mean(axis=0), y - y.mean(axis=0)
    U, S, Vt = np.linalg.svd(y.T @ x)
    signs = np.ones(3)
    if determinant and np.linalg.det(U @ Vt) * determinant < 0.0:
        signs[2] = -1.0
    Q = (U * signs) @ Vt
    size = max(float(np.sum(x**2)), 1e-300)
    scale = max(float(np.sum(S * signs)) / size, 0.0)
    residual = y - scale * x @ Q.T
    spread = np.linalg.svd(x, compute_uv=False)
    return Similarity(scale, Q, _share(residual, y), residual, int(np.sum(spread > 0.01 * max(spread[0], 1e-300))))


def scaled(x: Array, y: Array) -> Similarity:
    """Return the best scale (of either sign, as Q = -1 if negative) and constant from x (N, k) to y (N, k), no rotation."""
    x, y = x - x.mean(axis=0), y - y.mean(axis=0)
    scale = float(np.sum(x * y)) / max(float(np.sum(x**2)), 1e-300)
    residual = y - scale * x
    spread = np.linalg.svd(x, compute_uv=False)
    rank = int(np.sum(spread > 0.01 * max(spread[0], 1e-300)))
    return Similarity(abs(scale), np.copysign(1.0, scale) * np.eye(x.shape[1]), _share(residual, y), residual, rank)


def _share(residual: Array, y: Array) -> float:
    return float(np.sum(residual**2) / max(float(np.sum(y**2)), 1e-300))


def signed_permutations() -> list[Array]:
    """Return the 48 matrices that swap and mirror axes, the identity first."""
    out = []
    for order in permutations(range(3)):
        for signs in product((1.0, -1.0), repeat=3):
            P = np.zeros((3, 3))
            P[range(3), order] = signs
            out.append(P)
    return out


def nearest_axes(Q: Array) -> tuple[Array, float]:
    """Return the signed permutation of Q's determinant nearest to Q, and the angle (rad) between them."""
    alike = [P for P in signed_permutations() if np.linalg.det(P) * np.linalg.det(Q) > 0.0]
    P = max(alike, key=lambda P: float(np.trace(P.T @ Q)))
    return P, angle_of(P.T @ Q)


def angle_of(R: Array) -> float:
    """Return the angle (rad) of a rotation (3, 3)."""
    return float(np.linalg.norm(rotation_log(R)))


def as_axes(P: Array) -> str:
    """Say how the axes of a signed permutation read, e.g. `x, y, z read like -x, y, z`."""
    names = []
    for row in P:
        at = int(np.argmax(np.abs(row)))
        names.append(f"{'-' if row[at] < 0.0 else ''}{AXES[at]}")
    return f"x, y, z read like {', '.join(names)}"


def as_turn(R: Array) -> str:
    """Say a rotation (3, 3) as an angle about an axis, e.g. `45.0 deg about z`."""
    vector = rotation_log(R)
    angle = float(np.linalg.norm(vector))
    axis = vector / max(angle, 1e-12)
    at = int(np.argmax(np.abs(axis)))
    if abs(axis[at]) > np.cos(np.radians(3.0)):
        return f"{np.degrees(np.copysign(angle, axis[at])):.1f} deg about {AXES[at]}"
    return f"{np.degrees(angle):.1f} deg about ({', '.join(f'{a:.2f}' for a in axis)})"


def turned_alike(expected: Array, R: Array) -> tuple[Array, float]:
    """Return the turn G (3, 3) of R (N, 3, 3) = expected G, and the rms angle (rad) that it leaves."""
    relative = np.swapaxes(expected, 1, 2) @ R
    U, _, Vt = np.linalg.svd(relative.mean(axis=0))
    G = (U * np.array([1.0, 1.0, np.sign(np.linalg.det(U @ Vt))])) @ Vt
    left = rotation_log(np.swapaxes(relative, 1, 2) @ G)
    return G, float(np.sqrt(np.mean(np.sum(left**2, axis=1))))


def other_quaternions(q: Array) -> dict[str, Array]:
    """Return quaternions x y z w (N, 4) as they are if written otherwise, by what is to be said of them then."""
    w_first, conjugate = q[:, [1, 2, 3, 0]], np.array([-1.0, -1.0, -1.0, 1.0])
    return {
        "have w first": w_first,
        "are the inverse": q * conjugate,
        "have w first and are the inverse": w_first * conjugate,
    }


def mounting_claim(turn: Array, part: str, channels: tuple[str, ...]) -> Claim:
    """Return the claim of a `sensor_mounting`: turned by (3, 3) exactly, "turn" with its tool or "turn_alone"."""
    values = {f"turn_{a}": float(v) for a, v in zip(AXES, rotation_log(turn), strict=True)}
    term = {"effect": "sensor_mounting", "parameters": {"part": part, **values}}
    return Claim("sensor_mounting", {k: (v, 0.0, "rad") for k, v in values.items()}, channels, terms=(term,))

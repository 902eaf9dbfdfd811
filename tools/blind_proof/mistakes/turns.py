"""Rotations as this judge needs them; quaternions are x y z w."""

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

Array = NDArray[np.float64]


def anywhere(rng: np.random.Generator, count: int) -> Array:
    """Rotations (count, 3, 3), evenly spread over all."""
    quat = rng.normal(size=(count, 4))
    return np.asarray(Rotation.from_quat(quat).as_matrix())


def about(axis: Array, angle: float) -> Array:
    """A turn (3, 3) by an angle in rad about an axis (3,)."""
    return np.asarray(Rotation.from_rotvec(np.asarray(axis) / np.linalg.norm(axis) * angle).as_matrix())


def small(rng: np.random.Generator, count: int, rms: float) -> Array:
    """Turns (count, 3, 3) of an angle of so many rad rms about axes anywhere."""
    return np.asarray(Rotation.from_rotvec(rng.normal(size=(count, 3)) * rms / np.sqrt(3)).as_matrix())


def to_quat(turn: Array) -> Array:
    """Quaternions (N, 4), w not negative."""
    return np.asarray(Rotation.from_matrix(turn).as_quat(canonical=True))


def from_quat(quat: Array) -> Array:
    """Rotations (N, 3, 3); a row that is not measured stays NaN."""
    good = np.isfinite(quat).all(axis=1)
    out = np.full((len(quat), 3, 3), np.nan)
    out[good] = Rotation.from_quat(quat[good]).as_matrix()
    return out


def angle(turn: Array) -> float:
    """Angle in rad of one turn (3, 3)."""
    return float(Rotation.from_matrix(turn).magnitude())

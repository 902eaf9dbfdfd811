"""Orientations whose three numbers were written by one convention and read by another."""

from collections.abc import Iterator
from itertools import permutations
from typing import Final

import numpy as np
from scipy.spatial.transform import Rotation

from galen_hw.premises.rotations import turned_alike
from galen_hw.premises.unit_tables import TURN
from galen_hw.spatial import Array

ROTATION_VECTOR: Final = "a rotation vector"
EULER: Final = {
    "roll, pitch, yaw about fixed x, y, z": "xyz",
    "turns about x, y, z, each moved by those before": "XYZ",
    "turns about z, y, x, each moved by those before": "ZYX",
    "turns about z, y, z, each moved by those before": "ZYZ",
}
"""Conventions of robots' controllers, as scipy names their sequences: capital letters for moving axes."""


def misread(expected: Array, R: Array) -> tuple[str, float]:
    """Return how orientations R (N, 3, 3) were read and how they were written, and the rms angle (rad) that this leaves.

    Args:
        expected: (N, 3, 3) orientations that the arm has.
    """
    found = {}
    for read, written in permutations((ROTATION_VECTOR, *EULER), 2):
        # Three numbers of an orientation are not unique; those that were written are nearest to the arm's.
        made = np.stack([_orientations(numbers, written) for numbers in _numbers(R, read)])
        angles = [Rotation.from_matrix(np.swapaxes(expected, 1, 2) @ one).magnitude() for one in made]
        nearest = made[np.argmin(angles, axis=0), np.arange(len(R))]
        found[f"{written} that was read as {read}"] = turned_alike(expected, nearest)[1]
    best = min(found, key=lambda says: found[says])
    return best, found[best]


def _numbers(R: Array, convention: str) -> Iterator[Array]:
    """Yield each way of writing orientations (N, 3, 3) as three numbers (N, 3), the usual one first."""
    rotation = Rotation.from_matrix(R)
    if convention == ROTATION_VECTOR:
        vector = rotation.as_rotvec()
        size = np.linalg.norm(vector, axis=1, keepdims=True)
        yield vector
        yield vector * (1.0 - TURN / np.maximum(size, 1e-12))
        return
    sequence = EULER[convention]
    numbers = rotation.as_euler(sequence)
    half = 0.5 * TURN
    middle = -numbers[:, 1] if sequence[0] == sequence[2] else half - numbers[:, 1]
    other = np.stack([numbers[:, 0] + half, middle, numbers[:, 2] + half], axis=1)
    yield numbers
    yield (other + half) % TURN - half


def _orientations(numbers: Array, convention: str) -> Array:
    """Return the orientations (N, 3, 3) of three numbers (N, 3)."""
    if convention == ROTATION_VECTOR:
        return np.asarray(Rotation.from_rotvec(numbers).as_matrix())
    return np.asarray(Rotation.from_euler(EULER[convention], numbers).as_matrix())

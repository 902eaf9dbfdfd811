"""How frames move, and what every robot shares."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from galen_hw.spatial import Array
from galen_hw.units import STANDARD_GRAVITY

NOMINAL_GRAVITY = np.array([0.0, 0.0, -STANDARD_GRAVITY])


@dataclass(frozen=True, slots=True)
class Motion:
    """How a frame moves, in base coordinates and without gravity.

    Args:
        T: (N, 4, 4) pose in the base.
        acceleration: (N, 3) of the frame's origin, m/s^2.
        omega: (N, 3) rad/s; alpha: (N, 3) rad/s^2.
    """

    T: Array
    acceleration: Array
    omega: Array
    alpha: Array


def batch(q: ArrayLike) -> Array:
    """(N, n) of one row (n,) or many."""
    return np.atleast_2d(np.asarray(q, dtype=float))

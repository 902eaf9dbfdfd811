"""Inputs of the black boxes: force, joints, and the force's past."""

import numpy as np

from galen_hw.identification.deflection.data import DeflectionSet
from galen_hw.spatial import Array

LAGS_S = (0.1, 0.3, 1.0, 3.0)


def now(data: DeflectionSet) -> Array:
    """Force and joints (N, 3 + n)."""
    return np.hstack([data.force, data.q])


def with_past(data: DeflectionSet) -> Array:
    """Force, joints, and the force some moments ago (N, 15 + n)."""
    past = [np.stack([np.interp(data.time - lag, data.time, f) for f in data.force.T], axis=1) for lag in LAGS_S]
    return np.hstack([now(data), *past])

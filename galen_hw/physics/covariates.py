"""Columns of a recording that may be a cause of what is compared, and are no quantity that any simulation knows."""

from collections.abc import Mapping
from typing import Final

import numpy as np

from galen_hw.spatial import Array

COMPUTED: Final = ("compensated.", "std.")
COUNTED: Final = frozenset({"samples", "pose", "tool", "verify", "joint_age"})
"""Covariates that this program adds itself: by how they begin, and by their names."""


def covariates(columns: Mapping[str, Array]) -> tuple[str, ...]:
    """Return the covariates that may be a cause: no count, no clock, and none that was computed from the compared group."""
    given = {n: n.removeprefix("covariate.") for n in columns if n.startswith("covariate.")}
    names = (n for n, own in given.items() if own not in COUNTED and not own.startswith(COMPUTED))
    return tuple(n for n in names if np.isfinite(columns[n]).all() and not _counts(np.diff(columns[n])))


def _counts(steps: Array) -> bool:
    return bool((steps >= 0.0).all() or (steps <= 0.0).all())

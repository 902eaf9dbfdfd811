"""What a detector proposes, and what all detectors need."""

from dataclasses import dataclass

import numpy as np

from galen_hw.diagnosis.stats.sampling import Rows
from galen_hw.physics.effects.base import Effect
from galen_hw.physics.scenes.base import Scene
from galen_hw.spatial import Array


@dataclass(frozen=True)
class Sought:
    """An effect proposed by a detector, and the number of places that were searched for it."""

    effect: Effect
    trials: int


FEW_ROWS = 40
"""Rows too few to look for a moment or a movement in."""


SHARED = 0.1
"""Share of the strongest channel's gain from which another channel is in it too."""


def slow_spread(x: Array) -> Array:
    """Return the standard deviation (C,) of a residual (M, C) from differences of its rows, with a small part of its own."""
    return np.asarray(np.std(np.diff(x, axis=0), axis=0) / np.sqrt(2.0) + 0.05 * np.std(x, axis=0))


def moment(scene: Scene, rows: Rows, row: int) -> float:
    """Return the time at which an averaged row begins, s."""
    return float(scene.time[rows.starts[row]])

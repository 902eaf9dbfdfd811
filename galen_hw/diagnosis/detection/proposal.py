"""Something found by looking at a residual, and what all who look need."""

from dataclasses import dataclass

import numpy as np

from galen_hw.physics.effects.base import Effect
from galen_hw.physics.scenes.base import Scene
from galen_hw.spatial import Array


@dataclass(frozen=True)
class Sought:
    """Something found by looking, and at how many places was looked."""

    effect: Effect
    looked: int


FEW_ROWS = 40
"""Rows too few to look for a moment or a movement in."""


SHARED = 0.1
"""Share of the strongest channel's gain from which another channel is in it too."""


def slow_spread(x: Array) -> Array:
    """(C,) standard deviation of a rest (M, C) by the differences of its rows, and a little of its own."""
    return np.asarray(np.std(np.diff(x, axis=0), axis=0) / np.sqrt(2.0) + 0.05 * np.std(x, axis=0))


def moment(scene: Scene, row: int, rows: int) -> float:
    """Time of a row of the averaged rest."""
    place = min(round(row * len(scene) / rows), len(scene) - 1)
    return float(scene.time[place])

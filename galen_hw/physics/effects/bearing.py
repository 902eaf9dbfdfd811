"""Friction of a bearing, and what a joint does behind it: the load that it feels is what the friction lets through."""

from typing import Final

import numpy as np

from galen_hw.physics.scenes.base import Scene
from galen_hw.spatial import Array

FRICTIONS: Final = np.geomspace(0.02, 0.95, 7)
"""Shares of half of what the load does that are tried before the best one is sought."""
QUICKER: Final = (1.0, 0.6)
"""Shares of the constant that are tried with each: what waits for the friction seems to take longer."""
FIRST_STEPS: Final = np.array([[0.0, 0.0], [0.2, 0.0], [0.0, -0.2]])
"""Of these logarithms, with which friction and constant are sought from there."""


def let_through(scene: Scene, load: Array, friction: float) -> Array:
    """(N,) what a bearing with dry friction lets through of a load (N,), all in N or N m: a play of it as wide as that."""
    return scene.play("bearing", load[:, None], friction)[:, 0]


def begun(scale: float, constant: float) -> Array:
    """(n, 2) logarithms of friction (N or N m) and of the constant (s) of what is behind it, from which they are sought.

    Args:
        scale: half of what the load does, N or N m; constant: as it seems without friction, s.
    """
    return np.array([[np.log(f * scale), np.log(share * constant)] for f in FRICTIONS for share in QUICKER])

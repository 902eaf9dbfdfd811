"""Friction of a bearing, and what a joint does behind it: the load that it feels is what the friction lets through."""

import numpy as np

from galen_hw.physics.scenes.base import Scene
from galen_hw.spatial import Array


def let_through(scene: Scene, load: Array, friction: float) -> Array:
    """(N,) what a bearing with dry friction lets through of a load (N,), all in N or N m: a play of it as wide as that."""
    return scene.play("bearing", load[:, None], friction)[:, 0]


def begun(
    scale: float,
    constant: float,
    *,
    frictions: tuple[float, float, int] = (0.02, 0.95, 7),
    shares: tuple[float, ...] = (1.0, 0.6),
    steps: tuple[float, float] = (0.2, -0.2),
) -> tuple[Array, Array]:
    """(n, 2) logarithms of friction (N or N m) and of the constant (s) of what is behind it, from which they are sought.

    With the first steps (3, 2) from there.

    Args:
        scale: half of what the load does, N or N m; constant: as it seems without friction, s.
        frictions: least and most share of half of what the load does that is tried, and how many.
        shares: of the constant that are tried with each: what waits for the friction seems to take longer.
        steps: of the two logarithms.
    """
    first = [[np.log(f * scale), np.log(share * constant)] for f in np.geomspace(*frictions) for share in shares]
    return np.array(first), np.array([[0.0, 0.0], [steps[0], 0.0], [0.0, steps[1]]])

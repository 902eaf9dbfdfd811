"""What a model adds to a simulation, in the order in which the wire meets it: physics, late clocks and filters, limits."""

from collections.abc import Sequence

import numpy as np

from galen_hw.physics.effect import Columns, Downstream, Effect
from galen_hw.physics.scene import Scene
from galen_hw.physics.sensor_effects import Saturation
from galen_hw.spatial import Array

Placed = tuple[Effect, Array]
"""An effect with its linear parameters (k,)."""
Timing = Sequence[tuple[Downstream, Array]]
"""The ends of a stream with their parameters, the first one first."""


def through(effect: Effect, timing: Timing) -> Timing:
    """What an effect's change goes through before it is read; nothing for what belongs to moments."""
    if effect.EPISODIC:
        return ()
    if effect.DOWNSTREAM:
        return [(other, theta) for other, theta in timing if other.KEY in effect.BEHIND]
    return [(other, theta) for other, theta in timing if other.KEY not in effect.contains]


def change(scene: Scene, effect: Effect, theta: Array, timing: Timing) -> Array:
    """(N, C) what one effect adds, as it arrives."""
    columns = Columns(tuple(range(len(scene.channels))), effect.change(scene, theta)[:, :, None])
    for other, its in through(effect, timing):
        columns = other.delivered(scene, columns, its)
    return columns.values[:, :, 0]


def carried(scene: Scene, effects: Sequence[Placed], timing: Timing) -> Array:
    """(N, C) what all but limits add, as if nothing clipped."""
    open_end = [(other, its) for other, its in timing if not isinstance(other, Saturation)]
    out = np.zeros((len(scene), len(scene.channels)))
    for effect, theta in effects:
        if not isinstance(effect, Saturation):
            out += change(scene, effect, theta, open_end)
    return out


def limited(timing: Timing) -> list[str]:
    """Channels whose readings clip."""
    return [other.channel for other, _ in timing if isinstance(other, Saturation)]


def added(scene: Scene, effects: Sequence[Placed], timing: Timing) -> Array:
    """(N, C) what a model adds to a recording that it has not seen, whose constants are not known before."""
    whole = carried(scene, effects, timing)
    if not any(isinstance(effect, Saturation) for effect, _ in effects):
        return whole
    # Few rows clip: the median constant is that of the others.
    stream = scene.carrying(np.median(scene.residual - whole, axis=0), whole, limited(timing))
    return np.asarray(np.sum([change(stream, effect, theta, timing) for effect, theta in effects], axis=0))

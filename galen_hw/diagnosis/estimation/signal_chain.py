"""What a model adds to a simulation, in the order in which the wire meets it: physics, late clocks and filters, limits."""

from collections.abc import Sequence

import numpy as np

from galen_hw.physics.effects.base import Effect
from galen_hw.physics.effects.columns import Columns
from galen_hw.physics.effects.interactions import Placed, compound, meet
from galen_hw.physics.scenes.base import Scene
from galen_hw.spatial import Array

OutputStage = Sequence[tuple[Effect, Array]]
"""The ends of a stream with their parameters, the first one first."""


def through(effect: Effect, timing: OutputStage) -> OutputStage:
    """What an effect's change goes through before it is read; nothing for what belongs to moments."""
    if effect.EPISODIC:
        return ()
    if effect.DOWNSTREAM:
        return [(other, theta) for other, theta in timing if other.KEY in effect.BEHIND]
    return [(other, theta) for other, theta in timing if other.KEY not in effect.contains]


def total_output(scene: Scene, effects: Sequence[Placed], timing: OutputStage) -> Array:
    """(N, C) what effects add together, each as it arrives."""
    out = np.zeros((len(scene), len(scene.channels)))
    for (effect, _), change in zip(effects, compound(scene, effects), strict=True):
        out += output_of(scene, effect, change, timing)
    return out


def output_of(scene: Scene, effect: Effect, change: Array, timing: OutputStage) -> Array:
    """(N, C) what one effect adds, as it arrives."""
    columns = Columns(tuple(range(len(scene.channels))), change[:, :, None])
    for other, its in through(effect, timing):
        columns = other.delivered(scene, columns, its)
    return columns.values[:, :, 0]


def carried(scene: Scene, effects: Sequence[Placed], timing: OutputStage) -> Array:
    """(N, C) what all but limits add, as if nothing clipped."""
    open_end = [(other, its) for other, its in timing if not other.clips]
    return total_output(scene, [(e, theta) for e, theta in effects if not e.clips], open_end)


def interaction_terms(scene: Scene, effects: Sequence[Placed], timing: OutputStage) -> list[Array]:
    """(N, C) what each effect adds, as it arrives, because the others are there too; nothing at all where none meets another."""
    out: list[Array] = []
    if not meet(scene, effects):
        return out
    for (effect, theta), change in zip(effects, compound(scene, effects), strict=True):
        more = np.zeros_like(change) if effect.DOWNSTREAM else change - effect.change(scene, theta)
        out.append(output_of(scene, effect, more, timing) if more.any() else more)
    return out


def limited(timing: OutputStage) -> list[str]:
    """Channels whose readings clip."""
    return [other.clips[0] for other, _ in timing if other.clips]


def added(scene: Scene, effects: Sequence[Placed], timing: OutputStage) -> Array:
    """(N, C) what a model adds to a recording that it has not seen, whose constants are not known before."""
    whole = carried(scene, effects, timing)
    if not any(effect.clips for effect, _ in effects):
        return whole
    # Few rows clip: the median constant is that of the others.
    stream = scene.carrying(np.median(scene.residual - whole, axis=0), whole, limited(timing))
    return total_output(stream, effects, timing)

"""The signal chain of a model: physics, then the output stage of delays, filters and limits."""

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
    """Return the parts of the output stage that an effect passes through; none for momentary effects."""
    if effect.EPISODIC:
        return ()
    if effect.DOWNSTREAM:
        return [(other, theta) for other, theta in timing if other.KEY in effect.BEHIND]
    return [(other, theta) for other, theta in timing if other.KEY not in effect.contains]


def total_output(scene: Scene, effects: Sequence[Placed], timing: OutputStage) -> Array:
    """Return the total output (N, C) of effects, each through the output stage."""
    out = np.zeros((len(scene), len(scene.channels)))
    for (effect, _), change in zip(effects, compound(scene, effects), strict=True):
        out += output_of(scene, effect, change, timing)
    return out


def output_of(scene: Scene, effect: Effect, change: Array, timing: OutputStage) -> Array:
    """Return the output (N, C) of one effect through the output stage."""
    columns = Columns(tuple(range(len(scene.channels))), change[:, :, None])
    for other, its in through(effect, timing):
        columns = other.delivered(scene, columns, its)
    return columns.values[:, :, 0]


def carried(scene: Scene, effects: Sequence[Placed], timing: OutputStage) -> Array:
    """Return the output (N, C) of all effects but limits, as if nothing clipped."""
    open_end = [(other, its) for other, its in timing if not other.clips]
    return total_output(scene, [(e, theta) for e, theta in effects if not e.clips], open_end)


def interaction_terms(scene: Scene, effects: Sequence[Placed], timing: OutputStage) -> list[Array]:
    """Return the interaction term (N, C) of each effect, through the output stage; none where no effects interact."""
    out: list[Array] = []
    if not meet(scene, effects):
        return out
    for (effect, theta), change in zip(effects, compound(scene, effects), strict=True):
        more = np.zeros_like(change) if effect.DOWNSTREAM else change - effect.change(scene, theta)
        out.append(output_of(scene, effect, more, timing) if more.any() else more)
    return out


def limited(timing: OutputStage) -> list[str]:
    """Return the channels whose readings clip."""
    return [other.clips[0] for other, _ in timing if other.clips]


def added(scene: Scene, effects: Sequence[Placed], timing: OutputStage) -> Array:
    """Return the output (N, C) of a model in another recording, whose constants are not known beforehand."""
    whole = carried(scene, effects, timing)
    if not any(effect.clips for effect, _ in effects):
        return whole
    # Few rows clip: the median constant is that of the others.
    stream = scene.carrying(np.median(scene.residual - whole, axis=0), whole, limited(timing))
    return total_output(stream, effects, timing)

"""What came before a recording: what the first look leaves open of it, and who presumes to know it."""

from collections.abc import Sequence

from galen_hw.physics.effects.base import Effect
from galen_hw.physics.effects.columns import Columns
from galen_hw.physics.scenes.base import Scene
from galen_hw.physics.scenes.initial_state import Beginning
from galen_hw.spatial import Array


def left_open(scene: Scene, effects: Sequence[tuple[Effect, Array]]) -> Beginning:
    """What effects with parameters theta (k,) answer to that nobody recorded: late streams, and creep that had not settled."""
    all_of_them = [effect for effect, _ in effects]
    return sum((effect.beginning(scene, theta, all_of_them) for effect, theta in effects), Beginning())


def supposable(scene: Scene, effects: list[Effect], columns: list[Columns]) -> list[tuple[Effect, Columns]]:
    """Effects with their columns; no creep that began rested where any beginning as quick is fitted: it is the same there."""
    each = zip(effects, columns, strict=True)
    return [(effect, own) for effect, own in each if not effect.presumes(scene)]

"""Pushes on the tip beside where it is seen to go: a structure gives with a push, never against it."""

from collections.abc import Iterator
from dataclasses import replace
from typing import ClassVar, Final

import numpy as np

from galen_hw.physics.effects.registry import scene_of
from galen_hw.physics.observations import Observations
from galen_hw.physics.scenes.pose import POSITION
from galen_hw.premises.base import Action, Remark, Stage
from galen_hw.premises.criteria import CRITERIA
from galen_hw.spatial import Array

FORCE: Final = tuple(f"applied.force.{a}" for a in "xyz")
BLOCKS: Final = 20
"""Contiguous pieces of the rows, each one value: what wanders slowly, in tracker or arm, is one piece of luck."""
SURE: Final = 5.0
"""Standard errors over the pieces by which the tip must move against a push."""


class PushSigns:
    """Tests that the tip of an arm that stands moves with the force on it: the work of a push on a structure is not negative."""

    KEY: ClassVar[str] = "push_signs"
    STAGE: ClassVar[Stage] = Stage.FRAMES

    def examine(self, seen: Observations) -> Iterator[Remark]:
        """Yield one refusal where the work of the pushes is surely negative."""
        names = (*FORCE, *POSITION)
        if seen.predict != "pose" or seen.belief.robot is None or not all(n in seen.columns for n in names):
            return
        some = seen.taken(np.flatnonzero(np.isfinite(seen.matrix(*names)).all(axis=1)))
        if len(some) < BLOCKS * CRITERIA.fewest_vectors:
            return
        scene = scene_of(replace(some, belief=replace(some.belief, compliance={})))
        give, arm = scene.residual[:, :3], scene.simulated[:, :3]
        if not np.isfinite(give).all() or np.sum(np.var(arm, axis=0)) > np.sum(np.var(give, axis=0)):
            return  # an arm that moves is missed for more reasons than a push
        if not np.any(np.ptp(some.matrix(*FORCE), axis=0) > 0.0):
            return
        slope, spread = _given(some.matrix(*FORCE), give)
        if slope < -SURE * spread:
            what = f"the tip moves against the push, by {-1e6 * slope:.3g} +- {1e6 * spread:.2g} um/N"
            hint = "the opposite sign (reaction instead of action), or other axes than the base's?"
            todo = "give the force on the tip, in the base's axes"
            yield Remark(self.KEY, f"{what}: has the force {hint}", todo, names, Action.REFUSED)


def _given(force: Array, give: Array) -> tuple[float, float]:
    """Give along the push (N, 3), m/N, of all pushes together, and its standard error over contiguous pieces."""
    F, d = force - force.mean(axis=0), give - give.mean(axis=0)
    work, size = np.sum(F * d, axis=1), np.sum(F**2, axis=1)
    slope = float(work.sum() / size.sum())
    left = work - slope * size
    return slope, float(np.sqrt(sum(piece.sum() ** 2 for piece in np.array_split(left, BLOCKS))) / size.sum())

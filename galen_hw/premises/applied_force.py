"""The sign of a force that is applied to the tip: whatever gives, gives the way it is pushed."""

from collections.abc import Iterator
from typing import ClassVar, Final

import numpy as np

from galen_hw.physics.effects.registry import scene_of
from galen_hw.physics.observations import Observations
from galen_hw.physics.scenes.pose import POSITION
from galen_hw.premises.base import Action, Remark, Stage, with_columns
from galen_hw.premises.criteria import CRITERIA
from galen_hw.premises.pose_frames import sampled

APPLIED: Final = tuple(f"applied.force.{axis}" for axis in "xyz")


class AppliedForce:
    """Tests that the tip goes the way it is pushed: no spring, friction or play is without the work of the push.

    Judged within each segment, so that neither registration nor a constant of either enters.
    """

    KEY: ClassVar[str] = "applied_force"
    STAGE: ClassVar[Stage] = Stage.FRAMES

    def examine(self, seen: Observations) -> Iterator[Remark]:
        """Yield one remark where the tip goes against the push throughout; the force is turned round."""
        names = (*POSITION, *APPLIED)
        if seen.predict != "pose" or seen.belief.robot is None or not all(name in seen.columns for name in names):
            return
        if seen.belief.compliance:
            return  # what the model lets give too much comes back against the push
        some = sampled(seen, names)
        if len(some) < CRITERIA.fewest_split:
            return
        scene = scene_of(some)
        force, moved = some.matrix(*APPLIED), (scene.measured - scene.simulated)[:, :3]
        for part in some.segments:
            force[part] -= force[part].mean(axis=0)
            moved[part] -= moved[part].mean(axis=0)
        size = float(np.sum(force**2)) * float(np.sum(moved**2))
        along = float(np.sum(force * moved)) / np.sqrt(size) if size > 0.0 else 0.0
        if along > -CRITERIA.half:
            return
        repaired = with_columns(seen, {name: -seen.columns[name] for name in APPLIED})
        what = (
            f"the tip goes against applied.force (correlation {along:.2f}): it is the arm's reaction and not the push"
        )
        yield Remark(self.KEY, what, "", APPLIED, Action.REPAIRED, repaired)

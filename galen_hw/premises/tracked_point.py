"""Which point of the tool a tracker follows: the tip that is named, or the origin of its link."""

from collections.abc import Iterator
from dataclasses import replace
from typing import ClassVar

import numpy as np

from galen_hw.physics.effects.registry import scene_of
from galen_hw.physics.observations import Observations
from galen_hw.physics.scenes.pose import POSITION
from galen_hw.premises.base import Action, Remark, Stage
from galen_hw.premises.criteria import CRITERIA
from galen_hw.premises.registration import sampled


class TrackedPoint:
    """Tests whether tracked positions are those of the flange (the origin of the named link), not of the named tip."""

    KEY: ClassVar[str] = "tracked_point"
    STAGE: ClassVar[Stage] = Stage.FRAMES

    def examine(self, seen: Observations) -> Iterator[Remark]:
        """Yield at most one remark, where the origin explains what the tip misses."""
        tip = seen.belief.tip
        if seen.predict != "pose" or seen.simulation is not None or seen.belief.robot is None or not np.any(tip):
            return
        other = replace(seen, belief=replace(seen.belief, tip=np.zeros(3)))
        some = [sampled(one, POSITION) for one in (seen, other)]
        if not seen.has_all(*POSITION) or len(some[0]) < CRITERIA.fewest_vectors:
            return
        before, after = (_mean_square(one) for one in some)
        if not after < CRITERIA.small_turn * before:
            return
        place = ", ".join(f"{1e3 * x:.0f}" for x in tip)
        what = f"the tracked point is the origin of its link, not the named tip ({place}) mm from there: compared without it"
        yield Remark(self.KEY, what, "", POSITION, Action.REPAIRED, other)


def _mean_square(seen: Observations) -> float:
    """Return the mean square, m^2, of what positions miss."""
    scene = scene_of(seen)
    return float(np.mean(np.sum((seen.matrix(*POSITION) - scene.simulated[:, :3]) ** 2, axis=1)))

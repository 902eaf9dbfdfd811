"""A wrench without the weight of the named tool: the robot's controller, or a driver, has taken it off already."""

from collections.abc import Iterator
from dataclasses import replace
from typing import ClassVar

import numpy as np

from galen_hw.physics.effects.registry import scene_of
from galen_hw.physics.observations import Observations
from galen_hw.physics.rigid import Body
from galen_hw.premises.base import Action, Remark, Stage
from galen_hw.premises.criteria import CRITERIA
from galen_hw.premises.wrench_reading import FORCE, TORQUE, comparable


class WeightlessTool:
    """Tests whether a wrench holds nothing of the tool's weight, whatever it holds of the forces of its acceleration."""

    KEY: ClassVar[str] = "weightless_tool"
    STAGE: ClassVar[Stage] = Stage.LOAD

    def examine(self, seen: Observations) -> Iterator[Remark]:
        """Yield one remark: compared without gravity where its inertia is there, else without the tool."""
        tool, belief = seen.belief.tool, seen.belief
        if (
            seen.predict != "wrench"
            or seen.simulation is not None
            or tool.mass <= 0.0
            or not seen.has_all(*FORCE, *TORQUE)
        ):
            return
        some = comparable(seen)
        if len(some) < 2 * CRITERIA.pieces:
            return
        bare = replace(belief, tool=Body())
        others = {"its inertia is there": replace(belief, gravity=np.zeros(3))} if belief.dynamic else {}
        others["nor of its inertia" if belief.dynamic else ""] = bare
        named = _missed(some)
        left = {says: _missed(replace(some, belief=other)) for says, other in others.items()}
        says = min(left, key=lambda one: left[one])
        if not left[says] <= min(CRITERIA.gross_left * _weighed(some), CRITERIA.gross_gain * named):
            return  # nor where any of it is not finite
        what = (
            f"the wrench holds nothing of the named tool's weight, {tool.mass:.4g} kg{f' ({says})' if says else ''}: "
        )
        what += "the controller or a driver has taken it off, or the tool is not on; compared without it"
        todo = "name the tool only where its weight is in the readings"
        yield Remark(self.KEY, what, todo, (*FORCE, *TORQUE), Action.REPAIRED, replace(seen, belief=others[says]))


def _missed(seen: Observations) -> float:
    """Return the mean square of what the simulation misses of the force, a constant aside, N^2."""
    scene = scene_of(seen)
    return float(np.mean(np.var((scene.measured - scene.simulated)[:, :3], axis=0)))


def _weighed(seen: Observations) -> float:
    """Return the mean square that the weight of the bodies has in the force, a constant aside, N^2."""
    return float(np.mean(np.var(scene_of(seen).simulated[:, :3], axis=0)))

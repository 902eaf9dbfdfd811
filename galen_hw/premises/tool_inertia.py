"""The inertia of the tool: told about its centre of mass, or about the origin of the sensor."""

from collections.abc import Iterator
from dataclasses import replace
from typing import ClassVar

import numpy as np

from galen_hw.physics.effects.registry import scene_of
from galen_hw.physics.observations import Observations
from galen_hw.physics.rigid import Body, parallel_axis
from galen_hw.premises.base import Action, Remark, Stage
from galen_hw.premises.criteria import CRITERIA
from galen_hw.premises.wrench_reading import TORQUE, comparable
from galen_hw.spatial import Array


class ToolInertia:
    """Tests whether the named inertia of the tool is about the sensor's origin (the flange), not about the centre of mass."""

    KEY: ClassVar[str] = "tool_inertia"
    STAGE: ClassVar[Stage] = Stage.LOAD

    def examine(self, seen: Observations) -> Iterator[Remark]:
        """Yield at most one remark, where a motion shows moments of the one and not of the other."""
        tool = seen.belief.tool
        about_com = tool.inertia - tool.mass * parallel_axis(tool.com)
        if (
            seen.predict != "wrench"
            or seen.simulation is not None
            or seen.time is None
            or not seen.belief.dynamic
            or tool.mass <= 0.0
            or not all(name in seen.columns for name in TORQUE)
            or not _possible(about_com)
        ):
            return
        other = replace(seen, belief=replace(seen.belief, tool=Body(tool.mass, tool.com, about_com)))
        some = comparable(seen)
        if len(some) < 2 * CRITERIA.pieces:
            return
        before, after = (_squares(comparable(one)) for one in (seen, other))
        pieces = [len(part) for part in np.array_split(before, CRITERIA.pieces)]
        gain = np.array([part.mean() for part in np.split(before - after, np.cumsum(pieces)[:-1])])
        error = float(np.std(gain, ddof=1)) / np.sqrt(len(gain))
        if after.mean() > CRITERIA.half * before.mean() or gain.mean() < CRITERIA.paired_errors * error:
            return
        largest = float(np.max(np.diag(tool.inertia)))
        what = f"the tool's inertia ({largest:.3g} kg m^2 at most) is about the sensor's origin, not about the centre of mass "
        what += f"({float(np.max(np.diag(about_com))):.3g} there): taken about it"
        yield Remark(self.KEY, what, "", TORQUE, Action.REPAIRED, other)


def _possible(inertia: Array) -> bool:
    """Return whether a body can have such an inertia (3, 3): no principal moment is larger than the other two together."""
    first, second, third = np.linalg.eigvalsh(inertia)
    return bool(first > 0.0 and third <= first + second)


def _squares(seen: Observations) -> Array:
    """Return the squared residual (N,) of the torques, given a constant, each over its variance."""
    scene = scene_of(seen)
    at = [scene.channels.index(name) for name in TORQUE]
    residual = (scene.measured - scene.simulated)[:, at]
    spread = np.maximum(np.var(scene.measured[:, at], axis=0), 1e-300)
    return np.asarray(np.sum((residual - residual.mean(axis=0)) ** 2 / spread, axis=1))

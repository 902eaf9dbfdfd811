"""The bent arm to second order: what each port's give does to the loads and motions of all others.

The tip is a product of exponentials along the chain (Brockett 1984): structure, joints in their order, tool. Ports give
little, so its Taylor series to second order is exact enough:

    tip' = tip + sum_i y_i (a_i + 1/2 sum_j y_j h_ij),     h_ij = w_p x a_d

with a the motion of the tip per unit of give, w a port's turn, p the proximal and d the distal one of i and j. The load
of a port is the work of force and weight along its motion, which the other ports' gives change by h in the same way.
"""

from collections.abc import Iterable, Mapping, Sequence

import numpy as np

from galen_hw.lazy import cached_property
from galen_hw.physics.observations import Observations
from galen_hw.physics.scenes.base import once
from galen_hw.physics.scenes.elastic_arm import FRAMES, GivingScene, Slip
from galen_hw.spatial import Array


def chain_order(ports: Iterable[str], joints: Sequence[str]) -> list[str]:
    """Ports from the base to the tool."""

    def place(port: str) -> int:
        frame = port.partition(".")[0]
        if frame in FRAMES:
            return -1 if frame == FRAMES[0] else len(joints)
        return joints.index(port)

    return sorted(ports, key=place)


class BentScene(GivingScene):
    """A pose scene whose loads and motions are those of the bent arm.

    Args:
        observations, mass, moment, slips: as `GivingScene`.
        gives: port to what it gives (N,), m or rad, as far as it is known; nothing: the rigid arm.
    """

    def __init__(
        self,
        observations: Observations,
        *,
        mass: float = 0.0,
        moment: Sequence[float] = (0.0, 0.0, 0.0),
        slips: Mapping[str, Sequence[Slip]] | None = None,
        gives: Mapping[str, Array] | None = None,
    ) -> None:
        super().__init__(observations, mass=mass, moment=moment, slips=slips)
        self.gives = dict(gives or {})

    @cached_property
    def _weight_point(self) -> Array:
        """(N, 3) where the weight beyond the sensor acts, base."""
        if not self.mass:
            return self.tip
        return np.asarray(self.T_sensor[:, :3, 3] + self.T_sensor[:, :3, :3] @ (self.moment / self.mass))

    def _along(self, port: str, point: Array) -> Array:
        """(N, 3) motion of a point of the distal part per unit of give."""
        screw = self.screw(port)
        return np.asarray(screw[:, :3] + np.cross(screw[:, 3:], point))

    def _bent(self, port: str, point: Array) -> Array:
        """(N, 3) change of `_along` by the other ports' gives, and by its own."""
        out = np.zeros((len(self), 3))
        for other, give in self.gives.items():
            proximal, distal = chain_order((port, other), self.joint_names)
            out += give[:, None] * np.cross(self.screw(proximal)[:, 3:], self._along(distal, point))
        return out

    def _turned(self, port: str) -> Array:
        """(N, 3) change of a port's turn by the other ports' gives (Baker, Campbell, Hausdorff)."""
        out = np.zeros((len(self), 3))
        for other, give in self.gives.items():
            proximal, distal = chain_order((port, other), self.joint_names)
            out += give[:, None] * np.cross(self.screw(proximal)[:, 3:], self.screw(distal)[:, 3:])
        return out

    @once
    def bare_load(self, port: str) -> Array:
        """(N,) load of a port on the bent arm, N or N m."""
        weight = self.mass * self.belief.gravity
        tip = self._along(port, self.tip) + self._bent(port, self.tip)
        held = self._along(port, self._weight_point) + self._bent(port, self._weight_point)
        return np.asarray(np.sum(tip * self.force, axis=1) + held @ weight)

    @once
    def joint_port(self, joint: str) -> Array | None:
        """(N, C) motion [m, rad] of the tip per unit of give, on the arm that is bent half of the way."""
        move = self._along(joint, self.tip) + 0.5 * self._bent(joint, self.tip)
        turn = self.screw(joint)[:, 3:] + 0.25 * self._turned(joint)
        return np.concatenate([move, turn], axis=1)[:, : len(self.channels)]


class GiveScene(BentScene):
    """The rigid arm's loads, with ports that answer by the give itself: columns are then (N,) of m or rad a unit."""

    @once
    def joint_port(self, joint: str) -> Array | None:
        """(N, C) ones."""
        del joint
        return np.ones((len(self), len(self.channels)))

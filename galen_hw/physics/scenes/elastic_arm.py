"""An arm that gives: joints, structure and tool as springs with friction, play and memory under their own load.

Each place where the arm gives is a port: a joint's name, or an axis "structure.x" (base) or "tool.x" (sensor frame).
The effects of joints (compliance, hardening, creep) work on every port: the scene knows each one's load and screw.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Self

import numpy as np

from galen_hw.lazy import cached_property
from galen_hw.physics.observations import Observations
from galen_hw.physics.scenes.base import once
from galen_hw.physics.scenes.pose import PoseScene
from galen_hw.physics.scenes.screws import joint_screws
from galen_hw.spatial import Array

Slip = tuple[float, float]
"""A Maxwell slip element: load at which it slips (N or N m) and its share of the load."""
FRAMES = ("structure", "tool")


class GivingScene(PoseScene):
    """A pose scene with second-order geometry: loads act on the bent arm, screws at the middle of the way.

    Args:
        observations: the recording, group "pose".
        mass: kg that hangs beyond the sensor, and moment: (3,) kg m, mass times its centre in the sensor frame.
        lever: port to compliance; what the loads' levers are bent by.
        slips: port to slip elements; `load` is then what is left of the load behind the friction.
    """

    _screw_key: ClassVar[str] = "GivingScene.screw"

    def __init__(
        self,
        observations: Observations,
        *,
        mass: float = 0.0,
        moment: Sequence[float] = (0.0, 0.0, 0.0),
        lever: Mapping[str, float] | None = None,
        slips: Mapping[str, Sequence[Slip]] | None = None,
    ) -> None:
        super().__init__(observations)
        self.mass, self.moment = mass, np.asarray(moment, dtype=float)
        self.lever, self.slips = dict(lever or {}), dict(slips or {})

    def sharing(self, other: "GivingScene") -> Self:
        """Take over from a scene of the same recording what depends on the joints alone."""
        for name in ("T_sensor", "tip", "force", "q", "_joint_screws"):
            if name in other.__dict__:
                self.__dict__[name] = other.__dict__[name]
        screws = {k: v for k, v in other.__dict__.get("_once", {}).items() if k[0] == GivingScene._screw_key}
        self.__dict__.setdefault("_once", {}).update(screws)
        return self

    def play(self, name: Any, x: Array, half_width: Any, start: Array | None = None) -> Array:
        """Return `filters.play`, a column at a time in plain floats: many times quicker for few columns."""
        del name, start
        out, widths = np.empty_like(x), np.broadcast_to(np.asarray(half_width, dtype=float), x.shape[1:])
        for part in self.segments:
            for i, r in enumerate(widths.tolist()):
                out[part, i] = _played(x[part, i].tolist(), r)
        return out

    def lag(
        self, name: Any, x: Array, constant: Any, *, empty: bool = False, held: bool = True, bowed: bool = False
    ) -> Array:
        """Return `filters.lag` of inputs held over each step, as in the live service; a column at a time in plain floats."""
        if empty or not held:
            return super().lag(name, x, constant, empty=empty, held=held, bowed=bowed)
        out, constants = np.empty_like(x), np.broadcast_to(np.asarray(constant, dtype=float), x.shape[1:])
        for part in self.segments:
            steps = np.diff(self.time[part], prepend=self.time[part][:1])
            for i, T in enumerate(constants.tolist()):
                shares = -np.expm1(-np.maximum(steps, 0.0) / T)
                out[part, i] = _lagged(x[part, i].tolist(), shares.tolist())
        return out

    @property
    def ports(self) -> tuple[str, ...]:
        """All places where the arm could give."""
        return (*self.joint_names, *(f"{frame}.{axis}" for frame in FRAMES for axis in "xyz"))

    @once
    def screw(self, port: str) -> Array:
        """Return the motion [v, w] (N, 6) of the distal part per unit of compliance; v at the base's origin."""
        frame, _, axis = port.partition(".")
        if frame not in FRAMES:
            screws = joint_screws(self, port)
            assert screws is not None, "arm scenes have a robot"
            return screws
        along = np.zeros((len(self), 3))
        along[:] = np.eye(3)["xyz".index(axis)] if frame == "structure" else self.T_sensor[:, :3, "xyz".index(axis)]
        return np.concatenate([along, np.zeros((len(self), 3))], axis=1)

    @cached_property
    def _weight(self) -> tuple[Array, Array]:
        """Weight (3,) and its moment (N, 3) about the base's origin."""
        weight = self.mass * self.belief.gravity
        moment = np.cross(self.T_sensor[:, :3, :3] @ self.moment, self.belief.gravity)
        return weight, moment + np.cross(self.T_sensor[:, :3, 3], weight)

    def _bears(self, port: str, point: Array) -> Array:
        screw, (weight, moment) = self.screw(port), self._weight
        return np.asarray(
            np.sum(screw[:, :3] * (self.force + weight), axis=1)
            + np.sum(screw[:, 3:] * (np.cross(point, self.force) + moment), axis=1)
        )

    @cached_property
    def move(self) -> Array:
        """(N, 3) the tip's give to first order."""
        out = np.zeros((len(self), 3))
        for port, compliance in self.lever.items():
            screw = self.screw(port)
            along = screw[:, :3] + np.cross(screw[:, 3:], self.tip)
            out += compliance * self._bears(port, self.tip)[:, None] * along
        return out

    @once
    def bare_load(self, port: str) -> Array:
        """Return the load (N,) of a port on the bent arm, N or N m."""
        return self._bears(port, self.tip + self.move)

    @once
    def load(self, joint: str) -> Array | None:
        """Return the load behind the friction; None where it does not change."""
        x = self.bare_load(joint)
        out = x.copy()
        for half_width, share in self.slips.get(joint, ()):
            out += share * (self.play("slip", x[:, None], half_width)[:, 0] - x)
        return out if np.ptp(x) > 1e-9 else None

    @once
    def joint_port(self, joint: str) -> Array | None:
        """Return the port (N, C) of the screw, taken at the middle of the tip's way."""
        screw, width = self.screw(joint), len(self.channels)
        move = screw[:, :3] + np.cross(screw[:, 3:], self.tip + 0.5 * self.move)
        return np.concatenate([move, screw[:, 3:]], axis=1)[:, :width]


@dataclass(slots=True)
class RestingLoad:
    """Mean of a load from the start, for as long as it rests.

    A play begins in the middle of its band. Nothing moves inside the band, so that the noise of a single first sample would
    stay in all that follows.
    """

    count: int = 0
    mean: float = 0.0
    square: float = 0.0

    def take(self, load: float, half_width: float, *, share: float = 0.2, few: int = 10, sigmas: float = 4.5) -> bool:
        """Return whether it rests still; a load that moves is no part of the mean.

        Args:
            share: of a play's half width about the mean within which a load rests.
            few: loads that show how much they scatter.
            sigmas: standard deviations about the mean within which it rests then.
        """
        away = load - self.mean
        if self.count and abs(away) > share * half_width:
            return False
        if self.count >= few and away * away > sigmas * sigmas * self.square / self.count:
            return False
        self.count += 1
        self.mean += away / self.count
        self.square += away * (load - self.mean)
        return True


def _played(x: list[float], r: float) -> list[float]:
    """Return the play of half width r, beginning in the middle of its band."""
    start, rests, p, out = RestingLoad(), True, x[0], []
    for value in x:
        if rests:
            rests = start.take(value, r)
            p = start.mean
        if value - r > p:
            p = value - r
        elif value + r < p:
            p = value + r
        out.append(p)
    return out


def _lagged(x: list[float], shares: list[float]) -> list[float]:
    y, out = x[0], []
    for value, share in zip(x, shares, strict=True):
        y += share * (value - y)
        out.append(y)
    return out

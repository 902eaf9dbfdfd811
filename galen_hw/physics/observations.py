"""What the effects read: arrays of one recording (or of one live sample) and what the model believes."""

import itertools
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np

from galen_hw.kinematics import NOMINAL_GRAVITY, Robot, UrdfRobot
from galen_hw.physics.rigid import Body
from galen_hw.spatial import Array

Group = Literal["wrench", "pose", "targets", "effort", "position"]


@dataclass(frozen=True)
class Belief:
    """What the simulation believes.

    Args:
        robot: kinematics and dynamics; None where the recording names none.
        sensor_turn: (3, 3) by which the sensor is turned on its link, in its own axes.
        tool: the tool as a body; its mass may be 0 where nothing is known.
        tip: (3,) tool tip in the sensor frame, m.
        tip_rotation: (3, 3) tip to sensor: the axes whose orientation is tracked.
        bias_body: what hung on the sensor when it was zeroed.
        zeroed_rotation: (3, 3) sensor orientation at which it was zeroed.
        zeroed_joints: (n,) joint positions read there; None where they are not known.
        gravity: (3,) m/s^2 in the base frame.
        bias_free: constant offsets are fitted before comparing.
        dynamic: inertia is in the baseline, not weight alone.
        compliance: joint name to rad/(N m) or m/N that the baseline holds.
        distal: links of the robot that hang on the sensor beside the tool.
        ranges: column to rated (low, high).
        terms: of the tool's file, which the simulation adds (`physics/effects/terms.py`).
        epoch: seconds since the epoch at time 0 of the recording; None where it is not known.
    """

    robot: Robot | None = None
    sensor_turn: Array = field(default_factory=lambda: np.eye(3))
    tool: Body = field(default_factory=Body)
    tip: Array = field(default_factory=lambda: np.zeros(3))
    tip_rotation: Array = field(default_factory=lambda: np.eye(3))
    bias_body: Body | None = None
    zeroed_rotation: Array | None = None
    zeroed_joints: Array | None = None
    gravity: Array = field(default_factory=NOMINAL_GRAVITY.copy)
    bias_free: bool = False
    dynamic: bool = True
    compliance: Mapping[str, float] = field(default_factory=dict)
    distal: tuple[Body, ...] = ()
    ranges: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    terms: tuple[Mapping[str, Any], ...] = ()
    epoch: float | None = None

    @property
    def hanging(self) -> tuple[Body, ...]:
        """What weighs on the sensor: the tool, links of the robot, and what hung there before the tool."""
        bodies = (self.tool, *self.distal) if self.bias_body is None else (self.tool, *self.distal, self.bias_body)
        return tuple(body for body in bodies if body.mass > 0.0)

    def slides(self, joint: str) -> bool:
        """Return whether a joint is prismatic: as the URDF says, without one by the names of the Galen's carriages."""
        return self.robot.slides(joint) if isinstance(self.robot, UrdfRobot) else joint.startswith("carriage")


@dataclass(frozen=True)
class Observations:
    """Samples of one recording by column name, SI units, NaN where not measured.

    Args:
        predict: which group is compared.
        columns: float arrays (N,), names as in `docs/recording.md`.
        simulation: the compared group as someone else simulated it, row by row; None: simulate from the belief.
        belief: what the baseline knows.
        apart: several recordings laid end to end: nobody knows how much time lies between them.
    """

    predict: Group
    columns: Mapping[str, Array]
    simulation: Mapping[str, Array] | None = None
    belief: Belief = field(default_factory=Belief)
    apart: bool = False

    def __len__(self) -> int:
        """Return the number of samples."""
        return len(next(iter(self.columns.values()), ()))

    @property
    def time(self) -> Array | None:
        """(N,) s; None where only the order is known."""
        return self.columns.get("time")

    @property
    def segments(self) -> list[slice]:
        """Runs of rows that are continuous with each other."""
        segment = self.columns.get("segment")
        if segment is None:
            return [slice(0, len(self))]
        edges = [0, *(np.flatnonzero(np.diff(segment)) + 1).tolist(), len(self)]
        return [slice(a, b) for a, b in itertools.pairwise(edges) if b > a]

    @property
    def joint_names(self) -> tuple[str, ...]:
        """The robot's joints; without a robot the ones that have a column, in order of appearance."""
        if self.belief.robot is not None:
            return tuple(self.belief.robot.joint_names)
        found = (name.split(".", 1)[1].rsplit(".", 1)[0] for name in self.columns if name.startswith("joint."))
        return tuple(dict.fromkeys(found))

    def matrix(self, *names: str) -> Array:
        """Return the named columns (N, k); NaN where one is absent."""
        missing = np.full(len(self), np.nan)
        return (
            np.stack([np.asarray(self.columns.get(n, missing)) for n in names], axis=-1)
            if names
            else np.empty((len(self), 0))
        )

    def joints(self, kind: str) -> Array:
        """Return joint positions, velocities, efforts or commands (N, n); NaN where a joint has none."""
        return self.matrix(*(f"joint.{name}.{kind}" for name in self.joint_names))

    def has(self, prefix: str) -> bool:
        """Return whether any column begins so."""
        return any(name.startswith(prefix) for name in self.columns)

    def has_all(self, *names: str) -> bool:
        """Return whether every one of these columns is there."""
        return all(name in self.columns for name in names)

    def taken(self, rows: Any) -> "Observations":
        """Return the same with only some rows (slice, mask or indices)."""
        simulation = self.simulation
        cut = None if simulation is None else {k: v[rows] for k, v in simulation.items()}
        return Observations(self.predict, {k: v[rows] for k, v in self.columns.items()}, cut, self.belief, self.apart)

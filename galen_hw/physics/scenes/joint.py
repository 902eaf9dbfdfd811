"""Efforts and positions of joints."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any, Self

import numpy as np
from scipy.interpolate import CubicSpline

from galen_hw.errors import UsageError
from galen_hw.kinematics import UrdfRobot
from galen_hw.lazy import cached_property
from galen_hw.physics.channels import joint_of
from galen_hw.physics.scenes.base import Scene, once
from galen_hw.physics.signals.differentiation import CUT, has_line, smoothed
from galen_hw.spatial import Array

FEW = 20
"""Rows on the way up, and as many on the way down, from which an offset between them is told."""

FOLLOWS = 0.1
"""Share of a simulated servo's error that another cause than its response may have for that to be taken as known."""


class JointScene(Scene):
    """What efforts and positions share: one channel a joint."""

    kind = "effort"

    @cached_property
    def channels(self) -> tuple[str, ...]:  # type: ignore[override]
        """joint.NAME.effort or .position of the joints that have it, measured and simulated."""
        given, columns = self.observations.simulation, self.observations.columns
        names = (f"joint.{joint}.{self.kind}" for joint in self.joint_names)
        return tuple(name for name in names if name in columns and (given is None or name in given))

    @property
    def units(self) -> tuple[str, ...]:  # type: ignore[override]
        """N m or rad; N or m for a prismatic joint."""
        which = ("position", "effort").index(self.kind)
        return tuple(self.joint_units(joint_of(name))[which] for name in self.channels)

    def channel_of(self, joint: str) -> int | None:
        """Return the place of a joint's channel; None where it is not compared."""
        name = f"joint.{joint}.{self.kind}"
        return self.channels.index(name) if name in self.channels else None

    def only(self, joint: str, values: Array) -> Array | None:
        """Return (N, C) with values (N,) in the joint's channel."""
        place = self.channel_of(joint)
        if place is None:
            return None
        out = np.zeros((len(self), len(self.channels)))
        out[:, place] = values
        return out

    def _urdf(self) -> UrdfRobot | None:
        robot = self.belief.robot
        known = isinstance(robot, UrdfRobot) and np.isfinite(self.q).all()
        return robot if known and isinstance(robot, UrdfRobot) else None

    def _along(self, values: Array) -> Array:
        """Return the columns of compared joints, coarse rows brought to all rows."""
        order = [self.joint_index(joint_of(name)) for name in self.channels]
        return np.asarray(values[:, order])

    def _coarse(self, run: Callable[[Any], Array], *, most: int = 4000) -> Array:
        """Return run(rows) -> (M, ...) on an even choice of rows of each run, cubic in between; exact where there are few.

        Args:
            most: rows: ports of a URDF are smooth along the motion.
        """
        n = len(self)
        if n <= most:
            return np.asarray(run(np.arange(n)))
        chosen = [
            np.unique(np.linspace(s.start, s.stop - 1, max(4, most * (s.stop - s.start) // n)).astype(int))
            for s in self.segments
        ]
        values = np.asarray(run(np.concatenate(chosen)))
        own = np.split(values, np.cumsum([len(rows) for rows in chosen])[:-1])
        each = [
            CubicSpline(rows, at, axis=0)(np.arange(s.start, s.stop)) if len(rows) > 1 else at
            for s, rows, at in zip(self.segments, chosen, own, strict=True)
        ]
        return np.concatenate(each)


class EffortScene(JointScene):
    """Compared: joint.NAME.effort against the rigid robot's inverse dynamics, or a given simulation.

    Where noisy motion is low-passed before it is differentiated, the measured efforts go through the same low-pass (the
    parallel filter of dynamic identification: Gautier, Janot, Vandanjon 2013): a jump of force would else be smeared on
    one side alone.
    """

    @cached_property
    def measured(self) -> Array:
        """(N, C) recorded efforts, as far as the motion can tell them."""
        raw = self.observations.matrix(*self.channels)
        return raw if self.band is None else smoothed(self.time, raw, self.segments, self.band, bridge=True)

    def seen(self, x: Array) -> Array:
        """Return signals through the low-pass of the motion."""
        return x if self.band is None else smoothed(self.time, x, self.segments, self.band)

    @property
    def heard(self) -> float | None:
        """The cut-off of the low-pass of the motion."""
        return None if self.band is None else CUT * self.band

    def loses(self, band: float) -> bool:
        """Return whether efforts, low-passed too, would lose a line of their spectra that is above the band."""
        dt = float(np.median(np.diff(self.time)))
        raw = self.observations.matrix(*self.channels)
        return any(has_line(raw[:, c], dt, CUT * band) for c in range(raw.shape[1]))

    @cached_property
    def grain(self) -> int:
        """Four rows a cycle of the cut-off."""
        if self.band is None:
            return 1
        return max(1, int(1.0 / (4.0 * CUT * self.band * float(np.median(np.diff(self.time))))))

    def _simulate(self) -> Array:
        robot = self._urdf()
        if robot is None:
            raise UsageError(
                "efforts cannot be simulated without a URDF", where="recording.json: robot", todo="name a URDF"
            )
        dq, ddq = self.rates
        zero = np.zeros_like(dq)
        return self._along(robot.inverse_dynamics(self.q, *((dq, ddq) if self.belief.dynamic else (zero, zero))))

    def _uses_rates(self) -> bool:
        return self.belief.dynamic

    @once
    def joint_port(self, joint: str) -> Array | None:
        """Return the change of all efforts with a joint's position (central difference)."""
        robot = self._urdf()
        if robot is None:
            return None
        step = np.zeros(self.q.shape[1])
        step[self.joint_index(joint)] = 1e-4
        dq, ddq = self.rates

        def run(rows: Array) -> Array:
            up, down = (robot.inverse_dynamics(self.q[rows] + s * step, dq[rows], ddq[rows]) for s in (1.0, -1.0))
            return np.asarray((up - down) / 2e-4)

        return self._along(self._coarse(run))

    def misread(self, joint: str, *, offset: float = 0.0, scale: float = 0.0) -> Array | None:
        """Return the inverse dynamics of another motion, less that of this one."""
        robot = self._urdf()
        if robot is None:
            return None
        q, dq, ddq = self._stretched(joint, offset, scale)
        if not self.belief.dynamic:
            dq = ddq = np.zeros_like(q)

        def run(rows: Array) -> Array:
            return robot.inverse_dynamics(q[rows], dq[rows], ddq[rows])

        return self._along(self._coarse(run)) - self._rigid(robot)

    @once
    def _rigid(self, robot: UrdfRobot) -> Array:
        """Return efforts (N, C) of the motion itself, between the same coarse rows."""
        dq, ddq = self.rates if self.belief.dynamic else (np.zeros_like(self.q),) * 2
        return self._along(self._coarse(lambda rows: robot.inverse_dynamics(self.q[rows], dq[rows], ddq[rows])))

    @once
    def gravity_port(self) -> Array | None:
        """Return efforts per unit of gravity along x, y, z of the base."""
        robot = self._urdf()
        if robot is None:
            return None
        zero = np.zeros_like(self.q)
        parts = []
        for unit in np.eye(3):
            under = robot.under(unit)

            def run(rows: Array, one: UrdfRobot = under) -> Array:
                return one.inverse_dynamics(self.q[rows], zero[rows], zero[rows])

            parts.append(self._coarse(run))
        return np.stack([self._along(part) for part in parts], axis=-1)

    @once
    def body_port(self) -> Array | None:
        """Return efforts per inertial parameter of the link at the sensor (pinocchio's order); None where nothing moves it."""
        robot = self._urdf()
        if robot is None or robot.carrier is None:
            return None
        dq, ddq = self.rates
        return self._along(self._coarse(lambda rows: robot.load_regressor(self.q[rows], dq[rows], ddq[rows])))

    def carried_mass(self, joint: str = "") -> float:
        """Return the mass of all that a joint moves by itself, or of the link at the sensor, as the URDF has it, kg."""
        robot = self._urdf()
        return 0.0 if robot is None else robot.moved_mass(joint)

    @once
    def link_port(self, joint: str) -> tuple[Array, Array] | None:
        """Return efforts (N, C, 10) per inertial parameter of the link that a joint moves, and its centre of mass (3,), m.

        About and in the axes of that joint. None where there is no URDF, and of the link at the sensor, see `body_port`.
        """
        robot = self._urdf()
        if robot is None or joint not in robot.joint_names:
            return None
        number, com = robot.moved_body(joint)
        if number == robot.carrier:
            return None
        dq, ddq = self.rates
        port = self._coarse(lambda rows: robot.body_regressor(number, self.q[rows], dq[rows], ddq[rows]))
        return self._along(port), com

    def with_body(self, body: Array) -> Self | None:
        """Return the scene with another link at the sensor."""
        robot = self._urdf()
        other = None if robot is None else robot.with_load(body)
        return None if other is None else self._otherwise(belief=replace(self.belief, robot=other))

    def standing_at(self, joint: str, *, offset: float = 0.0, scale: float = 0.0) -> Self | None:
        """Return the scene of a robot that moves otherwise."""
        if self._urdf() is None:
            return None
        q, *rates = self._stretched(joint, offset, scale)
        return self._otherwise(q=q, rates=tuple(rates))

    def under(self, gravity: Array) -> Self | None:
        """Return the scene of links that weigh otherwise."""
        robot = self._urdf()
        if robot is None:
            return None
        return self._otherwise(belief=replace(self.belief, robot=robot.under(gravity), gravity=gravity))

    @once
    def inertial_port(self) -> Array | None:
        """Return inverse dynamics less weight, where the baseline holds weight alone."""
        robot = self._urdf()
        if robot is None or self.belief.dynamic:
            return None
        return self._along(robot.inverse_dynamics(self.q, *self.rates)) - self.simulated

    @once
    def link(self, joint: str) -> tuple[Array, Array] | None:
        """Return the pose (N, 4, 4) in the base of a joint's link, and efforts (N, C, 6) per wrench on it, base axes.

        Of the last link for "". Virtual work: the motors hold against it, tau = -J^T F. None without a URDF.
        """
        robot = self._urdf()
        if robot is None:
            return None

        def pose_of(rows: Array) -> Array:
            return robot.link_pose(self.q[rows], joint) if joint else robot.sensor_pose(self.q[rows])

        def turned(rows: Array) -> Array:
            q = self.q[rows]
            return np.swapaxes(robot.link_jacobian(q, joint) if joint else robot.sensor_jacobian(q), 1, 2)

        pose, jacobian = self._coarse(pose_of), self._coarse(turned)
        order = [self.joint_index(joint_of(name)) for name in self.channels]
        return pose, -jacobian[:, order]

    @once
    def carrier(self, joint: str) -> tuple[Array, Array, Array]:
        """Return of `link` orientation (3, 3, N), position (3, N) and efforts (C, 6, N), contiguous by rows: quicker.

        Raises:
            ValueError: there is no URDF.
        """
        known = self.link(joint)
        if known is None:
            raise ValueError("no link is known without a URDF")
        pose, answer = (np.ascontiguousarray(np.moveaxis(x, 0, -1)) for x in known)
        return pose[:3, :3], pose[:3, 3], answer

    @once
    def load(self, joint: str) -> Array | None:
        """Return the simulated effort itself."""
        place = self.channel_of(joint)
        return None if place is None else self.simulated[:, place]


class PositionScene(JointScene):
    """Compared: joint.NAME.position against a given simulation, or else against the command.

    The effects are driven by what was commanded or simulated: `q` and `rates` are those.
    """

    kind = "position"

    def _simulate(self) -> Array:
        commands = [name.removesuffix("position") + "command" for name in self.channels]
        if not all(name in self.observations.columns for name in commands):
            raise UsageError(
                "there is neither a command nor a simulation to compare positions with",
                where="recording",
                todo="add joint.*.command or --simulation",
            )
        return self.observations.matrix(*commands)

    @cached_property
    def q(self) -> Array:
        """(N, n) simulated positions; for joints that are not compared measured ones, or commands, or rest."""
        out = self.observations.joints("position")
        for instead in (self.observations.joints("command"), np.zeros(out.shape)):
            out = np.where(np.isfinite(out).all(axis=0), out, instead)
        for place, name in enumerate(self.channels):
            out[:, self.joint_index(joint_of(name))] = self.simulated[:, place]
        return out

    @once
    def resting(self, channel: str) -> Array | None:
        """Return the first measured position of every segment, less the offset at which the joint follows both ways.

        A joint that sticks inside its play stays where the last motion left it, which no later input tells. The offset is
        the middle between what is left over on the way up and on the way down, so that play and delay fall out.
        """
        if self.whole is not None:
            return self.whole.resting(channel)
        if channel not in self.channels:
            return None
        place = self.channels.index(channel)
        v = self.rates[0][:, self.joint_index(joint_of(channel))]
        quick = 0.3 * float(np.std(v))
        ways = [self.residual[way, place] for way in (v > quick, v < -quick)]
        known = quick > 0.0 and all(np.isfinite(way).sum() >= FEW for way in ways)
        offset = 0.5 * float(sum(np.nanmedian(way) for way in ways)) if known else 0.0
        return np.array([[self.measured[part.start, place] - offset] for part in self.segments])

    @once
    def joint_port(self, joint: str) -> Array | None:
        """Return one in the joint's own channel."""
        return self.only(joint, np.ones(len(self)))

    @once
    def load(self, joint: str) -> Array | None:
        """Return what (N,) the motor bears, N or N m: minus the effort, measured with a sign or else as the URDF needs it.

        None where neither is there.
        """
        effort = (self.whole or self).observations.columns.get(f"joint.{joint}.effort")
        if effort is not None and np.isfinite(effort).all() and np.min(effort) < 0.0 < np.max(effort):
            return -np.asarray(self.observations.columns[f"joint.{joint}.effort"])
        torque = self.motion_torque()
        return None if torque is None else -torque[:, self.joint_index(joint)]

    @once
    def response(self, joint: str) -> float | None:
        """Return the time constant by a given simulation and command: c - s = T ds/dt, where that is nearly all of it."""
        name, place = f"joint.{joint}.command", self.channel_of(joint)
        command = (self.whole or self).observations.columns.get(name)
        if self.observations.simulation is None or command is None or place is None or len(command) != len(self):
            return None
        rate, ahead = self.simulated_rate[:, place], command - self.simulated[:, place]
        known = np.isfinite(rate) & np.isfinite(ahead)
        rate, ahead = rate[known], ahead[known] - np.mean(ahead[known])
        if not len(rate) or not np.any(rate) or not np.any(ahead):
            return None
        constant = float(rate @ ahead / (rate @ rate))
        left = float(np.sum((ahead - constant * rate) ** 2) / np.sum(ahead**2))
        return constant if constant > 0.0 and left < FOLLOWS else None

    @once
    def motion_torque(self) -> Array | None:
        """Return efforts (N, n) that weight and motion need; None without a URDF."""
        robot = self._urdf()
        return None if robot is None else np.asarray(robot.inverse_dynamics(self.q, *self.rates))

    @once
    def inertia_load(self, joint: str) -> Array | None:
        """Return the load (N,) of motion alone, N or N m, weight left out, as where it is balanced; None without a URDF."""
        weight, torque = self._weights(), self.motion_torque()
        if weight is None or torque is None:
            return None
        return np.asarray((-torque - weight)[:, self.joint_index(joint)])

    def weight_load(self, joint: str) -> Array | None:
        """Return the load (N,) of weight alone, N or N m; None without a URDF."""
        weight = self._weights()
        return None if weight is None else np.asarray(weight[:, self.joint_index(joint)])

    @once
    def _weights(self) -> Array | None:
        """Return the loads (N, n) of all joints where the arm stands still."""
        robot = self._urdf()
        if robot is None:
            return None
        return -np.asarray(robot.inverse_dynamics(self.q, *(np.zeros_like(self.q) for _ in range(2))))

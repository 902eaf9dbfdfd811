"""The wrench of a force/torque sensor: what hangs on it, in the sensor frame."""

from dataclasses import replace
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from galen_hw.kinematics import Motion
from galen_hw.lazy import cached_property
from galen_hw.physics.observations import Observations
from galen_hw.physics.operators.stateful import Memory
from galen_hw.physics.rigid import Body, gravity_in_sensor, inertial_wrench, predicted_wrench, weight_map
from galen_hw.physics.scenes.base import Scene, once
from galen_hw.physics.scenes.imu import imu_ends, imu_motion, turn_rates
from galen_hw.physics.scenes.screws import axis_moves, axis_screws, exponential, joint_screws
from galen_hw.physics.scenes.sensitivity import Port
from galen_hw.physics.signals.recorded_band import recorded_band
from galen_hw.spatial import Array, rotation_exp, rotation_from_quaternion, skew, transform

WRENCH = tuple(f"wrench.{kind}.{axis}" for kind in ("force", "torque") for axis in "xyz")
ORIENTATION = tuple(f"sensor.orientation.{axis}" for axis in "xyzw")
MOMENT = 1e-3
"""s; what an arm does in it is second order to 1e-6, and rounding of its second difference is 1e-10 of its reach."""
SMALL = 1e-4
"""rad or m."""


class WrenchScene(Scene):
    """Compared: wrench.force and wrench.torque (N, 6)."""

    channels = WRENCH
    units = ("N",) * 3 + ("N m",) * 3

    @cached_property
    def T(self) -> Array:
        """(N, 4, 4) sensor pose in the base; without joints the origin is left at zero."""
        robot = self.belief.robot
        if robot is not None and np.isfinite(self.q).all():
            return self._seated(robot.sensor_pose(self.q))
        return self._seated(transform(rotation_from_quaternion(self.observations.matrix(*ORIENTATION)), np.zeros(3)))

    def _seated(self, T: Array) -> Array:
        """Return poses (N, 4, 4) of the sensor as it is turned on its link."""
        turn = self.belief.sensor_turn
        if np.array_equal(turn, np.eye(3)):
            return T
        T = T.copy()
        T[:, :3, :3] = T[:, :3, :3] @ turn
        return T

    @cached_property
    def heard(self) -> float | None:
        """Frequency (Hz) up to which somebody's filter let the wrench through, by the longest segment."""
        if not self.clock or self.memory is not None or self.whole is not None:
            return None
        longest = max(self.segments, key=lambda part: part.stop - part.start)
        step = float(np.median(np.diff(self.time[longest]))) if longest.stop - longest.start > 1 else 0.0
        if not step > 0.0:
            return None
        return recorded_band(self.observations.matrix(*self.channels)[longest], step, self.units)

    @property
    def cut(self) -> float:
        """The frequency of `heard` in cycles a row."""
        return 0.0 if self.heard is None else self.heard * float(np.median(np.diff(self.time)))

    @property
    def grain(self) -> int:
        """Four rows a cycle of the cut-off."""
        return max(1, int(1.0 / (4.0 * self.cut))) if self.cut else 1

    @once
    def sensor_in(self, joint: str) -> Array:
        """Return the pose (N, 4, 4) of the sensor as seen from the link that a joint moves; from the base for ""."""
        robot = self.belief.robot
        if not joint or robot is None:
            return self.T
        link = robot.link_pose(self.q, joint)
        Rt, out = np.swapaxes(link[:, :3, :3], 1, 2), self.T.copy()
        out[:, :3, :3] = Rt @ self.T[:, :3, :3]
        out[:, :3, 3] = np.einsum("nij,nj->ni", Rt, self.T[:, :3, 3] - link[:, :3, 3])
        return out

    @property
    def R(self) -> Array:
        """(N, 3, 3) sensor to base."""
        return np.asarray(self.T[:, :3, :3])

    @property
    def _jointed(self) -> bool:
        return self.belief.robot is not None and bool(self.joint_names) and bool(np.isfinite(self.q).all())

    @cached_property
    def sensed(self) -> Motion | None:
        """Motion of the sensor as its IMU has it; None where joints say how it moves, or no IMU does."""
        return None if self._jointed else imu_motion(self.observations, self.T)

    @cached_property
    def motion(self) -> Motion:
        """Motion of the sensor: by the joints, else by its IMU; at rest without a clock or either."""
        robot, zeros = self.belief.robot, np.zeros((len(self), 3))
        if robot is None or not self._jointed:
            return self.sensed or Motion(self.T, zeros, zeros, zeros)
        return self._seated_motion(robot.sensor_motion(self.q, *self.rates))

    def _seated_motion(self, motion: Motion) -> Motion:
        """Return how the sensor moves as it is turned on its link: in base axes nothing but its orientation is another."""
        return replace(motion, T=self._seated(motion.T))

    @cached_property
    def ends(self) -> NDArray[np.bool_]:
        """(N,) rows at the segments' ends, where the speed and acceleration of what moves are not known."""
        found = super().ends
        return found if self.sensed is None or self._rates is not None else found | imu_ends(self.observations, self.R)

    def row(self, k: int, memory: Memory) -> Self:
        """Return row k by itself; how the sensor moves there, the whole recording's IMU says."""
        one, sensed, at = super().row(k, memory), self.sensed, slice(k, k + 1)
        if sensed is not None:
            one.sensed = Motion(sensed.T[at], sensed.acceleration[at], sensed.omega[at], sensed.alpha[at])
        return one

    def _otherwise(self, **values: Any) -> Self:
        return super()._otherwise(**{"sensed": self.sensed, "heard": self.heard} | values)

    def _simulate(self) -> Array:
        b = self.belief
        static = predicted_wrench(
            self.R, b.tool, bias_body=b.bias_body, zeroed_rotation=b.zeroed_rotation, gravity=b.gravity
        )
        static = static + gravity_in_sensor(self.R, b.gravity) @ weight_map(*b.distal).T
        return static + self._inertia if b.dynamic else static

    def _uses_rates(self) -> bool:
        return self.belief.dynamic and bool(self.belief.tool.mass or self.belief.distal) and self._jointed

    @cached_property
    def _inertia(self) -> Array:
        return inertial_wrench(self.motion, *self.belief.hanging)

    @once
    def inertial_port(self) -> Array | None:
        """Return what acceleration adds."""
        return None if self.belief.dynamic or not np.any(self._inertia) else self._inertia

    @once
    def turn_port(self) -> Array | None:
        """Return the bodies' weight under -(alpha x + omega x omega x) r."""
        if self._jointed or not self.clock or self.memory is not None or not np.isfinite(self.R).all():
            return None
        rates = (self.sensed.omega, self.sensed.alpha) if self.sensed else turn_rates(self.time, self.R, self.segments)
        w, alpha = (np.einsum("nji,nj->ni", self.R, v) for v in rates)
        port = -np.einsum("ci,nij->ncj", self.weight, skew(alpha) + skew(w) @ skew(w))
        return port if np.any(port) else None

    @cached_property
    def weight(self) -> Array:
        """(6, 3): reading at rest per gravity in the sensor frame."""
        return weight_map(*self.belief.hanging)

    @once
    def gravity_port(self) -> Array | None:
        """Return R^T on gravity, less the same at the zeroing pose for the bias body."""
        port = self.weight @ np.swapaxes(self.R, 1, 2)
        zeroed, body = self.belief.zeroed_rotation, self.belief.bias_body
        if zeroed is not None and body is not None:
            port = port - weight_map(body) @ zeroed.T
        return np.asarray(port)

    @once
    def body_port(self) -> Array | None:
        """Return Newton and Euler, linear in m, m c and the inertia about the sensor's origin."""
        Rt = np.swapaxes(self.R, 1, 2)
        a, w, alpha = (
            np.einsum("nij,nj->ni", Rt, v) for v in (self.motion.acceleration, self.motion.omega, self.motion.alpha)
        )
        s = gravity_in_sensor(self.R, self.belief.gravity) - a
        out = np.zeros((len(self), 6, 10))
        out[:, :3, 0] = s
        out[:, :3, 1:4] = -skew(alpha) - skew(w) @ skew(w)
        out[:, 3:, 1:4] = -skew(s)
        out[:, 3:, 4:] = -_inertia_map(alpha) - skew(w) @ _inertia_map(w)
        return out

    @once
    def weight_port(self) -> Array | None:
        """Return Newton and Euler at rest: R^T g and its moment."""
        s = gravity_in_sensor(self.R, self.belief.gravity)
        out = np.zeros((len(self), 6, 10))
        out[:, :3, 0], out[:, 3:, 1:4] = s, -skew(s)
        return out

    @cached_property
    def zeroing(self) -> "WrenchScene | None":
        """The bias body at the joints' reading at which the sensor was zeroed: an arm that is wrong was wrong there too."""
        if self.whole is not None:
            return self.whole.zeroing
        if self.memory is None:
            return self._zeroing()
        if "zeroing" not in self.memory:  # row by row it stays what it is
            self.memory["zeroing"] = self._zeroing()
        found: WrenchScene | None = self.memory["zeroing"]
        return found

    def _zeroing(self) -> "WrenchScene | None":
        b = self.belief
        if b.robot is None or b.zeroed_joints is None or b.bias_body is None or not b.bias_body.mass:
            return None
        stood = zip(b.robot.joint_names, b.zeroed_joints, strict=True)
        columns = {f"joint.{name}.position": np.array([q]) for name, q in stood}
        belief = replace(b, tool=Body(), distal=(), zeroed_rotation=None, zeroed_joints=None, dynamic=False, terms=())
        return WrenchScene(Observations("wrench", columns, None, belief))

    def with_body(self, body: Array) -> Self | None:
        """Return the scene with another tool."""
        tool = self.belief.tool.with_parameters(body)
        return None if tool is None else self._otherwise(belief=replace(self.belief, tool=tool))

    def standing_at(self, joint: str, *, offset: float = 0.0, scale: float = 0.0) -> Self | None:
        """Return the scene whose joint stood otherwise at the zeroing too."""
        if self.belief.robot is None or joint not in self.joint_names or not np.isfinite(self.q).all():
            return None
        q, *rates = self._stretched(joint, offset, scale)
        belief, zero = self.belief, self.zeroing
        zero = None if zero is None else zero.standing_at(joint, offset=offset, scale=scale)
        if zero is not None:
            belief = replace(belief, zeroed_rotation=zero.R[0], zeroed_joints=zero.q[0])
        return self._otherwise(q=q, rates=tuple(rates), belief=belief, zeroing=zero)

    def under(self, gravity: Array) -> Self | None:
        """Return the scene with another gravity of all bodies, the one that was zeroed away included."""
        zero = None if self.zeroing is None else self.zeroing.under(gravity)
        return self._otherwise(belief=replace(self.belief, gravity=gravity), zeroing=zero)

    @once
    def joint_port(self, joint: str) -> Array | None:
        """Return the answer of a sensor turned about the joint's axis."""
        screws = joint_screws(self, joint)
        return None if screws is None else self._turned(screws[:, 3:])

    def misread(self, joint: str, *, offset: float = 0.0, scale: float = 0.0) -> Array | None:
        """Return weight and, where the baseline has it, inertia of the bodies in another pose and motion of the arm."""
        robot = self.belief.robot
        if robot is None or joint not in self.joint_names or not np.isfinite(self.q).all():
            return None
        q, dq, ddq = self._stretched(joint, offset, scale)
        if self.belief.dynamic:
            return self._moving(self._seated_motion(robot.sensor_motion(q, dq, ddq)))
        zeros = np.zeros((len(q), 3))
        return self._moving(Motion(self._seated(robot.sensor_pose(q)), zeros, zeros, zeros))

    def reseated(self, turn: Array) -> Array:
        """Return the exact change (N, 6) if the sensor is turned on its flange by a rotation vector (3,) in its own axes."""
        T = self.T.copy()
        T[:, :3, :3] = self.R @ rotation_exp(turn)
        return self._moving(Motion(T, self.motion.acceleration, self.motion.omega, self.motion.alpha))

    def _moving(self, motion: Motion) -> Array:
        """Return the change (N, 6) of the reading if the sensor moved otherwise."""
        gravity = self.belief.gravity
        turned = gravity_in_sensor(motion.T[:, :3, :3], gravity) - gravity_in_sensor(self.R, gravity)
        more = inertial_wrench(motion, *self.belief.hanging) - self._inertia if self.belief.dynamic else 0.0
        return np.asarray(turned @ self.weight.T + more)

    def _turned(self, phi: Array) -> Array:
        """Return the change (N, 6) of the reading for a small rotation phi (N, 3) of the sensor, base coordinates."""
        turned = np.cross(np.broadcast_to(self.belief.gravity, phi.shape), phi)
        return np.asarray(np.einsum("nji,nj->ni", self.R, turned) @ self.weight.T)

    def screw_port(self, screws: list[Array]) -> Array | None:
        """Return the exact answer, gravity alone: s' = R^T Q^T g."""
        g = np.broadcast_to(self.belief.gravity, (len(self), 3))
        turned = g
        for screw in screws:
            turned = np.einsum("nji,nj->ni", rotation_exp(screw[:, 3:]), turned)
        return np.asarray(np.einsum("nji,nj->ni", self.R, turned - g) @ self.weight.T)

    @cached_property
    def along(self) -> "tuple[Self, Self] | None":
        """The arm `MOMENT` earlier and later on its way, for what its motion adds; None where the baseline has weight alone."""
        if not self._uses_rates():
            return None
        dq, ddq = self.rates
        earlier, later = (
            self._otherwise(q=self.q + sign * MOMENT * dq + 0.5 * MOMENT**2 * ddq) for sign in (-1.0, 1.0)
        )
        return earlier, later

    @once
    def swept_port(self, joint: str, error: str) -> Array | None:
        """Return the central difference of the tool's inertia on an arm whose axes are elsewhere."""
        if self.along is None:
            return None
        earlier, later = self.along
        ends = []
        for amount in (SMALL, -SMALL):
            moves = [axis_moves(at, joint, {error: amount}) for at in (earlier, self, later)]
            ends.append(inertial_wrench(self._passing(*moves), *self.belief.hanging))
        return np.asarray((ends[0] - ends[1]) / (2.0 * SMALL))

    def _passing(self, *screws: list[Array]) -> Motion:
        """Return how the moved sensor moves: by where it is and was and will be (central differences of its path)."""
        assert self.along is not None, "asked only where there is a way"
        ends = (self.along[0], self, self.along[1])
        was, now, then = (_displaced(moves, at.T) for moves, at in zip(screws, ends, strict=True))
        back, on = (_between(now, other) / MOMENT for other in (was, then))
        acceleration = (was[:, :3, 3] - 2.0 * now[:, :3, 3] + then[:, :3, 3]) / MOMENT**2
        return Motion(now, acceleration, 0.5 * (on - back), (on + back) / MOMENT)

    @once
    def geometry_ports(self) -> list[Port]:
        """Return axes that do not point where the model says."""
        tilts = [found for found in axis_screws(self) if "tilt." in found[0]]
        return [
            Port(name, "rad", self._turned(np.sum([s[:, 3:] for s in screws], axis=0)), joint)
            for name, joint, screws in tilts
        ]

    @once
    def load(self, joint: str) -> Array | None:
        """Return the torque of the known weights about the joint."""
        screws = joint_screws(self, joint)
        if screws is None:
            return None
        at_sensor = self.simulated
        force = np.einsum("nij,nj->ni", self.R, at_sensor[:, :3])
        torque = np.einsum("nij,nj->ni", self.R, at_sensor[:, 3:]) + np.cross(self.T[:, :3, 3], force)
        return np.asarray(np.sum(screws[:, :3] * force + screws[:, 3:] * torque, axis=1))


def _displaced(screws: list[Array], T: Array) -> Array:
    """Return poses (N, 4, 4) moved by screws (N, 6) applied one after the other, the last one first."""
    for screw in reversed(screws):
        T = exponential(screw) @ T
    return T


def _between(T: Array, other: Array) -> Array:
    """Return the rotation vector (N, 3), in base axes, of a small turn from one pose to the other."""
    turn = other[:, :3, :3] @ np.swapaxes(T[:, :3, :3], 1, 2)
    return 0.5 * np.stack(
        [turn[:, 2, 1] - turn[:, 1, 2], turn[:, 0, 2] - turn[:, 2, 0], turn[:, 1, 0] - turn[:, 0, 1]], 1
    )


def _inertia_map(w: Array) -> Array:
    """Return L(w) (N, 3, 6) with I w = L [xx xy yy xz yz zz]."""
    out = np.zeros((len(w), 3, 6))
    x, y, z = w.T
    out[:, 0, 0], out[:, 0, 1], out[:, 0, 3] = x, y, z
    out[:, 1, 1], out[:, 1, 2], out[:, 1, 4] = x, y, z
    out[:, 2, 3], out[:, 2, 4], out[:, 2, 5] = x, y, z
    return out

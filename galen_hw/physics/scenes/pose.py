"""The tracked pose of the tool tip, and tracked points whose registration nobody knows."""

from typing import Any

import numpy as np

from galen_hw.errors import UsageError
from galen_hw.kinematics.dynamics import UrdfRobot
from galen_hw.lazy import cached_property
from galen_hw.physics.scenes.base import Scene, once
from galen_hw.physics.scenes.regressed_jacobian import jacobian
from galen_hw.physics.scenes.screws import axis_screws, exponential, joint_screws
from galen_hw.physics.scenes.sensitivity import Carried, Port
from galen_hw.spatial import Array, rotation_from_quaternion, rotation_log

POSITION = tuple(f"pose.position.{axis}" for axis in "xyz")
ORIENTATION = tuple(f"pose.orientation.{axis}" for axis in "xyz")
QUATERNION = (*ORIENTATION, "pose.orientation.w")
APPLIED = tuple(f"applied.force.{axis}" for axis in "xyz")


SLIPS = tuple((f"{what}_{axis}", unit) for what, unit in (("shift", "m"), ("turn", "rad")) for axis in "xyz")
"""Moves of what the arm carries, and their units."""


class ArmScene(Scene):
    """What pose and targets share: a robot, the tip, loads on it and motions of the distal part."""

    @cached_property
    def T_sensor(self) -> Array:
        """(N, 4, 4) rigid sensor pose in the base.

        Raises:
            UsageError: no robot is named.
        """
        if self.belief.robot is None:
            raise UsageError(
                "a pose cannot be simulated without a robot", where="recording.json: robot", todo="name it"
            )
        return self.belief.robot.sensor_pose(self.q)

    @cached_property
    def tip(self) -> Array:
        """(N, 3) rigid tip in the base."""
        return np.asarray(self.T_sensor[:, :3, 3] + self.T_sensor[:, :3, :3] @ self.belief.tip)

    @cached_property
    def force(self) -> Array:
        """(N, 3) known force on the tip in the base, N; zeros where none was recorded."""
        return np.nan_to_num(self.observations.matrix(*APPLIED))

    def torque_from(self, joint: str, force: Array, point: Array) -> Array:
        """Return the torque (N,) about a joint (or force along it) of a force (N, 3) at a point (N, 3)."""
        screws = joint_screws(self, joint)
        assert screws is not None, "arm scenes have a robot"
        return np.asarray(np.sum(screws[:, :3] * force + screws[:, 3:] * np.cross(point, force), axis=1))

    @cached_property
    def weight(self) -> Array:
        """Weight (3,) of what hangs on the arm, base frame, N."""
        return np.asarray(sum(body.mass for body in self.belief.hanging) * self.belief.gravity)

    def weight_load(self, joint: str) -> Array:
        """Return the load (N,) of the joint by the weight of what hangs on the arm."""
        out = np.zeros(len(self))
        for body in self.belief.hanging:
            com = self.T_sensor[:, :3, 3] + self.T_sensor[:, :3, :3] @ body.com
            out += self.torque_from(joint, np.broadcast_to(body.mass * self.belief.gravity, com.shape), com)
        return out

    @once
    def own_load(self, joint: str) -> Array | None:
        """Return the load (N,) of the joint by its links and what hangs on it, N m or N; None: no link has a mass."""
        weights = self._link_loads
        robot = self.belief.robot
        if weights is None or robot is None or joint not in robot.joint_names:
            return None
        return np.asarray(weights[:, robot.joint_names.index(joint)] + self.weight_load(joint))

    @cached_property
    def _link_loads(self) -> Array | None:
        """(N, J) loads of the robot's joints by the weight of its links: what holds them up, with the other sign."""
        robot = self.belief.robot
        if not isinstance(robot, UrdfRobot):
            return None
        still = np.zeros_like(self.q)
        loads = -robot.under(self.belief.gravity).inverse_dynamics(self.q, still, still)
        return loads if np.ptp(loads) > 0.0 else None

    @cached_property
    def base_moment(self) -> Array | None:
        """(N, 3) moment of all weights and of the applied force about the base's origin, N m; None: no link has a mass."""
        robot = self.belief.robot
        links = robot.first_moment(self.q) if isinstance(robot, UrdfRobot) and self._link_loads is not None else None
        if links is None:
            return None
        for body in self.belief.hanging:
            links = links + body.mass * (self.T_sensor[:, :3, 3] + self.T_sensor[:, :3, :3] @ body.com)
        return np.asarray(np.cross(links, self.belief.gravity) + np.cross(self.tip, self.force))

    def base_ports(self) -> list[Array] | None:
        """Return the answers (N, C) to tilts of the base about its x and y in proportion to `base_moment`, per rad/(N m)."""
        moment = self.base_moment
        if moment is None or not np.ptp(moment) > 0.0:
            return None
        return [self._answer(np.concatenate([np.zeros_like(moment), moment * axis], axis=1)) for axis in np.eye(3)[:2]]

    @once
    def load(self, joint: str) -> Array | None:
        """Return applied force and weight together."""
        if self.belief.robot is None:
            return None
        total = self.torque_from(joint, self.force, self.tip) + self.weight_load(joint)
        bears = np.ptp(total) > 0.0 if self.whole is None else self.whole.load(joint) is not None
        return total if bears else None

    @cached_property
    def bent(self) -> Array:
        """(N, 6) screw of the give that the baseline already holds, its loads as in `load`."""
        out = np.zeros((len(self), 6))
        for joint, compliance in self.belief.compliance.items():
            load, screws = self.load(joint), joint_screws(self, joint)
            if load is not None and screws is not None:
                out += compliance * load[:, None] * screws
        return out

    def _answer(self, screw: Array) -> Array:
        raise AssertionError("given by the subclasses")

    @once
    def joint_port(self, joint: str) -> Array | None:
        """Return the answer of the distal part moved by the joint; without a robot as a given simulation shows it."""
        screws = joint_screws(self, joint)
        if screws is not None:
            return self._answer(screws)
        return (
            None if self._jacobian is None or joint not in self.moved else self._jacobian[:, :, self.moved.index(joint)]
        )

    @cached_property
    def _jacobian(self) -> Array | None:
        """(N, C, J) Jacobian of a given simulation by the joints that move, where no robot tells them; of positions alone."""
        if self.belief.robot is not None or self.observations.simulation is None or not self.moved:
            return None
        if not all("position" in name for name in self.channels):
            return None
        missed = np.nanstd(self.residual, axis=0)
        return jacobian(self.q[:, [self.joint_index(name) for name in self.moved]], self.simulated, missed)

    @once
    def geometry_ports(self) -> list[Port]:
        """Return the errors of links and axes; metres for shifts and lengths, rad for tilts."""
        return [
            Port(name, "rad" if "tilt." in name else "m", self._answer(sum(screws)), joint)  # type: ignore[arg-type]
            for name, joint, screws in axis_screws(self)
        ]


class PoseScene(ArmScene):
    """Compared: position of the tip (m) and, where tracked, orientation as a rotation vector from the simulated one (rad).

    Of a motion that vector stands on how far the simulated orientation has turned since the segment began, about each axis of
    the base: what is late is late in that too.
    """

    @property
    def channels(self) -> tuple[str, ...]:  # type: ignore[override]
        """Orientation only where it was measured."""
        columns = self.observations.columns
        return (*POSITION, *ORIENTATION) if all(name in columns for name in QUATERNION) else POSITION

    @property
    def units(self) -> tuple[str, ...]:  # type: ignore[override]
        """Metres and radians."""
        return ("m",) * 3 + ("rad",) * (len(self.channels) - 3)

    @property
    def turned(self) -> tuple[str, ...]:
        """The orientation."""
        return self.channels[3:]

    @cached_property
    def measured(self) -> Array:
        """Position, and the rotation vector from simulated to measured orientation, on how far that has turned."""
        position = self.observations.matrix(*POSITION)
        if len(self.channels) == 3:
            return position
        R = rotation_from_quaternion(self.observations.matrix(*QUATERNION))
        off = rotation_log(R @ np.swapaxes(self._pose[:, :3, :3], 1, 2))
        return np.concatenate([position, self.simulated[:, 3:] + off], axis=1)

    @property
    def raw_residual(self) -> Array:
        """(N, C) recorded minus simulated; nothing is filtered here, and an orientation is no difference of columns."""
        return self.residual

    @cached_property
    def _pose(self) -> Array:
        """(N, 4, 4) simulated tip: someone else's, or rigid with the baseline's give."""
        given = self.observations.simulation
        T = self.T_sensor.copy() if self.belief.robot is not None else np.tile(np.eye(4), (len(self), 1, 1))
        if given is not None:
            T[:, :3, 3] = np.stack([given[name] for name in POSITION], axis=-1)
            if all(name in given for name in QUATERNION):
                T[:, :3, :3] = rotation_from_quaternion(np.stack([given[name] for name in QUATERNION], axis=-1))
            return T
        T[:, :3, :3], T[:, :3, 3] = T[:, :3, :3] @ self.belief.tip_rotation, self.tip
        return np.asarray(exponential(self.bent) @ T)

    @cached_property
    def simulated(self) -> Array:
        """Position, and how far the orientation has turned since the segment began; of poses without a clock zeros."""
        position, R = self._pose[:, :3, 3], self._pose[:, :3, :3]
        if len(self.channels) == 3:
            return position

        def run(part: slice, state: Any) -> tuple[Array, tuple[Array, Array]]:
            last, far = (R[part][0], np.zeros(3)) if state is None else state
            steps = rotation_log(R[part] @ np.swapaxes(np.concatenate([last[None], R[part][:-1]]), 1, 2))
            out = far + np.cumsum(steps, axis=0)
            return out, (R[part][-1], out[-1])

        turned = self._carried("turned", np.zeros((len(self), 3)), run) if self.clock else np.zeros((len(self), 3))
        return np.concatenate([position, turned], axis=1)

    def _answer(self, screw: Array) -> Array:
        move = screw[:, :3] + np.cross(screw[:, 3:], self.simulated[:, :3])
        return np.concatenate([move, screw[:, 3:]], axis=1)[:, : len(self.channels)]

    @once
    def slipping(self) -> list[Carried]:
        """Return the tool in its holder: shifts and, where orientation is tracked, turns about the tip, in the tip's axes."""
        R, width = self._pose[:, :3, :3], len(self.channels)
        values = np.zeros((len(self), width, width))
        values[:, :3, :3] = R
        values[:, 3:, 3:] = R[:, : width - 3, : width - 3]
        return [Carried("tool", tuple(range(width)), SLIPS[:width], values)]

    def screw_port(self, screws: list[Array]) -> Array | None:
        """Return the exact answer, by the product of exponentials."""
        Q = np.tile(np.eye(4), (len(self), 1, 1))
        for screw in screws:
            Q = Q @ exponential(screw)
        p = self.simulated[:, :3]
        move = np.einsum("nij,nj->ni", Q[:, :3, :3], p) + Q[:, :3, 3] - p
        return np.concatenate([move, rotation_log(Q[:, :3, :3])], axis=1)[:, : len(self.channels)]


class TargetsScene(ArmScene):
    """Compared: tracked points (m) in a tracker frame that is registered here, with the points' places on the body."""

    @cached_property
    def channels(self) -> tuple[str, ...]:  # type: ignore[override]
        """target.N.position.x y z of every target."""
        return tuple(name for name in self.observations.columns if name.startswith("target."))

    @property
    def units(self) -> tuple[str, ...]:  # type: ignore[override]
        """Metres throughout."""
        return ("m",) * len(self.channels)

    @cached_property
    def registration(self) -> tuple[Array, Array, Array]:
        """R (3, 3), t (3,) base to tracker and points (K, 3) in the sensor frame, least squares by turns and screws.

        Raises:
            UsageError: no row shows all targets.
        """
        if self.whole is not None:
            return self.whole.registration
        T = exponential(self.bent) @ self.T_sensor
        y = self.measured.reshape(len(self), -1, 3)
        good = np.isfinite(y).all(axis=(1, 2))
        if not good.any():
            raise UsageError(
                f"no row shows all {y.shape[1]} targets",
                where="recording: target.N.position",
                todo="compare one at a time: leave the columns of the others out",
            )
        return register(T[good], y[good])

    @cached_property
    def _points(self) -> Array:
        """(N, K, 3) the targets in the base as simulated."""
        T, x = exponential(self.bent) @ self.T_sensor, self.registration[2]
        return np.asarray(np.einsum("nij,kj->nki", T[:, :3, :3], x) + T[:, None, :3, 3])

    @cached_property
    def simulated(self) -> Array:
        """The body's points seen from the registered tracker."""
        given = self.observations.simulation
        if given is not None:
            return np.stack([np.asarray(given[name]) for name in self.channels], axis=-1)
        R, t, _ = self.registration
        return np.asarray(self._points @ R.T + t).reshape(len(self), -1)

    def _answer(self, screw: Array) -> Array:
        move = screw[:, None, :3] + np.cross(screw[:, None, 3:], self._points)
        return np.asarray(move @ self.registration[0].T).reshape(len(self), -1)

    def screw_port(self, screws: list[Array]) -> Array | None:
        """Return the exact answer, by the product of exponentials."""
        Q = np.tile(np.eye(4), (len(self), 1, 1))
        for screw in screws:
            Q = Q @ exponential(screw)
        moved = self._points @ np.swapaxes(Q[:, :3, :3], 1, 2) + Q[:, None, :3, 3]
        return np.asarray((moved - self._points) @ self.registration[0].T).reshape(len(self), -1)

    def nuisances(self) -> list[Array]:
        """Return the tracker's frame (6) and each target's place on the body (3 each)."""
        if self.observations.simulation is not None:
            return []
        rows = (len(self), 1)
        out = [self._answer(np.tile(unit, rows)) for unit in np.eye(6)]
        for target in self._each():
            for axis in range(3):
                column = np.zeros((len(self), len(self.channels)))
                column[:, list(target.channels)] = target.values[:, :, axis]
                out.append(column)
        return out

    def _each(self) -> list[Carried]:
        """Return every target by itself, in the sensor's axes."""
        R = self.registration[0] @ self.T_sensor[:, :3, :3]
        names = [self.channels[3 * k].rsplit(".", 2)[0] for k in range(len(self.channels) // 3)]
        return [Carried(name, (3 * k, 3 * k + 1, 3 * k + 2), SLIPS[:3], R) for k, name in enumerate(names)]

    @once
    def slipping(self) -> list[Carried]:
        """Return every target by itself, the body that bears them all (shifts, and turns about their middle), and the tracker.

        A tracker, or a base, that shifts does so along its own axes, wherever the arm is.
        """
        if self.belief.robot is None:
            return []
        every = tuple(range(len(self.channels)))
        shifted = np.tile(np.eye(3), (len(self), len(every) // 3, 1))
        axes, middle = self.T_sensor[:, :3, :3], self._points.mean(axis=1)
        shifts = [np.concatenate([axes[:, :, i], np.zeros_like(middle)], axis=1) for i in range(3)]
        turns = [np.concatenate([np.cross(middle, axes[:, :, i]), axes[:, :, i]], axis=1) for i in range(3)]
        whole = np.stack([self._answer(screw) for screw in shifts + turns], axis=-1)
        return [*self._each(), Carried("targets", every, SLIPS, whole), Carried("tracker", every, SLIPS[:3], shifted)]


def register(T: Array, y: Array, turns: int = 60) -> tuple[Array, Array, Array]:
    """Return frame and body points with y_nk = R (T_n x_k) + t, least squares: R, t by Kabsch and x in closed form, by turns.

    Args:
        T: (N, 4, 4) body poses in the base; y: (N, K, 3) tracked points.
    """
    # Linear start: y = A (R_n x) + ... is bilinear; R from the relative rotations of the points' spread needs two points,
    # so several starts are tried and the best kept.
    best: tuple[float, Array, Array, Array] | None = None
    rng = np.random.default_rng(0)
    sample = np.unique(np.linspace(0, len(T) - 1, 300).astype(int))
    for start in range(12):
        R = np.eye(3) if start == 0 else np.linalg.qr(rng.normal(size=(3, 3)))[0]
        R = R if np.linalg.det(R) > 0 else R @ np.diag([1.0, 1.0, -1.0])
        found = _by_turns(T[sample], y[sample], R, turns)
        if best is None or found[0] < best[0]:
            best = found
    assert best is not None, "at least one start"
    return _by_turns(T, y, best[1], turns)[1:]


def _by_turns(T: Array, y: Array, R: Array, turns: int) -> tuple[float, Array, Array, Array]:
    Rb, pb = T[:, :3, :3], T[:, :3, 3]
    x = t = np.zeros(3)
    last = np.inf
    for _ in range(turns):
        # Points and translation for a given R: y R - p = Rb x + R^T t, linear.
        back = y @ R - pb[:, None]
        mean_Rt = Rb.mean(axis=0)
        m = back.mean(axis=(0, 1))
        A = np.eye(3) - mean_Rt.T @ mean_Rt
        rb = np.einsum("nji,nkj->ki", Rb, back) / len(T)
        x_mean = np.linalg.pinv(A, rcond=1e-9) @ (rb.mean(axis=0) - mean_Rt.T @ m)
        shift = m - mean_Rt @ x_mean
        x = rb - mean_Rt.T @ shift
        t = R @ shift
        points = np.einsum("nij,kj->nki", Rb, x) + pb[:, None]
        if not np.isfinite(points).all():
            # Of a body that never turns, points far enough away fit anything.
            return np.inf, R, t, np.asarray(x)
        U, _, Vt = np.linalg.svd(np.einsum("nki,nkj->ij", y - y.mean(axis=(0, 1)), points - points.mean(axis=(0, 1))))
        R = U @ np.diag([1.0, 1.0, np.sign(np.linalg.det(U @ Vt))]) @ Vt
        t = y.mean(axis=(0, 1)) - R @ points.mean(axis=(0, 1))
        error = float(np.sum((points @ R.T + t - y) ** 2))
        if last - error < 1e-9 * error:
            break
        last = error
    return error, R, t, np.asarray(x)

"""Robots: where the sensor is, how it moves, and what the rigid body says the joints must bear.

Arrays are batches: `q`, `dq`, `ddq` are (N, n) in the order of `joint_names`, rad or m and their rates.
"""

from collections.abc import Callable
from copy import copy
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from galen_hw.errors import UsageError
from galen_hw.spatial import Array, cross, rotation_about, transform
from galen_hw.units import STANDARD_GRAVITY

GALEN_JOINTS = ("carriage1", "carriage2", "carriage3", "roll", "tilt")
NOMINAL_GRAVITY = np.array([0.0, 0.0, -STANDARD_GRAVITY])


@dataclass(frozen=True, slots=True)
class Motion:
    """How a frame moves, in base coordinates and without gravity.

    Args:
        T: (N, 4, 4) pose in the base.
        acceleration: (N, 3) of the frame's origin, m/s^2.
        omega: (N, 3) rad/s; alpha: (N, 3) rad/s^2.
    """

    T: Array
    acceleration: Array
    omega: Array
    alpha: Array


@dataclass(frozen=True, slots=True)
class LinearDelta:
    """Three vertical carriages that carry a platform on rods of equal length, always parallel to the base.

    Source: `spec/galen-nominal`, carriage_i = z - sqrt(L^2 - (x - r cos a_i)^2 - (y - r sin a_i)^2) + sqrt(L^2 - r^2).

    Args:
        rod_length: L, m.
        radius: r, tower circle minus platform circle, m.
        azimuths: a_i of the towers from base x, rad.
    """

    rod_length: float = 0.400
    radius: float = 0.150
    azimuths: tuple[float, float, float] = (np.pi / 2, 7 * np.pi / 6, 11 * np.pi / 6)

    @property
    def _towers(self) -> Array:
        a = np.asarray(self.azimuths)
        return self.radius * np.stack([np.cos(a), np.sin(a)], axis=-1)

    @property
    def _home_height(self) -> float:
        return float(np.sqrt(self.rod_length**2 - self.radius**2))

    def carriages(self, platform: ArrayLike) -> Array:
        """Carriage positions (..., 3) in m of platform positions (..., 3) in m; NaN where a rod cannot reach."""
        p = np.asarray(platform, dtype=float)
        flat2 = np.sum((p[..., None, :2] - self._towers) ** 2, axis=-1)
        with np.errstate(invalid="ignore"):
            return np.asarray(p[..., 2:] - np.sqrt(self.rod_length**2 - flat2) + self._home_height)

    def platform(self, carriages: ArrayLike) -> Array:
        """Platform positions (..., 3) in m of carriages (..., 3) in m: the upper meeting point of three spheres.

        NaN where the rods do not meet.
        """
        c = np.asarray(carriages, dtype=float)
        centres = np.empty((*c.shape, 3))
        centres[..., :2], centres[..., 2] = self._towers, c - self._home_height
        e1, e2 = centres[..., 1, :] - centres[..., 0, :], centres[..., 2, :] - centres[..., 0, :]
        normal = cross(e1, e2)
        n2 = np.sum(normal**2, axis=-1, keepdims=True)
        # Circumcentre of the three carriages relative to the first; all three are at rod length from the platform.
        l1, l2 = np.sum(e1**2, axis=-1, keepdims=True), np.sum(e2**2, axis=-1, keepdims=True)
        centre = (l1 * cross(e2, normal) + l2 * cross(normal, e1)) / (2.0 * n2)
        with np.errstate(invalid="ignore"):
            height = np.sqrt((self.rod_length**2 - np.sum(centre**2, axis=-1, keepdims=True)) / n2)
        return np.asarray(centres[..., 0, :] + centre + np.sign(normal[..., 2:]) * height * normal)

    def _rods(self, platform: Array) -> Array:
        """Vectors (..., 3, 3) from each carriage's joint to the platform."""
        rods = np.empty((*platform.shape, 3))
        rods[..., :2] = platform[..., None, :2] - self._towers
        rods[..., 2] = np.sqrt(self.rod_length**2 - np.sum(rods[..., :2] ** 2, axis=-1))
        return rods

    def jacobian(self, platform: ArrayLike) -> Array:
        """Derivative of the platform by the carriages, (..., 3, 3), at platform positions (..., 3)."""
        rods = self._rods(np.asarray(platform, dtype=float))
        return np.asarray(np.linalg.inv(rods / rods[..., 2:]))

    def rates(self, platform: Array, d_carriages: Array, dd_carriages: Array) -> tuple[Array, Array]:
        """Velocity and acceleration (..., 3) of the platform, from |rod| = L differentiated twice."""
        rods = self._rods(platform)
        inv = np.linalg.inv(rods)
        velocity = (inv @ (rods[..., 2] * d_carriages)[..., None])[..., 0]
        relative = np.repeat(velocity[..., None, :], 3, axis=-2)
        relative[..., 2] -= d_carriages
        right = rods[..., 2] * dd_carriages - np.sum(relative**2, axis=-1)
        return velocity, (inv @ right[..., None])[..., 0]


class UrdfRobot:
    """A serial robot read from a URDF by pinocchio.

    Args:
        urdf: path of the file, or its text.
        sensor_link: link whose frame is the sensor's; the last link if None.
        base_link: link in which poses are given; the root if None.
        gravity: (3,) m/s^2 in the base frame.

    Raises:
        UsageError: the file cannot be read, or a link is not in it.
    """

    def __init__(
        self,
        urdf: Path | str,
        *,
        sensor_link: str | None = None,
        base_link: str | None = None,
        gravity: ArrayLike = NOMINAL_GRAVITY,
    ) -> None:
        self.model = _load(urdf)
        self.name: str = self.model.name
        self.joint_names: tuple[str, ...] = tuple(self.model.names)[1:]
        if self.model.nq != self.model.nv or self.model.nq != len(self.joint_names):
            raise UsageError(
                "only fixed, prismatic and revolute joints are read", where=self.name, todo="set limits on its joints"
            )
        self.lower: Array = np.array(self.model.lowerPositionLimit)
        self.upper: Array = np.array(self.model.upperPositionLimit)
        self._sensor = self._frame(sensor_link or self.model.frames[-1].name)
        self._base = self._frame(base_link) if base_link else 0
        self._data = self.model.createData()
        pin.framesForwardKinematics(self.model, self._data, np.zeros(self.model.nq))
        self._T_root_base = np.array(self._data.oMf[self._base].homogeneous)
        self._R_base_root: Array = self._T_root_base[:3, :3].T.copy()
        self.gravity: Array = np.asarray(gravity, dtype=float)
        self.model.gravity.linear = self._R_base_root.T @ self.gravity

    def _frame(self, link: str) -> int:
        if not self.model.existFrame(link):
            known = ", ".join(f.name for f in self.model.frames if f.type == pin.FrameType.BODY)
            raise UsageError(f"no link {link!r}", where=self.name, todo=f"one of: {known}")
        return int(self.model.getFrameId(link))

    def _scratch(self, rows: Array) -> pin.Data:
        """Pinocchio's working memory: every batch has its own, so that threads may ask at once; live rows share one."""
        return self._data if len(rows) == 1 else self.model.createData()

    @property
    def chain(self) -> tuple[tuple[str, ...], ...]:
        """Joints that carry the sensor, the base's first, one a link."""
        carried = self.model.supports[self.model.frames[self._sensor].parentJoint]
        return tuple((self.model.names[i],) for i in carried if i > 0)

    def _moved_by(self, joint: str) -> int:
        """Frame of the link that a joint moves, at the joint."""
        return int(self.model.getFrameId(joint, pin.FrameType.JOINT))

    def frame_pose(self, q: ArrayLike, link: str | None = None) -> Array:
        """Pose (N, 4, 4) of `link` (the sensor if None) in the base."""
        return self._pose(q, self._sensor if link is None else self._frame(link))

    def link_pose(self, q: ArrayLike, joint: str) -> Array:
        """Pose (N, 4, 4) in the base of the link that a joint moves, at the joint."""
        return self._pose(q, self._moved_by(joint))

    def _pose(self, q: ArrayLike, frame: int) -> Array:
        q = _batch(q)
        data = self._scratch(q)
        inv_base = np.linalg.inv(self._T_root_base)

        def one(qi: Array) -> Array:
            pin.forwardKinematics(self.model, data, qi)
            return np.asarray(pin.updateFramePlacement(self.model, data, frame).homogeneous)

        return np.asarray(inv_base @ _rows(one, (4, 4), q))

    def sensor_pose(self, q: ArrayLike) -> Array:
        """Pose (N, 4, 4) of the sensor in the base."""
        return self.frame_pose(q)

    def sensor_jacobian(self, q: ArrayLike) -> Array:
        """Twist [v, w] of the sensor's origin per joint rate, (N, 6, n), in base coordinates."""
        return self._jacobian(q, self._sensor)

    def link_jacobian(self, q: ArrayLike, joint: str) -> Array:
        """The same of the link that a joint moves, at the joint."""
        return self._jacobian(q, self._moved_by(joint))

    def _jacobian(self, q: ArrayLike, frame: int) -> Array:
        q = _batch(q)
        data = self._scratch(q)
        blocks = np.kron(np.eye(2), self._R_base_root)

        def one(qi: Array) -> Array:
            J = pin.computeFrameJacobian(self.model, data, qi, frame, pin.ReferenceFrame.LOCAL_WORLD_ALIGNED)
            return np.asarray(J)

        return np.asarray(blocks @ _rows(one, (6, self.model.nv), q))

    def sensor_motion(self, q: ArrayLike, dq: ArrayLike, ddq: ArrayLike) -> Motion:
        """Pose, velocity and acceleration of the sensor, see `Motion`."""
        q, dq, ddq = _batch(q), _batch(dq), _batch(ddq)
        data = self._scratch(q)
        world = pin.ReferenceFrame.LOCAL_WORLD_ALIGNED

        def one(qi: Array, vi: Array, ai: Array) -> Array:
            pin.forwardKinematics(self.model, data, qi, vi, ai)
            pin.updateFramePlacement(self.model, data, self._sensor)
            v = pin.getFrameVelocity(self.model, data, self._sensor, world)
            a = pin.getFrameClassicalAcceleration(self.model, data, self._sensor, world)
            return np.concatenate([a.linear, v.angular, a.angular])

        rates = _rows(one, (9,), q, dq, ddq).reshape(-1, 3, 3) @ self._R_base_root.T
        return Motion(self.sensor_pose(q), rates[:, 0], rates[:, 1], rates[:, 2])

    def inverse_dynamics(self, q: ArrayLike, dq: ArrayLike, ddq: ArrayLike) -> Array:
        """Joint efforts (N, n), N m or N, that the rigid robot needs for this motion under gravity (RNEA)."""
        q, dq, ddq = _batch(q), _batch(dq), _batch(ddq)
        data = self._scratch(q)

        def one(qi: Array, vi: Array, ai: Array) -> Array:
            return np.asarray(pin.rnea(self.model, data, qi, vi, ai))

        return _rows(one, (self.model.nv,), q, dq, ddq)

    def with_load(self, body: ArrayLike) -> "UrdfRobot | None":
        """The same robot whose last link has inertial parameters (10,) more, as of `dynamics_regressor`; None: no body."""
        total = self.model.inertias[-1].toDynamicParameters() + np.asarray(body, dtype=float)
        if not total[0] > 0.0:
            return None
        other = self._of(pin.Model(self.model))
        other.model.inertias[len(self.model.inertias) - 1] = pin.Inertia.FromDynamicParameters(total)
        return other

    def carrying(self, mass: float, com: ArrayLike, inertia: ArrayLike) -> "UrdfRobot":
        """The same robot with one more body fixed to its sensor.

        Args:
            mass: kg; com: (3,) in the sensor frame, m; inertia: (3, 3) about the centre of mass, sensor axes, kg m^2.
        """
        other, frame = self._of(pin.Model(self.model)), self.model.frames[self._sensor]
        body = pin.Inertia(float(mass), np.asarray(com, dtype=float), np.asarray(inertia, dtype=float))
        other.model.appendBodyToJoint(frame.parentJoint, body, frame.placement)
        return other

    def link_body(self, link: str) -> tuple[float, Array, Array]:
        """Mass, kg, centre of mass (3,), m, and inertia about it (3, 3), kg m^2, of a link, in its own axes.

        Raises:
            UsageError: there is no such link.
        """
        frames = self.model.frames
        place = frames[self._frame(link)]
        own = frames[place.parentFrame].inertia
        if frames[place.parentFrame].type != pin.FrameType.FIXED_JOINT:
            # Pinocchio keeps it in the joint, with all links that are fixed to it.
            fixed = [f for f in frames if f.type == pin.FrameType.FIXED_JOINT and f.parentJoint == place.parentJoint]
            rest = self.model.inertias[place.parentJoint].toDynamicParameters()
            rest = rest - sum((f.placement.act(f.inertia).toDynamicParameters() for f in fixed), np.zeros(10))
            own = pin.Inertia.FromDynamicParameters(rest) if rest[0] > 1e-9 else pin.Inertia.Zero()
        return float(own.mass), np.array(own.lever), np.array(own.inertia)

    def under(self, gravity: ArrayLike) -> "UrdfRobot":
        """The same robot under another gravity (3,), m/s^2, in the axes of its root."""
        other = self._of(pin.Model(self.model))
        other.model.gravity.linear = np.asarray(gravity, dtype=float)
        return other

    def _of(self, model: pin.Model) -> "UrdfRobot":
        other = copy(self)
        vars(other).update(model=model, _data=model.createData())
        return other

    def dynamics_regressor(self, q: ArrayLike, dq: ArrayLike, ddq: ArrayLike) -> Array:
        """Joint efforts per inertial parameter, (N, n, 10 n), pinocchio's order m, m c, I about the joint."""
        q, dq, ddq = _batch(q), _batch(dq), _batch(ddq)
        data = self._scratch(q)

        def one(qi: Array, vi: Array, ai: Array) -> Array:
            return np.asarray(pin.computeJointTorqueRegressor(self.model, data, qi, vi, ai))

        return _rows(one, (self.model.nv, 10 * self.model.nv), q, dq, ddq)


@dataclass
class GalenRobot:
    """The Galen: linear delta, roll, tilt. Joints are carriage1, carriage2, carriage3, roll, tilt.

    Args:
        delta: geometry of the platform's drive.
        platform_to_roll: (3,) m; roll turns about x.
        roll_to_tilt: (3,) m in the roll frame; tilt turns about y.
        tilt_to_sensor: (3,) m in the tilt frame.
        gravity: (3,) m/s^2 in the base frame.
        lower, upper: (5,) joint limits, m and rad.
    """

    delta: LinearDelta = field(default_factory=LinearDelta)
    platform_to_roll: tuple[float, float, float] = (0.0, 0.0, 0.045)
    roll_to_tilt: tuple[float, float, float] = (0.210, 0.0, 0.035)
    tilt_to_sensor: tuple[float, float, float] = (0.055, 0.0, 0.0)
    gravity: Array = field(default_factory=NOMINAL_GRAVITY.copy)
    lower: Array = field(default_factory=lambda: np.array([-0.233, -0.272, -0.237, -1.57, -1.04]))
    upper: Array = field(default_factory=lambda: np.array([0.263, 0.241, 0.254, 1.57, 0.96]))
    name: str = "galen"
    joint_names: tuple[str, ...] = GALEN_JOINTS

    @property
    def chain(self) -> tuple[tuple[str, ...], ...]:
        """Joints that carry the sensor, the base's first; the carriages move one link together."""
        return (self.joint_names[:3], *((joint,) for joint in self.joint_names[3:]))

    def link_pose(self, q: ArrayLike, joint: str) -> Array:
        """Pose (N, 4, 4) in the base of the link that a joint moves, at the joint; of the platform for any carriage."""
        q = _batch(q)
        platform = self.delta.platform(q[:, :3])
        if joint not in self.joint_names[3:]:
            return transform(np.broadcast_to(np.eye(3), (len(q), 3, 3)), platform)
        Rr, p = rotation_about(0, q[:, 3]), platform + np.asarray(self.platform_to_roll)
        if joint == self.joint_names[3]:
            return transform(Rr, p)
        return transform(self.sensor_rotation(q), p + Rr @ np.asarray(self.roll_to_tilt))

    def sensor_rotation(self, q: ArrayLike) -> Array:
        """Sensor to base, R = Rx(roll) Ry(tilt), (N, 3, 3)."""
        q = _batch(q)
        return rotation_about(0, q[:, 3]) @ rotation_about(1, q[:, 4])

    def sensor_pose(self, q: ArrayLike) -> Array:
        """Pose (N, 4, 4) of the sensor in the base."""
        q = _batch(q)
        Rr, R = rotation_about(0, q[:, 3]), self.sensor_rotation(q)
        p = self.delta.platform(q[:, :3]) + np.asarray(self.platform_to_roll)
        return transform(R, p + Rr @ np.asarray(self.roll_to_tilt) + R @ np.asarray(self.tilt_to_sensor))

    def sensor_jacobian(self, q: ArrayLike) -> Array:
        """Twist [v, w] of the sensor's origin per joint rate, (N, 6, 5), in base coordinates."""
        q = _batch(q)
        Rr, R = rotation_about(0, q[:, 3]), self.sensor_rotation(q)
        from_tilt = R @ np.asarray(self.tilt_to_sensor)
        from_roll = Rr @ np.asarray(self.roll_to_tilt) + from_tilt
        roll_axis, tilt_axis = np.broadcast_to([1.0, 0.0, 0.0], from_tilt.shape), Rr[:, :, 1]
        J = np.zeros((len(q), 6, 5))
        J[:, :3, :3] = self.delta.jacobian(self.delta.platform(q[:, :3]))
        J[:, :3, 3], J[:, 3:, 3] = np.cross(roll_axis, from_roll), roll_axis
        J[:, :3, 4], J[:, 3:, 4] = np.cross(tilt_axis, from_tilt), tilt_axis
        return J

    def sensor_motion(self, q: ArrayLike, dq: ArrayLike, ddq: ArrayLike) -> Motion:
        """Pose, velocity and acceleration of the sensor, see `Motion`."""
        q, dq, ddq = _batch(q), _batch(dq), _batch(ddq)
        Rr, R = rotation_about(0, q[:, 3]), self.sensor_rotation(q)
        _, platform_acc = self.delta.rates(self.delta.platform(q[:, :3]), dq[:, :3], ddq[:, :3])
        roll_rate, roll_acc = dq[:, 3:4] * [1.0, 0.0, 0.0], ddq[:, 3:4] * [1.0, 0.0, 0.0]
        omega = roll_rate + dq[:, 4:5] * Rr[:, :, 1]
        alpha = roll_acc + ddq[:, 4:5] * Rr[:, :, 1] + np.cross(roll_rate, dq[:, 4:5] * Rr[:, :, 1])
        arm, end = Rr @ np.asarray(self.roll_to_tilt), R @ np.asarray(self.tilt_to_sensor)
        acc = platform_acc + np.cross(roll_acc, arm) + np.cross(roll_rate, np.cross(roll_rate, arm))
        acc += np.cross(alpha, end) + np.cross(omega, np.cross(omega, end))
        return Motion(self.sensor_pose(q), acc, omega, alpha)


Robot = GalenRobot | UrdfRobot
"""Either kind: both have joint_names, lower, upper, gravity, chain, link_pose, sensor_pose, sensor_jacobian and
sensor_motion."""


def _load(urdf: Path | str) -> pin.Model:
    text = str(urdf)
    if not text.lstrip().startswith("<") and not Path(text).is_file():
        raise UsageError("no such file", where=text, todo="check the path")
    try:
        return pin.buildModelFromXML(text) if text.lstrip().startswith("<") else pin.buildModelFromUrdf(text)
    except (ValueError, RuntimeError) as error:
        raise UsageError(f"not a readable URDF ({error})", where=text[:80], todo="check the file") from error


def _batch(q: ArrayLike) -> Array:
    return np.atleast_2d(np.asarray(q, dtype=float))


def _rows(one: Callable[..., Array], shape: tuple[int, ...], *inputs: Array) -> Array:
    """Apply pinocchio's one-sample functions row by row."""
    out = np.empty((len(inputs[0]), *shape))
    for i, row in enumerate(zip(*inputs, strict=True)):
        out[i] = np.reshape(one(*row), shape)  # pinocchio gives a vector for a matrix of one column
    return out

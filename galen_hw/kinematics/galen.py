"""The Galen: a linear delta, roll and tilt, in closed form."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike

from galen_hw.kinematics.delta import LinearDelta
from galen_hw.kinematics.motion import NOMINAL_GRAVITY, Motion, batch
from galen_hw.spatial import Array, rotation_about, transform

GALEN_JOINTS = ("carriage1", "carriage2", "carriage3", "roll", "tilt")


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
        q = batch(q)
        platform = self.delta.platform(q[:, :3])
        if joint not in self.joint_names[3:]:
            return transform(np.broadcast_to(np.eye(3), (len(q), 3, 3)), platform)
        Rr, p = rotation_about(0, q[:, 3]), platform + np.asarray(self.platform_to_roll)
        if joint == self.joint_names[3]:
            return transform(Rr, p)
        return transform(self.sensor_rotation(q), p + Rr @ np.asarray(self.roll_to_tilt))

    def sensor_rotation(self, q: ArrayLike) -> Array:
        """Sensor to base, R = Rx(roll) Ry(tilt), (N, 3, 3)."""
        q = batch(q)
        return rotation_about(0, q[:, 3]) @ rotation_about(1, q[:, 4])

    def sensor_pose(self, q: ArrayLike) -> Array:
        """Pose (N, 4, 4) of the sensor in the base."""
        q = batch(q)
        Rr, R = rotation_about(0, q[:, 3]), self.sensor_rotation(q)
        p = self.delta.platform(q[:, :3]) + np.asarray(self.platform_to_roll)
        return transform(R, p + Rr @ np.asarray(self.roll_to_tilt) + R @ np.asarray(self.tilt_to_sensor))

    def sensor_jacobian(self, q: ArrayLike) -> Array:
        """Twist [v, w] of the sensor's origin per joint rate, (N, 6, 5), in base coordinates."""
        q = batch(q)
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
        q, dq, ddq = batch(q), batch(dq), batch(ddq)
        Rr, R = rotation_about(0, q[:, 3]), self.sensor_rotation(q)
        _, platform_acc = self.delta.rates(self.delta.platform(q[:, :3]), dq[:, :3], ddq[:, :3])
        roll_rate, roll_acc = dq[:, 3:4] * [1.0, 0.0, 0.0], ddq[:, 3:4] * [1.0, 0.0, 0.0]
        omega = roll_rate + dq[:, 4:5] * Rr[:, :, 1]
        alpha = roll_acc + ddq[:, 4:5] * Rr[:, :, 1] + np.cross(roll_rate, dq[:, 4:5] * Rr[:, :, 1])
        arm, end = Rr @ np.asarray(self.roll_to_tilt), R @ np.asarray(self.tilt_to_sensor)
        acc = platform_acc + np.cross(roll_acc, arm) + np.cross(roll_rate, np.cross(roll_rate, arm))
        acc += np.cross(alpha, end) + np.cross(omega, np.cross(omega, end))
        return Motion(self.sensor_pose(q), acc, omega, alpha)

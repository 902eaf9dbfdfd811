"""The direction of gravity in the sensor for one joint vector, in plain floats: the hot path of the compensation.

numpy needs about 1 us a call for three numbers; here a Galen's direction takes about 2 us altogether.
"""

from collections.abc import Sequence
from math import cos, sin
from typing import TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from galen_hw.kinematics import Robot

Triple: TypeAlias = tuple[float, float, float]


class GravityDirection:
    """s = R(q)^T g for a serial chain, by the product of exponentials (Lynch and Park, Modern Robotics, 4.1).

    R(q) = exp(hat(w_1) q_1) ... exp(hat(w_n) q_n) R(0), where w_i is the angular part of the base Jacobian at q = 0,
    so that one formula serves the Galen and any URDF. Joints that do not turn the sensor are left out.

    Args:
        robot: with sensor_pose and sensor_jacobian.
        gravity: (3,) m/s^2 in the base; the robot's own if None.
    """

    def __init__(self, robot: Robot, gravity: ArrayLike | None = None) -> None:
        zero = np.zeros(len(robot.joint_names))
        g = robot.gravity if gravity is None else np.asarray(gravity, dtype=float)
        self._gravity: Triple = (float(g[0]), float(g[1]), float(g[2]))
        axes = robot.sensor_jacobian(zero)[0, 3:].T
        self.joints: tuple[int, ...] = tuple(int(i) for i in np.flatnonzero(np.linalg.norm(axes, axis=1) > 1e-9))
        """Indices of the joints that turn the sensor."""
        self._axes = tuple(tuple(float(x) for x in axes[i]) for i in self.joints)
        self._R0: tuple[float, ...] = tuple(float(x) for x in robot.sensor_pose(zero)[0, :3, :3].T.ravel())

    def __call__(self, turning: Sequence[float]) -> Triple:
        """Gravity in sensor axes, m/s^2.

        Args:
            turning: positions of the joints `joints`, in that order, rad; what follows them is not read.
        """
        x, y, z = self._gravity
        for (wx, wy, wz), angle in zip(self._axes, turning, strict=False):
            c, s = cos(angle), sin(angle)
            d = (wx * x + wy * y + wz * z) * (1.0 - c)
            # Rodrigues' formula for minus the angle.
            x, y, z = (
                x * c - (wy * z - wz * y) * s + wx * d,
                y * c - (wz * x - wx * z) * s + wy * d,
                z * c - (wx * y - wy * x) * s + wz * d,
            )
        a, b, c, d, e, f, g, h, i = self._R0
        return a * x + b * y + c * z, d * x + e * y + f * z, g * x + h * y + i * z

"""The wrench that rigid bodies hanging on the sensor make it read: weight, zeroing and inertia.

Convention (`docs/recording.md`): a body of weight vector w (base) with its centre of mass at c (sensor frame) makes a
sensor at rest read force R^T w and torque c x R^T w, R taking sensor coordinates to base. A wrench is [force, torque].
Everything is linear in s = R^T g, see `gravity_map` and `docs/compensation.md`.
"""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike

from galen_hw.kinematics import NOMINAL_GRAVITY, Motion
from galen_hw.spatial import Array, skew


@dataclass(frozen=True, slots=True)
class Body:
    """A rigid body that hangs on the sensor.

    Args:
        mass: kg.
        com: (3,) centre of mass in the sensor frame, m.
        inertia: (3, 3) about the centre of mass, sensor axes, kg m^2.
    """

    mass: float = 0.0
    com: Array = field(default_factory=lambda: np.zeros(3))
    inertia: Array = field(default_factory=lambda: np.zeros((3, 3)))

    def with_parameters(self, more: Array) -> "Body | None":
        """Return it with m, m c (3) and inertia xx xy yy xz yz zz about the sensor's origin added (10,); None if weightless."""
        mass = self.mass + float(more[0])
        if mass <= 0.0:
            return None
        com = np.asarray(self.mass * self.com + more[1:4]) / mass
        xx, xy, yy, xz, yz, zz = more[4:]
        about_origin = (
            self.inertia + self.mass * parallel_axis(self.com) + np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        )
        return Body(mass, com, about_origin - mass * parallel_axis(com))

    def seen_from(self, T: Array) -> "Body":
        """Return the body in the axes of a frame in which its own stand at T (4, 4)."""
        R = T[:3, :3]
        return Body(self.mass, R @ self.com + T[:3, 3], R @ self.inertia @ R.T)


def parallel_axis(c: Array) -> Array:
    """Return the inertia (3, 3) about the origin of unit mass at c."""
    return np.asarray(np.dot(c, c) * np.eye(3) - np.outer(c, c))


def gravity_in_sensor(R: ArrayLike, gravity: ArrayLike = NOMINAL_GRAVITY) -> Array:
    """Return gravity s = R^T g, (..., 3) m/s^2, of sensor orientations (..., 3, 3)."""
    return np.asarray(np.swapaxes(np.asarray(R, dtype=float), -1, -2) @ np.asarray(gravity, dtype=float))


def weight_map(*bodies: Body) -> Array:
    """Return W (6, 3) with wrench = W s: [m 1; hat(m c)], summed over the bodies."""
    W = np.zeros((6, 3))
    for body in bodies:
        W[:3] += body.mass * np.eye(3)
        W[3:] += skew(body.mass * np.asarray(body.com, dtype=float))
    return W


def gravity_map(
    tool: Body,
    *,
    bias_body: Body | None = None,
    zeroed_rotation: ArrayLike | None = None,
    offset: ArrayLike = (0.0,) * 6,
    gravity: ArrayLike = NOMINAL_GRAVITY,
) -> Array:
    """Return M (6, 4) with predicted wrench = M [s; 1] (report, equation 11, with a constant offset).

    Args:
        tool: what hangs on the sensor with its weight in the reading.
        bias_body: what hung on it already when it was zeroed.
        zeroed_rotation: (3, 3) orientation at which it was zeroed; None if never, the bias body then weighs in full.
        offset: (6,) constant bias of the sensor, N and N m.
        gravity: (3,) m/s^2 in the base.
    """
    bias_body = Body() if bias_body is None else bias_body
    constant = np.asarray(offset, dtype=float).copy()
    if zeroed_rotation is not None:
        constant -= weight_map(bias_body) @ gravity_in_sensor(zeroed_rotation, gravity)
    return np.column_stack([weight_map(tool, bias_body), constant])


def predicted_wrench(
    R: ArrayLike,
    tool: Body,
    *,
    bias_body: Body | None = None,
    zeroed_rotation: ArrayLike | None = None,
    offset: ArrayLike = (0.0,) * 6,
    gravity: ArrayLike = NOMINAL_GRAVITY,
) -> Array:
    """Return the wrench (N, 6) that the sensor reads at rest in orientations R (N, 3, 3); arguments as in `gravity_map`."""
    M = gravity_map(tool, bias_body=bias_body, zeroed_rotation=zeroed_rotation, offset=offset, gravity=gravity)
    return np.asarray(gravity_in_sensor(R, gravity) @ M[:, :3].T + M[:, 3])


def inertial_wrench(motion: Motion, *bodies: Body) -> Array:
    """Return the wrench (N, 6) that the bodies' acceleration adds to the reading (Newton and Euler, minus m a_c and so on).

    With a the sensor origin's acceleration, w and alpha its rates, all in the sensor frame:
    a_c = a + alpha x c + w x (w x c), force = -m a_c, torque = c x force - I alpha - w x (I w).
    """
    Rt = np.swapaxes(motion.T[:, :3, :3], -1, -2)
    a, w, alpha = ((Rt @ vector[:, :, None])[:, :, 0] for vector in (motion.acceleration, motion.omega, motion.alpha))
    out = np.zeros((len(a), 6))
    for body in bodies:
        c, inertia = np.asarray(body.com, dtype=float), np.asarray(body.inertia, dtype=float)
        force = -body.mass * (a + np.cross(alpha, c) + np.cross(w, np.cross(w, c)))
        out[:, :3] += force
        out[:, 3:] += np.cross(c, force) - alpha @ inertia.T - np.cross(w, w @ inertia.T)
    return out

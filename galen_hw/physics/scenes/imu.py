"""The motion of a sensor as an accelerometer and a gyroscope in its frame have it, for where no joints say how it moves."""

import numpy as np
from numpy.typing import NDArray

from galen_hw.kinematics import Motion
from galen_hw.physics.observations import Observations
from galen_hw.physics.rigid import gravity_in_sensor
from galen_hw.physics.signals.differentiation import denoised, derivatives, ends
from galen_hw.spatial import Array, continuous, quaternion_from_rotation

ACCELERATION = tuple(f"imu.acceleration.{axis}" for axis in "xyz")
ANGULAR_VELOCITY = tuple(f"imu.angular_velocity.{axis}" for axis in "xyz")


def imu_motion(observations: Observations, T: Array) -> Motion | None:
    """Return the motion of the sensor at poses T (N, 4, 4), from `imu.*`; None unless every row has acceleration and pose.

    The IMU sits at the sensor's origin. White noise is taken off by penalised splines where there is a clock. From what feels
    gravity, gravity is taken off as it is felt itself: what stays the same in the base, since an arm that swings to and fro has
    no acceleration on average. (With the believed gravity, a base that is tilted would look like an acceleration.) The angular
    velocity is the gyroscope's, else that of the orientation; its derivative, never over the border of a segment, is zero
    without a clock.
    """
    felt, turning = (observations.matrix(*names) for names in (ACCELERATION, ANGULAR_VELOCITY))
    if not len(felt) or not (np.isfinite(felt).all() and np.isfinite(T).all()):
        return None
    R, time, segments = T[:, :3, :3], observations.time, observations.segments
    gyroscope = bool(np.isfinite(turning).all())
    if time is None:
        omega = _in_base(R, turning) if gyroscope else np.zeros_like(felt)
        alpha = np.zeros_like(felt)
    elif gyroscope:
        omega = _in_base(R, denoised(time, turning, segments))
        alpha = _in_base(R, derivatives(time, turning, segments)[0])
    else:
        omega, alpha = turn_rates(time, R, segments)
    quiet = felt if time is None else denoised(time, felt, segments)
    acceleration = _in_base(R, quiet)
    if feels_gravity(felt, R, observations.belief.gravity):
        acceleration -= _mean(acceleration, segments)
    return Motion(T, acceleration, omega, alpha)


def feels_gravity(felt: Array, R: Array, gravity: Array) -> bool:
    """Return whether readings (N, 3) are nearer to R^T (-g), an accelerometer's at rest, than to none: some logs lack g."""
    return bool(np.mean((felt + gravity_in_sensor(R, gravity)) ** 2) < np.mean(felt**2))


def imu_ends(observations: Observations, R: Array) -> NDArray[np.bool_]:
    """Return which rows (N,) are so near an end of their segment that `imu_motion` has no derivatives; none without a clock."""
    time, turning = observations.time, observations.matrix(*ANGULAR_VELOCITY)
    if time is None:
        return np.zeros(len(R), dtype=bool)
    return ends(time, turning if np.isfinite(turning).all() else _continuous(R), observations.segments)


def turn_rates(time: Array, R: Array, segments: list[slice]) -> tuple[Array, Array]:
    """Return angular velocity and acceleration (N, 3) of orientations (N, 3, 3) over time (N,) in s, base coordinates.

    Of the unit quaternion q: the vectors of 2 dq/dt q* and 2 d2q/dt2 q*.
    """
    q = _continuous(R)
    first, second = derivatives(time, q, segments)
    return _turning(first, q), _turning(second, q)


def _continuous(R: Array) -> Array:
    """Return unit quaternions x y z w (N, 4) whose sign does not jump."""
    return continuous(quaternion_from_rotation(R))


def _turning(rate: Array, q: Array) -> Array:
    """Return the vector part (N, 3) of 2 p q* of quaternions x y z w (N, 4)."""
    p, v = rate[:, :3], q[:, :3]
    return np.asarray(2.0 * (p * q[:, 3:] - v * rate[:, 3:] - np.cross(p, v)))


def _in_base(R: Array, v: Array) -> Array:
    return np.asarray(np.einsum("nij,nj->ni", R, v))


def _mean(v: Array, segments: list[slice]) -> Array:
    """Return the mean (3,) of (N, 3) that fades at the ends of the segments, so that half a swing there counts little."""
    fade = np.concatenate([np.hanning(part.stop - part.start + 2)[1:-1] for part in segments])
    return np.asarray(fade @ v / fade.sum())

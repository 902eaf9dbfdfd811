"""The robot of a configuration."""

import hashlib

import numpy as np

from galen_hw.config.schema import Config, RobotSection
from galen_hw.errors import UsageError
from galen_hw.kinematics import GalenRobot, LinearDelta, Robot, UrdfRobot
from galen_hw.premises.model import sensor_problems


def build_robot(config: Config) -> Robot:
    """The Galen with the configured geometry, or the configured URDF with the joints that move the sensor in the base.

    Raises:
        UsageError: the URDF cannot be read, a link is not in it, or nobody says which of several ends the sensor's is.
    """
    robot = config.robot
    gravity = np.asarray(robot.gravity_m_per_s2)
    if robot.urdf is not None:
        whole = UrdfRobot(robot.urdf, sensor_link=robot.sensor_link, base_link=robot.base_link, gravity=gravity)
        for problem in sensor_problems(whole, named=robot.sensor_link is not None):
            if problem.severity == "refuse":
                raise UsageError(problem.what, where=problem.where, todo=problem.todo)
        return whole.keeping(whole.moving())
    return _galen(robot, gravity)


def _galen(robot: RobotSection, gravity: "np.ndarray[tuple[int, ...], np.dtype[np.float64]]") -> GalenRobot:
    delta = robot.delta
    return GalenRobot(
        delta=LinearDelta(delta.rod_length_m, delta.radius_m, delta.azimuths_rad),
        platform_to_roll=robot.platform_to_roll_m,
        roll_to_tilt=robot.roll_to_tilt_m,
        tilt_to_sensor=robot.tilt_to_sensor_m,
        gravity=gravity,
        lower=np.array([*robot.carriage_lower_m, robot.roll_limits_rad[0], robot.tilt_limits_rad[0]]),
        upper=np.array([*robot.carriage_upper_m, robot.roll_limits_rad[1], robot.tilt_limits_rad[1]]),
        name=robot.name,
    )


def identity(config: Config) -> str:
    """A short name of the configured hardware: what a service has learnt belongs to it."""
    drivers = ",".join(f"{name}={device.driver}" for name, device in sorted(config.devices.items()))
    digest = hashlib.sha256(f"{config.robot.model_dump_json()} {drivers}".encode()).hexdigest()
    return f"{config.robot.name}-{digest[:12]}"

"""Whether a set-up's robot and its motors are one machine."""

from galen_hw.config.load import Setup
from galen_hw.config.robot import build_robot
from galen_hw.daemon.layout import MOTORS
from galen_hw.errors import UsageError
from galen_hw.kinematics import Robot, UrdfRobot
from galen_hw.premises.model import ModelProblem, base_problems, missing_joints, model_problems


def motor_joints(setup: Setup) -> tuple[str, ...] | None:
    """Joints that the motors' settings name; None without motors, or where the driver names none."""
    device = setup.devices.get(MOTORS)
    axes = getattr(device.settings, "axes", None) if device is not None else None
    return None if axes is None else tuple(axis.joint for axis in axes)


def joint_problems(robot: Robot, setup: Setup) -> list[ModelProblem]:
    """Joints of the robot that no motor has: nothing that turns with them can be compensated."""
    having = motor_joints(setup)
    return [] if having is None else missing_joints(robot.joint_names, having, f"robot {setup.config.robot.name}")


def robot_notes(robot: Robot, setup: Setup) -> list[ModelProblem]:
    """What is odd about the model of a URDF."""
    if not isinstance(robot, UrdfRobot):
        return []
    named = setup.config.robot.sensor_link is not None
    return model_problems(robot, sensor_named=named) + base_problems(robot, robot.joint_names)


def must_fit(setup: Setup) -> None:
    """Refuse to run a robot whose joints nobody reads.

    Raises:
        UsageError: no motor has a joint that moves the sensor, or the robot cannot be built.
    """
    for problem in joint_problems(build_robot(setup.config), setup):
        raise UsageError(problem.what, where=f"{setup.path}: {problem.where}", todo=problem.todo)

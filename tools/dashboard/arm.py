"""Lines and points that show the arm, in the base frame, from the configured kinematics."""

from typing import Any

import numpy as np

from galen_hw.kinematics import GalenRobot, Robot
from galen_hw.messages import JointsState
from galen_hw.spatial import Array


def positions(robot: Robot, state: JointsState) -> Array | None:
    """(n,) in the robot's order; None where one is missing."""
    q = np.array([state.position.get(name, np.nan) for name in robot.joint_names])
    return q if np.isfinite(q).all() else None


def arm_lines(robot: Robot, q: Array) -> dict[str, Any]:
    """What to draw, in m: `lines` (each a list of points), `joints` and `sensor` (points), `rotation` of the sensor."""
    sensor = robot.sensor_pose(q)[0]
    joints = [robot.link_pose(q, names[0])[0, :3, 3] for names in robot.chain]
    lines = [_points([*joints, sensor[:3, 3]])]
    if isinstance(robot, GalenRobot):
        lines += _delta(robot, q, joints[0])
    else:
        lines[0].insert(0, [0.0, 0.0, 0.0])
    return {
        "lines": lines,
        "joints": _points(joints),
        "sensor": _points([sensor[:3, 3]])[0],
        "rotation": sensor[:3, :3].tolist(),
    }


def _delta(robot: GalenRobot, q: Array, platform: Array) -> list[list[list[float]]]:
    """The three rods, and the columns that the carriages run on."""
    azimuths = np.asarray(robot.delta.azimuths)
    xy = robot.delta.radius * np.stack([np.cos(azimuths), np.sin(azimuths)], axis=-1)
    home = float(np.sqrt(robot.delta.rod_length**2 - robot.delta.radius**2))
    lines = []
    for i in range(3):
        carriage = np.array([*xy[i], q[i] - home])
        low, high = (np.array([*xy[i], limit[i] - home]) for limit in (robot.lower, robot.upper))
        lines += [_points([carriage, platform]), _points([low, high])]
    return lines


def _points(points: list[Array]) -> list[list[float]]:
    return [[round(float(x), 5) for x in point] for point in points]

"""The robot of a recording: which of its joints are asked for, where the others stand, and what is odd about its model."""

from pathlib import Path
from typing import Final

import numpy as np

from galen_hw.errors import UsageError
from galen_hw.kinematics import GalenRobot, Robot, UrdfRobot
from galen_hw.kinematics.joint_map import sources
from galen_hw.premises.model import ModelProblem, base_problems, model_problems
from galen_hw.recording import Recording
from galen_hw.recording.recording import SENSOR_ORIENTATION
from galen_hw.spatial import Array

IN_JOINTS: Final = ("effort", "position")
"""Groups in which the arm itself bears what hangs on its sensor; the URDF holds its links already."""
UNDER_GRAVITY: Final = ("wrench", "effort", "position")
"""Groups for which the base's own motion counts by how gravity turns in it, and not as a frame that moves along."""


def robot_of(recording: Recording, predict: str | None) -> Robot | None:
    """The robot that a recording names, with the joints that a group needs or that were recorded and matter to it.

    Args:
        predict: the group that is compared; "wrench" for a calibration.

    Raises:
        UsageError: its file is not there or cannot be used.
    """
    info, urdf = recording.info, recording.urdf
    if info.robot is None:
        return None
    if info.robot == "galen":
        return GalenRobot(gravity=np.array(info.gravity))
    assert urdf is not None, "a robot that is named has a file"
    if isinstance(urdf, Path) and not urdf.is_file():
        raise UsageError("the robot's file is not there", where=str(urdf), todo="put the URDF beside the recording")
    sensor = info.sensor_link or info.tip_link
    whole = UrdfRobot(urdf, sensor_link=sensor, base_link=info.base_link, gravity=np.array(info.gravity))
    return _read(whole, recording, predict)


def model_notes(recording: Recording, robot: Robot | None, predict: str | None) -> list[str]:
    """What is odd about a robot's model and cannot be seen in the answer.

    Raises:
        UsageError: nothing may be fitted on such a model.
    """
    if not isinstance(robot, UrdfRobot) or recording.simulation is not None:
        return []
    info, read = recording.info, _recorded(recording)
    absent = [name for name in robot.moving() if name not in read]
    if predict == "wrench" and absent:
        if recording.has(*SENSOR_ORIENTATION):
            return []
        what = f"{len(absent)} of the robot's joints have no position, first {absent[0]}"
        raise UsageError(what, where=recording.about, todo=f"add the column joint.{absent[0]}.position")
    problems = model_problems(
        robot,
        sensor_named=bool(info.sensor_link or info.tip_link),
        frames=predict not in IN_JOINTS,
        masses=predict == "effort",
    )
    if predict in UNDER_GRAVITY:
        problems += base_problems(robot, read)
    if predict in IN_JOINTS:
        problems += _unread(robot, recording)
    for problem in problems:
        if problem.severity == "refuse":
            how = " (--sensor-link, or sensor_link in recording.json)" if problem.where.endswith("sensor_link") else ""
            raise UsageError(problem.what, where=problem.where, todo=problem.todo + how)
    return [str(problem) for problem in problems]


def zeroed_joints(recording: Recording, robot: Robot | None) -> Array | None:
    """(n,) positions of the robot's joints at which the sensor was zeroed; None where they are not given.

    Raises:
        UsageError: a joint that moves the sensor is missing, or the number of values fits no joints.
    """
    if robot is None:
        return None
    info, zeroed = recording.info, recording.info.zeroed_at
    if not isinstance(robot, UrdfRobot):
        given = info.zeroed_joints(robot.joint_names)
        return None if given is None else np.array(given)
    moving = tuple(name for name in robot.joint_names if name in robot.moving())
    named = moving if isinstance(zeroed, dict) or len(zeroed or ()) == len(moving) != 4 else robot.independent
    given = info.zeroed_joints(named)
    if given is None:
        return None
    # Joints that do not move the sensor need not be named.
    known = (dict(zeroed) if isinstance(zeroed, dict) else {}) | dict(zip(named, given, strict=True))
    return np.array([known.get(name, 0.0) for name in robot.joint_names])


def zeroed_names(robot: Robot | None) -> tuple[str, ...]:
    """Joints of a robot by whose number a list of values is told from a quaternion."""
    if robot is None:
        return ()
    return robot.independent if isinstance(robot, UrdfRobot) else tuple(robot.joint_names)


def _read(whole: UrdfRobot, recording: Recording, predict: str | None) -> UrdfRobot:
    """With the joints that are asked for or known; others stand where they stood in the median, or at zero."""
    needed, useful = _joints(whole, recording, predict)
    known = _recorded(recording)
    whole_rows = {name for name in known if np.isfinite(recording.columns[f"joint.{name}.position"]).all()}
    at = {name: float(np.nanmedian(recording.columns[f"joint.{name}.position"])) for name in known}
    robot = whole.keeping([n for n in whole.independent if n in needed or (n in useful and n in whole_rows)], at)
    return robot.standing() if predict in UNDER_GRAVITY else robot


def _joints(robot: UrdfRobot, recording: Recording, predict: str | None) -> tuple[set[str], set[str]]:
    """Joints without which nothing is simulated, and those that matter where they were recorded."""
    info, base = recording.info, set(robot.moving_base)
    if predict in IN_JOINTS:
        bearing, moved = _bearing(robot, recording, str(predict))
        compared = set(_compared(robot, recording, str(predict)))
        return compared | (bearing - base), bearing | moved
    needed = set(robot.moving())
    for link in (*(info.distal_bodies or ()), *([info.tip_link] if info.tip_link and predict != "wrench" else [])):
        if link in robot.urdf.links:
            needed |= set(robot.moving(link, against=robot.sensor_link))
    return needed, set(robot.beyond(robot.sensor_link)) | (base if predict in UNDER_GRAVITY else set())


def _compared(robot: UrdfRobot, recording: Recording, predict: str) -> list[str]:
    """Joints of whose column something was measured; all where none was."""
    columns = recording.columns
    found = [n for n in robot.independent if np.isfinite(columns.get(f"joint.{n}.{predict}", np.nan)).any()]
    return found or list(robot.independent)


def _bearing(robot: UrdfRobot, recording: Recording, predict: str) -> tuple[set[str], set[str]]:
    """Joints that turn gravity for the compared ones, and those that move what they bear."""
    urdf, bearing, moved = robot.urdf, set[str](), set[str]()
    compared = set(_compared(robot, recording, predict))
    for name, joint in urdf.joints.items():
        if compared.intersection(sources(urdf, [name])):
            bearing |= set(sources(urdf, urdf.carriers(joint.child)))
            moved |= set(robot.beyond(joint.child))
    return bearing, moved - bearing


def _unread(robot: UrdfRobot, recording: Recording) -> list[ModelProblem]:
    """Joints that move what the arm bears and that were not recorded."""
    _, moved = _bearing(robot, recording, str(recording.info.predict))
    missing = [
        n for n in robot.independent if n in moved and n not in robot.joint_names and n not in _recorded(recording)
    ]
    if not missing:
        return []
    what = f"no position of {', '.join(missing)}: what hangs there is taken to stand at zero"
    return [ModelProblem(what, f"{robot.urdf.where}: joints", "record them if they move")]


def _recorded(recording: Recording) -> set[str]:
    """Joints of whose position something was measured."""
    columns = recording.columns
    return {n for n in recording.joint_names if np.isfinite(columns.get(f"joint.{n}.position", np.nan)).any()}

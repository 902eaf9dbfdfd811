"""From a recording to what the effects read: columns, simulation, and what the simulation believes."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from galen_hw.errors import UsageError
from galen_hw.kinematics import GalenRobot, Robot, UrdfRobot
from galen_hw.physics.observations import Belief, Observations
from galen_hw.physics.rigid import Body
from galen_hw.recording import Recording
from galen_hw.spatial import Array, rotation_from_quaternion
from galen_hw.tools.diagnose_tool import terms_of


def observations_of(recording: Recording) -> Observations:
    """What the effects read, from a recording and its own notes.

    Raises:
        UsageError: the recording does not say what is compared.
    """
    info = recording.info
    if info.predict is None:
        where = f"{recording.path}/recording.json: predict"
        raise UsageError("nothing is named to compare", where=where, todo='e.g. "predict": "wrench"')
    columns, simulation = dict(recording.columns), recording.simulation
    simulated = None if simulation is None else _matched(recording, simulation)
    belief = _belief(recording)
    names = () if belief.robot is None else belief.robot.joint_names
    if info.predict == "position" and any(f"joint.{name}.position" not in columns for name in names):
        # Servos are compared one by one; where some joints were not recorded nothing is known of how the arm stands.
        belief = replace(belief, robot=None)
    return Observations(info.predict, columns, simulated, belief)


def _matched(recording: Recording, simulation: Recording) -> dict[str, Array]:
    """The simulation's columns at the recording's rows: by time, or row by row; NaN outside."""
    ours, theirs = recording.time, simulation.time
    if ours is None or theirs is None:
        if len(simulation) != len(recording):
            raise UsageError(
                f"the simulation has {len(simulation)} rows beside {len(recording)} and no common clock",
                where=str(simulation.path),
                todo="give both a time column, or as many rows",
            )
        return dict(simulation.columns)
    same = len(ours) == len(theirs) and np.allclose(ours, theirs, rtol=0.0, atol=1e-9)
    if same:
        return dict(simulation.columns)
    order = np.argsort(theirs, kind="stable")
    if min(ours.max(), theirs.max()) <= max(ours.min(), theirs.min()):
        what = (
            f"the simulation does not overlap the recording in time: {theirs.min():.6g} to {theirs.max():.6g} s beside "
            f"{ours.min():.6g} to {ours.max():.6g} s"
        )
        raise UsageError(what, where=str(simulation.path), todo="give both the same clock")
    return {k: np.interp(ours, theirs[order], v[order], np.nan, np.nan) for k, v in simulation.columns.items()}


def _belief(recording: Recording) -> Belief:
    info = recording.info
    robot = _robot(recording)
    tool, bias = info.tool, info.bias_body
    return Belief(
        robot=robot,
        tool=Body() if tool is None else _body(tool.mass, tool.com, tool.inertia),
        tip=np.zeros(3) if tool is None or tool.tip is None else np.array(tool.tip),
        bias_body=None if bias is None else _body(bias.mass, bias.com, bias.inertia),
        zeroed_rotation=_zeroed(recording, robot),
        zeroed_joints=_zeroed_joints(recording, robot),
        gravity=np.array(info.gravity),
        bias_free=info.model.bias == "free",
        dynamic=info.model.dynamics == "rigid",
        compliance={} if info.model.compliance is None else dict(info.model.compliance.joint),
        distal_bodies=info.distal_bodies or (),
        ranges=dict(info.ranges),
        terms=terms_of(recording),
        epoch=recording.epoch,
    )


def _body(mass: float | None, com: tuple[float, ...] | None, inertia: tuple[tuple[float, ...], ...] | None) -> Body:
    return Body(
        mass or 0.0,
        np.zeros(3) if com is None else np.array(com),
        np.zeros((3, 3)) if inertia is None else np.array(inertia),
    )


def _robot(recording: Recording) -> Robot | None:
    info = recording.info
    if info.robot is None:
        return None
    if info.robot == "galen":
        return GalenRobot(gravity=np.array(info.gravity))
    urdf = recording.urdf
    if isinstance(urdf, Path) and not urdf.is_file():
        raise UsageError("the robot's file is not there", where=str(urdf), todo="put the URDF beside the recording")
    assert urdf is not None, "a robot that is named has a file"
    sensor = info.sensor_link or info.tip_link
    return UrdfRobot(urdf, sensor_link=sensor, base_link=info.base_link, gravity=np.array(info.gravity))


def _zeroed(recording: Recording, robot: Robot | None) -> Array | None:
    names = () if robot is None else tuple(robot.joint_names)
    quaternion = recording.info.zeroed_quaternion(names)
    if quaternion is not None:
        return rotation_from_quaternion(quaternion)
    if robot is None and recording.info.zeroed_at is not None and recording.info.bias_body is not None:
        what, where = (
            "joints, but no robot that would say how the sensor stood",
            f"{recording.path}/recording.json: zeroed_at",
        )
        raise UsageError(what, where=where, todo="give the sensor's orientation there as a quaternion x y z w")
    joints = _zeroed_joints(recording, robot)
    return None if joints is None or robot is None else np.asarray(robot.sensor_pose(joints)[0, :3, :3])


def _zeroed_joints(recording: Recording, robot: Robot | None) -> Array | None:
    joints = None if robot is None else recording.info.zeroed_joints(tuple(robot.joint_names))
    return None if joints is None else np.array(joints)

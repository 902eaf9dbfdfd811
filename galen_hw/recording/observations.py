"""From a recording to what the effects read: columns, simulation, and what the simulation believes."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from galen_hw.errors import UsageError
from galen_hw.kinematics import Robot, UrdfRobot
from galen_hw.physics.observations import Belief, Observations
from galen_hw.physics.rigid import Body
from galen_hw.recording import Recording
from galen_hw.recording.recording import group_of
from galen_hw.recording.robot import IN_JOINTS, robot_of, zeroed_joints, zeroed_names
from galen_hw.spatial import Array, rotation_from_quaternion

Rows = NDArray[np.bool_] | slice
Terms = Sequence[dict[str, Any]]
"""As in a tool's file: effect and parameters."""
FIXED = 1e-3
"""Of a pose, in m and in parts of a turn's matrix: what moves less stands still."""
LARGEST = float(np.finfo(float).max) ** 0.25
"""Of a number in a recording: products of two of them have a square."""
SET_BACK = 0.05
"""Share of rows that are earlier than one before them, from which a clock was set back, and rows are not just out of order."""
ASKED = 200
"""Rows on which that is asked."""
FEW = 6
"""Names that one line can bear."""


@contextmanager
def named_in(recording: Recording) -> Iterator[None]:
    """Physics knows no files: an error that speaks of "recording" gets the name of the one that was given."""
    try:
        yield
    except UsageError as error:
        raise UsageError(error.what, where=recording.place(error.where), todo=error.todo) from error


def observations_of(recording: Recording, terms: Terms = ()) -> Observations:
    """What the effects read, from a recording and its own notes.

    Args:
        terms: further effects of the tool in hand, which the simulation adds.

    Raises:
        UsageError: the recording does not say what is compared.
    """
    with named_in(recording):
        return _observations(recording, terms)


def _nothing_named(recording: Recording) -> UsageError:
    """Return what a recording lacks that does not say what is compared."""
    groups, where = {group_of(column) for column in recording.columns}, recording.about
    if "position" in groups and recording.info.robot is None and groups & {"wrench", "effort", "pose", "targets"}:
        return UsageError(
            "the joints of which robot?", where=where, todo="--robot FILE.urdf, or robot in recording.json"
        )
    if "wrench" in groups and not groups & {"position", "sensor"}:
        todo = "record the joints (and give --robot) or the sensor's orientation beside it"
        return UsageError("a wrench alone: how the sensor stood is not known", where=where, todo=todo)
    if where != str(recording.path):
        return UsageError("nothing is named to compare", where=f"{where}: predict", todo='e.g. "predict": "wrench"')
    unknown = [column.removeprefix("covariate.") for column in recording.columns if group_of(column) == "covariate"]
    more = f" and {len(unknown) - FEW} more" if len(unknown) > FEW else ""
    names = f" ({', '.join(unknown[:FEW])}{more} are no names that are known)" if unknown else ""
    todo = f"say which is which: galen-hw import {where} --write-map {where}.map.toml, edit that, and ask again"
    return UsageError(f"no wrench, effort or pose to compare{names}", where=where, todo=todo)


def _observations(recording: Recording, terms: Terms) -> Observations:
    info = recording.info
    if info.predict is None:
        raise _nothing_named(recording)
    for each in (recording, recording.simulation):
        if each is not None:
            _finite_squares(each)
    columns, simulation = dict(recording.columns), recording.simulation
    simulated = None if simulation is None else _matched(recording, simulation)
    belief = replace(_belief(recording), terms=tuple(terms))
    names = () if belief.robot is None else belief.robot.joint_names
    if info.predict == "position" and any(f"joint.{name}.position" not in columns for name in names):
        # Servos are compared one by one; where some joints were not recorded nothing is known of how the arm stands.
        belief = replace(belief, robot=None)
    return Observations(info.predict, columns, simulated, belief)


def _finite_squares(recording: Recording) -> None:
    """Refuse numbers whose squares are none: every error is a mean square.

    Raises:
        UsageError: a column holds one.
    """
    for name, values in recording.columns.items():
        large = np.flatnonzero(np.abs(values) > LARGEST)
        if len(large):
            what = f"{name} is {values[large[0]]:.3g} in row {large[0] + 1}, which no machine measures"
            raise UsageError(what, where=str(recording.path), todo="leave cells empty that were not measured")


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
    runs = np.unique(recording.segment)
    if not np.array_equal(runs, np.unique(simulation.segment)):
        return _by_time(recording, simulation, slice(None), slice(None))
    out = {name: np.full(len(recording), np.nan) for name in simulation.columns}
    for run in runs:  # each may have a clock of its own
        rows, its = recording.segment == run, simulation.segment == run
        for name, values in _by_time(recording, simulation, rows, its).items():
            out[name][rows] = values
    return out


def _clock(whose: str, one: Recording, rows: Rows) -> Array:
    """Return the times (n,), s, of some rows.

    Raises:
        UsageError: the clock was set back among them.
    """
    assert one.time is not None
    time = one.time[rows]
    behind = time < np.maximum.accumulate(time)
    if np.mean(behind) > SET_BACK:
        row = int(np.arange(len(one))[rows][np.argmax(behind)]) + 1
        raise UsageError(
            f"the clock of the {whose} is set back at row {row}: no time tells what belongs together",
            where=str(one.path),
            todo="give both one clock that rises, or the same rows",
        )
    return time


def _by_time(recording: Recording, simulation: Recording, rows: Rows, its: Rows) -> dict[str, Array]:
    """Return the simulation's columns of its rows `its`, at the times of the recording's `rows`; NaN outside."""
    ours, theirs = (_clock(*one) for one in (("recording", recording, rows), ("simulation", simulation, its)))
    if min(ours.max(), theirs.max()) <= max(ours.min(), theirs.min()):
        what = (
            f"the simulation does not overlap the recording in time: {theirs.min():.6g} to {theirs.max():.6g} s beside "
            f"{ours.min():.6g} to {ours.max():.6g} s"
        )
        raise UsageError(what, where=str(simulation.path), todo="give both the same clock")
    order = np.argsort(theirs, kind="stable")
    return {k: np.interp(ours, theirs[order], v[its][order], np.nan, np.nan) for k, v in simulation.columns.items()}


def _belief(recording: Recording) -> Belief:
    info = recording.info
    robot = robot_of(recording, info.predict)
    tool, bias = info.tool, info.bias_body
    tip, tip_rotation = _tip(recording, robot)
    belief = Belief(
        robot=robot,
        tool=Body() if tool is None else _body(tool.mass, tool.com, tool.inertia),
        tip=tip,
        tip_rotation=tip_rotation,
        bias_body=None if bias is None else _body(bias.mass, bias.com, bias.inertia),
        zeroed_rotation=_zeroed(recording, robot),
        zeroed_joints=zeroed_joints(recording, robot),
        gravity=np.array(info.gravity),
        bias_free=info.model.bias == "free",
        dynamic=info.model.dynamics == "rigid" and (robot is not None or "dynamics" in info.model.model_fields_set),
        compliance={} if info.model.compliance is None else dict(info.model.compliance.joint),
        distal=() if info.predict in IN_JOINTS else _distal(recording, robot),
        ranges=dict(info.ranges),
        epoch=recording.epoch,
    )
    if info.predict in IN_JOINTS and isinstance(robot, UrdfRobot):
        for body in belief.hanging:
            robot = robot.carrying(body.mass, body.com, body.inertia)
    return replace(belief, robot=robot)


def _distal(recording: Recording, robot: Robot | None) -> tuple[Body, ...]:
    """Links of the URDF that hang on the sensor, as bodies in its frame.

    Raises:
        UsageError: there is no URDF or no such link, or a link moves against the sensor.
    """
    links, where = recording.info.distal_bodies or (), f"{recording.about}: distal_bodies"
    if links and not isinstance(robot, UrdfRobot):
        raise UsageError("links are named, but no URDF that holds them", where=where, todo="name the URDF as robot")
    return tuple(_link(recording, robot, link, where) for link in links if isinstance(robot, UrdfRobot))


def _link(recording: Recording, robot: UrdfRobot, link: str, where: str) -> Body:
    T = _in_sensor(recording, robot, link)
    if T is None:
        what = f"link {link!r} moves against the sensor"
        raise UsageError(what, where=where, todo="name links that are fixed to it, and the others' weight as tool")
    return Body(*robot.link_body(link)).seen_from(T)


def _in_sensor(recording: Recording, robot: UrdfRobot, link: str) -> Array | None:
    """Pose (4, 4) of a link in the sensor frame; None where it moves against the sensor."""
    positions = [recording.columns.get(f"joint.{name}.position") for name in robot.joint_names]
    # A joint that was not recorded stood where the URDF has its zero.
    q = np.stack([np.zeros(len(recording)) if x is None else x for x in positions], axis=-1)
    q = q[np.isfinite(q).all(axis=1)]
    q = q[:: max(len(q) // ASKED, 1)] if len(q) else np.zeros((1, len(positions)))
    T = np.linalg.inv(robot.sensor_pose(q)) @ robot.frame_pose(q, link)
    return None if np.max(np.ptp(T[:, :3], axis=0)) > FIXED else np.asarray(T[len(T) // 2])


def _tip(recording: Recording, robot: Robot | None) -> tuple[Array, Array]:
    """Tool tip (3,) in the sensor frame, and the (3, 3) axes that are tracked there: of the tip's link where one is named.

    Raises:
        UsageError: that link moves against the sensor.
    """
    info = recording.info
    named = None if info.tool is None or info.tool.tip is None else np.array(info.tool.tip)
    T: Array | None = np.eye(4)
    if info.tip_link is not None and info.sensor_link is not None and isinstance(robot, UrdfRobot):
        T = _in_sensor(recording, robot, info.tip_link)
    if T is None and info.predict == "pose":
        what, where = f"link {info.tip_link!r} moves against the sensor", f"{recording.about}: tip_link"
        raise UsageError(what, where=where, todo="name a link that is fixed to the sensor's")
    T = np.eye(4) if T is None else T
    return T[:3, 3] if named is None else named, T[:3, :3]


def _body(mass: float | None, com: tuple[float, ...] | None, inertia: tuple[tuple[float, ...], ...] | None) -> Body:
    return Body(
        mass or 0.0,
        np.zeros(3) if com is None else np.array(com),
        np.zeros((3, 3)) if inertia is None else np.array(inertia),
    )


def _zeroed(recording: Recording, robot: Robot | None) -> Array | None:
    quaternion = recording.info.zeroed_quaternion(zeroed_names(robot))
    if quaternion is not None:
        return rotation_from_quaternion(quaternion)
    if robot is None and recording.info.zeroed_at is not None and recording.info.bias_body is not None:
        what, where = (
            "joints, but no robot that would say how the sensor stood",
            f"{recording.about}: zeroed_at",
        )
        raise UsageError(what, where=where, todo="give the sensor's orientation there as a quaternion x y z w")
    joints = zeroed_joints(recording, robot)
    return None if joints is None or robot is None else np.asarray(robot.sensor_pose(joints)[0, :3, :3])

"""From a recording, continuous or already averaged, to the static poses that a calibration is fitted to."""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from galen_hw.errors import UsageError
from galen_hw.identification.poses import Mask, Poses
from galen_hw.identification.still import average, still_spans
from galen_hw.kinematics import Robot
from galen_hw.physics.rigid import Body
from galen_hw.premises import Remark
from galen_hw.recording import WRENCH, Recording
from galen_hw.recording.recording import SENSOR_ORIENTATION
from galen_hw.recording.robot import model_notes, robot_of, zeroed_joints, zeroed_names
from galen_hw.spatial import Array, quaternion_from_rotation, rotation_from_quaternion
from galen_hw.tools.examined import examine_recording

SAME_ORIENTATION = 0.005
"""rad between two visits of one pose."""
MOST_AVERAGED_ROWS = 2000
POSE, SAMPLES, TOOL, VERIFY, HOME = (f"covariate.{name}" for name in ("pose", "samples", "tool", "verify", "home"))
STD = tuple(f"covariate.std.{name.removeprefix('wrench.')}" for name in WRENCH)


@dataclass(frozen=True)
class Found:
    """Poses of a recording and how they were found, one note a line; `terms` of a tool's file that its premises claim."""

    poses: Poses
    notes: tuple[str, ...]
    robot: Robot | None
    joints: Array
    premises: tuple[Remark, ...] = ()

    @property
    def terms(self) -> tuple[Mapping[str, object], ...]:
        """Return what was solved before the fit and must be applied live as well: a sensor that is turned on its link."""
        claims = [r.claim for r in self.premises if r.claim is not None]
        return tuple(term for c in claims if c.effect == "sensor_mounting" for term in c.terms)


def poses_of(recording: Recording, robot: Robot | None = None, *, repair: bool = True) -> Found:
    """Return the static poses of a recording, once its premises hold.

    Args:
        recording: with a raw wrench, and joints of a known robot or the sensor's orientation.
        robot: used instead of the one that the recording names.
        repair: put right what is certain (`galen_hw.premises`); else the same is refused.

    Raises:
        UsageError: no wrench, no orientation, a premise that refuses the recording, or nothing ever rests.
    """
    where = str(recording.path)
    if not recording.has(*WRENCH):
        missing = next(name for name in WRENCH if name not in recording.columns)
        raise UsageError(f"there is no column {missing}", where=where, todo="a calibration needs the raw wrench")
    robot = robot or robot_of(recording, "wrench")
    # Before any premise looks at it: what has no orientation at all is refused in plain words.
    joints = _joints(recording, robot)
    _orientation(recording, robot, joints)
    about_model = model_notes(recording, robot if joints.shape[1] else None, "wrench")
    examined = examine_recording(recording, "wrench", repair=repair, one_load=True)
    recording = examined.recording
    joints = _joints(recording, robot)
    R = _orientation(recording, robot, joints) @ examined.sensor_turn
    good: Mask = np.asarray(np.isfinite(np.column_stack([recording.wrench, R.reshape(-1, 9)])).all(axis=1))
    notes = [*about_model, *examined.notes]
    notes += [f"{int((~good).sum())} rows without wrench or orientation are left out"] if not good.all() else []
    averaged = _is_averaged(recording)
    poses = _rows(recording, R, good) if averaged else _spans(recording, R, joints, good)
    if len(poses) == 0:
        raise UsageError("nothing ever rests in it", where=where, todo="hold each pose for half a second at least")
    if not averaged:
        notes.append(f"{len(poses)} poses at rest were found in {len(recording)} samples")
    zero = _zero(recording, robot)
    zero = None if zero is None else zero @ examined.sensor_turn
    poses = replace(poses, zero=zero, gravity=np.array(recording.info.gravity))
    if recording.info.bias_body is not None:
        known = recording.info.bias_body
        poses = replace(poses, bias_body=Body(known.mass, np.array(known.com)))
    return Found(poses, tuple(notes), robot, joints, examined.examination.remarks)


def _joints(recording: Recording, robot: Robot | None) -> Array:
    if robot is None:
        return np.empty((len(recording), 0))
    missing = [name for name in robot.joint_names if f"joint.{name}.position" not in recording.columns]
    if missing and not recording.has(*SENSOR_ORIENTATION):
        todo = "record the joints, or the sensor's orientation"
        raise UsageError(f"there is no column joint.{missing[0]}.position", where=str(recording.path), todo=todo)
    return np.empty((len(recording), 0)) if missing else recording.joints("position", robot.joint_names)


def _orientation(recording: Recording, robot: Robot | None, joints: Array) -> Array:
    """(N, 3, 3) sensor to base, NaN where not known."""
    if robot is not None and joints.shape[1]:
        known = np.isfinite(joints).all(axis=1)
        R = np.full((len(joints), 3, 3), np.nan)
        R[known] = robot.sensor_pose(joints[known])[:, :3, :3]
        return R
    if not recording.has(*SENSOR_ORIENTATION):
        todo = "name the robot in recording.json, or add sensor.orientation.x y z w"
        raise UsageError("neither a robot nor the sensor's orientation is known", where=str(recording.path), todo=todo)
    return rotation_from_quaternion(recording.matrix(*SENSOR_ORIENTATION))


def _is_averaged(recording: Recording) -> bool:
    """Each row is a pose: it says so, has no clock, or its rows are far apart."""
    time = recording.time
    if SAMPLES in recording.columns or time is None:
        return True
    return len(time) <= MOST_AVERAGED_ROWS and len(time) > 1 and float(np.median(np.diff(time))) > 0.4


def _rows(recording: Recording, R: Array, keep: Mask) -> Poses:
    """One row a pose."""
    n = len(recording)
    samples = recording.columns.get(SAMPLES, np.full(n, np.nan))
    std = recording.matrix(*STD)
    poses = Poses(
        R,
        recording.wrench,
        std**2 / samples[:, None],
        recording.time,
        _flag(recording, TOOL, default=True),
        _flag(recording, VERIFY, default=False),
        _flag(recording, HOME, default=False) if HOME in recording.columns else _visits(R),
    )
    noise = np.sqrt(np.nanmean(std[keep] ** 2, axis=0)) if np.isfinite(std[keep]).any() else np.full(6, np.nan)
    return replace(poses.select(keep), noise=noise)


def _spans(recording: Recording, R: Array, joints: Array, keep: Mask) -> Poses:
    """Averages over the spans at rest of a continuous recording."""
    time = recording.time
    assert time is not None
    R, wrench, time = R[keep], recording.wrench[keep], time[keep]
    motion = joints[keep] if joints.shape[1] else quaternion_from_rotation(R)
    spans = still_spans(time, motion)
    if not spans:
        return Poses.make(R[:0], wrench[:0])
    mean, variance, count = average(spans, wrench)
    middle = [(s.first + s.last) // 2 for s in spans]
    flags = [_flag(recording, name, default=default)[keep] for name, default in ((TOOL, True), (VERIFY, False))]
    noise = np.sqrt((variance * count[:, None]).sum(axis=0) / count.sum())
    still = R[middle]
    return Poses(
        still,
        mean,
        variance / count[:, None],
        time[middle],
        flags[0][middle],
        flags[1][middle],
        _visits(still),
        noise=noise,
    )


def _flag(recording: Recording, column: str, *, default: bool) -> Mask:
    values = recording.columns.get(column)
    return np.full(len(recording), default) if values is None else np.asarray(values > 0.5)


def _visits(R: Array) -> Mask:
    """The orientation that is visited most often, if thrice or more: the home pose."""
    known = np.nan_to_num(R)
    cosine = 0.5 * (np.einsum("aij,bij->ab", known, known) - 1.0)
    near = np.arccos(cosine.clip(-1.0, 1.0)) < SAME_ORIENTATION
    most = int(np.argmax(near.sum(axis=1)))
    return np.asarray(near[most] if near[most].sum() >= 3 else np.zeros(len(R), dtype=bool))


def _zero(recording: Recording, robot: Robot | None) -> Array | None:
    """(3, 3) orientation in which the sensor was zeroed."""
    joints = zeroed_joints(recording, robot)
    if joints is not None and robot is not None:
        return np.asarray(robot.sensor_pose(joints)[0, :3, :3])
    quaternion = recording.info.zeroed_quaternion(zeroed_names(robot))
    return None if quaternion is None else rotation_from_quaternion(quaternion)

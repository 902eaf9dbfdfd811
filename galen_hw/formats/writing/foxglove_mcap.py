"""A recording as MCAP with Foxglove's schemas: JointStates, PoseInFrame, FrameTransform, and JSON with a schema for the rest."""

import warnings
from pathlib import Path
from typing import Any, Final

import numpy as np

from galen_hw.clock import NS_PER_S
from galen_hw.errors import UsageError
from galen_hw.formats.contents import needed
from galen_hw.recording import Recording
from galen_hw.recording.info import INFO, URDF
from galen_hw.recording.recording import POSE, SENSOR_ORIENTATION, WRENCH, joint_column

VECTOR: Final = {"type": "object", "properties": {a: {"type": "number"} for a in "xyz"}}
WRENCH_SCHEMA: Final = {"type": "object", "title": "wrench", "properties": {"force": VECTOR, "torque": VECTOR}}


def write(recording: Recording, path: Path) -> list[str]:
    """Write it.

    Raises:
        UsageError: there is no clock, or foxglove-sdk is not installed.
    """
    try:
        import foxglove
        from foxglove import channels, messages
    except ImportError as error:
        line = needed("foxglove-sdk", "an MCAP file with Foxglove's schemas")(error)
        raise UsageError(line.what, todo="pip install 'galen-hw[foxglove]'") from None
    if recording.time is None:
        todo = "export it as csv, parquet or mat"
        raise UsageError("it has no time, and messages need one", where=str(recording.path), todo=todo)
    context = foxglove.Context()
    with warnings.catch_warnings(), foxglove.open_mcap(str(path), context=context) as file:
        warnings.simplefilter("ignore")
        file.write_metadata("galen-hw", {INFO: recording.info.to_json(), URDF: recording.urdf_text})
        _write(recording, foxglove, channels, messages, context)
    return []


def _write(recording: Recording, foxglove: Any, channels: Any, messages: Any, context: Any) -> None:
    assert recording.time is not None, "asked before"
    epoch_ns = 0 if recording.epoch is None else round(recording.epoch * NS_PER_S)
    stamps = (np.round(recording.time * NS_PER_S).astype(np.int64) + epoch_ns).clip(min=0).tolist()
    rest = _rest(recording)
    properties = {name: {"type": "number"} for name in rest}
    out = {
        "/wrench": foxglove.Channel("/wrench", schema=WRENCH_SCHEMA, message_encoding="json", context=context),
        "/joint_states": channels.JointStatesChannel("/joint_states", context=context),
        "/pose": channels.PoseInFrameChannel("/pose", context=context),
        "/sensor": channels.FrameTransformChannel("/sensor", context=context),
        "/other": foxglove.Channel(
            "/other",
            schema={"type": "object", "title": "other", "properties": properties},
            message_encoding="json",
            context=context,
        ),
    }
    rows = {name: values.tolist() for name, values in recording.columns.items()}
    made = _Rows(recording, rows, messages)
    for i, ns in enumerate(stamps):
        stamp = messages.Timestamp(sec=ns // NS_PER_S, nsec=ns % NS_PER_S)
        if (wrench := made.values(WRENCH, i)) is not None:
            parts = [dict(zip("xyz", part, strict=True)) for part in (wrench[:3], wrench[3:])]
            out["/wrench"].log(dict(zip(("force", "torque"), parts, strict=True)), log_time=ns)
        if recording.joint_names:
            out["/joint_states"].log(made.joints(stamp, i), log_time=ns)
        if (pose := made.values(POSE, i)) is not None:
            out["/pose"].log(made.pose(stamp, pose), log_time=ns)
        if (turn := made.values(SENSOR_ORIENTATION, i)) is not None:
            out["/sensor"].log(made.frame(stamp, turn), log_time=ns)
        if rest:
            out["/other"].log({name: _finite(rows[name][i]) for name in rest}, log_time=ns)


def _finite(value: float) -> float | None:
    """JSON has no NaN."""
    return value if np.isfinite(value) else None


def _rest(recording: Recording) -> list[str]:
    whole = [*(WRENCH if recording.has(*WRENCH) else ()), *(POSE if recording.has(*POSE) else ())]
    whole += SENSOR_ORIENTATION if recording.has(*SENSOR_ORIENTATION) else ()
    kept = {"time", *whole}
    joints = {n for n in recording.columns if (joint := joint_column(n)) and joint[1] != "command"}
    return [name for name in recording.columns if name not in kept and name not in joints]


class _Rows:
    """Messages of one row."""

    def __init__(self, recording: Recording, rows: dict[str, list[float]], messages: Any) -> None:
        self._rows, self._messages, self._names = rows, messages, recording.joint_names
        self._base = recording.info.base_link or "base"
        self._sensor = recording.info.sensor_link or "sensor"

    def values(self, names: tuple[str, ...], row: int) -> list[float] | None:
        """A vector; None where it was not measured or is not recorded."""
        found = [self._rows[name][row] for name in names if name in self._rows]
        return found if len(found) == len(names) and np.isfinite(found).all() else None

    def joints(self, stamp: Any, row: int) -> Any:
        """Positions, velocities and efforts."""
        states = []
        for name in self._names:
            kinds = {k: self._rows.get(f"joint.{name}.{k}") for k in ("position", "velocity", "effort")}
            found = {k: v[row] for k, v in kinds.items() if v is not None and np.isfinite(v[row])}
            states.append(self._messages.JointState(name=name, **found))
        return self._messages.JointStates(timestamp=stamp, joints=states)

    def pose(self, stamp: Any, v: list[float]) -> Any:
        """Of the tool's tip."""
        place = self._messages.Vector3(x=v[0], y=v[1], z=v[2])
        pose = self._messages.Pose(position=place, orientation=self._turn(v[3:]))
        return self._messages.PoseInFrame(timestamp=stamp, frame_id=self._base, pose=pose)

    def frame(self, stamp: Any, v: list[float]) -> Any:
        """How the sensor stands; where, is not known."""
        return self._messages.FrameTransform(
            timestamp=stamp,
            parent_frame_id=self._base,
            child_frame_id=self._sensor,
            translation=self._messages.Vector3(x=0.0, y=0.0, z=0.0),
            rotation=self._turn(v),
        )

    def _turn(self, v: list[float]) -> Any:
        return self._messages.Quaternion(x=v[0], y=v[1], z=v[2], w=v[3])

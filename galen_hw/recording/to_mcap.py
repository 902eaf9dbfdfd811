"""A `Recording` as an MCAP file: what has a topic becomes messages, the rest rows of a channel of their own."""

import json
from collections.abc import Mapping
from contextlib import suppress
from math import isfinite, nan
from pathlib import Path
from typing import Any, Final

from galen_hw.clock import NS_PER_S
from galen_hw.errors import UsageError
from galen_hw.messages import JointsState, Vector3, WrenchRaw
from galen_hw.recording.from_mcap import TABLE_TOPIC
from galen_hw.recording.mcap_writer import Encoding, McapWriter
from galen_hw.recording.recording import WRENCH, Recording

ROW_SCHEMA: Final[dict[str, Any]] = {
    "type": "object",
    "title": "row",
    "description": "columns of an imported table that have no topic",
    "properties": {
        "timestamp": {"type": "number"},
        "columns": {"type": "object", "additionalProperties": {"type": "number"}},
    },
}


def write_mcap(recording: Recording, path: Path | str, *, encoding: Encoding = "json", overwrite: bool = False) -> Path:
    """Write a recording as MCAP; `read_recording` gives the same columns back, bit for bit.

    A simulation that lies beside the recording is not taken along.

    Raises:
        UsageError: the file is there already, or cannot be written.
    """
    path = Path(path)
    if path.exists() and not overwrite:
        raise UsageError("is there already", where=str(path), todo="give another name, or --overwrite")
    scratch = path.with_name(f".{path.name}.new")
    try:
        with scratch.open("wb") as stream:
            _write(recording, McapWriter(stream, encoding=encoding, metadata=_metadata(recording)))
        scratch.replace(path)
    except OSError as error:
        raise UsageError(f"cannot be written ({error.strerror or error})", where=str(path)) from error
    finally:  # A Ctrl-C leaves nothing behind either.
        with suppress(OSError):
            scratch.unlink()
    return path


def _metadata(recording: Recording) -> dict[str, str]:
    tool = recording.info.tool
    return {
        "robot": recording.info.robot or "",
        "tool": tool.name if tool else "",
        "columns": json.dumps(list(recording.columns)),
        "clock": "rows" if recording.time is None else "time",
    }


def _write(recording: Recording, writer: McapWriter) -> None:
    writer.attach("recording.json", recording.info.to_json())
    if recording.urdf is not None and recording.info.robot:
        writer.attach(recording.info.robot, recording.urdf_text, media_type="application/xml")
    columns = {name: values.tolist() for name, values in recording.columns.items()}
    time = columns.get("time") or [float(i) for i in range(len(recording))]
    has_wrench = all(name in columns for name in WRENCH)
    joints = _whole_joints(recording)
    held = set(WRENCH if has_wrench else ()) | {f"joint.{n}.{k}" for n in joints for k in _KINDS}
    rest = [name for name in columns if name not in held]
    log_ns = 0
    for i, seconds in enumerate(time):
        row = {name: columns[name][i] for name in columns}
        head = {"timestamp": seconds, "t_ns": round(seconds * NS_PER_S), "seq": i, "source": "table"}
        log_ns = max(log_ns, head["t_ns"])  # Readers go by it, and a table keeps the order of its rows.
        if joints:
            writer.message("joints/state", _joints_state(head, row, joints), log_ns)
        if has_wrench:
            writer.message("wrench/raw", _wrench(head, row), log_ns)
        writer.record(TABLE_TOPIC, ROW_SCHEMA, {"timestamp": seconds, "columns": {n: row[n] for n in rest}}, log_ns, i)
    writer.finish()


_KINDS: Final = ("position", "velocity", "effort")


def _whole_joints(recording: Recording) -> tuple[str, ...]:
    """Joints that become messages: those with a position."""
    return tuple(n for n in recording.joint_names if f"joint.{n}.position" in recording.columns)


def _joints_state(head: Mapping[str, Any], row: Mapping[str, float], joints: tuple[str, ...]) -> JointsState:
    position, velocity, effort = ({n: row.get(f"joint.{n}.{kind}", nan) for n in joints} for kind in _KINDS)
    valid = all(map(isfinite, position.values()))
    return JointsState(**head, valid=valid, position=position, velocity=velocity, effort=effort)


def _wrench(head: Mapping[str, Any], row: Mapping[str, float]) -> WrenchRaw:
    fx, fy, fz, tx, ty, tz = (row[name] for name in WRENCH)
    valid = isfinite(fx + fy + fz + tx + ty + tz)
    return WrenchRaw(**head, valid=valid, force=Vector3(fx, fy, fz), torque=Vector3(tx, ty, tz))

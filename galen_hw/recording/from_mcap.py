"""An MCAP file as a `Recording`: everything at the times of the raw wrench samples."""

from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import msgspec
import numpy as np

from galen_hw.clock import NS_PER_S
from galen_hw.documents import DocumentError, load_json
from galen_hw.errors import UsageError
from galen_hw.messages import CompensationState, JointsState, Message, TrackedPose, WrenchCompensated, WrenchRaw
from galen_hw.recording.checks import check
from galen_hw.recording.info import RecordingInfo, info_of, parse_info
from galen_hw.recording.mcap_reader import McapFile
from galen_hw.recording.recording import AXES, WRENCH, Recording
from galen_hw.spatial import Array

TABLE_TOPIC: Final = "table/row"
EXTRAPOLATE_S: Final = 0.08
"""Joint states carry this far beyond the last one, as in the live compensation; then positions are not known."""
Columns = dict[str, Array]


class Row(msgspec.Struct):
    """One row of an imported table: the columns that have no topic."""

    columns: dict[str, float | None]
    timestamp: float | None = None


def read_mcap(path: Path, *, compensated: bool = False) -> Recording:
    """Read an MCAP file of `galen-hw record` or `galen-hw import`.

    Args:
        path: of the file.
        compensated: also give `covariate.compensated.*`, as it was computed live.

    Raises:
        UsageError: not an MCAP file, or nothing in it to make a table of.
    """
    topics = {"wrench/raw", "joints/state", "tracker/tool", "compensation/state", TABLE_TOPIC}
    wanted = frozenset(topics | ({"wrench/compensated"} if compensated else set()))
    file = McapFile(path, wanted, {TABLE_TOPIC: Row})
    found: dict[str, list[Any]] = {}
    for logged in file:
        found.setdefault(logged.topic, []).append(logged.message)
    rows = found.pop(TABLE_TOPIC, None)
    columns, notes = _from_table(rows, found, file) if rows else _from_bus(found, file)
    states: list[CompensationState] = found.get("compensation/state", [])
    recording = Recording(
        columns,
        _info(file, states),
        path,
        attachments=dict(file.attachments),
        tool_file=next((s.tool_file for s in reversed(states) if s.tool_file), ""),
        epoch=None if rows else float(found[_base(found, file)][0].timestamp),
    )
    return replace(recording, warnings=(*file.warnings, *notes, *check(recording)))


def _base(found: dict[str, list[Any]], file: McapFile) -> str:
    """The topic whose samples are the rows."""
    order = ("wrench/raw", "joints/state", "tracker/tool")
    base = next((topic for topic in order if found.get(topic)), None)
    if base is None:
        file.refuse_nothing("holds no wrench, joint or tracker samples")
    return base


def _from_bus(found: dict[str, list[Any]], file: McapFile) -> tuple[Columns, list[str]]:
    base = _base(found, file)
    for messages in found.values():
        # Several processes wrote them, and a wall clock may have been set in between: the samples' own clock is not.
        messages.sort(key=lambda message: message.t_ns)
    t_ns = np.array([m.t_ns for m in found[base]], dtype=np.int64)
    start = int(t_ns[0])
    time = (t_ns - start) / NS_PER_S
    columns: Columns = {"time": time}
    notes: list[str] = []
    joints: list[JointsState] = found.get("joints/state", [])
    if joints:
        columns |= _joints(joints, time, start)
    if base == "wrench/raw":
        columns |= _wrench(found[base], notes)
    if found.get("tracker/tool"):
        columns |= _tracker(found["tracker/tool"], time, start)
    if found.get("wrench/compensated"):
        columns |= _compensated(found["wrench/compensated"], t_ns)
    return _measured(columns), notes


def _measured(columns: Columns) -> Columns:
    return {name: values for name, values in columns.items() if not np.isnan(values).all()}


def _wrench(messages: list[WrenchRaw], notes: list[str]) -> Columns:
    values = np.array([_six(m) for m in messages])
    bad = np.array([not m.valid or m.saturated for m in messages])
    values[bad] = np.nan
    if bad.any():
        notes.append(f"wrench: {int(bad.sum())} samples were not valid or saturated and are taken as not measured")
    return dict(zip(WRENCH, values.T, strict=True))


def _six(message: WrenchRaw | WrenchCompensated) -> tuple[float, ...]:
    f, t = message.force, message.torque
    return f.x, f.y, f.z, t.x, t.y, t.z


def _seconds(messages: list[Any], start: int) -> tuple[Array, list[Any]]:
    """Times from `start` of the usable messages, increasing, and these messages."""
    usable: list[Any] = []
    for message in messages:
        if message.valid and (not usable or message.t_ns > usable[-1].t_ns):
            usable.append(message)
    return np.array([(m.t_ns - start) / NS_PER_S for m in usable]), usable


def _joints(messages: list[JointsState], time: Array, start: int) -> Columns:
    t, usable = _seconds(messages, start)
    columns: Columns = {}
    if not usable:
        return columns
    names = dict.fromkeys(name for m in usable for name in m.position)
    kinds: dict[str, list[dict[str, float]]] = {
        "position": [m.position for m in usable],
        "velocity": [m.velocity for m in usable],
        "effort": [m.effort for m in usable],
    }
    for name in names:
        series = {k: np.array([values.get(name, np.nan) for values in found]) for k, found in kinds.items()}
        after = np.clip(time - t[-1], 0.0, EXTRAPOLATE_S)
        for kind, values in series.items():
            column = at_times(time, t, values)
            if kind == "position":
                column = column + after * np.nan_to_num(series["velocity"][-1])
            columns[f"joint.{name}.{kind}"] = column
    return columns


def at_times(time: Array, t: Array, values: Array, bound: float = EXTRAPOLATE_S) -> Array:
    """Values (N,) at `time` between samples at `t` (increasing): linear; NaN before, over gaps and late after.

    A gap is longer than `bound` and five times the median step.
    """
    column = np.interp(time, t, values)
    step = float(np.median(np.diff(t))) if len(t) > 1 else bound
    longest = max(bound, 5.0 * step)
    right = np.clip(np.searchsorted(t, time, side="left"), 1, max(1, len(t) - 1))
    gap = (t[np.minimum(right, len(t) - 1)] - t[right - 1]) > longest
    inside = (time > t[right - 1]) & (time < t[np.minimum(right, len(t) - 1)])
    column[(time < t[0]) | (time > t[-1] + bound) | (gap & inside)] = np.nan
    return np.asarray(column)


def _tracker(messages: list[TrackedPose], time: Array, start: int) -> Columns:
    t, usable = _seconds([m for m in messages if not m.missing], start)
    if not usable:
        return {}
    xyz = np.array([(m.position.x, m.position.y, m.position.z) for m in usable])
    return {f"target.1.position.{a}": at_times(time, t, xyz[:, i]) for i, a in enumerate(AXES)}


def _compensated(messages: list[WrenchCompensated], t_ns: "np.ndarray[tuple[int], np.dtype[np.int64]]") -> Columns:
    by_time = {m.t_ns: _six(m) for m in messages if m.valid}
    nothing = (np.nan,) * 6
    values = np.array([by_time.get(int(t), nothing) for t in t_ns])
    names = (name.replace("wrench.", "covariate.compensated.") for name in WRENCH)
    return dict(zip(names, values.T, strict=True))


def _from_table(rows: list[Row], found: dict[str, list[Message]], file: McapFile) -> tuple[Columns, list[str]]:
    """A table that was imported: its own rows hold what the messages do not, in the order of its columns."""
    rest = {key: np.array([row.columns.get(key) for row in rows], dtype=float) for key in rows[0].columns}
    wrenches = [m for m in found.get("wrench/raw", []) if isinstance(m, WrenchRaw)]
    joints = [m for m in found.get("joints/state", []) if isinstance(m, JointsState)]
    if wrenches:
        rest |= dict(zip(WRENCH, np.array([_six(m) for m in wrenches]).T, strict=True))
    for name in joints[0].position if joints else ():
        rest |= {
            f"joint.{name}.position": np.array([m.position.get(name, np.nan) for m in joints]),
            f"joint.{name}.velocity": np.array([m.velocity.get(name, np.nan) for m in joints]),
            f"joint.{name}.effort": np.array([m.effort.get(name, np.nan) for m in joints]),
        }
    names = _column_names(file) or list(rest)
    lengths = {len(rest[name]) for name in names if name in rest}
    if len(lengths) != 1:
        raise UsageError("its rows do not belong together", where=str(file.path), todo="import the table again")
    return {name: rest[name] for name in names if name in rest}, []


def _column_names(file: McapFile) -> list[str]:
    where = f"{file.path}: metadata: columns"
    try:
        names = load_json(file.metadata.get("columns", "[]"))
    except DocumentError as error:
        raise UsageError(error.what, where=where, todo="import the table again") from None
    if not isinstance(names, list) or not all(isinstance(name, str) for name in names):
        raise UsageError("not a list of names", where=where, todo="import the table again")
    return names


def _info(file: McapFile, states: list[CompensationState]) -> RecordingInfo:
    attached = file.attachments.get("recording.json")
    if attached is not None:
        return parse_info(attached, f"{file.path}: recording.json")
    robot = file.metadata.get("robot_file") or ("galen" if file.metadata.get("robot") else None)
    values: dict[str, Any] = {"schema": 1, "robot": robot, "predict": "wrench"}
    values |= {key: file.metadata[key] for key in ("base_link", "sensor_link") if file.metadata.get(key)}
    values |= {"sensor_serial": serial} if (serial := file.metadata.get("serial_number")) else {}
    values |= {"virtual": True} if file.metadata.get("virtual") == "true" else {}
    where = f"{file.path}: compensation/state: tool_file"
    tools = {state.tool_file for state in states if state.tool_file}
    if tools:
        values |= _tool_of(next(s.tool_file for s in reversed(states) if s.tool_file), where)
    if len(tools) > 1:
        file.warnings.append("the tool or its calibration was changed during the recording; the last one is given")
    return info_of(values, str(file.path))


def _tool_of(text: str, where: str) -> dict[str, Any]:
    try:
        tool = load_json(text)
    except DocumentError as error:
        raise UsageError(error.what, where=where, todo="record it again") from None
    if not isinstance(tool, dict):
        raise UsageError("not a tool's file", where=where, todo="record it again")
    return tool_info(tool)


def tool_info(tool: dict[str, Any]) -> dict[str, Any]:
    """The keys of recording.json from a tool's file; its constant bias has no key there and is left free."""
    part = {key: tool[key] for key in ("name", "mass", "com", "inertia", "tip") if tool.get(key) is not None}
    values: dict[str, Any] = {"tool": part, "model": {"bias": "free"}}
    values |= {key: tool[key] for key in ("zeroed_at", "gravity") if tool.get(key) is not None}
    body = tool.get("bias_body")
    if body:
        known = isinstance(body, dict)
        values["bias_body"] = {key: body[key] for key in ("mass", "com") if key in body} if known else body
    return values

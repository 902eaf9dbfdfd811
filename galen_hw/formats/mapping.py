"""The map from a file's columns to ours: found by name, type and unit, or read from a TOML that a person edited."""

import json
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from galen_hw.documents import DocumentError, load_toml
from galen_hw.errors import UsageError
from galen_hw.formats.contents import Contents
from galen_hw.formats.names import Match, chosen, fits, matches, quantity_of
from galen_hw.formats.units import ALLOWED, FACTORS, factor
from galen_hw.recording.recording import FIXED_COLUMNS, group_of


@dataclass(frozen=True)
class Entry:
    """One column of ours.

    Args:
        target: our column; stream, column: of the file; unit: that it is in, empty for SI; scale: a further factor (a sign).
    """

    target: str
    stream: str
    column: str
    unit: str = ""
    scale: float = 1.0

    @property
    def factor(self) -> float:
        """From the file's number to SI."""
        return self.scale * (factor(self.unit, quantity_of(self.target)) or 1.0)


@dataclass
class Map:
    """What becomes of a file.

    Args:
        entries: the columns that are taken.
        info: keys of recording.json.
        rows: stream whose samples are the rows; empty: of the group that is compared.
        stamps: whose clock is joined on: "header" (the samples' own) or "log" (when they were written).
        offset_s: added to the clock of a stream.
        can: how a CAN log is decoded: the keys of `can_log`.
        doubtful: families of columns for which several sources are as likely; nothing is taken for them.
        beside: folder of the TOML, for the files that it names.
        also: further files of the same recording (joints beside a sensor's log).
        left: columns that are another reading of what is taken, and are not taken beside it: one line a stream.
    """

    entries: list[Entry] = field(default_factory=list)
    info: dict[str, Any] = field(default_factory=dict)
    rows: str = ""
    stamps: str = "header"
    offset_s: dict[str, float] = field(default_factory=dict)
    can: dict[str, Any] = field(default_factory=dict)
    doubtful: dict[str, list[str]] = field(default_factory=dict)
    beside: Path = Path()
    also: tuple[Path, ...] = ()
    left: list[str] = field(default_factory=list)


def guess(contents: Sequence[Contents]) -> Map:
    """The map that names, types and units suggest."""
    streams = [stream for one in contents for stream in one.streams]
    likely = [match for stream in streams for match in matches(stream)]
    found, doubtful = chosen(likely)
    seen = {(match.stream, match.column) for match in likely}
    taken = {(match.stream, match.column) for match in found}
    found = _with_orientation(found)
    entries = [Entry(m.target, m.stream, m.column, m.unit) for m in found]
    mapped = {stream for stream, _ in taken}
    left = []
    for stream in streams:
        # What else was measured by the same clock might matter; other topics are told, and can be asked for. A second reading
        # of the same thing (filtered, estimated) is none of its causes, and would be found to explain it.
        rest = [column for column in stream.columns if stream.name in mapped and (stream.name, column) not in taken]
        again = [column for column in rest if (stream.name, column) in seen]
        left += [f"{stream.title}: not taken beside what is: {', '.join(again)}"] if again else []
        others = (column for column in rest if column not in again)
        entries += [Entry(f"covariate.{_covariate(stream.name, c)}", stream.name, c) for c in others]
    info: dict[str, Any] = {}
    for one in contents:
        info |= one.info
    return Map(_unique(entries), info, doubtful=doubtful, left=left)


def _covariate(stream: str, column: str) -> str:
    return ".".join(part for part in (stream.strip("/").replace("/", "."), column) if part)


def _unique(entries: list[Entry]) -> list[Entry]:
    seen: dict[str, Entry] = {}
    for entry in entries:
        seen.setdefault(entry.target, entry)
    return list(seen.values())


def _with_orientation(found: list[Match]) -> list[Match]:
    """Where a wrench was recorded and no joints, an orientation is how the sensor stood."""
    families = {match.family for match in found}
    if "wrench.force" not in families or families & {"joint.*.position", "sensor.orientation"}:
        return found
    turns = [_sensor(m) for m in found if m.family == "pose.orientation"]
    kept = found if "pose.position" in families else [m for m in found if m.family != "pose.orientation"]
    return [*kept, *turns]


def _sensor(match: Match) -> Match:
    target = match.target.replace("pose.", "sensor.")
    return Match(target, match.stream, match.column, match.unit, match.weight, match.source)


def write_map(what: Map, path: Path) -> None:
    """Write the map as a TOML that can be edited and given back.

    Raises:
        UsageError: it cannot be written.
    """
    lines = [
        "# galen-hw import: which column of the file is which of ours (docs/import.md). Edit it, and give it with --map.",
        f"also = {_toml([str(one) for one in what.also])}  # further files of the same recording, beside this map",
        f"rows = {_toml(what.rows)}  # stream whose samples are the rows; empty: of the group that is compared",
        f"stamps = {_toml(what.stamps)}  # header: the samples' own; log: when they were written",
    ]
    for family, places in what.doubtful.items():
        lines += [f"# {family}: several are as likely, choose one:", *(f"#   {place}" for place in places)]
    for name, table in (("recording", what.info), ("offset_s", what.offset_s), ("can", what.can)):
        lines += [
            "",
            f"[{name}]",
            *(f"{_toml(key)} = {_toml(value)}" for key, value in table.items() if value is not None),
        ]
    lines += [
        "",
        "[columns]",
        "# Keys: wrench.force.x, wrench.torque.x, joint.NAME.position, sensor.orientation.x, ... (docs/recording.md).",
        "# covariate.NAME is a column that is not known: where it is one of these, rename its key. unit and scale may be added.",
    ]
    for entry in what.entries:
        parts = {"stream": entry.stream, "column": entry.column}
        parts |= {"unit": entry.unit} if entry.unit else {}
        inner = ", ".join(f"{key} = {_toml(value)}" for key, value in parts.items())
        inner += f", scale = {entry.scale}" if entry.scale != 1.0 else ""
        lines.append(f"{_toml(entry.target)} = {{ {inner} }}")
    try:
        path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    except OSError as error:
        raise UsageError(f"cannot be written ({error.strerror})", where=str(path)) from error


def _toml(value: Any) -> str:
    if isinstance(value, dict):
        inside = ", ".join(f"{_toml(k)} = {_toml(v)}" for k, v in value.items() if v is not None)
        return "{ " + inside + " }"
    if isinstance(value, list | tuple):
        return f"[{', '.join(map(_toml, value))}]"
    # A JSON string, number or boolean is one of TOML too, except for DEL and what is beyond the basic plane.
    return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")


def read_map(path: Path) -> Map:
    """A map that was written by `write_map` and perhaps edited.

    Raises:
        UsageError: not there, not TOML, or a key, a column or a unit that is none; the line names it.
    """
    try:
        found = load_toml(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise UsageError(
            f"cannot be read ({error.strerror})", where=str(path), todo="galen-hw import --write-map"
        ) from error
    except (UnicodeDecodeError, DocumentError) as error:
        where = error.within(str(path)) if isinstance(error, DocumentError) else str(path)
        raise UsageError(str(error), where=where) from None
    known = {
        "also": list,
        "rows": str,
        "stamps": str,
        "recording": dict,
        "offset_s": dict,
        "can": dict,
        "columns": dict,
    }
    for key, value in found.items():
        if key not in known or not isinstance(value, known[key]):
            raise UsageError("not a key of a map", where=f"{path}: {key}", todo=f"known are {', '.join(known)}")
    if found.get("stamps", "header") not in ("header", "log"):
        raise UsageError(f"{found['stamps']!r} is no clock", where=f"{path}: stamps", todo="header or log")
    for name, value in found.get("offset_s", {}).items():
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise UsageError("not a number of seconds", where=f"{path}: offset_s.{name}")
    entries = [_entry(target, value, f"{path}: columns.{target}") for target, value in found.get("columns", {}).items()]
    also = tuple(path.parent / str(name) for name in found.get("also", []))
    rest = {key: found[key] for key in ("rows", "stamps", "offset_s", "can") if key in found}
    return Map(entries, info=found.get("recording", {}), beside=path.parent, also=also, **rest)


def _entry(target: str, value: Any, where: str) -> Entry:
    if group_of(target) == "covariate" and not target.startswith("covariate.") and target not in FIXED_COLUMNS:
        raise UsageError("not a column of a recording", where=where, todo="docs/recording.md lists them")
    if not isinstance(value, dict) or not isinstance(value.get("column"), str):
        raise UsageError("names no column", where=where, todo='e.g. { stream = "/ft", column = "wrench.force.x" }')
    unknown = set(value) - {"stream", "column", "unit", "scale"}
    if unknown:
        raise UsageError(f"{unknown.pop()} is not known", where=where, todo="known are stream, column, unit, scale")
    unit, scale = value.get("unit", ""), value.get("scale", 1.0)
    quantity = quantity_of(target)
    if not isinstance(unit, str) or (unit and factor(unit, quantity) is None):
        units = ", ".join(name for family in ALLOWED[quantity] for name in FACTORS[family] if name)
        raise UsageError(f"{unit!r} is no unit of {quantity}", where=where, todo=f"known are {units}")
    if isinstance(scale, bool) or not isinstance(scale, int | float):
        raise UsageError("scale is not a number", where=where)
    return Entry(target, str(value.get("stream", "")), value["column"], unit, float(scale))


def check_map(what: Map, contents: Sequence[Contents]) -> None:
    """Refuse a map that names what the file does not hold.

    Raises:
        UsageError: a stream or column that is not there; the line names those that are.
    """
    streams = {stream.name: stream for one in contents for stream in one.streams}
    for name in [*what.offset_s, *([what.rows] if what.rows else [])]:
        if name not in streams:
            raise UsageError(f"there is no stream {name!r}", todo=f"there are {_some(streams)}")
    for entry in what.entries:
        if entry.stream not in streams:
            raise UsageError(
                f"there is no stream {entry.stream!r}", where=entry.target, todo=f"there are {_some(streams)}"
            )
        if entry.column not in streams[entry.stream].columns:
            where, todo = (
                f"{entry.target}: {entry.stream or 'table'}",
                f"there are {_some(streams[entry.stream].columns)}",
            )
            raise UsageError(f"there is no column {entry.column!r}", where=where, todo=todo)


def _some(names: Any) -> str:
    listed = [repr(name) for name in names]
    return ", ".join(listed[:8]) + (f" and {len(listed) - 8} more" if len(listed) > 8 else "")


__all__ = ["Entry", "Map", "check_map", "fits", "guess", "read_map", "write_map"]

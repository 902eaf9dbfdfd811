"""CSV of NDI Track and ToolBox, and of NDI's CAPI sample: tools side by side, in mm, quaternions with Q0 first."""

import csv
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from galen_hw.errors import UsageError
from galen_hw.formats.contents import Contents, Head, Stream, unreadable
from galen_hw.spatial import Array

STARTS: Final = ("Port", "ToolInfo")
NUMBERS: Final = ("Q0", "Qx", "Qy", "Qz", "Tx", "Ty", "Tz", "Error")
STATES: Final = ("State", "TransformStatus")
GOOD: Final = ("OK", "OK (PARTIAL)", "VALID", "ENABLED", "0", "00", "")
BAD_FLOAT: Final = -1e20
"""NDI writes -3.697314e28 where nothing was measured (Polaris API guide)."""


@dataclass(frozen=True)
class Tool:
    """Where a tool's columns stand: first, and by name."""

    name: str
    places: dict[str, int]


def sniff(head: Head) -> bool:
    """By the names of the header."""
    return bool(head.lines) and bool(_tools(_header(head.lines[0])))


def _header(line: str) -> list[str]:
    return [cell.strip() for cell in next(csv.reader([line]), [])]


def _tools(names: Sequence[str]) -> list[Tool]:
    """Tools of a header; none where it is not one of NDI's."""
    if not names or names[0] not in ("Tools", "ToolCount"):
        return []
    starts = [i for i, name in enumerate(names) if name.startswith(STARTS) and not name.startswith("PortHandle")]
    tools = []
    for start, end in zip(starts, [*starts[1:], len(names)], strict=True):
        places: dict[str, int] = {}
        for i in range(start, end):
            places.setdefault(names[i].rstrip("#"), i)  # markers repeat Tx, Ty, Tz behind the tool's own
        if all(name in places for name in NUMBERS):
            tools.append(Tool(names[start], places))
    return tools


def read(path: Path) -> Contents:
    """Each tool's origin as a target, in m; its quaternion and error beside it.

    Raises:
        UsageError: it cannot be read, or no tool was ever seen.
    """
    try:
        rows = list(csv.reader(path.read_text(encoding="utf-8-sig", errors="replace").splitlines()))
    except (OSError, csv.Error) as error:
        raise unreadable(path, error) from None
    tools = _tools([cell.strip() for cell in rows[0]])
    body = [row for row in rows[1:] if any(cell.strip() for cell in row)]
    needed = 1 + max(max(tool.places[name] for name in NUMBERS) for tool in tools)
    whole = [row for row in body if len(row) >= needed]
    if not whole:
        raise UsageError("there are no rows", where=str(path), todo="record something first")
    stream = Stream("", {}, "NDI tools")
    if len(whole) < len(body):
        stream.lost["a row that is not whole"] = len(body) - len(whole)
    contents = Contents([stream], how=["NDI's mm are read as m, Q0 as the real part of the quaternion"])
    for number, tool in enumerate(tools, 1):
        _add(stream, tool, number, whole, contents)
    _clock(stream, tools[0], whole, contents)
    return contents


def _add(stream: Stream, tool: Tool, number: int, rows: list[list[str]], contents: Contents) -> None:
    values = {name: _column(rows, tool.places[name]) for name in NUMBERS}
    state = next((tool.places[name] for name in STATES if name in tool.places), None)
    seen = np.ones(len(rows), dtype=bool)
    if state is not None:
        seen = np.array([row[state].strip().upper() in GOOD for row in rows])
    place = np.stack([values[name] for name in ("Tx", "Ty", "Tz")])
    seen &= np.isfinite(place).all(axis=0) & (place > BAD_FLOAT).all(axis=0)
    if not seen.all():
        contents.notes.append(
            f"{tool.name}: not seen in {int((~seen).sum())} of {len(rows)} rows, which are left empty"
        )
    for axis in "xyz":
        column = f"{tool.name} T{axis}"
        stream.columns[column] = np.where(seen, values[f"T{axis}"], np.nan)
        stream.units[column] = "mm"
        stream.hints[column] = f"target.{number}.position.{axis}"
    for name, ours in (("Q0", "w"), ("Qx", "x"), ("Qy", "y"), ("Qz", "z"), ("Error", "error")):
        column = f"{tool.name} {name}"
        stream.columns[column] = np.where(seen, values[name], np.nan)
        stream.hints[column] = f"covariate.target_{number}.{ours}"


def _column(rows: list[list[str]], place: int) -> Array:
    return np.array([_number(row[place]) for row in rows])


def _number(cell: str) -> float:
    try:
        return float(cell)
    except ValueError:
        return np.nan


def _clock(stream: Stream, tool: Tool, rows: list[list[str]], contents: Contents) -> None:
    """The samples' own stamps where there are any; frame numbers count at a rate that the file does not say."""
    places = tool.places
    if "timespec_s" in places and "timespec_ns" in places:
        seconds, rest = _column(rows, places["timespec_s"]), _column(rows, places["timespec_ns"])
        if np.isfinite(seconds + rest).all():
            stream.origin_ns = int(seconds[0]) * 1_000_000_000 + int(rest[0])
            stream.time = (seconds - seconds[0]) + (rest - rest[0]) * 1e-9
            return
    stream.columns["Frame"] = _column(rows, places.get("Frame", 0))
    contents.notes.append(
        'it says no times, only frame numbers: "time" = { column = "Frame", scale = 0.016666667 } in a map for 60 Hz'
    )

"""Text exports of NDI First Principles (Optotrak): a head of "name: value", then frames with x y z of every marker."""

import re
from pathlib import Path
from typing import Final

import numpy as np

from galen_hw.formats.contents import Contents, Head, head_of
from galen_hw.formats.csv_table import Layout, layout_of, read_stream

_HEAD: Final = re.compile(r"\s*\"?(Number of frames|Frequency|Units)\"?\s*[:,\t ]+\s*(.+?)\s*$", re.IGNORECASE)
_AXIS: Final = re.compile(r"(.+?)[\s_.]*([xyz])$", re.IGNORECASE)
BAD_FLOAT: Final = -1e20


def sniff(head: Head) -> bool:
    """By the head, and a table whose first column is the frame."""
    about = _about(head)
    layout = layout_of(head.lines[:100]) if "frequency" in about else None
    return layout is not None and layout.header is not None and layout.names[0].lower().startswith("frame")


def _about(head: Head) -> dict[str, str]:
    return {m[1].lower(): m[2].strip('", \t') for line in head.lines[:30] if (m := _HEAD.match(line))}


def read(path: Path) -> Contents:
    """Every marker as a target, in m; time by the frame and the frequency of the head.

    Raises:
        UsageError: it cannot be read.
    """
    head = head_of(path)
    about = _about(head)
    layout = layout_of(head.lines[:400])
    stream, notes, passed = read_stream(path, layout if isinstance(layout, Layout) else None)
    notes = [line for line in notes if "before the names" not in line]
    unit = about.get("units", "mm")
    markers: dict[str, int] = {}
    missing = 0
    for column, values in list(stream.columns.items()):
        found = _AXIS.match(column)
        lost = values < BAD_FLOAT
        missing += int(lost.sum())
        stream.columns[column] = np.where(lost, np.nan, values)
        if found is None or f"{found[1]}" == "":
            continue
        number = markers.setdefault(found[1].strip(), len(markers) + 1)
        stream.units[column] = unit
        stream.hints[column] = f"target.{number}.position.{found[2].lower()}"
    if missing:
        notes.append(f'{missing} cells hold NDI\'s number for "not seen" and are left empty')
    frame = stream.columns.pop(stream_frame(list(stream.columns)))
    frequency = float(re.findall(r"[\d.]+", about["frequency"])[0])
    stream.time = (frame - frame[0]) / frequency
    how = [f"{unit} as m; time by the frame at {frequency:g} Hz"]
    named = ", ".join(f"target.{n} is {name}" for name, n in markers.items())
    return Contents([stream], passed, [*notes, named] if named else notes, how=how)


def stream_frame(names: list[str]) -> str:
    """The column of the frame's number."""
    return next(name for name in names if name.lower().startswith("frame"))

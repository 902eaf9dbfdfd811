"""Which column of a table is its clock, and since when it counts."""

import re
from typing import Final

import numpy as np

from galen_hw.clock import NS_PER_S
from galen_hw.formats.contents import Contents, Stream
from galen_hw.formats.names import plain
from galen_hw.formats.units import FACTORS, canonical, split_unit

_TIME: Final = re.compile(
    r"(?:time|t|timestamp|time_?stamp|stamp|seconds|secs?|elapsed(?:_time)?|duration|timestamps)$"
)
_EPOCH: Final = (("ns", 1e17, 1e19), ("us", 1e14, 1e17), ("ms", 1e11, 1e14), ("s", 1e8, 1e11))
"""Whole stamps of the calendar lie between 1973 and 5138: by its size alone such a number says its unit."""


def take_clock(contents: Contents) -> Contents:
    """Give every stream of a table its clock, where it has none; the column is then no column any more."""
    for stream in contents.streams:
        if stream.time is None:
            _take(stream, contents.notes)
    return contents


def _take(stream: Stream, notes: list[str]) -> None:
    found = [column for column in stream.columns if _TIME.fullmatch(plain(split_unit(column)[0]))]
    # A name like ours before all others; else the first of the file.
    column = "time" if "time" in found else next(iter(found), None)
    if column is None:
        return
    if len(found) > 1:
        more = ", ".join(name for name in found if name != column)
        notes.append(f"{stream.title}: {column!r} is taken as the clock, not {more}")
    values = stream.columns.pop(column)
    unit = canonical(stream.units.pop(column, split_unit(column)[1]))
    empty = np.isnan(values)
    if empty.any():
        stream.columns = {name: cells[~empty] for name, cells in stream.columns.items()}
        stream.lost["without a time"] = int(empty.sum())
        values = values[~empty]
    if not len(values):
        stream.time = values
        return
    middle = float(np.median(np.abs(values)))
    epoch = next((name for name, low, high in _EPOCH if low <= middle < high), None)
    if not unit and epoch is not None:
        unit = epoch
        notes.append(f"{stream.title}: {column!r} counts {unit} since 1970, by its size")
    factor = FACTORS["time"].get(unit, 1.0)
    if epoch is None or epoch != (unit or "s"):
        stream.time = values * factor
        return
    # Differences first: a double holds nanoseconds of this century to a quarter of a microsecond.
    stream.origin_ns = round(float(values[0]) * factor * NS_PER_S)
    stream.time = (values - values[0]) * factor

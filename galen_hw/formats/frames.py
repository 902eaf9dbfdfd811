"""Data frames and nested arrays (MATLAB, HDF5, Parquet) as streams."""

import sys
from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from galen_hw.clock import NS_PER_S
from galen_hw.formats.contents import Contents, Stream
from galen_hw.formats.csv_table import numbers
from galen_hw.spatial import Array

if TYPE_CHECKING:
    import pandas as pd

MOST_CELLS: Final = 64
"""Wider arrays (images, spectra) are no columns."""
XYZ: Final = ("x", "y", "z")
WRENCH: Final = ("force.x", "force.y", "force.z", "torque.x", "torque.y", "torque.z")


def stream_of_frame(name: str, frame: "pd.DataFrame", contents: Contents) -> Stream:
    """A table; a clock in its index (timetables) is its time."""
    import pandas as pd

    stream = Stream(name, {})
    if isinstance(frame.index, pd.DatetimeIndex | pd.TimedeltaIndex):
        ns = frame.index.as_unit("ns").asi8
        absolute = isinstance(frame.index, pd.DatetimeIndex)
        stream.origin_ns = int(ns[0]) if absolute and len(ns) else None
        stream.time = (ns - (stream.origin_ns or 0)) / NS_PER_S
    for column in frame.columns:
        cells = frame[column]
        if (
            isinstance(cells.dtype, np.dtype)
            and cells.dtype == object
            and len(cells)
            and isinstance(cells.iloc[0], np.ndarray)
        ):
            stream.columns |= dict(split(str(column), np.stack(list(cells))))
            continue
        if pd.api.types.is_timedelta64_dtype(cells):
            stream.columns[str(column)] = cells.dt.total_seconds().to_numpy(dtype=float)
            stream.units[str(column)] = "s"
            continue
        values, bad, stamps = numbers(cells)
        if values is None:
            contents.passed.append(f"{'.'.join(filter(None, (name, str(column))))}: text, not taken")
            continue
        if stamps:
            stream.units[str(column)] = "s"
        if bad:
            contents.notes.append(f"{column}: {bad} cells that are no numbers are taken as not measured")
        stream.columns[str(column)] = values
    return stream


def split(name: str, values: "np.ndarray[Any, Any]") -> Iterator[tuple[str, Array]]:
    """(N, k) as k columns: of a vector x y z, of a wrench or quaternion where the width and the name say so, else by number."""
    if values.ndim == 1:
        yield name, np.asarray(values, dtype=float)
        return
    flat = values.reshape(len(values), -1)
    width, low = flat.shape[1], name.lower()
    parts: tuple[str, ...] = tuple(str(i) for i in range(width))
    if width == 3:
        parts = XYZ
    elif width == 6 and any(word in low for word in ("wrench", "ft", "force")):
        parts = WRENCH
    elif width == 4 and any(word in low for word in ("quat", "orient", "rot")):
        parts = ("x", "y", "z", "w")
    joined = "{0}[{1}]" if parts[0] == "0" else "{0}.{1}"
    for i, part in enumerate(parts):
        yield joined.format(name, part), np.asarray(flat[:, i], dtype=float)


def streams_of_arrays(tree: Mapping[str, Any], contents: Contents) -> None:
    """Arrays of a file as streams: those of one folder (or struct) and one length belong to one clock.

    Args:
        tree: arrays, data frames, or mappings of them, by name.
        contents: that they are added to.
    """
    _walk("", tree, contents)


def _walk(place: str, tree: Mapping[str, Any], contents: Contents) -> None:
    by_length: dict[int, dict[str, Array]] = {}
    for name, value in tree.items():
        here = ".".join(filter(None, (place, str(name))))
        if isinstance(value, Mapping):
            _walk(here, value, contents)
        elif _is_frame(value):
            contents.streams.append(stream_of_frame(here, value, contents))
        elif (array := _table(value)) is None:
            contents.passed.append(f"{here}: {_described(value)}, not taken")
        else:
            by_length.setdefault(len(array), {}).update(split(str(name), array))
    for length, columns in by_length.items():
        if length > 1 or len(by_length) == 1:
            label = place if len(by_length) == 1 else ".".join(filter(None, (place, f"rows {length}")))
            contents.streams.append(Stream(label, columns))
        else:
            contents.passed += [f"{'.'.join(filter(None, (place, name)))}: one number, not taken" for name in columns]


def _is_frame(value: Any) -> bool:
    """Whether it is a data frame; pandas is not loaded to find that there is none."""
    pandas = sys.modules.get("pandas")
    return pandas is not None and isinstance(value, pandas.DataFrame)


def _table(value: Any) -> "np.ndarray[Any, Any] | None":
    """(N,) or (N, k) numbers, samples along the first axis; None where it is none."""
    array = np.asarray(value)
    if array.dtype.kind not in "fiub" or array.size == 0 or array.ndim > 2:
        return None
    if array.ndim == 0:
        return array.reshape(1)
    if array.ndim == 2:
        # MATLAB's row vectors, and tables that lie on their side.
        if 1 in array.shape:
            return array.reshape(-1)
        array = array.T if array.shape[0] < array.shape[1] and array.shape[0] <= MOST_CELLS else array
        return array if array.shape[1] <= MOST_CELLS else None
    return array


def _described(value: Any) -> str:
    array = np.asarray(value)
    shape = " x ".join(map(str, array.shape)) or "one value"
    return f"{type(value).__name__ if array.dtype == object else array.dtype} of {shape}"

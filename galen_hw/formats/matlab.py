"""MATLAB files of versions 4, 5 to 7 and 7.3: arrays, structs, tables and timetables, by mat-io."""

import re
import warnings
from pathlib import Path
from typing import Any, Final

import numpy as np

from galen_hw.formats.contents import Contents, Head, needed, unreadable
from galen_hw.formats.frames import streams_of_arrays
from galen_hw.recording.info import INFO, URDF

_HEAD: Final = re.compile(rb"MATLAB \d\.\d MAT-file")


def sniff(head: Head) -> bool:
    """By the text that MATLAB writes in front, or the small header of version 4."""
    if _HEAD.match(head.data):
        return True
    words = np.frombuffer(head.data[:20], dtype="<i4") if len(head.data) >= 20 else np.zeros(5, dtype="<i4")
    kind, rows, columns, imaginary, name = words.tolist()
    known = kind in (0, 10, 20, 30, 40, 50) and imaginary in (0, 1) and rows > 0 and columns > 0 and 1 < name < 64
    return bool(known and head.data[20 : 20 + name].rstrip(b"\0").replace(b"_", b"").isalnum())


def read(path: Path) -> Contents:
    """The arrays, structs and tables that hold numbers.

    Raises:
        UsageError: it cannot be read, or the reader is not installed.
    """
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # it sets an option of pandas that is the default by now
            from matio import load_from_mat
    except ImportError as error:
        raise needed("mat-io", "a MATLAB file")(error) from None
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            found = load_from_mat(str(path))
    except Exception as error:  # noqa: BLE001 - a cut-off file makes the reader raise anything
        raise unreadable(path, error or type(error).__name__, "is it whole? save it again with -v7.3") from None
    contents = Contents()
    if "recording" in found:  # as our own export writes it
        for name, document in (("info", INFO), ("robot_description", URDF)):
            if isinstance(text := _plain(found.get(name)), np.ndarray) and text.dtype.kind == "U" and text.size == 1:
                contents.texts[document] = str(text.item())
                del found[name]
    streams_of_arrays({k: _plain(v) for k, v in found.items() if not k.startswith("__")}, contents)
    return contents


def _plain(value: Any) -> Any:
    """Structs as mappings."""
    if isinstance(value, np.ndarray) and value.dtype.names:
        record = value.reshape(-1)[0] if value.size == 1 else value
        return {name: _plain(record[name]) for name in value.dtype.names}
    if isinstance(value, np.ndarray) and value.dtype == object and value.size == 1:
        return _plain(value.reshape(-1)[0])
    if isinstance(value, np.void) and value.dtype.names:
        return {name: _plain(value[name]) for name in value.dtype.names}
    if isinstance(value, dict):
        return {name: _plain(inner) for name, inner in value.items()}
    return value

"""HDF5: every data set of numbers; those of one group and length belong to one clock."""

from pathlib import Path
from typing import Any, Final

import numpy as np

from galen_hw.formats.contents import Contents, Head, needed, unreadable
from galen_hw.formats.frames import streams_of_arrays

MAGIC: Final = b"\x89HDF\r\n\x1a\n"


def sniff(head: Head) -> bool:
    """By its signature, which may stand at 0, 512, 1024, ..."""
    return any(head.data[place : place + 8] == MAGIC for place in (0, 512, 1024, 2048, 4096))


def read(path: Path) -> Contents:
    """The data sets, with units from an attribute `units` or `unit`.

    Raises:
        UsageError: it cannot be read, or h5py is not installed.
    """
    try:
        import h5py
    except ImportError as error:
        raise needed("h5py", "an HDF5 file")(error) from None
    contents = Contents()
    units: dict[str, str] = {}
    try:
        with h5py.File(path, "r") as file:
            tree = _tree(file, units, h5py)
    except (OSError, RuntimeError, KeyError, ValueError) as error:
        raise unreadable(path, error, "is it whole?") from None
    streams_of_arrays(tree, contents)
    for stream in contents.streams:
        for column in stream.columns:
            head = ".".join(filter(None, (stream.name.removeprefix("rows ").lstrip("0123456789"), column)))
            for name in (head, head.rpartition(".")[0], head.partition("[")[0]):
                if name in units:
                    stream.units[column] = units[name]
                    break
    return contents


def _tree(group: Any, units: dict[str, str], h5py: Any, place: str = "") -> dict[str, Any]:
    out: dict[str, Any] = {}
    for name, item in group.items():
        here = ".".join(filter(None, (place, name)))
        if isinstance(item, h5py.Group):
            out[name] = _tree(item, units, h5py, here)
            continue
        if not isinstance(item, h5py.Dataset):
            continue
        value = item[()]
        if isinstance(value, np.ndarray) and value.dtype.names:
            out[name] = {field: value[field] for field in value.dtype.names}
        else:
            out[name] = value
        unit = item.attrs.get("units", item.attrs.get("unit"))
        if unit is not None:
            units[here] = unit.decode() if isinstance(unit, bytes) else str(unit)
    return out

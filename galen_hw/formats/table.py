"""The table of formats: each one file with `sniff(head) -> bool` and `read(path) -> Contents`.

To add a format: one file, one line here. The first that knows the content is taken, so that what is special stands before
what is general; names of files decide nothing.
"""

import importlib
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Final

from galen_hw.errors import UsageError
from galen_hw.formats.contents import Contents, Head, head_of


@dataclass(frozen=True)
class Format:
    """A line of the table.

    Args:
        name: of the format, for people.
        module: of this package, imported when it is asked.
    """

    name: str
    module: str

    @property
    def reader(self) -> ModuleType:
        """The module."""
        return importlib.import_module(f"galen_hw.formats.{self.module}")


FORMATS: Final = (
    Format("ROS 2 bag", "rosbag2"),
    Format("ROS 1 bag", "rosbag1"),
    Format("MCAP", "mcap_any"),
    Format("MATLAB", "matlab"),
    Format("HDF5", "hdf5"),
    Format("Parquet", "parquet"),
    Format("CAN log", "can_log"),
    Format("NDI Track or ToolBox CSV", "ndi_toolbox"),
    Format("NDI First Principles", "ndi_first_principles"),
    Format("UR RTDE CSV", "ur_rtde"),
    Format("libfranka log", "libfranka"),
    Format("CSV", "csv_table"),
)

ELSE: Final = (
    (b"PK\x03\x04", b"[Content_Types].xml", "an Excel workbook", "save the sheet as CSV"),
    (b"\xd0\xcf\x11\xe0", b"", "an Excel workbook", "save the sheet as CSV"),
    (b"PK\x03\x04", b"", "a packed file", "unpack it"),
    (b"\x1f\x8b", b"", "a packed file", "unpack it: gunzip"),
    (b"\x28\xb5\x2f\xfd", b"", "a packed file", "unpack it: unzstd"),
)
"""What is not read, by how it begins and by what is in it: what it is, and what to do."""


def format_of(path: Path) -> tuple[Format, Head]:
    """The format of a file or folder.

    Raises:
        UsageError: it is not there, or of none that is known.
    """
    head = head_of(path)
    found = next((one for one in FORMATS if one.reader.sniff(head)), None)
    if found is None:
        for begin, within, what, todo in ELSE:
            if head.data.startswith(begin) and within in head.data:
                raise UsageError(what, where=str(path), todo=todo)
        if path.suffix == ".csv" and len(head.text.strip().splitlines()) == 1:
            raise UsageError("there are no rows", where=str(path), todo="record something first")
        known = ", ".join(one.name for one in FORMATS)
        what = "is empty" if path.is_file() and not head.data else "not a format that is known"
        raise UsageError(what, where=str(path), todo=f"known are table folders and {known}: docs/import.md")
    return found, head


def read_contents(path: Path) -> tuple[str, Contents]:
    """Name of the format, and all of a file or folder.

    Raises:
        UsageError: it is not there, of no known format, or cannot be read.
    """
    found, _ = format_of(path)
    contents = found.reader.read(path)
    assert isinstance(contents, Contents)
    return found.name, contents

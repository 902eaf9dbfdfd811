"""Recordings as files of other programs: one file a format, one line in the table `EXPORTS`."""

import importlib
import tempfile
from pathlib import Path
from typing import Final

from galen_hw.errors import UsageError
from galen_hw.recording import Recording

EXPORTS: Final[dict[str, tuple[str, str]]] = {
    # name: (module with `write(recording, path) -> lines`, what it is)
    "mat": ("galen_hw.formats.writing.matlab", "a MATLAB file with one table"),
    "rosbag2": ("galen_hw.formats.writing.rosbag2", "a ROS 2 bag: WrenchStamped, JointState, PoseStamped"),
    "foxglove": ("galen_hw.formats.writing.foxglove_mcap", "an MCAP file with Foxglove's own schemas"),
}


def export(recording: Recording, path: Path, kind: str, *, overwrite: bool = False) -> list[str]:
    """Write a recording in a format of `EXPORTS`, all or nothing; what it has no place for, one line each.

    Raises:
        UsageError: the file is there already or cannot be written, or a package is not installed.
    """
    if path.exists() and not (overwrite and path.is_file()):
        raise UsageError("is there already", where=str(path), todo="give another name, or --overwrite")
    if not path.parent.is_dir():
        raise UsageError("there is no such folder", where=str(path.parent), todo="make it first")
    try:
        with tempfile.TemporaryDirectory(prefix=f".{path.name}.", dir=path.parent) as scratch:
            ready = Path(scratch) / path.name  # bags name their files after their folder
            lines: list[str] = importlib.import_module(EXPORTS[kind][0]).write(recording, ready)
            ready.replace(path)
    except OSError as error:
        raise UsageError(f"cannot be written ({error.strerror or error})", where=str(path)) from error
    return lines

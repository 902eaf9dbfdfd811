"""Recordings: what was measured, from MCAP files and from table folders alike, and the way back to either."""

from pathlib import Path

from galen_hw.errors import UsageError
from galen_hw.recording.info import BiasBody, Compliance, Model, RecordingInfo, Tool
from galen_hw.recording.recording import WRENCH, Recording
from galen_hw.recording.table import read_table, write_table

__all__ = [
    "WRENCH",
    "BiasBody",
    "Compliance",
    "Model",
    "Recording",
    "RecordingInfo",
    "Tool",
    "read_recording",
    "write_table",
]


def read_recording(path: Path | str, *, simulation: Path | str | None = None) -> Recording:
    """Read an MCAP file or a table folder (`docs/recording.md`).

    Args:
        path: the folder, one of its files, or an MCAP file.
        simulation: a table someone else simulated; the sub-folder `simulation/` is used without being asked.

    Raises:
        UsageError: nothing there, or not a recording; the text names the file, column and row.
    """
    path = Path(path)
    if not path.exists():
        raise UsageError("there is no such recording", where=str(path), todo="give a folder or an MCAP file")
    return read_table(path, simulation=None if simulation is None else Path(simulation))

"""Recordings: what was measured, from MCAP files and from table folders alike, and the way back to either."""

from dataclasses import replace
from pathlib import Path

from galen_hw.errors import UsageError
from galen_hw.recording.checks import check_simulation
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
    "beside",
    "read_recording",
    "write_table",
]


def read_recording(path: Path | str, *, simulation: Path | str | None = None, compensated: bool = False) -> Recording:
    """Read an MCAP file or a table folder (`docs/recording.md`).

    Args:
        path: the folder, one of its files, or an MCAP file.
        simulation: a recording that someone else simulated; a table's sub-folder `simulation/` is used without being
            asked.
        compensated: of an MCAP file, also give the compensated wrench, as `covariate.compensated.*`.

    Raises:
        UsageError: nothing there, or not a recording; the text names the file, column and row.
    """
    path = Path(path)
    if not path.exists():
        raise UsageError("there is no such recording", where=str(path), todo="check the path")
    if path.is_file() and path.suffix not in (".csv", ".parquet", ".json"):
        from galen_hw.recording.from_mcap import read_mcap

        recording = read_mcap(path, compensated=compensated)
    else:
        recording = read_table(path)
    if simulation is None:
        return recording
    simulation = Path(simulation)
    simulated = read_table(simulation, info_needed=False) if simulation.is_dir() else read_recording(simulation)
    return beside(recording, simulated)


def beside(recording: Recording, simulated: Recording) -> Recording:
    """Return a recording with what someone else simulated beside it, and what is odd about that."""
    old = () if recording.simulation is None else tuple(w for w in recording.warnings if w.startswith("simulation: "))
    kept = tuple(w for w in recording.warnings if w not in old)
    return replace(recording, simulation=simulated, warnings=(*kept, *check_simulation(recording, simulated)))

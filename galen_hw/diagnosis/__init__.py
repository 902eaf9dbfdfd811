"""Locate, name, model and prove what a model left out of a recording: `diagnose` is the face."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from galen_hw.diagnosis.result import Diagnosis, Finding

if TYPE_CHECKING:
    from galen_hw.recording import Recording

    Source = Recording | Path | str

__all__ = ["Diagnosis", "Finding", "diagnose"]


def diagnose(
    recording: "Source | Sequence[Source]",
    *,
    simulation: Path | str | None = None,
    holdout: "float | Source | Sequence[Source]" = 0.3,
    seed: int = 0,
    repair: bool = True,
    progress: Callable[[str, float], None] | None = None,
) -> Diagnosis:
    """Return what a model leaves out of a recording: the verdict, findings with parameters, what they take on held-out data.

    Args:
        recording: an MCAP file or table folder, read or not; several of one machine are fitted as one.
        simulation: a table that someone else simulated, of a recording that is not read yet.
        holdout: the share of contiguous blocks to set aside, or recordings of the same machine to be judged on.
        seed: of the choice of blocks.
        repair: put right in memory what is certain (units, axes, clocks); else the same is refused.
        progress: told what is being done and which share (0 to 1) is behind.

    Raises:
        UsageError: a recording cannot be read or compared; the text says what, where and what to do.
    """
    # What fits takes a second to load, and the daemon needs none of it.
    from galen_hw.diagnosis.recordings import diagnose_recordings

    share, judges = (holdout, []) if isinstance(holdout, float | int) else (0.3, _read(holdout))
    work = diagnose_recordings(
        _read(recording, simulation), holdout=judges, share=share, seed=seed, repair=repair, progress=progress
    )
    return work.diagnosis


def _read(given: "Source | Sequence[Source]", simulation: Path | str | None = None) -> "list[Recording]":
    """The recordings, those that are paths read."""
    from galen_hw.recording import Recording, read_recording

    sources = [given] if isinstance(given, Recording | Path | str) else list(given)
    return [one if isinstance(one, Recording) else read_recording(one, simulation=simulation) for one in sources]

"""What a user gives as a recording: a path, or one that was read (and perhaps changed) already."""

from collections.abc import Sequence
from pathlib import Path

from galen_hw.formats import read as read_recording
from galen_hw.recording import Recording

Given = Recording | Path | str
"""A recording, or the path of one."""


def recording_of(given: Given) -> Recording:
    """Read a recording where a path is given.

    Raises:
        UsageError: nothing is there, or it is no recording.
    """
    return given if isinstance(given, Recording) else read_recording(given)


def recordings_of(given: Given | Sequence[Given]) -> list[Recording]:
    """Read one recording or several, in the order in which they are given.

    Raises:
        UsageError: nothing is there, or it is no recording.
    """
    several = [given] if isinstance(given, (Recording, Path, str)) else given
    return [recording_of(one) for one in several]

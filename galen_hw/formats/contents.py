"""What a format gives: streams of named columns on clocks of their own, and what of the file could not be read."""

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import numpy.typing as npt

from galen_hw.clock import NS_PER_S
from galen_hw.errors import UsageError
from galen_hw.spatial import Array

Nanoseconds = npt.NDArray[np.int64]


@dataclass
class Stream:
    """Samples of one topic, table or sensor.

    Args:
        name: as in the file: a topic, a table, a data set's folder; empty where the file is one table.
        columns: (N,) each, as in the file, NaN where a cell was empty; `units` of those that the file or name gives.
        kind: type of the messages, for people.
        time: (N,) s after `origin_ns`, by the samples' own stamps; None where only the order is known.
        origin_ns: of `time`, since the epoch; None for a clock of the file's own.
        logged: (N,) s on the same origin, by when they were written to the file; None where it is the same or not known.
        frame: that the samples are given in, where the file says so.
        lost: samples or rows that were there and are not in the columns, by reason.
        hints: columns of ours by column, where the format itself says what a column is.
    """

    name: str
    columns: dict[str, Array]
    kind: str = ""
    time: Array | None = None
    origin_ns: int | None = None
    logged: Array | None = None
    units: dict[str, str] = field(default_factory=dict)
    frame: str = ""
    lost: dict[str, int] = field(default_factory=dict)
    hints: dict[str, str] = field(default_factory=dict)

    def __len__(self) -> int:
        """Number of samples that are there."""
        return len(next(iter(self.columns.values()), () if self.time is None else self.time))

    @property
    def rows_in(self) -> int:
        """Number of samples that the file held."""
        return len(self) + sum(self.lost.values())

    @property
    def title(self) -> str:
        """For people."""
        return " ".join(filter(None, (self.name, f"({self.kind})" if self.kind else ""))) or "table"


@dataclass
class Contents:
    """All of a file.

    Args:
        streams: that hold numbers.
        passed: topics and data sets that hold none that could be taken, with the number of messages and why.
        notes: what is odd or was lost, one line each.
        texts: documents in the file that belong to a recording, by name: `robot.urdf`, `recording.json`.
        info: keys of recording.json that the file itself says.
        how: what the format did to numbers, one line each (a wrench that was turned, mm as m).
    """

    streams: list[Stream] = field(default_factory=list)
    passed: list[str] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    texts: dict[str, str] = field(default_factory=dict)
    info: dict[str, object] = field(default_factory=dict)
    how: list[str] = field(default_factory=list)


@dataclass(frozen=True)
class Head:
    """The beginning of a file, by which its format is told: content, not its name.

    Args:
        path: a file, or a folder.
        data: the first 64 KiB; empty for a folder.
    """

    path: Path
    data: bytes

    @property
    def text(self) -> str:
        """As text; empty where it is none."""
        if self.data[:2] in UTF16:
            return self.data.decode("utf-16", "ignore")
        if b"\0" in self.data:
            return ""
        for encoding in ("utf-8-sig", "latin-1"):
            try:
                return self.data.decode(encoding)
            except UnicodeDecodeError as error:
                if error.start > len(self.data) - 4:  # cut within a character
                    return self.data[: error.start].decode(encoding)
        return ""

    @property
    def lines(self) -> list[str]:
        """Of the text, the last one left out where it may be cut."""
        lines = self.text.splitlines()
        return lines[:-1] if len(self.data) >= HEAD_BYTES and len(lines) > 1 else lines


HEAD_BYTES = 64 * 1024
UTF16 = (b"\xff\xfe", b"\xfe\xff")
"""How a text in UTF-16 begins: what Excel saves as "Unicode text"."""
BLOCK = 65536


def head_of(path: Path) -> Head:
    """The beginning of a file or folder.

    Raises:
        UsageError: it is not there, or cannot be read.
    """
    if path.is_dir():
        return Head(path, b"")
    try:
        with path.open("rb") as file:
            return Head(path, file.read(HEAD_BYTES))
    except FileNotFoundError:
        raise UsageError("there is no such recording", where=str(path), todo="give a file or a folder") from None
    except OSError as error:
        raise UsageError(f"cannot be read ({error.strerror})", where=str(path)) from error


def relative(stamps_ns: Nanoseconds, origin_ns: int) -> Array:
    """Seconds after an origin; the difference is made in whole nanoseconds, so that no digit is lost."""
    out = np.empty(len(stamps_ns))
    for start in range(0, len(out), BLOCK):  # so that of a million stamps no second array of differences is held
        out[start : start + BLOCK] = (stamps_ns[start : start + BLOCK] - origin_ns) / NS_PER_S
    return out


def unreadable(path: Path, error: object, todo: str = "check the file") -> UsageError:
    """The one line of a file whose format is known and which a reader refused."""
    return UsageError(" ".join(f"cannot be read ({error})".split())[:300], where=str(path), todo=todo)


def needed(package: str, wanted: str) -> Callable[[ImportError], UsageError]:
    """The line that says which package is missing."""

    def line(_: ImportError) -> UsageError:
        return UsageError(f"{wanted} needs the package {package}", todo="pip install 'galen-hw[import]'")

    return line

"""CAN logs of every kind that python-can reads, and candump's terminal output, decoded by the sensors' own drivers."""

import importlib
import re
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType
from typing import Any, Final

from galen_hw.clock import NS_PER_S
from galen_hw.drivers.device import CanFrame
from galen_hw.drivers.listening import Frames
from galen_hw.drivers.table import LISTENERS
from galen_hw.errors import UsageError
from galen_hw.formats.contents import Contents, Head, Stream, head_of, needed, relative, unreadable
from galen_hw.recording.recording import WRENCH

_CANDUMP: Final = re.compile(r"\(\d+\.\d+\)\s+\S+\s+[0-9A-Fa-f]{3,8}#")
_TERMINAL: Final = re.compile(
    r"\s*(?:\((?P<time>[^)]+)\)\s+)?\S+\s+(?:(?:TX|RX)\s+[-EB ]+\s+)?(?P<id>[0-9A-Fa-f]{3}|[0-9A-Fa-f]{8})\s+\[(?P<n>\d)\]"
    r"(?P<data>(?:\s+[0-9A-Fa-f]{2})*|\s+remote request)\s*$"
)
_BINARY: Final = (
    ("BLFReader", b"LOGG", b""),
    ("MF4Reader", b"MDF     ", b""),
    ("SqliteReader", b"SQLite format 3\0", b"arbitration_id"),
)
_TEXTS: Final = (
    ("CanutilsLogReader", _CANDUMP),
    ("ASCReader", re.compile(r"date .*\nbase ")),
    ("TRCReader", re.compile(r";(\$FILEVERSION|#{10})")),
    ("CSVReader", re.compile(r"timestamp,arbitration_id,extended")),
    ("terminal", re.compile(_TERMINAL.pattern, re.MULTILINE)),
)
TIMELESS: Final = "its frames have no times (candump without -ta): only their order is known; use candump -L"
EPOCH_S: Final = 1e8
"""Stamps beyond it count from 1970."""


def sniff(head: Head) -> bool:
    """By the signatures and first lines that the writers make."""
    return _kind(head) is not None


def _kind(head: Head) -> str | None:
    """Name of the reader."""
    for kind, start, inside in _BINARY:
        if head.data.startswith(start) and inside in head.data:
            return kind
    lines = [line for line in head.lines[:50] if line.strip()]
    return next((kind for kind, pattern in _TEXTS if lines and pattern.match("\n".join(lines[:5]))), None)


def read(path: Path, settings: dict[str, Any] | None = None) -> Contents:
    """The wrench of the sensor whose frames are in the log.

    Args:
        path: of the log; settings: the map's `[can]`: driver, and the keys of its listener.

    Raises:
        UsageError: it cannot be read, no driver knows its frames or two do, or a calibration is not known.
    """
    settings = settings or {}
    notes: list[str] = []
    frames = list(_frames(path, notes))
    if not frames:
        raise UsageError("there are no data frames in it", where=str(path), todo="record something first")
    frames.sort(key=lambda pair: pair[1])
    name, listener = _listener(path, frames, settings)
    try:
        heard = listener.listen(frames, settings)
    except UsageError as error:
        raise UsageError(error.what, where=f"{path}: {error.where or name}", todo=error.todo) from None
    if not len(heard.t_ns):
        raise UsageError("no sample in it is whole", where=f"{path}: {name}")
    absolute = frames[0][1] > EPOCH_S * NS_PER_S
    origin = int(heard.t_ns[0])
    stream = Stream(
        "",
        dict(zip(WRENCH, heard.wrench.T, strict=True)),
        name,
        relative(heard.t_ns, origin if absolute else 0),
        origin if absolute else None,
    )
    left_empty = {why: n for why, n in heard.lost.items() if n and why.endswith("(left empty)")}
    if TIMELESS in notes:
        stream.time = stream.origin_ns = None
    stream.lost = {why: n for why, n in heard.lost.items() if n and why not in left_empty}
    notes += [f"{count} samples: {why}" for why, count in left_empty.items()]
    info = {"sensor_serial": heard.serial_number} if heard.serial_number else {}
    how = [f"{len(frames)} frames, decoded by the driver {name}: {heard.described}"]
    return Contents([stream], [], notes, info=dict(info), how=how)


def _listener(path: Path, frames: Frames, settings: dict[str, Any]) -> tuple[str, ModuleType]:
    named = settings.get("driver")
    if named is not None and named not in LISTENERS:
        known = ", ".join(LISTENERS)
        raise UsageError(f"{named!r} decodes no log", where=f"{path}: can.driver", todo=f"known are {known}")
    names = [named] if named is not None else list(LISTENERS)
    modules = {name: importlib.import_module(LISTENERS[name]) for name in names}
    found = {name: module.recognises(frames, settings) for name, module in modules.items()}
    likely = [name for name, count in found.items() if count]
    if not likely:
        seen = sorted({frame.arbitration_id for frame, _ in frames})
        shown = ", ".join(f"{one:03X}" for one in seen[:8]) + (" ..." if len(seen) > 8 else "")
        what = f"no driver knows its frames (identifiers {shown})"
        raise UsageError(
            what, where=str(path), todo=f"known are {', '.join(LISTENERS)}; give can.driver and its identifiers"
        )
    best = max(likely, key=lambda name: found[name])
    if len(likely) > 1 and 2 * sorted(found.values())[-2] > found[best]:
        todo = "give can.driver in a map"
        raise UsageError(f"its frames may be of {' or '.join(likely)}", where=str(path), todo=todo)
    return best, modules[best]


def _frames(path: Path, notes: list[str]) -> Iterator[tuple[CanFrame, int]]:
    """Data frames of 11-bit identifiers; what else there is is counted."""
    kind = _kind(head_of(path))
    if kind == "terminal":
        yield from _terminal(path, notes)
        return
    try:
        import can.io

        options: dict[str, Any] = {"relative_timestamp": False} if kind == "ASCReader" else {}
        reader = getattr(can.io, str(kind))(str(path), **options)
    except (ImportError, NotImplementedError) as error:
        raise needed("asammdf", "an MF4 log")(ImportError(str(error))) from None
    except Exception as error:  # noqa: BLE001 - damaged files make the readers raise anything
        raise unreadable(path, error, "is it whole?") from None
    other = 0
    try:
        with reader:
            for message in reader:
                if message.is_error_frame or message.is_remote_frame or message.is_extended_id or message.is_fd:
                    other += 1
                    continue
                yield CanFrame(message.arbitration_id, bytes(message.data)), round(message.timestamp * NS_PER_S)
    except Exception as error:  # noqa: BLE001 - the end of a file that was cut off
        notes.append(
            f"cut off or damaged ({' '.join(str(error).split())[:80] or type(error).__name__}); all before was read"
        )
    if other:
        notes.append(f"{other} frames that are no data of 11-bit identifiers are left out")


def _terminal(path: Path, notes: list[str]) -> Iterator[tuple[CanFrame, int]]:
    other, stampless = 0, 0
    for i, line in enumerate(path.read_text(encoding="utf-8", errors="replace").splitlines()):
        found = _TERMINAL.match(line)
        data = bytes.fromhex(found["data"]) if found and "remote" not in found["data"] else None
        if found is None or data is None or len(data) != int(found["n"]) or len(found["id"]) != 3:
            other += bool(line.strip())
            continue
        try:
            seconds = float(found["time"])
        except (TypeError, ValueError):
            seconds, stampless = 1e-4 * i, stampless + 1  # for the drivers, which go by the order
        yield CanFrame(int(found["id"], 16), data), round(seconds * NS_PER_S)
    if stampless:
        notes.append(TIMELESS)
    if other:
        notes.append(f"{other} lines are no data frames and are left out")


__all__ = ["read", "sniff"]

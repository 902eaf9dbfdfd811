"""Where tools' files live: nominal ones in the package, calibrations as generations in the state directory.

    STATE/tools/NAME/0001.json ...   generations, written once, never changed
    STATE/tools/NAME/active.json     {"generation": n}: the one in use
    STATE/tools/selected.json        {"tool": NAME}: taken up when the daemon starts

Every one of them bears the digest of its content, so that a flipped bit is not taken for another tool. What an older
version wrote without is sealed by its owner when it is first read.

A calibration made on a virtual robot says so in its file and has a pointer of its own (`active-virtual.json`, and
`selected-virtual.json` for the tool in hand): what is tried without hardware neither replaces nor becomes what the real
sensor is compensated with.

Every file is written beside its place, flushed to the disk and then renamed over it, so that a power cut leaves either
the old content or the new.
"""

import hashlib
import json
import logging
import os
import re
from contextlib import suppress
from dataclasses import dataclass, field
from importlib import resources
from pathlib import Path
from typing import Any

from galen_hw.config.tool_file import NAME, Origin, ToolFile, parse_sealed, parse_tool
from galen_hw.documents import DocumentError, intact, load_json, sealed
from galen_hw.errors import UsageError


def write_atomic(path: Path, text: str) -> None:
    """Replace a file by `text`, all or nothing even if the power fails.

    Raises:
        UsageError: the directory cannot be written.
    """
    scratch = path.with_name(f".{path.name}.{os.getpid()}.new")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with scratch.open("w", encoding="utf-8") as file:
            file.write(text)
            file.flush()
            os.fsync(file.fileno())
        scratch.replace(path)
        directory = os.open(path.parent, os.O_RDONLY | os.O_DIRECTORY)
        try:
            os.fsync(directory)
        finally:
            os.close(directory)
    except OSError as error:
        with suppress(OSError):
            scratch.unlink(missing_ok=True)
        raise UsageError(
            f"cannot be written ({error.strerror})", where=str(path), todo="check space and rights"
        ) from None


@dataclass(frozen=True, slots=True)
class Generation:
    """One calibration in the history of a tool; `active` on its kind of hardware; `error` says why it is unreadable."""

    number: int
    path: Path
    active: bool
    tool: ToolFile | None
    error: str = ""


@dataclass(frozen=True, slots=True)
class ToolStore:
    """The tools of one installation.

    Args:
        state_dir: of the service (`$STATE_DIRECTORY` or the user's).
        nominal_dir: folder of nominal files, the package's own if None.
        virtual: whose calibrations are in use: those of virtual (True) or of real hardware (False); None for people,
            who are shown the real one where there is one.
    """

    state_dir: Path
    nominal_dir: Path | None = field(default=None)
    virtual: bool | None = None

    def names(self) -> list[str]:
        """All tools, nominal or calibrated, sorted."""
        found = set(self._nominal_texts())
        if self._root.is_dir():
            found |= {folder.name for folder in self._root.iterdir() if folder.is_dir() and self._numbers(folder.name)}
        return sorted(found)

    def load(self, name: str) -> ToolFile:
        """The tool in use: its active calibration, or the nominal file if there is none.

        Raises:
            UsageError: no such tool, or its file is damaged or impossible.
        """
        number = self.active(name)
        return self.nominal(name) if number is None else self.generation(name, number)

    def nominal(self, name: str) -> ToolFile:
        """Geometry alone, from the package or the first generation of an imported tool.

        Raises:
            UsageError: no such tool.
        """
        check_name(name)
        texts = self._nominal_texts()
        if name in texts:
            return parse_tool(*texts[name])
        numbers = self._numbers(name)
        if not numbers:
            known = ", ".join(self.names()) or "none"
            raise UsageError(f"no tool {name!r}", where=str(self._root), todo=f"one of: {known}; or import its file")
        tool = self.generation(name, numbers[-1])
        return ToolFile(name=tool.name, tip=tool.tip, contact=tool.contact, inertia=tool.inertia)

    def generation(self, name: str, number: int) -> ToolFile:
        """One calibration of the history.

        Raises:
            UsageError: not there, damaged or impossible.
        """
        path = self.path(name, number)
        try:
            text = path.read_text(encoding="utf-8")
        except UnicodeDecodeError:
            todo = "restore it, or roll back"
            raise UsageError("is damaged: not a text in UTF-8", where=str(path), todo=todo) from None
        except OSError:
            numbers = ", ".join(map(str, self._numbers(name)))
            todo = f"there are: {numbers}" if numbers else "it was never calibrated"
            raise UsageError(f"tool {name!r} has no generation {number}", where=str(path), todo=todo) from None
        tool, whole = parse_sealed(text, str(path))
        if tool.name != name:
            raise UsageError(f"is the file of {tool.name!r}", where=str(path), todo=f"galen-hw tool rollback {name}")
        if not whole:
            _seal(path, tool)
        return tool

    def active(self, name: str) -> int | None:
        """Number of the generation in use; None if the tool was never calibrated on such hardware."""
        return next((n for kind in self._kinds if (n := self._pointer(name, virtual=kind)) is not None), None)

    def history(self, name: str) -> list[Generation]:
        """All generations, oldest first; a damaged one is listed with its error.

        Raises:
            UsageError: no such tool.
        """
        self.nominal(name)
        active = {self._pointer(name, virtual=kind) for kind in (False, True)}
        return [self._entry(name, number, number in active) for number in self._numbers(name)]

    def save(self, tool: ToolFile, *, activate: bool = True) -> ToolFile:
        """Add a generation (nothing is ever overwritten) and, unless told otherwise, make it the one in use.

        Returns:
            The tool with its generation and identity filled in.

        Raises:
            UsageError: the tool has no calibration, or the directory cannot be written.
        """
        if tool.origin is None or not tool.calibrated:
            raise UsageError(f"tool {tool.name!r} holds no calibration to save", todo="calibrate it first")
        number = max(self._numbers(tool.name), default=0) + 1
        tool = tool.model_copy(update={"origin": _identified(tool, tool.origin, number)})
        write_atomic(self.path(tool.name, number), tool.to_sealed_json() + "\n")
        if activate:
            self.activate(tool.name, number)
        return tool

    def activate(self, name: str, number: int) -> ToolFile:
        """Make a generation the one in use on its kind of hardware, after reading it.

        Raises:
            UsageError: not there, damaged or impossible; the one in use stays.
        """
        tool = self.generation(name, number)
        path = self._root / name / _file("active", virtual=_is_virtual(tool))
        _write_pointer(path, {"generation": number})
        return tool

    def rollback(self, name: str, number: int | None = None) -> ToolFile:
        """Go back to a generation, or to the latest readable one before the active one, of the same kind of hardware.

        Raises:
            UsageError: there is none.
        """
        if number is not None:
            return self.activate(name, number)
        kind = next((k for k in self._kinds if self._pointer(name, virtual=k) is not None), self._kinds[0])
        active = self._pointer(name, virtual=kind)
        older = [
            g.number
            for g in self.history(name)
            if g.tool is not None and _is_virtual(g.tool) is kind and (active is None or g.number < active)
        ]
        if not older:
            raise UsageError(f"tool {name!r} has no earlier calibration", todo=f"galen-hw tool history {name}")
        return self.activate(name, older[-1])

    def selected(self) -> str | None:
        """The tool that the daemon takes up when it starts; None for no tool."""
        path = self._root / _file("selected", virtual=self._kinds[0])
        name = _read_pointer(path, "tool") if path.exists() else None
        return name if isinstance(name, str) and re.fullmatch(NAME, name) else None

    def select(self, name: str | None) -> None:
        """Remember the tool in hand over restarts; None for no tool.

        Raises:
            UsageError: no such tool.
        """
        if name is not None:
            self.load(name)
        path = self._root / _file("selected", virtual=self._kinds[0])
        _write_pointer(path, {"tool": name})

    @property
    def _kinds(self) -> tuple[bool, ...]:
        """Kinds of hardware (virtual or not) whose calibrations count, the first one first."""
        return (False, True) if self.virtual is None else (self.virtual,)

    def _pointer(self, name: str, *, virtual: bool) -> int | None:
        check_name(name)
        path = self._root / name / _file("active", virtual=virtual)
        number = _read_pointer(path, "generation") if path.exists() else None
        return number if isinstance(number, int) else None

    @property
    def _root(self) -> Path:
        return Path(self.state_dir) / "tools"

    def path(self, name: str, number: int) -> Path:
        """File of a generation, there or not."""
        check_name(name)
        return self._root / name / f"{number:04d}.json"

    def _numbers(self, name: str) -> list[int]:
        folder = self._root / name
        found = [int(p.stem) for p in folder.glob("*.json") if p.stem.isdigit()] if folder.is_dir() else []
        return sorted(found)

    def _entry(self, name: str, number: int, active: bool) -> Generation:
        path = self.path(name, number)
        try:
            return Generation(number, path, active, self.generation(name, number))
        except UsageError as error:
            return Generation(number, path, active, None, str(error))

    def _nominal_texts(self) -> dict[str, tuple[str, str]]:
        """Text and place of every nominal file by tool."""
        folder = resources.files("galen_hw.config") / "tools" if self.nominal_dir is None else self.nominal_dir
        files = [f for f in folder.iterdir() if f.name.endswith(".json")] if folder.is_dir() else []
        return {f.name.removesuffix(".json"): (f.read_text(encoding="utf-8"), str(f)) for f in files}


def binding_problems(tool: ToolFile, *, sensor_serial: str, robot: str, virtual: bool | None = None) -> list[str]:
    """Why a calibration does not belong to this hardware, one line each; none if it does or is not known to not.

    Args:
        sensor_serial, robot: empty where not known; virtual: the hardware is virtual, None where not known.
    """
    origin = tool.origin
    if origin is None:
        return []
    problems = []
    if virtual is not None and origin.virtual is not virtual:
        there, here = ("real", "virtual") if virtual else ("virtual", "real")
        problems.append(f"was calibrated on a {there} robot, this is a {here} one")
    if origin.sensor_serial and sensor_serial and origin.sensor_serial != sensor_serial:
        problems.append(f"was calibrated on sensor {origin.sensor_serial}, this is {sensor_serial}")
    if origin.robot and robot and origin.robot != robot:
        problems.append(f"was calibrated on robot {origin.robot!r}, this is {robot!r}")
    return problems


def check_binding(tool: ToolFile, *, sensor_serial: str, robot: str, virtual: bool | None = None) -> None:
    """Refuse a calibration of another sensor or robot.

    Raises:
        UsageError: it belongs to other hardware.
    """
    problems = binding_problems(tool, sensor_serial=sensor_serial, robot=robot, virtual=virtual)
    if problems:
        todo = f"galen-hw calibrate --tool {tool.name}"
        raise UsageError(f"tool {tool.name!r} {' and '.join(problems)}", todo=todo)


def _identified(tool: ToolFile, origin: Origin, number: int) -> Origin:
    digest = hashlib.sha256(tool.to_json().encode()).hexdigest()[:8]
    return origin.model_copy(update={"generation": number, "id": f"{tool.name}/{number:04d}-{digest}"})


def _is_virtual(tool: ToolFile) -> bool:
    return tool.origin is not None and tool.origin.virtual


def _file(stem: str, *, virtual: bool) -> str:
    return f"{stem}-virtual.json" if virtual else f"{stem}.json"


def check_name(name: str) -> None:
    """Refuse what cannot be a tool's name.

    Raises:
        UsageError: other letters than a file's name may have, or too many.
    """
    if not re.fullmatch(NAME, name):
        raise UsageError(f"{name!r} cannot be a tool's name", todo="small letters, digits, - and _, at most 40")


def _seal(path: Path, tool: ToolFile) -> None:
    """Give a generation of an older version its digest; only its owner does, so that it stays the owner's."""
    with suppress(OSError, UsageError):
        if path.stat().st_uid == os.geteuid():
            write_atomic(path, tool.to_sealed_json() + "\n")
            logging.getLogger(__name__).warning("%s: had no digest (an older version wrote it) and has one now", path)


def _write_pointer(path: Path, data: dict[str, Any]) -> None:
    write_atomic(path, json.dumps(sealed(data)) + "\n")


def _read_pointer(path: Path, key: str) -> Any:
    """The value that a pointer holds.

    Raises:
        UsageError: it is not what was written. (Older versions wrote no digest.)
    """
    damaged = UsageError("is damaged", where=str(path), todo="delete it, then select or roll back again")
    try:
        data = load_json(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, DocumentError):
        raise damaged from None
    if not isinstance(data, dict) or not set(data) <= {key, "digest"} or intact(data) is False:
        raise damaged
    return data.get(key)

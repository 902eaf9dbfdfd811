"""Files of other programs as one `Recording`: read, mapped, joined, and accounted for row by row."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import numpy as np

from galen_hw.errors import UsageError
from galen_hw.formats.clocks import take_clock
from galen_hw.formats.contents import Contents
from galen_hw.formats.joining import Joined, join
from galen_hw.formats.mapping import Entry, Map, check_map, guess, read_map
from galen_hw.formats.own import is_own
from galen_hw.formats.robots import attach_robot, name_sensor, renamed_joints
from galen_hw.formats.table import read_contents
from galen_hw.kinematics.xacro import RobotFile
from galen_hw.recording import Recording, read_recording
from galen_hw.recording.checks import check
from galen_hw.recording.info import INFO, info_of, parse_info
from galen_hw.recording.recording import group_of

MAP_SUFFIX: Final = ".map.toml"
"""A map beside a file, with its name before this, is used without being asked for."""


@dataclass(frozen=True)
class Imported:
    """What was made of files.

    Args:
        recording: joined; not checked for oddities yet.
        used: the map.
        account: rows in, rows out, dropped and why, one line a stream.
        notes: what is odd or was done to numbers.
        formats: of the files, for people.
    """

    recording: Recording
    used: Map
    account: tuple[str, ...]
    notes: tuple[str, ...]
    formats: tuple[str, ...]


def read(
    path: Path | str,
    *,
    simulation: Path | str | None = None,
    compensated: bool = False,
    robot: RobotFile | None = None,
    info: dict[str, Any] | None = None,
) -> Recording:
    """A recording of any format, galen-hw's own or another's, as commands take it.

    A map beside the file (run.bag and run.bag.map.toml) is used; a recording.json beside it says what it belongs to.

    Args:
        path: file or folder.
        simulation: a recording that someone else simulated.
        compensated: also give the compensated wrench, where the recording has it.
        robot: in place of the one that the recording names.
        info: keys of recording.json that come before what the recording says.

    Raises:
        UsageError: not there, of no known format, or not certain what its columns are: which, and what to do.
    """
    path = Path(path)
    if not path.exists() or is_own(path):
        recording = read_recording(path, simulation=simulation, compensated=compensated)
        recording = replace(recording, info=recording.info.model_copy(update=info)) if info else recording
        return recording if robot is None else recording.with_robot(robot.name, robot.text)
    imported = import_files([path], info=info, robot=robot)
    if imported.used.doubtful:
        family, places = next(iter(imported.used.doubtful.items()))
        todo = f"galen-hw import {path} --write-map MAP.toml, choose there, then --map MAP.toml -o FOLDER"
        raise UsageError(f"{family} may be {' or '.join(places)}", where=str(path), todo=todo)
    recording = imported.recording
    said = [f"read as {imported.formats[0]}", *imported.account, *imported.notes]
    recording = replace(recording, warnings=(*said, *check(recording)))
    if simulation is not None:
        from galen_hw.recording import beside

        recording = beside(recording, read(simulation))
    return recording


def import_files(
    paths: Sequence[Path],
    map_file: Path | None = None,
    info: dict[str, Any] | None = None,
    robot: RobotFile | None = None,
) -> Imported:
    """Read files, and join them on one clock.

    Args:
        paths: files or folders of any known format; streams of several are told apart by their file's name.
        map_file: a map that a person edited; None for one beside the first file, or the guess.
        info: keys of recording.json that come before all others.
        robot: in place of the one that the files name.

    Raises:
        UsageError: a file, a map or a join that cannot be; one line.
    """
    if map_file is None:
        beside = paths[0].with_name(paths[0].name + MAP_SUFFIX)
        map_file = beside if beside.is_file() else None
    given = None if map_file is None else read_map(map_file)
    paths = [*paths, *(given.also if given is not None else ())]
    named = [_contents(path, given, several=len(paths) > 1) for path in paths]
    contents = [one for _, one in named]
    if given is not None:
        given.entries = [entry for entry in given.entries if entry.target != "time"]  # they have become clocks
    what = guess(contents) if given is None or not given.entries else given
    if given is not None and what is not given:
        # A map without columns says other things; which is which is found as without it.
        kept = {k: getattr(given, k) for k in ("rows", "stamps", "offset_s", "can", "beside", "also")}
        what = replace(what, **kept, info=what.info | given.info)
    elif given is not None:
        try:
            check_map(what, contents)
        except UsageError as error:
            where = f"{map_file}: {error.where}" if error.where else str(map_file)
            raise UsageError(error.what, where=where, todo=error.todo) from None
    if not what.entries and what.doubtful:
        titles = tuple(stream.title for one in contents for stream in one.streams)
        return Imported(Recording({}), what, titles, (), tuple(name for name, _ in named))
    if not what.entries:
        raise _nothing(paths, contents)
    texts = {name: text for one in contents for name, text in one.texts.items()}
    what.info = _within(texts, paths[0]) | _beside(paths[0]) | what.info | (info or {})
    if robot is not None:
        what.info["robot"] = robot.name
        texts |= {robot.name: robot.text} if robot.text else {}
    notes = [line for one in contents for line in (*one.how, *one.notes)]
    notes += attach_robot(what, texts, paths[0], [e.target for e in what.entries])
    urdf = texts.get(str(what.info.get("robot")))
    notes += name_sensor(what, urdf, contents)
    if what is not given:
        what.entries, more = renamed_joints(what.entries, urdf, what.info)
        notes += more
    _predict(what)
    joined = _joined(paths, contents, what)
    account = [*joined.account, *what.left, *(line for one in contents for line in one.passed)]
    recording = _recording(joined, what, paths[0], texts, notes)
    return Imported(recording, what, tuple(account), tuple(notes), tuple(name for name, _ in named))


def _nothing(paths: Sequence[Path], contents: Sequence[Contents]) -> UsageError:
    """No column is one of a recording: what there is instead."""
    there = [f"{s.title}: {', '.join(list(s.columns)[:FEW])}" for one in contents for s in one.streams]
    there += [line for one in contents for line in (*one.passed, *one.notes)]
    more = f" and {len(there) - FEW} more" if len(there) > FEW else ""
    what = (
        f"no column is one of a recording: there are {'; '.join(there[:FEW])}{more}" if there else "there are no rows"
    )
    todo = "name them in a map: galen-hw import FILE --write-map MAP.toml, then --map MAP.toml"
    return UsageError(what, where=", ".join(map(str, paths)), todo=todo)


FEW: Final = 6


def _contents(path: Path, given: Map | None, *, several: bool) -> tuple[str, Contents]:
    name, contents = read_contents(path) if given is None or not given.can else _can(path, given)
    if several:
        for stream in contents.streams:
            stream.name = f"{path.name}:{stream.name}" if stream.name else path.name
    for stream in contents.streams:
        named = (
            next((e for e in given.entries if e.target == "time" and e.stream == stream.name), None) if given else None
        )
        if named is not None and named.column in stream.columns:
            stream.time, stream.origin_ns = stream.columns.pop(named.column) * named.factor, None
    return name, take_clock(contents)


def _can(path: Path, given: Map) -> tuple[str, Contents]:
    """A CAN log by the keys of a map; other formats have no use for them."""
    from galen_hw.formats import can_log
    from galen_hw.formats.table import format_of

    found, _ = format_of(path)
    return (found.name, can_log.read(path, given.can)) if found.module == "can_log" else read_contents(path)


def _within(texts: dict[str, str], path: Path) -> dict[str, Any]:
    """The keys of a recording.json in the file itself, as our own exports have it."""
    return _said(texts[INFO], f"{path}: {INFO}") if INFO in texts else {}


def _beside(path: Path) -> dict[str, Any]:
    """The keys of a recording.json in the same folder."""
    file = path.parent / INFO
    return _said(file.read_text(encoding="utf-8-sig"), str(file)) if file.is_file() else {}


def _said(text: str, where: str) -> dict[str, Any]:
    info = parse_info(text, where)
    return info.model_dump(mode="json", by_alias=True, exclude_unset=True)


def _predict(what: Map) -> None:
    """Name what is compared, where only one thing can be."""
    if what.info.get("predict") is not None:
        return
    groups = {group_of(entry.target) for entry in what.entries}
    robot = what.info.get("robot") is not None
    if "wrench" in groups and ("sensor" in groups or (robot and "position" in groups)):
        what.info["predict"] = "wrench"
    elif robot and "position" in groups:
        what.info["predict"] = next((g for g in ("effort", "pose", "targets") if g in groups), None)
    elif {"position", "command"} <= groups:
        what.info["predict"] = "position"
    if what.info.get("predict") == "wrench":
        # Nobody knows at what the sensor was zeroed: a constant is then no finding.
        what.info.setdefault("model", {"bias": "free"})


def _joined(paths: Sequence[Path], contents: Sequence[Contents], what: Map) -> Joined:
    streams = [stream for one in contents for stream in one.streams]
    try:
        joined = join(streams, what, what.info.get("predict"))
    except UsageError as error:
        where = ", ".join(map(str, paths)) + (f": {error.where}" if error.where else "")
        raise UsageError(error.what, where=where, todo=error.todo) from None
    if not joined.columns or not len(next(iter(joined.columns.values()))):
        raise UsageError("there are no rows", where=", ".join(map(str, paths)), todo="record something first")
    return joined


def _recording(joined: Joined, what: Map, path: Path, texts: dict[str, str], notes: list[str]) -> Recording:
    columns = {}
    order = ("time", "segment")
    names = sorted(joined.columns, key=lambda name: (name not in order, name.startswith("covariate.")))
    for name in names:
        values = np.asarray(joined.columns[name], dtype=float)
        infinite = np.isinf(values)
        if infinite.any():
            notes.append(f"{name}: {int(infinite.sum())} infinite values are taken as not measured")
            values = np.where(infinite, np.nan, values)
        if np.isnan(values).all():
            notes.append(f"{name}: every cell is empty; the column is left out")
            continue
        columns[name] = values
    if joined.columns and not columns:
        raise UsageError("nothing was measured, every column is empty", where=str(path), todo="check the file")
    info = info_of({"schema": 1} | {k: v for k, v in what.info.items() if v is not None}, str(path))
    return Recording(columns, info, path, attachments=texts, epoch=joined.epoch)


__all__ = ["Entry", "Imported", "import_files", "read"]

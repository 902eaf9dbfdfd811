"""Deflection recordings for the fit: read, checked one by one, told apart by configuration and day, split."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from galen_hw.errors import UsageError
from galen_hw.formats import read as read_recording
from galen_hw.identification.deflection.data import DeflectionSet, check
from galen_hw.recording import Recording
from galen_hw.tools.examined import examine_recording

if TYPE_CHECKING:
    from galen_hw.physics.observations import Group

SAME_M, SAME_RAD = 0.02, 0.05
SAME_TIP_M = 1e-4
"""A tip that was measured again lies this near; the tracker's noise is as large."""
LEAST_SEEN = 60
MOVED = 0.1
KINDS = ("same configuration", "new configuration", "other day")


@dataclass(frozen=True)
class Sets:
    """The sets of recordings with pushes.

    Args:
        sets: labelled by configuration; days: the day of each by name; virtual: any is of a virtual robot.
        notes: what the premises said, one line each with the set's name.
    """

    sets: list[DeflectionSet]
    days: dict[str, str]
    virtual: bool
    notes: list[str]


def recordings_in(paths: Sequence[Path]) -> list[Recording]:
    """Read the recordings among the paths; a folder of recordings stands for all in it.

    Raises:
        UsageError: one cannot be read.
    """
    return [read_recording(path) for path in _folders(paths)]


def sets_of(recordings: Sequence[Recording]) -> Sets:
    """Return the sets of recordings with pushes; calibration sets without force are left out.

    Raises:
        UsageError: not a deflection recording, or sets of different tools, tips or kinds of robot; one line with what to
            record next.
    """
    sets, days, notes = [], {}, list[str]()
    virtual: dict[str, bool] = {}
    for recording in recordings:
        path, extra = recording.path, recording.info.model_extra or {}
        _need_tracker(recording, path)
        if extra.get("purpose") == "calibration":
            continue
        tool = "" if recording.info.tool is None else recording.info.tool.name
        name = path.name if path.is_dir() else path.stem
        group: Group = recording.info.predict or "pose"
        found = examine_recording(recording, group)
        notes += [f"{name}: {line}" for line in found.notes]
        made = DeflectionSet.of(
            name, found.examination.observations, configuration=str(extra.get("configuration", "")), tool=tool
        )
        days[name] = str(extra.get("session", ""))
        virtual[name] = recording.info.virtual
        sets.append(made)
    if not sets:
        raise UsageError("no set with pushes", todo="record one: galen-hw collect deflection")
    check(sets)
    _refuse_mixed(sets, virtual)
    return Sets(_labelled(sets), days, any(virtual.values()), notes)


def _refuse_mixed(sets: Sequence[DeflectionSet], virtual: dict[str, bool]) -> None:
    """Sets of one tool's name whose tips differ, or of a virtual and a real robot: one model cannot be both.

    Raises:
        UsageError: they are mixed; one line that names the sets.
    """
    real, simulated = ([s.name for s in sets if virtual[s.name] is kind] for kind in (False, True))
    if real and simulated:
        what = f"sets of a virtual robot ({', '.join(simulated)}) beside sets of a real one ({', '.join(real)})"
        raise UsageError(what, todo="fit each by itself")
    tip = sets[0].observations.belief.tip
    other = [s for s in sets if np.linalg.norm(s.observations.belief.tip - tip) > SAME_TIP_M]
    if other:
        there, here = (
            f"({', '.join(f'{1e3 * x:.2f}' for x in s.observations.belief.tip)}) mm" for s in (other[0], sets[0])
        )
        alike = [s.name for s in sets if all(s is not o for o in other)]
        what = f"tool.tip differs: {there} in {', '.join(s.name for s in other)}, {here} in {', '.join(alike)}"
        raise UsageError(what, todo="fit each tip by itself, or correct tool.tip in recording.json")


def _folders(paths: Sequence[Path]) -> list[Path]:
    """Recordings among the paths; a folder of recordings stands for all in it."""
    out: list[Path] = []
    for path in paths:
        inside = sorted(p.parent for p in path.glob("*/recording.json")) if path.is_dir() else []
        out += inside if inside and not (path / "recording.json").exists() else [path]
    return out


def _need_tracker(recording: Recording, path: Path) -> None:
    columns = recording.columns
    if not recording.has("pose"):
        tracked = any(name.startswith("target.") for name in columns)
        what = "tracked points that are not registered" if tracked else "no tracked pose of the tip"
        raise UsageError(what, where=str(path), todo="record with the tracker: galen-hw collect deflection")
    seen = np.isfinite(columns.get("pose.position.x", np.full(len(recording), np.nan)))
    if np.count_nonzero(seen) < LEAST_SEEN:
        what = f"the tool is seen in {np.count_nonzero(seen)} rows only"
        raise UsageError(what, where=str(path), todo="turn the markers to the tracker, then record the set again")


def _labelled(sets: Sequence[DeflectionSet]) -> list[DeflectionSet]:
    """Sets at one place share a label; a set that visits several places is a configuration of its own."""
    places: list[tuple[Any, str]] = []
    out = []
    for s in sets:
        middle, spread = np.median(s.q, axis=0), np.ptp(s.q, axis=0).max()
        label = s.name if spread > MOVED else ""
        near = np.array([SAME_M] * 3 + [SAME_RAD] * (s.q.shape[1] - 3)) if s.q.shape[1] > 3 else SAME_RAD
        for at, known in places:
            label = label or (known if np.all(np.abs(at - middle) < near) else "")
        label = label or s.configuration
        places.append((middle, label))
        out.append(replace(s, configuration=label))
    return out


def split(
    sets: Sequence[DeflectionSet], days: dict[str, str], named: Sequence[str] = ()
) -> tuple[list[DeflectionSet], dict[str, list[DeflectionSet]]]:
    """Sets to learn from, and those held out by kind.

    Named sets are held out; otherwise all of another day than the first, the configuration in the middle of the list
    and one set of a configuration that has two, as long as three configurations are left to learn from.
    """
    unknown = set(named) - {s.name for s in sets}
    if unknown:
        known = ", ".join(s.name for s in sets)
        raise UsageError(f"no set {min(unknown)!r}", where="--holdout", todo=f"one of: {known}")
    first = days.get(sets[0].name, "")
    out = {s.name for s in sets if s.name in named or (not named and days.get(s.name, "") != first)}
    left = [s for s in sets if s.name not in out]
    labels = list(dict.fromkeys(s.configuration for s in left))
    if not named and len(labels) >= 4:
        new = labels[len(labels) // 2]
        twice = next((c for c in labels if c != new and sum(s.configuration == c for s in left) > 1), None)
        out |= {s.name for s in left if s.configuration == new}
        out |= {s.name for s in [s for s in left if s.configuration == twice][1:2]}
    elif not named and len(left) > 2:
        out.add(left[-1].name)
    learn = [s for s in sets if s.name not in out]
    known_places = {s.configuration for s in learn}
    held: dict[str, list[DeflectionSet]] = {kind: [] for kind in KINDS}
    for s in sets:
        if s.name in out:
            other = days.get(s.name, "") != first
            held["other day" if other else KINDS[s.configuration not in known_places]].append(s)
    return learn, {kind: found for kind, found in held.items() if found}

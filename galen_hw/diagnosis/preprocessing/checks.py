"""Screening before any fit: rows that can be compared, and notes on the others."""

from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np

from galen_hw.diagnosis.stats.paired_test import PIECES
from galen_hw.diagnosis.stats.sampling import Index, Mask
from galen_hw.errors import UsageError
from galen_hw.physics.effects.registry import scene_of
from galen_hw.physics.scenes.base import Scene
from galen_hw.physics.scenes.pose import QUATERNION
from galen_hw.physics.signals.differentiation import at_rest, denoised
from galen_hw.premises import Action, Examination
from galen_hw.spatial import Array

ORIENTATION: Final = tuple(f"sensor.orientation.{axis}" for axis in "xyzw")


@dataclass
class Screening:
    """Hold a recording without the rows that cannot be compared, and what was noted of it.

    Args:
        scene: without the rows that cannot be compared.
        notes: one line each.
        wrong: lines that make every finding worthless (axes, signs, units); channels they concern.
    """

    scene: Scene
    notes: list[str] = field(default_factory=list)
    wrong: list[str] = field(default_factory=list)
    channels: list[str] = field(default_factory=list)

    def take(self, examination: Examination) -> None:
        """Add what the premises say of the recording; what they claim as physics becomes a finding as well."""
        first = [r for r in examination.remarks if r.action is not Action.REFUSED]
        self.notes[:0] = [r.line for r in first] + [r.line for r in examination.refused]
        if examination.refused:
            # What is refused is the cause of what later checks found.
            self.notes = [line for line in self.notes if line not in self.wrong]
            self.wrong = [r.line for r in examination.refused]
            self.channels = [c for r in examination.refused for c in r.columns]


def screened(scene: Scene, *, short: int = 100) -> Screening:
    """Leave out rows that cannot be compared; axes, signs, units and clocks are checked before (`galen_hw.premises`).

    Args:
        short: rows of a motion below which only gross effects can show.

    Raises:
        UsageError: no channel, nothing to simulate from, a clock that is none, or too few rows to compare.
    """
    if not scene.channels:
        group = scene.observations.predict
        raise UsageError(f"no column of the group {group!r} is there to compare", where="recording", todo="see predict")
    _drivable(scene)
    out = Screening(scene)
    for step in (_measured, _with_tool, _in_time_order, _with_inputs):
        out.scene = step(out.scene, out.notes)
    out.scene = quiet(_split_at_gaps(_complete(out.scene, out.notes, out.wrong), out.notes))
    if out.scene.clock and len(out.scene) < short:
        out.notes.append(f"only {len(out.scene)} rows: too short to tell any but gross effects")
    out.notes += out.wrong
    return out


def held_out(scene: Scene, notes: list[str]) -> Scene:
    """Return a held-out recording without the rows that cannot be compared, and note what is left out.

    Raises:
        UsageError: as `screened`.
    """
    mine: list[str] = []
    for step in (_with_tool, _in_time_order, _with_inputs, _complete, _split_at_gaps):
        scene = step(scene, mine)
    notes += [f"held-out recording: {line}" for line in mine]
    return quiet(scene)


def _drivable(scene: Scene) -> None:
    """Raise if there is nothing to simulate from."""
    seen, robot, columns = scene.observations, scene.belief.robot, scene.observations.columns
    if seen.simulation is not None or seen.predict == "position":
        return
    turned = seen.predict == "wrench" and all(name in columns for name in ORIENTATION)
    absent = [n for n in robot.joint_names if f"joint.{n}.position" not in columns] if robot is not None else []
    if robot is None and not turned:
        instead = " or the columns sensor.orientation.x y z w" if seen.predict == "wrench" else ""
        raise UsageError(
            "there is nothing to simulate from",
            where="recording.json: robot",
            todo=f"name the robot{instead}, or add a folder simulation/",
        )
    if absent and not turned:
        what = f"{len(absent)} of the robot's joints have no position, first {absent[0]}"
        raise UsageError(what, where="recording", todo=f"add the column joint.{absent[0]}.position")


def _measured(scene: Scene, notes: list[str]) -> Scene:
    """Leave out joints and orientations of which nothing was measured: the others can be compared."""
    columns = scene.observations.columns
    may_lack = {name for name in scene.channels if name.startswith("joint.")}
    may_lack |= set(QUATERNION) if scene.observations.predict == "pose" else set()
    empty = {name for name in may_lack & set(columns) if not np.isfinite(columns[name]).any()}
    if not empty or empty >= set(scene.channels):
        return scene
    notes += [f"{name} was not measured and is left out" for name in sorted(empty)]
    return scene_of(replace(scene.observations, columns={k: v for k, v in columns.items() if k not in empty}))


def _with_tool(scene: Scene, notes: list[str]) -> Scene:
    """Leave out poses of a calibration sweep in which nothing hung on the sensor: the named tool was not there."""
    tool = scene.observations.columns.get("covariate.tool")
    bare = np.zeros(len(scene), dtype=bool) if tool is None else np.asarray(tool < 0.5)
    if scene.observations.predict != "wrench" or not bare.any() or bare.all():
        return scene
    notes.append(f"{int(bare.sum())} rows without the tool (covariate.tool) are left out")
    return scene_of(scene.observations.taken(~bare))


def _in_time_order(scene: Scene, notes: list[str], *, most: float = 0.05) -> Scene:
    """Leave out rows whose clock stands or runs backwards inside a segment.

    Args:
        most: share of rows out of order beyond which the clock is not one clock.
    """
    if not scene.clock:
        return scene
    good, behind = np.ones(len(scene), dtype=bool), 0
    for part in scene.segments:
        t = scene.time[part]
        if np.all(np.diff(t) > 0.0):
            continue
        rising = longest_rising(t)
        behind += len(t) - len(rising)
        kept = np.zeros(len(t), dtype=bool)
        kept[rising[np.diff(t[rising], prepend=-np.inf) > 0.0]] = True
        good[part] = kept
    if good.all():
        return scene
    if behind > most * len(scene):
        raise UsageError(
            f"time runs backwards in {behind} of {len(scene)} rows",
            where="recording: time",
            todo="sort the rows, or number the runs 0, 1, 2 in a column segment",
        )
    notes.append(f"time repeats or runs backwards in {int((~good).sum())} rows, which are left out")
    return scene_of(scene.observations.taken(good))


def longest_rising(t: Array) -> Index:
    """Return the indices of a longest subsequence of (N,) that never falls (patience sorting, N log N)."""
    tails: list[float] = []
    ends: list[int] = []
    before = np.full(len(t), -1, dtype=np.intp)
    for i, x in enumerate(t.tolist()):
        at = bisect_right(tails, x)
        before[i] = ends[at - 1] if at else -1
        tails[at : at + 1] = [x]
        ends[at : at + 1] = [i]
    out, i = [], ends[-1]
    while i >= 0:
        out.append(i)
        i = int(before[i])
    return np.array(out[::-1], dtype=np.intp)


def _split_at_gaps(scene: Scene, notes: list[str], *, times: float = 5.0, least: float = 0.5) -> Scene:
    """Begin a new segment after each gap of the clock, or of what was left out.

    Args:
        times: the median step; what is longer is a gap: what happened in it nobody knows.
        least: seconds of a gap.
    """
    if not scene.clock or len(scene) < 3:
        return scene
    steps = np.diff(scene.time)
    edges = np.zeros(len(scene), dtype=bool)
    for part in scene.segments:
        edges[part.start] = True
    inside = steps[~edges[1:]]
    if not len(inside):
        return scene
    gap = (steps > max(times * float(np.median(inside)), least)) & ~edges[1:]
    if not gap.any():
        return scene
    longest = float(steps[gap].max())
    notes.append(
        f"time has {int(gap.sum())} gaps, the longest of {longest:.3g} s: what has a memory starts afresh there"
    )
    edges[1:] |= gap
    observations = scene.observations
    columns = dict(observations.columns) | {"segment": np.cumsum(edges).astype(float) - 1.0}
    return scene_of(replace(observations, columns=columns))


def _with_inputs(scene: Scene, notes: list[str]) -> Scene:
    """Leave out rows without the inputs of the simulation; interpolate empty cells of thermometers."""
    columns, robot = scene.observations.columns, scene.belief.robot
    bridged = {}
    for name, values in columns.items():
        there = np.isfinite(values)
        if name.startswith("temperature.") and there.any() and not there.all():
            bridged[name] = np.interp(np.arange(len(values)), np.flatnonzero(there), values[there])
            notes.append(f"{name}: {int((~there).sum())} empty cells are bridged from their neighbours")
    drivers = ORIENTATION if robot is None else [f"joint.{n}.position" for n in robot.joint_names]
    good = np.ones(len(scene), dtype=bool)
    for name in drivers:
        if name in columns and np.isfinite(columns[name]).any():
            good &= np.isfinite(columns[name])
    enough(good)
    if not good.all():
        notes.append(f"{int((~good).sum())} rows have no joint position or orientation and are left out")
    if good.all() and not bridged:
        return scene
    observations = replace(scene.observations, columns=dict(columns) | bridged)
    return scene_of(observations.taken(good))


def quiet(scene: Scene) -> Scene:
    """Return the scene with denoised joint positions, at rest where they stand, where their noise enters the simulation.

    In a tracked pose it is in all channels at once: an arm that is wrong by a foot would explain what shakes it at rest, and a
    dead band or a filter that does no more than quieten the encoders would be believed. A wrench that is simulated from noisy
    joints is noisy itself, and a lag quietens that where a delay does not. What looks like noise may be poses one after the
    other: a joint that the tracker or the sensor saw go there stays as it was read.
    """
    seen = scene.observations
    if seen.predict not in ("pose", "targets", "wrench") or not scene.clock or not np.isfinite(scene.q).all():
        return scene
    q = denoised(scene.time, at_rest(scene.time, scene.q, scene.segments), scene.segments)
    places = {f"joint.{name}.position": q[:, i] for i, name in enumerate(scene.joint_names)}
    whole = scene_of(replace(seen, columns=dict(seen.columns) | places))
    if _as_near(whole, scene):
        return whole
    for name, values in places.items():
        other = scene_of(replace(scene.observations, columns=dict(scene.observations.columns) | {name: values}))
        scene = other if _as_near(other, scene) else scene
    return scene


def _as_near(other: Scene, scene: Scene, *, sure: float = 4.0, most: float = 0.1) -> bool:
    """Return whether another simulation of a recording misses hardly more of it, all channels alike, and not surely more.

    Joints that were read on an even clock and stamped unevenly are not where a smooth motion has them at those times.

    Args:
        sure: standard errors over pieces of the recording.
        most: share of the variance of what the simulation misses that may come to it; more is motion taken for noise.
    """
    residual, its = (one.residual - np.nanmean(one.residual, axis=0) for one in (scene, other))
    more = (its**2 - residual**2) / np.maximum(np.nanvar(residual, axis=0), 1e-30)
    pieces = [np.nanmean(x) for x in np.array_split(more, min(PIECES, len(more)))]
    surely = np.mean(pieces) > sure * np.std(pieces) / np.sqrt(len(pieces))
    return bool(np.nanmean(more) <= most and not surely)


def enough(good: Mask, *, fewest: int = 8) -> None:
    """Raise if too few rows (N,) can be compared.

    Args:
        fewest: rows.

    Raises:
        UsageError: fewer than `fewest`.
    """
    if good.sum() < fewest:
        what = f"only {int(good.sum())} of {len(good)} rows can be compared"
        raise UsageError(what, where="recording", todo=f"record at least {fewest}, with no empty cells")


def _complete(scene: Scene, notes: list[str], wrong: Sequence[str] = ()) -> Scene:
    """Leave out rows without a measured or simulated value; raise for a channel without any."""
    y, s = scene.measured, scene.simulated
    for c, name in enumerate(scene.channels):
        if not np.isfinite(y[:, c]).any():
            raise UsageError(f"{name} has no value", where="recording", todo="add the column, or fill it")
        if not np.isfinite(s[:, c]).any():
            if wrong:
                raise UsageError(wrong[0], where="recording", todo="give SI units")
            raise UsageError(f"{name} cannot be simulated", where="recording", todo="check the joints' columns")
    good = np.asarray(np.isfinite(y).all(axis=1) & np.isfinite(s).all(axis=1))
    enough(good)
    if good.all():
        return scene
    notes.append(f"{int((~good).sum())} rows have no value to compare and are left out")
    return scene_of(scene.observations.taken(good))

"""Compared channels that cannot be what they are called: copies, dead and stuck ones, joints with the other sign."""

from collections.abc import Iterator
from typing import ClassVar, Final
from weakref import ref

import numpy as np

from galen_hw.physics.effects.registry import scene_of
from galen_hw.physics.observations import Observations
from galen_hw.physics.scenes.base import Scene
from galen_hw.premises.base import Action, Remark, Stage, joint_positions, known_rows, with_columns
from galen_hw.premises.cells import runs
from galen_hw.premises.criteria import CRITERIA
from galen_hw.premises.sampling import compared_names, copies, measured
from galen_hw.spatial import Array

DEAD: Final = 0.05
"""Of the liveliest simulated channel of its unit: a channel that should move so much cannot stand still."""


_kept: Final[dict[str, tuple[ref[Observations], Scene | None]]] = {}
"""The scene asked last: several premises ask for the same one, whose motion is differentiated and simulated."""


def compared(seen: Observations) -> Scene | None:
    """Return the scene of a stretch of the rows that can be compared; None where there are hardly any."""
    last = _kept.get("last")
    if last is not None and last[0]() is seen:
        return last[1]
    scene = _stretch(seen)
    _kept["last"] = (ref(seen), scene)
    return scene


def _stretch(seen: Observations) -> Scene | None:
    seen = measured(seen)
    names, robot, driven = compared_names(seen), seen.belief.robot, joint_positions(seen)
    rows = known_rows(seen, (*names, *driven))
    if not names or len(rows) < CRITERIA.fewest_vectors:
        return None
    # In one piece: what accelerates is part of the simulation.
    some = seen.taken(rows[: CRITERIA.stretch])
    if robot is not None and len(driven) < len(robot.joint_names) and seen.predict != "position":
        return None
    return scene_of(some)


class DeadChannels:
    """Tests for compared channels that stand still while their simulation moves."""

    KEY: ClassVar[str] = "dead_channels"
    STAGE: ClassVar[Stage] = Stage.FRAMES

    def examine(self, seen: Observations) -> Iterator[Remark]:
        """Yield a remark for each channel that stands still."""
        still = [n for n in compared_names(seen) if np.nanmax(seen.columns[n]) == np.nanmin(seen.columns[n])]
        scene = compared(seen) if still else None
        if scene is None:
            return
        moves = np.ptp(scene.simulated, axis=0)
        for name in still:
            if name not in scene.channels:
                continue
            c = scene.channels.index(name)
            if moves[c] > DEAD * max(moves[d] for d in _kin(scene, c)):
                value = float(seen.columns[name][0])
                what = (
                    f"{name} stands still at {value:.4g} while its simulation moves by {moves[c]:.3g} {scene.units[c]}"
                )
                why = "the drive was off, or the channel is dead" if name.endswith(".effort") else "the channel is dead"
                yield Remark(self.KEY, what, f"{why}: leave its column out", (name,), Action.REFUSED)
            else:
                yield Remark(self.KEY, f"{name} is constant: the channel may be dead", "", (name,))


class StuckChannels:
    """Tests for channels of a wrench that stay at one reading for a while, to the last bit, while their simulation moves.

    A joint may stand by its friction, and a reading at its limit is the search's.
    """

    KEY: ClassVar[str] = "stuck_channels"
    STAGE: ClassVar[Stage] = Stage.FRAMES

    def examine(self, seen: Observations) -> Iterator[Remark]:
        """Yield a remark for each channel; while it is stuck it was not measured."""
        time = seen.time
        found = (
            {} if time is None else {n: r for n in compared_names(seen) if (r := _longest(seen.columns[n])) is not None}
        )
        scene = scene_of(seen) if found else None
        if time is None or scene is None:
            return
        for name, rows in found.items():
            c = scene.channels.index(name) if name in scene.channels else None
            if c is None or not np.isfinite(scene.simulated[rows, c]).all():
                continue
            moves = float(np.ptp(scene.simulated[rows, c]))
            steps = np.abs(np.diff(seen.columns[name]))
            usual = float(np.median(steps[steps > 0.0]))
            if moves < max(DEAD * float(np.nanmax(np.ptp(scene.simulated, axis=0)[_kin(scene, c)])), 10.0 * usual):
                continue
            values = seen.columns[name].copy()
            stuck, values[rows.start + 1 : rows.stop] = float(values[rows.start]), np.nan
            seen = with_columns(seen, {name: values})
            what = (
                f"{name} is stuck at {stuck:.4g} from {time[rows.start]:.4g} to {time[rows.stop - 1]:.4g} s while its simulation "
                f"moves by {moves:.3g} {scene.units[c]}: taken as not measured"
            )
            yield Remark(self.KEY, what, "", (name,), Action.REPAIRED, seen)


STUCK_ROWS: Final = 50
STUCK_SHARE: Final = 0.02
"""Of the recording, at least: what is shorter is the search's (`glitches`)."""


def _longest(values: Array) -> slice | None:
    """Return the longest run of one reading in (N,) values that change else; None where it is short, or they do not change."""
    same = values[1:] == values[:-1]
    first, last = max(runs(same), key=lambda run: run[1] - run[0], default=(0, 0))
    length = last - first
    if length < max(STUCK_ROWS, STUCK_SHARE * len(values)) or length > 0.9 * len(values):
        return None
    others = np.delete(same, slice(first, last))
    at_limit = values[first] in (np.nanmin(values), np.nanmax(values))
    return None if at_limit or np.mean(others) >= CRITERIA.half else slice(first, last + 1)


def _kin(scene: Scene, c: int) -> list[int]:
    """Return the channels of the unit of channel c."""
    return [d for d, unit in enumerate(scene.units) if unit == scene.units[c]]


class CopiedColumns:
    """Tests for compared channels that are one and the same, row by row: one was exported twice, and the other is lost."""

    KEY: ClassVar[str] = "copied_columns"
    STAGE: ClassVar[Stage] = Stage.CELLS

    def examine(self, seen: Observations) -> Iterator[Remark]:
        """Yield a remark for each channel that is a copy of one before it."""
        for first, name in copies(seen, compared_names(seen)):
            there = seen.columns[name][np.isfinite(seen.columns[name])]
            if len(np.unique(there[: CRITERIA.stretch])) < CRITERIA.fewest_vectors:
                continue  # what stands still, or knows hardly any value, is like others by chance
            what = f"{name} is the same as {first} in every row"
            todo = "export it again: one of the two was written twice"
            yield Remark(self.KEY, what, todo, (first, name), Action.REFUSED)


class JointSigns:
    """Tests efforts and positions of joints, channel by channel: the opposite sign of the simulation, their constant included."""

    KEY: ClassVar[str] = "joint_signs"
    STAGE: ClassVar[Stage] = Stage.FRAMES

    def examine(self, seen: Observations) -> Iterator[Remark]:
        """Yield a remark for each joint that is its simulation turned round; what is less clear is asked later."""
        if seen.predict not in ("effort", "position"):
            return
        scene = compared(seen)
        if scene is None or len(scene) < 50 or not np.isfinite(scene.simulated).all():
            return
        for name, y, x in zip(scene.channels, scene.measured.T, scene.simulated.T, strict=True):
            if (slope(x, y) or 0.0) < 0.0 and _turned(y, x):
                seen = with_columns(seen, {name: -seen.columns[name]})
                what = f"{name} reads with the opposite sign of its simulation"
                yield Remark(self.KEY, what, "", (name,), Action.REPAIRED, seen)


def _turned(y: Array, x: Array) -> bool:
    """Return whether -y (N,) is as x (N,), its constant too: one that the sign does not explain says that more is wrong."""
    return bool(np.sum((y + x) ** 2) < CRITERIA.gross_left * np.sum((y - x) ** 2))


def slope(x: Array, y: Array) -> float | None:
    """Return the least-squares slope of y (N,) over x (N,) where the two are one signal; None where they are not."""
    if np.std(x) == 0.0 or np.std(y) == 0.0 or abs(float(np.corrcoef(x, y)[0, 1])) < CRITERIA.one_signal:
        return None
    return float(np.cov(y, x)[0, 1] / np.var(x, ddof=1))

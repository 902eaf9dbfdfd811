"""How columns were brought together: two topics on rows of their own, a slow topic held on the rows of a fast one."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import ClassVar, Final

import numpy as np
from scipy.interpolate import PchipInterpolator

from galen_hw.physics.observations import Observations
from galen_hw.premises.base import Action, Remark, Stage, with_columns, without_columns
from galen_hw.premises.cells import Mask
from galen_hw.premises.criteria import CRITERIA
from galen_hw.spatial import Array

APART: Final = 0.02
"""Share of rows on which both of two joined groups may stand without the join being one by rows."""
GAP: Final = 5.0
"""Median steps of a topic beyond which nothing is interpolated: a gap."""

COMPARED: Final = {
    "wrench": ("wrench.", ""),
    "pose": ("pose.", ""),
    "targets": ("target.", ""),
    "effort": ("joint.", ".effort"),
    "position": ("joint.", ".position"),
}


def compared_names(seen: Observations) -> list[str]:
    """Return the columns of the compared group of which anything was measured."""
    return [n for n in _group(seen) if np.isfinite(seen.columns[n]).any()]


def measured(seen: Observations) -> Observations:
    """Return the recording without compared joints and orientations of which nothing was measured: others can be compared."""
    empty = {n for n in _group(seen) if n.startswith(("joint.", "pose.orientation."))} - set(compared_names(seen))
    return without_columns(seen, empty) if empty else seen


def _group(seen: Observations) -> list[str]:
    """Return the columns of the compared group."""
    keys = COMPARED[seen.predict]
    return [n for n in seen.columns if n.startswith(keys[0]) and n.endswith(keys[-1])]


def copies(seen: Observations, names: Sequence[str]) -> Iterator[tuple[str, str]]:
    """Yield a column and a later one that is the same in every row, to the last digit, for each that is a copy."""
    for k, name in enumerate(names):
        values = seen.columns[name]
        first = next((n for n in names[:k] if np.array_equal(seen.columns[n], values, equal_nan=True)), None)
        if first is not None:
            yield first, name


def driver_names(seen: Observations) -> list[str]:
    """Return the columns that the simulation is driven by: joints, orientation, applied force."""
    compared = set(_group(seen))
    kinds = (".position", ".velocity", ".command", ".effort")
    return [
        n
        for n in seen.columns
        if n not in compared
        and (
            (n.startswith("joint.") and n.endswith(kinds))
            or n.startswith(("sensor.orientation.", "applied.force.", "imu."))
        )
    ]


class OuterJoin:
    """Tests for two topics that were joined on rows of their own: where one has cells the other has none."""

    KEY: ClassVar[str] = "outer_join"
    STAGE: ClassVar[Stage] = Stage.CELLS

    def examine(self, seen: Observations) -> Iterator[Remark]:
        """Yield one remark; what drives is interpolated to the rows of what is compared."""
        time = seen.time
        theirs, ours = driver_names(seen), compared_names(seen)
        if time is None or not theirs or not ours:
            return
        driven = np.isfinite(seen.matrix(*theirs)).any(axis=1)
        measured = np.isfinite(seen.matrix(*ours)).any(axis=1)
        both, total = int((driven & measured).sum()), len(seen)
        if both > APART * total or driven.sum() < 20 or measured.sum() < 20 or np.any(np.diff(time) < 0.0):
            return
        columns = {name: values[measured] for name, values in seen.columns.items()}
        for name in theirs:
            columns[name] = _between(time, seen.columns[name], time[measured])
        rate = [1.0 / float(np.median(np.diff(time[rows]))) for rows in (driven, measured)]
        what = (
            f"joints ({int(driven.sum())} rows, {rate[0]:.3g} Hz) and {ours[0].split('.')[0]} ({int(measured.sum())} rows, "
            f"{rate[1]:.3g} Hz) stand on rows of their own, as of a join of two topics: joints are resampled to the others' rows"
        )
        taken = seen.taken(measured)
        yield Remark(self.KEY, what, "", tuple(theirs), Action.REPAIRED, replace(taken, columns=columns))


def _between(time: Array, values: Array, at: Array) -> Array:
    """Interpolate values to other times, monotone between the measured ones; NaN outside them and across gaps."""
    there = np.isfinite(values)
    if there.sum() < 4:
        return np.full(len(at), np.nan)
    t, v = time[there], values[there]
    keep = np.diff(t, prepend=-np.inf) > 0.0
    t, v = t[keep], v[keep]
    out = np.asarray(PchipInterpolator(t, v, extrapolate=False)(at))
    after = np.clip(np.searchsorted(t, at), 1, len(t) - 1)
    wide = t[after] - t[after - 1] > GAP * float(np.median(np.diff(t)))
    return np.where(wide & ~np.isin(at, t), np.nan, out)


class Staircase:
    """Tests for joint positions that are held for several rows while what is compared changes in each: a slower topic."""

    KEY: ClassVar[str] = "staircase"
    STAGE: ClassVar[Stage] = Stage.CELLS

    def examine(self, seen: Observations) -> Iterator[Remark]:
        """Yield one remark; positions are interpolated between the rows at which they change."""
        names = [n for n in driver_names(seen) if n.endswith(".position") or n.startswith("sensor.orientation.")]
        if seen.time is None or seen.predict == "position" or not names or len(seen) < 40:
            return
        values = seen.matrix(*names)
        if not np.isfinite(values).all():
            return
        moves = values[:, np.ptp(values, axis=0) > 0.0]
        ours = seen.matrix(*compared_names(seen))
        changes = np.any(np.diff(moves, axis=0) != 0.0, axis=1)
        live = np.any(np.diff(ours, axis=0) != 0.0, axis=1)
        held = _rows_held(changes)
        if held is None or np.mean(live[~changes]) < 0.9 or not _moves_throughout(moves, changes):
            return
        fresh = np.concatenate([[True], changes])
        columns = {n: _between(seen.time, np.where(fresh, seen.columns[n], np.nan), seen.time) for n in names}
        what = (
            f"joint positions are held for {held} rows each (a slower topic): interpolated between the rows that change"
        )
        repaired = with_columns(seen, columns)
        last = int(np.flatnonzero(fresh)[-1])
        yield Remark(self.KEY, what, "", tuple(names), Action.REPAIRED, repaired.taken(np.arange(len(seen)) <= last))


class SlowReadings:
    """Tests for compared readings that are held for several rows: a sensor that is slower than its log.

    A held reading is late by up to a period, with a saw tooth of the sensor's rate: a delay, a vibration and an unknown.
    """

    KEY: ClassVar[str] = "slow_readings"
    STAGE: ClassVar[Stage] = Stage.CELLS

    def examine(self, seen: Observations) -> Iterator[Remark]:
        """Yield one remark; the rows that repeat a reading are left out."""
        names = compared_names(seen)
        if seen.time is None or not names or len(seen) < 40:
            return
        values = seen.matrix(*names)
        if not np.isfinite(values).all():
            return
        changes = np.any(np.diff(values, axis=0) != 0.0, axis=1)
        fresh = np.concatenate([[True], changes])
        held = _rows_held(changes)
        if held is None or not _change_by_any_size(values[fresh]):
            return
        rate = 1.0 / float(np.median(np.diff(seen.time)))
        what = (
            f"{names[0].split('.')[0]} readings are held for {held} rows each, of a sensor that is slower than its log "
            f"({rate / held:.3g} Hz in rows of {rate:.3g} Hz): {int(fresh.sum())} rows with a new reading are kept"
        )
        yield Remark(self.KEY, what, "", tuple(names), Action.REPAIRED, seen.taken(fresh))


def _change_by_any_size(fresh: Array) -> bool:
    """Return whether readings (n, C) change as noise does, and not by steps: a slow signal waits for the next step as well."""
    moves = [column[column > 0.0] for column in np.abs(np.diff(fresh, axis=0)).T]
    return any(len(one) and float(np.min(one)) < CRITERIA.half * float(np.median(one)) for one in moves)


def _rows_held(changes: Mask) -> int | None:
    """Return how many rows a value stands, where nearly all do so alike; None where values change with every row."""
    at = np.flatnonzero(changes)
    if len(at) < 10:
        return None
    lengths = np.diff(at)
    usual = int(np.median(lengths))
    # A topic's messages do not come on time to a row.
    near = np.abs(lengths - usual) <= max(1, usual // 4)
    return usual if usual >= 2 and np.mean(near) > 0.9 else None


def _moves_throughout(moves: Array, changes: Mask) -> bool:
    """Return whether steps are those of a motion that went on meanwhile: smooth when the held rows are left out."""
    fresh = moves[np.concatenate([[True], changes])]
    return len(fresh) > 10 and bool(any(float(np.mean(np.diff(q) ** 2)) < 0.1 * float(np.var(q)) for q in fresh.T))


def steps_within(values: Array, segments: Sequence[slice]) -> Array:
    """Return the changes from one measured value of (N,) to the next, none from one segment to another."""
    return np.concatenate([np.diff(values[part][np.isfinite(values[part])]) for part in segments])


def unwrapped(values: Array, segments: Sequence[slice], period: float) -> Array:
    """Return values (N,) unwrapped by a period within each segment, whose first value stays as it was read."""
    out = values.copy()
    for part in segments:
        there = np.isfinite(values[part])
        out[part][there] = np.unwrap(values[part][there], period=period)
    return out

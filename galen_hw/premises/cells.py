"""Cells: values that mean "lost", rows that stand twice, raw rows where one row should be one pose."""

from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from typing import ClassVar, Final

import numpy as np
from numpy.typing import NDArray

from galen_hw.physics.observations import Observations
from galen_hw.premises.base import Action, Remark, Stage
from galen_hw.spatial import Array

Mask = NDArray[np.bool_]

LARGEST: Final = 1e20
"""No SI number of a machine is so large; NDI's "missing" is -3.697314e28 (Polaris API guide, BAD_FLOAT)."""
HELD_ROWS: Final = 4
"""Rows of exactly one value in all channels of a noisy group: of white noise with two values alone, 1 in 2^(3 x 3)."""
RAW_ROWS: Final = 5
"""Rows of one pose from which on they are samples of it and no visits."""
SAME_POSE: Final = 2e-3
"""rad or m; readings of one pose: more than an encoder's noise, less than any step of a sweep."""
POSE = tuple(f"pose.position.{a}" for a in "xyz") + tuple(f"pose.orientation.{a}" for a in "xyzw")


def rows_in(count: int, total: int) -> str:
    """Say a number of rows with its share."""
    share = 100.0 * count / max(total, 1)
    return f"{count} of {total} rows ({share:.2g} %)" if share < 99.5 else f"{count} of {total} rows"


class LostValues:
    """Tests for numbers that stand for "not measured": huge ones, a tracker's origin and identity, its last value held."""

    KEY: ClassVar[str] = "lost_values"
    STAGE: ClassVar[Stage] = Stage.CELLS

    def examine(self, seen: Observations) -> Iterator[Remark]:
        """Yield one remark; the cells become NaN."""
        columns, said, names = dict(seen.columns), list[str](), list[str]()
        for name, values in seen.columns.items():
            huge = np.abs(values) > LARGEST
            if huge.any() and name not in ("time", "segment"):
                columns[name] = np.where(huge, np.nan, values)
                names.append(name)
        if names:
            worst = names[0]
            lost = int((np.abs(seen.columns[worst]) > LARGEST).sum())
            value = float(seen.columns[worst][np.abs(seen.columns[worst]) > LARGEST][0])
            said.append(f"{rows_in(lost, len(seen))} of {worst} read {value:.7g}, which means lost")
        for group in _tracked(columns):
            for what, sought in (
                ("the origin", partial(_origin, group=group)),
                ("one and the same far place", partial(_far, group=group)),
                ("their last value again", _held),
            ):
                lost_rows = sought(np.stack([columns[name] for name in group], axis=1))
                if lost_rows.any():
                    for name in group:
                        columns[name] = np.where(lost_rows, np.nan, columns[name])
                    names += group
                    said.append(
                        f"{rows_in(int(lost_rows.sum()), len(seen))} of {group[0].rsplit('.', 2)[0]} read {what}"
                    )
        if names:
            what = f"{'; '.join(said)}: taken as not measured"
            columns_said = tuple(dict.fromkeys(names))
            yield Remark(self.KEY, what, "", columns_said, Action.REPAIRED, replace(seen, columns=columns))


def _tracked(columns: dict[str, Array]) -> list[list[str]]:
    """Return the groups of columns that a tracker loses together."""
    pose = [name for name in POSE if name in columns]
    targets: dict[str, list[str]] = {}
    for name in columns:
        if name.startswith("target."):
            targets.setdefault(name.rsplit(".", 2)[0], []).append(name)
    return [group for group in (pose, *targets.values()) if group]


def _origin(values: Array, group: list[str]) -> Mask:
    """Return which rows (N,) read exactly zeros, with or without the identity, where most others do not."""
    position = [k for k, name in enumerate(group) if ".position." in name]
    zero = np.all(values[:, position] == 0.0, axis=1)
    return zero if 0 < zero.sum() < 0.5 * len(values) else np.zeros(len(values), dtype=bool)


def _far(values: Array, group: list[str]) -> Mask:
    """Return which rows (N,) read one place to the last bit that is as far from every other as these are apart, or farther.

    What moves does not come back to the last bit; a number that stands for "lost" (9999, -1000) does nothing else.
    """
    columns = [k for k, name in enumerate(group) if ".position." in name]
    position = values[:, columns]
    there = np.isfinite(position).all(axis=1)
    places, which, counts = np.unique(position[there], axis=0, return_inverse=True, return_counts=True)
    out = np.zeros(len(values), dtype=bool)
    if len(places) < HELD_ROWS or counts.max() < 2:
        return out
    best = int(np.argmax(counts))
    others = np.delete(places, best, axis=0)
    middle, size = others.mean(axis=0), np.linalg.norm(np.ptp(others, axis=0))
    alone = counts[best] < 0.5 * len(values) and float(np.linalg.norm(places[best] - middle)) > 2.0 * size > 0.0
    if alone:
        out[there] = which.reshape(-1) == best
    return out


def _held(values: Array) -> Mask:
    """Return which rows (N,) repeat the row before to the last bit: all if that is no chance, else runs where nearly all change.

    The first row of a run was measured.
    """
    same = np.zeros(len(values), dtype=bool)
    alike = values[1:] == values[:-1]
    same[1:] = alike.all(axis=1)
    if same.sum() >= 0.5 * len(values):
        return np.zeros_like(same)
    # By chance each column repeats as often as it does beside others that do not.
    if len(values) * float(np.prod(np.mean(alike[~same[1:]], axis=0))) < 1.0:
        return same
    out = np.zeros_like(same)
    for start, stop in runs(same):
        out[start:stop] = stop - start >= HELD_ROWS - 1
    return out if np.sum(same & ~out) <= 0.01 * len(values) else np.zeros_like(out)


def runs(flags: Mask) -> list[tuple[int, int]]:
    """Return (start, stop) of each run of True in (N,) flags."""
    edges = np.diff(np.concatenate([[False], flags, [False]]).astype(np.int8))
    return list(zip(np.flatnonzero(edges == 1).tolist(), np.flatnonzero(edges == -1).tolist(), strict=True))


class DoubledRows:
    """Tests for rows that stand twice, to the last digit of every column: two merges of one log, or a slow publisher.

    A machine at rest behind rounded readings repeats itself as well. So copies are told by their stamps, by standing side by side
    throughout the recording, or, without a clock, by readings that are otherwise never the same twice.
    """

    KEY: ClassVar[str] = "doubled_rows"
    STAGE: ClassVar[Stage] = Stage.CELLS

    def examine(self, seen: Observations) -> Iterator[Remark]:
        """Yield one remark; the copies go."""
        names = [name for name in seen.columns if name not in ("time", "segment")]
        if len(seen) < 8 or not names:
            return
        values = np.nan_to_num(seen.matrix(*names), nan=LARGEST)
        double = _copies(values) if seen.time is None else _same_stamp(seen.time, values) | _side_by_side(values)
        if not double.any():
            return
        what = f"{rows_in(int(double.sum()), len(seen))} stand twice, to the last digit of every column; the copies are left out"
        yield Remark(self.KEY, what, "", (), Action.REPAIRED, seen.taken(~double))


def _copies(values: Array) -> Mask:
    """Return which rows (N,) stood before, anywhere, where columns are otherwise never the same twice."""
    unique, first = np.unique(values, axis=0, return_index=True)
    out = np.ones(len(values), dtype=bool)
    out[first] = False
    distinct = [len(np.unique(column)) / len(unique) for column in unique.T]
    return out if max(distinct) > 0.99 and np.median(distinct) > 0.5 else np.zeros_like(out)


def _same_stamp(time: Array, values: Array) -> Mask:
    """Return which rows (N,) have the stamp and all values of an earlier one."""
    if np.all(np.diff(time) > 0.0):
        return np.zeros(len(time), dtype=bool)
    _, first = np.unique(np.column_stack([time, values]), axis=0, return_index=True)
    out = np.ones(len(time), dtype=bool)
    out[first] = False
    return out


def _side_by_side(values: Array) -> Mask:
    """Return which rows (N,) repeat the one before, where throughout the recording each stands so many times."""
    same = np.zeros(len(values), dtype=bool)
    same[1:] = np.all(values[1:] == values[:-1], axis=1)
    starts = np.flatnonzero(~same)
    lengths = np.diff([*starts.tolist(), len(values)])
    usual = int(np.median(lengths))
    return same if usual >= 2 and np.mean(lengths == usual) > 0.9 else np.zeros_like(same)


class PoseRows:
    """Tests for raw rows of static poses whose clock, if any, stamps the pose: rows of one pose share its errors and are one."""

    KEY: ClassVar[str] = "pose_rows"
    STAGE: ClassVar[Stage] = Stage.CELLS

    def examine(self, seen: Observations) -> Iterator[Remark]:
        """Yield one remark; each pose becomes one row, with its number of samples and their standard deviations."""
        if seen.simulation is not None or seen.predict not in ("wrench", "pose", "targets"):
            return
        if seen.time is not None and np.all(np.diff(seen.time) != 0.0):
            return  # a clock of the rows: where poses end need not be known
        bounds = pose_bounds(seen)
        counts = np.diff([*bounds, len(seen)])
        if seen.time is not None and np.any(np.delete(np.diff(seen.time), np.array(bounds[1:], dtype=int) - 1) != 0.0):
            return  # a clock of the rows
        if len(bounds) < 4 or not np.any(counts >= RAW_ROWS) or len(bounds) == len(seen):
            return
        columns = {name: _means(values, bounds) for name, values in seen.columns.items()}
        columns |= _spreads(seen, bounds)
        columns["covariate.samples"] = counts.astype(float)
        mixed = f", {int((counts == 1).sum())} of them of a single row" if np.any(counts == 1) else ""
        what = f"{len(seen)} rows of {len(bounds)} poses{mixed}: averaged pose by pose"
        # Rows of one pose are one pose; averages among them are another matter, since each counts as many.
        action = Action.REPAIRED if mixed else Action.NOTE
        yield Remark(self.KEY, what, "", (), action, replace(seen, columns=columns))


def pose_bounds(seen: Observations) -> list[int]:
    """Return the first row of each run of rows that were driven alike: joints, orientation, applied force, tool."""
    names = [
        n
        for n in seen.columns
        if (n.endswith(".position") and n.startswith("joint."))
        or n.startswith(("sensor.orientation.", "applied.force."))
    ]
    names += [n for n in seen.columns if n in ("segment", "covariate.tool", "covariate.pose", "covariate.verify")]
    if not names:
        return list(range(len(seen)))
    values = np.nan_to_num(seen.matrix(*names), nan=LARGEST)
    bounds, first = [0], values[0]
    for row in range(1, len(values)):
        if np.max(np.abs(values[row] - first)) > SAME_POSE:
            bounds.append(row)
            first = values[row]
    return bounds


def _means(values: Array, bounds: list[int]) -> Array:
    """Return the means (P,) of runs, without the cells that were not measured."""
    there = np.isfinite(values)
    total = np.add.reduceat(np.where(there, values, 0.0), bounds)
    count = np.add.reduceat(there.astype(float), bounds)
    return np.where(count > 0.0, total / np.maximum(count, 1.0), np.nan)


def _spreads(seen: Observations, bounds: list[int]) -> dict[str, Array]:
    """Return the standard deviations within each pose of the wrench's columns, as a sweep of our own has them."""
    out = {}
    for name in (n for n in seen.columns if n.startswith("wrench.")):
        mean = _means(seen.columns[name], bounds)
        square = _means(seen.columns[name] ** 2, bounds)
        counts = np.diff([*bounds, len(seen)])
        variance = np.maximum(square - mean**2, 0.0) * counts / np.maximum(counts - 1, 1)
        out[f"covariate.std.{name.removeprefix('wrench.')}"] = np.where(counts > 1, np.sqrt(variance), np.nan)
    return out

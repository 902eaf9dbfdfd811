"""Gaps that a program filled by straight lines before the export: rows that nobody measured, and that look as if."""

from collections.abc import Iterator
from typing import ClassVar, Final

import numpy as np

from galen_hw.physics.observations import Observations
from galen_hw.premises.base import Action, Remark, Stage, with_columns
from galen_hw.premises.cells import HELD_ROWS, Mask, rows_in, runs
from galen_hw.premises.criteria import CRITERIA
from galen_hw.premises.sampling import compared_names
from galen_hw.spatial import Array, continuous

BELOW: Final = 0.01
"""Of the deviations that noise makes: two orders of magnitude. One row in two hundred is as straight by chance."""
DIGITS: Final = 0.1
"""Of the same, by which a file's digits may hide it: what is rounded more coarsely tells nothing."""
BY_CHANCE: Final = 0.01
"""Stretches that chance may make in a whole recording."""
MOST_DECIMALS: Final = 15
"""That a double of about one tells."""
SHOWN: Final = 4
"""Stretches that are named in one line."""


class FilledGaps:
    """Tests for stretches in which all channels of a device run along straight lines without noise, and have noise else.

    The deviation of a row from the line through its neighbours is compared with those of the other rows, and with what stamps
    that jitter make of the same speed. A channel that is smooth throughout (a simulation, a filter) tells nothing, nor does one
    that stands still; where half the rows lie on lines, or lines are short, all was resampled and nothing was filled.
    """

    KEY: ClassVar[str] = "filled_gaps"
    STAGE: ClassVar[Stage] = Stage.CELLS

    def examine(self, seen: Observations) -> Iterator[Remark]:
        """Yield one remark for each device; the rows of the lines become NaN."""
        if seen.time is None or len(seen) < 100:
            return
        for names in _devices(compared_names(seen)):
            assert seen.time is not None, "a copy has the same columns"
            # Gaps are filled over the stamps, or over the numbers of the rows.
            clocks = ((seen.time, float(_digit(seen.time[:, None])[0])), (np.arange(len(seen), dtype=float), 0.0))
            found = max((_filled(seen, names, *clock) for clock in clocks), key=np.sum)
            if not found.any():
                continue
            stretches = [f"{seen.time[a]:.5g} to {seen.time[b - 1]:.5g} s" for a, b in runs(found)]
            seen = with_columns(seen, {name: np.where(found, np.nan, seen.columns[name]) for name in names})
            where = ", ".join(stretches[:SHOWN]) + (f" and {len(stretches) - SHOWN} more" if stretches[SHOWN:] else "")
            what = f"{rows_in(int(found.sum()), len(seen))} of {_called(names)} lie on straight lines without noise ({where})"
            what += ": gaps that were filled, taken as not measured"
            todo = "export without filling gaps, or leave these rows out"
            yield Remark(self.KEY, what, todo, tuple(names), Action.REPAIRED, seen)


def _devices(names: list[str]) -> list[list[str]]:
    """Return the compared columns in groups of what one device measures: a tracked body, or all of a wrench or of the joints."""
    groups: dict[str, list[str]] = {}
    for name in names:
        groups.setdefault(name.rsplit(".", 2)[0] if name.startswith("target.") else "", []).append(name)
    return list(groups.values())


def _called(names: list[str]) -> str:
    """Return what a device's columns are called together."""
    if names[0].startswith("joint."):
        return f"{names[0]} and {len(names) - 1} more" if len(names) > 1 else names[0]
    return names[0].rsplit(".", 2)[0]


def _filled(seen: Observations, names: list[str], clock: Array, tick: float) -> Mask:
    """Return which rows (N,) lie on straight lines over a clock (N,), without noise, in all of the columns that have noise else.

    Args:
        tick: to which the clock is written.
    """
    values = seen.matrix(*names)
    turns = [k for k, name in enumerate(names) if ".orientation." in name]
    if len(turns) == 4:
        there = np.isfinite(values[:, turns]).all(axis=1)
        q = values[:, turns]
        q[there] = _of_length_one(continuous(q[there]))
        values[:, turns] = q
    inside = np.zeros(len(values), dtype=bool)
    for part in seen.segments:
        inside[part.start + 1 : part.stop - 1] = True
    span = clock[2:] - clock[:-2]
    inside[1:-1] &= (span > 0.0) & (np.diff(clock)[1:] >= 0.0) & (np.diff(clock)[:-1] >= 0.0)
    rows = np.flatnonzero(inside)
    share = ((clock[rows] - clock[rows - 1]) / (clock[rows + 1] - clock[rows - 1]))[:, None]
    off = values[rows] - values[rows - 1] * (1.0 - share) - values[rows + 1] * share
    step = np.abs(values[rows + 1] - values[rows - 1])
    if len(turns) == 4:
        off[:, turns] = _off_arc(*(values[rows + k][:, turns] for k in (-1, 0, 1)))
    rounding = 2.0 * _digit(seen.matrix(*names)) + step * (tick / span[rows - 1][:, None])
    chance = _chance(off, step, rounding)
    out = np.zeros(len(values), dtype=bool)
    if chance is None or len(rows) < 0.5 * len(values):
        return out
    straight, log_chance = np.zeros(len(values), dtype=bool), np.zeros(len(values))
    straight[rows], log_chance[rows] = chance < 1.0, np.log(chance)
    for start, stop in runs(straight):
        by_chance = len(rows) * float(np.exp(np.sum(log_chance[start:stop])))
        out[start:stop] = stop - start >= HELD_ROWS and by_chance < BY_CHANCE
    short = int(straight.sum() - out.sum())
    resampled = straight.sum() > CRITERIA.half * len(values) or short > CRITERIA.half * out.sum()
    return np.zeros_like(out) if resampled else out


def _chance(off: Array, step: Array, rounding: Array) -> Array | None:
    """Return with which chance (n,) rows lie so near the line through their neighbours; 1 where they do not, None: no noise.

    Args:
        off: (n, k) deviations from the line, NaN where not measured.
        step: (n, k) from the row before to the one behind.
        rounding: (n, k) deviation that the digits of the file make.
    """
    straight, chance = np.ones(len(off), dtype=bool), np.ones(len(off))
    noisy = False
    for d, moved, digits in zip(off.T, step.T, rounding.T, strict=True):
        known = np.isfinite(d)
        straight &= known
        usual = float(np.median(np.abs(d[known]))) if known.any() else 0.0
        # What curves stays on one side of the line from row to row; of white noise three rows in four change sides.
        if not usual > 0.0 or np.mean(d[1:] * d[:-1] < 0.0) < CRITERIA.half:
            continue
        noisy = True
        # Stamps that jitter make deviations in proportion to the speed: slow rows are nearer the line without being filled.
        moves = known & (moved > 0.0)
        expected = np.minimum(usual, moved * float(np.median(np.abs(d[moves]) / moved[moves])))
        limit = np.maximum(BELOW * expected, digits)
        straight &= np.abs(np.nan_to_num(d)) <= limit
        # Channels may share their noise: the one that tells most counts, the others only must not contradict.
        tells = known & (limit <= DIGITS * expected)
        chance[tells] = np.minimum(chance[tells], limit[tells] / expected[tells])
    return np.where(straight, chance, 1.0) if noisy else None


def _off_arc(before: Array, q: Array, after: Array) -> Array:
    """Return by how much quaternions (n, 4) of length one lie beside the arc between those before and after.

    Along the arc programs differ: some turn evenly, others make a straight line of length one behind.
    """
    along = _of_length_one(after - before)
    middle = _of_length_one(after + before)
    off = q - middle * np.sum(q * middle, axis=1, keepdims=True) - along * np.sum(q * along, axis=1, keepdims=True)
    return np.asarray(off)


def _of_length_one(q: Array) -> Array:
    """Return (N, 4) divided by their lengths."""
    return np.asarray(q / np.maximum(np.linalg.norm(q, axis=1, keepdims=True), 1e-300))


def _digit(values: Array) -> Array:
    """Return the unit of the last decimal (k,) to which the columns of (N, k) are written; for a quarter it may be more."""
    decimals = np.full(values.shape, float(MOST_DECIMALS))
    for k in reversed(range(MOST_DECIMALS)):
        same = np.isclose(np.round(values, k), values, rtol=4.0 * np.finfo(float).eps, atol=0.0)
        decimals[same] = k
    decimals[~np.isfinite(values)] = np.nan
    known = np.isfinite(decimals).any(axis=0)
    out = np.zeros(values.shape[1])
    # Zeros at the end are not written or not seen; rows with fewer digits have larger values.
    out[known] = 10.0 ** -np.round(np.nanquantile(decimals[:, known], 0.25, axis=0))
    return out

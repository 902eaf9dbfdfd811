"""The clock: its unit, its steps, stamps that were rounded, and whether it runs as the motion says."""

from collections.abc import Iterator
from typing import ClassVar, Final

import numpy as np
from numpy.typing import NDArray

from galen_hw.physics.observations import Observations
from galen_hw.premises.base import Action, Remark, Stage, with_columns
from galen_hw.premises.cells import rows_in
from galen_hw.premises.criteria import CRITERIA
from galen_hw.spatial import Array

UNITS: Final = {"ms": 1e3, "us": 1e6, "ns": 1e9}
PERIODS_S: Final = (2e-5, 0.4)
"""Shortest and longest time between rows of a recorded motion: 50 kHz, 2.5 Hz."""
SPEEDS: Final = (1e-4, 30.0)
"""Slowest and fastest motion of a machine that was worth recording, rms rad/s or m/s."""
SMOOTH: Final = 0.02
"""Mean squared step from row to row over the variance, of a joint that moves smoothly."""
STEP: Final = 5.0
"""Times the median step of time, either way, from which on a clock was set."""
AT_ONCE: Final = 0.1
"""Of the mean time between rows: what follows sooner was delivered together."""
ALONE: Final = 3
"""Stamps in a row that are off by themselves, and no clock that was set."""


def moving(seen: Observations) -> list[Array]:
    """Return the columns (N,) that say how the machine moves: joints' positions, else the sensor's orientation or the pose."""
    groups = (
        [n for n in seen.columns if n.startswith("joint.") and n.endswith((".position", ".command"))],
        [n for n in seen.columns if n.startswith("sensor.orientation.")],
        [n for n in seen.columns if n.startswith("pose.position.")],
    )
    names = next((group for group in groups if group), [])
    columns = [np.asarray(seen.columns[n])[np.isfinite(seen.columns[n])] for n in names]
    return [c for c in columns if len(c) > 2 and np.ptp(c) > 0.0]


def smooth(seen: Observations) -> bool:
    """Return whether any of what moves does so smoothly from row to row: rows are samples of a motion, not poses."""
    return any(float(np.mean(np.diff(q) ** 2)) < SMOOTH * float(np.var(q)) for q in moving(seen))


class ClockUnit:
    """Tests whether time is in seconds: rows of a smooth motion are milliseconds apart, not seconds."""

    KEY: ClassVar[str] = "clock_unit"
    STAGE: ClassVar[Stage] = Stage.CELLS

    def examine(self, seen: Observations) -> Iterator[Remark]:
        """Yield one remark: repaired where one unit alone is possible, or the velocities tell it."""
        time = seen.time
        if time is None or len(time) < 50:
            return
        steps = np.diff(time)
        if not np.any(steps > 0.0):
            return  # of reversed rows or a clock that stands: no unit
        # Stamps of whole seconds stand still more often than not: over the whole recording they advance all the same.
        step = (
            float(np.ptp(time)) / (len(time) - 1) if np.median(steps) == 0.0 else float(np.median(steps[steps > 0.0]))
        )
        if step < PERIODS_S[1] or not smooth(seen):
            return
        by_speed = speed_scale(seen)
        if by_speed is not None:
            near = [(u, f) for u, f in UNITS.items() if abs(np.log(by_speed * f)) < 0.1]
        else:
            near = [
                (u, f)
                for u, f in UNITS.items()
                if PERIODS_S[0] <= step / f <= PERIODS_S[1] and _possible(seen, step / f)
            ]
        text = f"time advances by {step:.6g} a row while the joints move smoothly"
        whole = by_speed is None and step == 1.0 and np.all(steps == 1.0)
        if len(near) != 1 or whole:
            todo = "give seconds" + (" (it may be a row number)" if whole else "")
            yield Remark(self.KEY, f"{text}: it is not in seconds (is it in ms?)", todo, ("time",), Action.REFUSED)
            return
        unit, factor = near[0]
        repaired = with_columns(seen, {"time": time / factor})
        yield Remark(self.KEY, f"{text}: it is in {unit}", "", ("time",), Action.REPAIRED, repaired)


def _possible(seen: Observations, period: float) -> bool:
    """Return whether machines move as fast as this one would with so many seconds between rows."""
    fastest = max(float(np.sqrt(np.mean(np.diff(q) ** 2))) for q in moving(seen)) / period
    return SPEEDS[0] <= fastest <= SPEEDS[1]


def speed_scale(seen: Observations) -> float | None:
    """Return the median over joints of (change of position per time) over measured velocity; None: nothing tells.

    1 where clock and velocities agree, 1e-3 where time is in ms.
    """
    found = _scales(seen)
    return float(np.median(found)) if found else None


def _scales(seen: Observations) -> list[float]:
    """Return (change of position per time) over measured velocity of each joint for which the two are one signal."""
    found = []
    for name in [n for n in seen.columns if n.startswith("joint.") and n.endswith(".velocity")]:
        q = seen.columns.get(name.replace(".velocity", ".position"))
        one = None if q is None else _scale(seen, q, seen.columns[name])
        if one is not None:
            found.append(one)
    return found


def travelled(seen: Observations, q: Array, v: Array) -> tuple[Array, Array] | None:
    """Return the changes of a position q (N,) over some rows each, and the same by its velocity v (N,), at most 200 of them.

    Over many rows a motion is far above the noise of its readings, and stamps that jitter are evened out. None: too few rows.
    """
    time = seen.time
    if time is None:
        return None
    inside = np.diff(time) > 0.0
    for part in seen.segments[1:]:
        inside[part.start - 1] = False
    inside &= np.isfinite(np.diff(q)) & np.isfinite(v[1:]) & np.isfinite(v[:-1])
    if inside.sum() < 20:
        return None
    change, told = np.diff(q)[inside], (0.5 * (v[1:] + v[:-1]) * np.diff(time))[inside]
    width = max(len(change) // 200, 1)
    count = len(change) // width * width
    first, second = (x[:count].reshape(-1, width).sum(axis=1) for x in (change, told))
    return first, second


def _scale(seen: Observations, q: Array, v: Array) -> float | None:
    """Return the change of position per time over velocity; None where the two are not one signal."""
    found = travelled(seen, q, v)
    if found is None:
        return None
    moved, told = found
    if np.std(moved) == 0.0 or np.std(told) == 0.0 or np.corrcoef(moved, told)[0, 1] < 0.9:
        return None
    return float(np.sum(moved * told) / np.sum(told**2))


class RowOrder:
    """Tests whether rows are in the order of their stamps: a table that was sorted by something else, or written as a set."""

    KEY: ClassVar[str] = "row_order"
    STAGE: ClassVar[Stage] = Stage.CELLS

    def examine(self, seen: Observations) -> Iterator[Remark]:
        """Yield one remark; rows are sorted by their stamps, where the motion is then smoother."""
        time = seen.time
        if time is None or len(time) < 50 or len(seen.segments) > 1 or len(np.unique(time)) < len(time):
            return
        back = int(np.sum(np.diff(time) < 0.0))
        if back <= ALONE:
            return
        order = np.argsort(time)
        taken = seen.taken(order)
        before, after = (sum(_roughness(q) for q in moving(one)) for one in (seen, taken))
        if back < len(time) - 1 and not after < CRITERIA.half * before:
            return  # a clock that was set: rows follow each other as they stand
        what = f"rows are not in the order of their stamps, which go back {back} times: sorted by them, the motion is smooth"
        yield Remark(self.KEY, what, "", ("time",), Action.REPAIRED, taken)


def _roughness(q: Array) -> float:
    """Return the mean squared step of q (N,) over its variance."""
    return float(np.mean(np.diff(q) ** 2)) / max(float(np.var(q)), 1e-300)


class ClockSteps:
    """Tests for a clock that was set back while recording: rows are in order, their stamps are not. Forth, it is a gap."""

    KEY: ClassVar[str] = "clock_steps"
    STAGE: ClassVar[Stage] = Stage.CELLS

    def examine(self, seen: Observations) -> Iterator[Remark]:
        """Yield one remark; a new segment begins at each step, and time goes on from there."""
        time = seen.time
        if time is None or len(time) < 8 or not smooth(seen):
            return
        steps = np.diff(time)
        edges = np.zeros(len(steps), dtype=bool)
        for part in seen.segments[1:]:
            edges[part.start - 1] = True
        usual = float(np.median(steps[(steps > 0.0) & ~edges])) if np.any((steps > 0.0) & ~edges) else 0.0
        back = (steps < -STEP * usual) & ~edges & _lasting(time)
        if not usual or not back.any() or back.sum() > 0.01 * len(time):
            return
        shift = np.zeros(len(time))
        shift[1:] = np.cumsum(np.where(back, usual - steps, 0.0))
        segment = np.concatenate([[0], np.cumsum(back | edges)]).astype(float)
        rows = np.flatnonzero(back) + 1
        first = f"{abs(steps[rows[0] - 1]):.4g} s at row {rows[0] + 1}"
        more = f" and {len(rows) - 1} more times" if len(rows) > 1 else ""
        what = f"the clock steps back by {first}{more}: a new segment begins there, and no motion is taken across it"
        repaired = with_columns(seen, {"time": time + shift, "segment": segment})
        yield Remark(self.KEY, what, "", ("time",), Action.REPAIRED, repaired)


def _lasting(time: Array) -> NDArray[np.bool_]:
    """Return the steps (N - 1,) after which stamps stay behind: not a stamp or three by themselves that are off."""
    out = np.ones(len(time) - 1, dtype=bool)
    for k in range(1, ALONE + 1):
        before, after = np.full(len(out), -np.inf), np.full(len(out), np.inf)
        before[k:] = time[: len(out) - k]
        after[: len(out) - k] = time[k + 1 :]
        # One of the next is ahead of the last one again, or one before the last is behind the next.
        out &= ~((after > time[:-1]) & np.isfinite(after)) & ~((before < time[1:]) & np.isfinite(before))
    return out


class RoundedClock:
    """Tests for stamps that say when rows were written, not when they were sampled: rounded, or in bursts.

    Whole seconds, a spreadsheet's digits; blocks of rows that a driver or a serial port delivers at once.
    """

    KEY: ClassVar[str] = "rounded_clock"
    STAGE: ClassVar[Stage] = Stage.CELLS

    def examine(self, seen: Observations) -> Iterator[Remark]:
        """Yield one remark; rows are spread evenly, which is within the rounding, or the block, of every stamp."""
        time = seen.time
        if time is None or len(time) < 50 or not smooth(seen):
            return
        spread = time.copy()
        rounded, worst, bursts = 0, 0.0, False
        for part in seen.segments:
            found = _spread(time[part])
            if found is not None:
                even, quantum, blocks = found
                spread[part], rounded, worst = even, rounded + len(even), max(worst, quantum)
                bursts |= blocks
        if not rounded:
            return
        rows, repaired = rows_in(rounded, len(time)), with_columns(seen, {"time": spread})
        if not bursts:
            what = f"stamps of {rows} are rounded to {worst:.3g} s, coarser than rows follow: rows are spread evenly"
            yield Remark(self.KEY, what, "", ("time",), Action.REPAIRED, repaired)
            return
        what = (
            f"stamps of {rows} come in bursts {worst:.3g} s apart, as a driver delivers blocks: rows are spread evenly"
        )
        sampled = _sampled_when_stamped(seen, time)
        if sampled:
            what += ", and joints, which were read at the stamps, are interpolated"
            joints = {name: np.interp(spread, time, seen.columns[name]) for name in sampled}
            repaired = with_columns(repaired, joints).taken((spread >= time[0]) & (spread <= time[-1]))
        yield Remark(self.KEY, what, "", ("time", *sampled), Action.REPAIRED, repaired)


def _spread(t: Array) -> tuple[Array, float, bool] | None:
    """Return even times (n,) of rows with stamps (n,), the time between different stamps, s, and whether they come in bursts."""
    steps = np.diff(t)
    if len(t) < 20 or np.any(steps < 0.0) or not t[-1] > t[0]:
        return None
    least = AT_ONCE * float(t[-1] - t[0]) / len(steps)
    between = steps[steps > least]
    # Blocks follow each other in time; behind a single gap all rows would be one.
    alike = len(between) >= CRITERIA.pieces and np.max(between) < CRITERIA.least_factor * np.median(between)
    bursts = bool(alike and len(between) <= CRITERIA.half * len(steps) and np.mean(steps == 0.0) < CRITERIA.half)
    if not bursts and float(np.mean(steps == 0.0)) < 0.1:
        return None
    least = least if bursts else 0.0
    row = np.arange(len(t), dtype=float)
    quantum = float(np.min(steps[steps > least], initial=np.inf))
    slope, start = _even(row, t, least)
    even = start + slope * row
    if not slope > 0.0 or np.max(np.abs(even - t - 0.5 * quantum * _floored(even, t))) > 1.5 * quantum:
        return None
    # A block is delivered when its last row was sampled.
    return even - (quantum - slope if bursts else 0.0), quantum, bursts


def _sampled_when_stamped(seen: Observations, time: Array) -> list[str]:
    """Return the columns of joints where most of them hardly move within a burst: they were read when the rows were stamped."""
    steps = np.diff(time)
    inside = steps < AT_ONCE * float(np.ptp(time)) / len(steps)
    names = [n for n in seen.columns if n.startswith("joint.") and n.endswith((".position", ".velocity", ".command"))]
    moves = [np.abs(np.diff(seen.columns[n])) for n in names if np.isfinite(seen.columns[n]).all()]
    held = sum(float(np.mean(x[inside])) < CRITERIA.gross_gain * float(np.mean(x[~inside])) for x in moves)
    return names if len(moves) == len(names) and held > CRITERIA.half * len(names) else []


def _even(row: Array, t: Array, least: float = 0.0) -> tuple[float, float]:
    """Return slope and start of evenly spaced times by the rows at which the stamp changes, which are exact to one row.

    Args:
        least: s; a stamp that changes by less is that of the same block.
    """
    change = np.flatnonzero(np.diff(t) > least) + 1
    if len(change) < 3:
        slope = float(np.ptp(t)) / max(len(t) - 1, 1)
        return slope, float(t[0])
    fit = np.polyfit(row[change] - 0.5, t[change], 1)
    return float(fit[0]), float(fit[1])


def _floored(even: Array, t: Array) -> float:
    """Return 1 where stamps lie below the even times on average (cut off), 0 where about them (rounded)."""
    return 1.0 if float(np.mean(even - t)) > 0.0 else 0.0


RATES: Final = (180.0 / np.pi, 2.0 * np.pi, 30.0 / np.pi, 60.0, 1e3)
"""Factors of units: degrees, revolutions a second and a minute, a minute, mm."""


class ClockRate:
    """Tests whether the clock runs as positions and measured velocities say: all joints alike, a factor that is not 1."""

    KEY: ClassVar[str] = "clock_rate"
    STAGE: ClassVar[Stage] = Stage.CELLS
    OFF: ClassVar[float] = 0.05
    """A velocity filter's gain error is less."""

    def examine(self, seen: Observations) -> Iterator[Remark]:
        """Yield one remark; the clock is repaired where several joints agree."""
        time = seen.time
        if time is None or len(time) < 50 or not smooth(seen):
            return
        found = _scales(seen)
        if len(found) < 2:
            return
        scale = float(np.median(found))
        if abs(np.log(scale)) < self.OFF or np.max(np.abs(np.log(np.array(found) / scale))) > self.OFF:
            return
        if any(abs(abs(np.log(scale)) - np.log(unit)) < CRITERIA.same_factor for unit in RATES):
            return  # a unit of the velocities, or of the positions: theirs to say
        what = f"the clock runs at {1.0 / scale:.4g} times the rate that positions and velocities of {len(found)} joints agree on"
        yield Remark(self.KEY, what, "", ("time",), Action.REPAIRED, with_columns(seen, {"time": time * scale}))

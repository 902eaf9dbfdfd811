"""Joints: angles that wrap, columns of velocity that are none, numbers that were read as unsigned."""

from collections.abc import Iterator, Sequence
from itertools import combinations
from typing import ClassVar, Final

import numpy as np

from galen_hw.physics.observations import Observations
from galen_hw.premises.base import Action, Remark, Stage, with_columns, without_columns
from galen_hw.premises.cells import Mask, rows_in, runs
from galen_hw.premises.clock import SPEEDS, STEP, travelled
from galen_hw.premises.sampling import compared_names, copies, steps_within, unwrapped
from galen_hw.premises.unit_tables import TURN, VELOCITY_RATIOS, unit_of
from galen_hw.spatial import Array

WRAPS: Final = (TURN, 360.0)
"""A turn in rad and in degrees."""
SURELY_MOVED: Final = 50.0
"""Times the noise of a reading that a joint must have gone before its velocities are doubted."""
FEWEST_JUMPS: Final = 3
"""Passages through zero from which on a jump is a sign."""
BY_CHANCE: Final = 0.01
"""Chance that is taken that columns seem to be folded at one and the same number."""
LEAST_MOTION: Final = 0.02
"""rad or m, the same of an encoder without noise."""


def joint_columns(seen: Observations, kind: str) -> list[str]:
    """Return the columns `joint.NAME.kind`."""
    return [n for n in seen.columns if n.startswith("joint.") and n.endswith(f".{kind}")]


class WrappedJoints:
    """Tests for angles that jump by a whole turn: wrapped to one turn, and perhaps resampled by straight lines behind.

    Resampled ones have rows anywhere between the two ends, which no joint was at.
    """

    KEY: ClassVar[str] = "wrapped_joints"
    STAGE: ClassVar[Stage] = Stage.CELLS

    def examine(self, seen: Observations) -> Iterator[Remark]:
        """Yield one remark; the angles are unwrapped within their segments, without rows between."""
        if seen.time is None:
            return
        ours, columns, jumps = set(compared_names(seen)), dict[str, Array](), 0
        lost = np.zeros(len(seen), dtype=bool)
        for name in [*joint_columns(seen, "position"), *joint_columns(seen, "command")]:
            for turn in WRAPS:
                between = _between_ends(seen.columns[name], seen.time, seen.segments, turn)
                values = np.where(between, np.nan, seen.columns[name])
                step = np.abs(steps_within(values, seen.segments))
                if len(step) < 7:
                    continue
                usual = float(np.quantile(step, 0.95))
                wraps = np.abs(step - turn) < max(0.05 * turn, 2.0 * usual)
                if wraps.any() and usual < 0.1 * turn and np.nanmax(values) - np.nanmin(values) < 1.01 * turn:
                    columns[name], jumps = unwrapped(values, seen.segments, turn), jumps + int(wraps.sum())
                    lost |= between
                    if name not in ours and between.any():
                        # What drives is needed in every row: there as straight lines make it of angles that do not wrap.
                        known = np.isfinite(columns[name])
                        filled = np.interp(seen.time[between], seen.time[known], columns[name][known])
                        columns[name][between] = filled
                    break
        if columns:
            names = ", ".join(columns)
            what = f"{names} wrap{'s' if len(columns) == 1 else ''} by a whole turn {jumps} times: unwrapped"
            if lost.any():
                end = "interpolated" if ours.isdisjoint(columns) else "left out"
                rows = rows_in(int(lost.sum()), len(seen))
                what += f"; {rows} between the two ends, which resampling made by straight lines, are {end}"
            todo = "unwrap before resampling" if lost.any() else ""
            yield Remark(self.KEY, what, todo, tuple(columns), Action.REPAIRED, with_columns(seen, columns))


def _between_ends(values: Array, time: Array, segments: Sequence[slice], turn: float) -> Mask:
    """Return which of angles (N,) stand between the two ends of a turn, passed faster than any machine, and no wrap at once.

    Args:
        time: (N,) s.
        segments: runs of rows that are continuous.
        turn: a whole turn in the unit of the angles.
    """
    out = np.zeros(len(values), dtype=bool)
    for part in segments:
        there = part.start + np.flatnonzero(np.isfinite(values[part]))
        x, period = values[there], np.diff(time[there])
        if len(x) < 8 or not np.all(period > 0.0):
            continue
        rate = np.diff(x) / period
        usual = float(np.quantile(np.abs(rate), 0.95))
        fastest = max(STEP * usual, SPEEDS[1] * turn / TURN)
        # Where a wrap begins or ends just beside a row, this one is hardly off: by what the motion beside it foretells.
        ahead, behind = np.diff(rate) * period[1:], -np.diff(rate) * period[:-1]
        limit = STEP * float(np.quantile(np.abs(ahead), 0.95))
        for way in (-1.0, 1.0):
            for start, stop in runs(way * rate > fastest):
                first, last = start, stop
                if first >= 2 and way * ahead[first - 2] > limit:
                    first -= 1
                if last + 1 < len(rate) and way * behind[last] > limit:
                    last += 1
                away = abs(abs(float(x[last] - x[first])) - turn)
                if away < max(0.05 * turn, 2.0 * usual * float(time[there[last]] - time[there[first]])):
                    out[there[first + 1 : last]] = True
    return out


class VelocityColumns:
    """Tests measured velocities against the change of positions: all zero, turned round, in other units, of another joint.

    They are never needed: positions say how the arm moves. What contradicts them is left out.
    """

    KEY: ClassVar[str] = "velocity_columns"
    STAGE: ClassVar[Stage] = Stage.UNITS

    def examine(self, seen: Observations) -> Iterator[Remark]:
        """Yield one remark for each way in which velocities are wrong; their columns go."""
        if seen.time is None or len(seen) < 20:
            return
        why: dict[str, list[str]] = {}
        for name in joint_columns(seen, "velocity"):
            q = seen.columns.get(name.replace(".velocity", ".position"))
            says = None if q is None else wrong_velocity(seen, q, seen.columns[name])
            if says:
                why.setdefault(says, []).append(name)
        crossed = _crossed(seen, [name for names in why.values() for name in names])
        if crossed:
            first, second = (name.rsplit(".", 1)[0] for name in crossed)
            what = f"{first}.velocity is the change of {second}.position and the other way round: columns of the two are swapped"
            yield Remark(self.KEY, what, "give each joint its own columns", crossed, Action.REFUSED)
            return
        for says, names in why.items():
            seen = without_columns(seen, names)
            what = f"{', '.join(names)}: {says}; left out, the positions say how the arm moves"
            yield Remark(self.KEY, what, "", tuple(names), Action.REPAIRED, seen)


class CopiedPositions:
    """Tests for joints whose positions are the same, row by row: one was exported twice, and the other is lost.

    Motors of one gantry, or carriages of a delta, may well move alike: a velocity has to say that the joint moved otherwise.
    """

    KEY: ClassVar[str] = "copied_positions"
    STAGE: ClassVar[Stage] = Stage.UNITS

    def examine(self, seen: Observations) -> Iterator[Remark]:
        """Yield a refusal for each joint that moves as one before it, and not as its velocity."""
        names = joint_columns(seen, "position") if seen.predict != "position" else []
        for first, name in copies(seen, names):
            q = seen.columns[name]
            speeds = [seen.columns.get(n.replace(".position", ".velocity")) for n in (first, name)]
            if any(v is not None and wrong_velocity(seen, q, v) for v in speeds):
                what = f"{name} is the same as {first} in every row, and the velocity says otherwise"
                todo = "export it again: one of the two was written twice"
                yield Remark(self.KEY, what, todo, (first, name), Action.REFUSED)


def _crossed(seen: Observations, names: Sequence[str]) -> tuple[str, ...]:
    """Return two of the velocity columns of which each is the change of the other's position; empty without such a pair."""
    for one, other in combinations(names, 2):
        pairs = ((one, other), (other, one))
        found = [travelled(seen, seen.columns[q.replace(".velocity", ".position")], seen.columns[v]) for v, q in pairs]
        if all(x is not None and min(map(np.ptp, x)) > 0.0 and np.corrcoef(*x)[0, 1] > 0.9 for x in found):
            return one, other
    return ()


def wrong_velocity(seen: Observations, q: Array, v: Array) -> str:
    """Say what is wrong with velocities v (N,) beside positions q (N,); empty where nothing is, or the joint hardly moves."""
    found = travelled(seen, q, v)
    if found is None:
        return ""
    change, told = found
    there = q[np.isfinite(q)]
    noise = float(np.median(np.abs(np.diff(there, n=2))))
    if np.ptp(there) < max(SURELY_MOVED * noise, LEAST_MOTION):
        return ""
    if not np.any(told):
        return "all zero while the position moves"
    if np.std(told) == 0.0 or np.std(change) == 0.0:
        return ""
    return _unlike(change, told)


def _unlike(change: Array, told: Array) -> str:
    """Say how two signals differ that should be one; empty where they do not."""
    correlation = float(np.corrcoef(change, told)[0, 1])
    scale = float(np.sum(told * change) / np.sum(change**2))
    if abs(correlation) < 0.5:
        return "not the change of the position"
    if correlation < -0.9:
        return "the opposite sign of the position's change"
    if correlation > 0.9 and not 0.2 < scale < 5.0:
        hint = unit_of(scale, VELOCITY_RATIOS) or "degrees or mm"
        return f"{scale:.3g} times the position's change (is it in {hint}?)"
    return ""


class SignMagnitude:
    """Tests for integers that were read as unsigned: sign and magnitude, or two's complement, by what continuity says.

    A value that passes through zero jumps by the sign's bit (or by twice that) and goes on: with the bit taken as the sign it
    does not jump at all.
    """

    KEY: ClassVar[str] = "unsigned_integers"
    STAGE: ClassVar[Stage] = Stage.UNITS

    def examine(self, seen: Observations) -> Iterator[Remark]:
        """Yield one remark; the columns get their signs."""
        if seen.time is None:
            return
        columns, how = {}, ""
        names = [n for n in seen.columns if n.startswith(("joint.", "wrench."))]
        for name in names:
            found = _signed(seen.columns[name])
            if found is not None:
                columns[name], how = found
        folded = [n for n in compared_names(seen) if n in names and n not in columns and _folded(seen.columns[n])]
        upper = [_upper_band(seen.columns[n]) for n in folded]
        # A sign's bit is where all upper bands begin; with two's complement they end there.
        ends = [x for x in zip(*upper, strict=True) if len(x) > 1 and max(x) < min(x) * (1.0 + _apart(len(x)))]
        # One column alone must flicker between two bands that both begin at an edge: it goes to and fro about zero.
        ends = ends or [(upper[0][0],) for n in folded if len(folded) == 1 and _flickers(seen.columns[n])]
        if ends:
            one = "s" if len(folded) == 1 else ""
            bands = f"lie{one} near 0 or near {ends[0][0]:.6g} and jump{one} between"
            what = f"{', '.join(folded)} {bands}: numbers read as unsigned?"
            yield Remark(self.KEY, what, "read them as signed", tuple(folded), Action.REFUSED)
            return
        if columns:
            what = f"{', '.join(columns)} jump{'s' if len(columns) == 1 else ''} by {how} where the value passes zero"
            yield Remark(self.KEY, what, "", tuple(columns), Action.REPAIRED, with_columns(seen, columns))


def _folded(values: Array) -> bool:
    """Return whether values keep to two bands, at zero and at a top, half of it empty between, and jump from one to the other."""
    v = values[np.isfinite(values)]
    if len(v) < 40 or v.min() < 0.0 or v.max() == 0.0:
        return False
    levels = np.unique(v)
    if len(levels) < 20:
        return False  # a few coarse steps have gaps of their own
    gap = np.diff(levels)
    jumps = int(np.sum(np.abs(np.diff(v)) > 0.5 * v.max()))
    if gap.max() <= 0.25 * v.max() or jumps < FEWEST_JUMPS:
        return False
    # What jumps to and fro all the time may have two states; folded at a number, both bands begin sharply (or end so).
    return jumps < 0.2 * len(v) or _flickers(v)


def _flickers(values: Array) -> bool:
    """Return whether values lie in two bands that both have a sharp edge, the lower one at its beginning."""
    v = values[np.isfinite(values)]
    begins, _ = _upper_band(v)
    low, high = v[v < begins], v[v >= begins]
    return _sharp(low) and (_sharp(high) or _sharp(-high))


def _sharp(band: Array) -> bool:
    """Return whether values begin at an edge, densely, as the sizes of what goes to and fro about zero do."""
    least, tenth, most = np.quantile(band, [0.0, 0.1, 0.9])
    return bool(tenth - least < 0.2 * (most - least))


def _apart(count: int) -> float:
    """Return the relative spread of so many numbers that has this chance if they are unrelated; a tenth at most."""
    return float(min(BY_CHANCE ** (1.0 / (count - 1)), 0.1))


def _upper_band(values: Array) -> tuple[float, float]:
    """Return where the upper of two bands begins and ends."""
    levels = np.unique(values[np.isfinite(values)])
    return float(levels[int(np.argmax(np.diff(levels))) + 1]), float(levels[-1])


def _signed(values: Array) -> tuple[Array, str] | None:
    """Return the values with their signs, and in words what was read as unsigned; None where nothing was."""
    there = np.isfinite(values)
    v = values[there]
    if len(v) < 40 or v.min() < 0.0 or v.max() == 0.0:
        return None
    steps = np.abs(np.diff(v))
    levels = np.unique(v)
    # Counts times a scale differ in their last bits.
    gaps = np.diff(levels)
    quantum = float(np.min(gaps[gaps > 1e-7 * v.max()], initial=np.inf))
    if not np.isfinite(quantum) or np.max(np.abs(v / quantum - np.round(v / quantum))) > 0.01:
        return None  # no counts: what its sign's bit is, nobody knows
    for bit in range(6, 32):
        base = quantum * 2.0**bit
        jumps = int(np.sum(steps > 0.5 * base))
        if (
            not 0.9 * base < v.max() < 2.0 * base
            or v.min() > 0.5 * base
            or not FEWEST_JUMPS <= jumps < 0.2 * len(steps)
        ):
            continue
        for says, signed in (
            (
                f"the sign's bit ({base:.6g}: sign and magnitude, read as unsigned)",
                np.where(v > 0.999 * base, base - v, v),
            ),
            (f"{2.0 * base:.6g} (two's complement, read as unsigned)", np.where(v > 0.999 * base, v - 2.0 * base, v)),
        ):
            if not np.any(np.abs(np.diff(signed)) > 0.5 * base):
                out = values.copy()
                out[there] = signed
                return out, says
    return None

"""Commands that are no positions, and positions that are but commands."""

from collections.abc import Iterator
from typing import ClassVar, Final

import numpy as np

from galen_hw.physics.observations import Observations
from galen_hw.premises.base import Action, Remark, Stage
from galen_hw.premises.clock import travelled
from galen_hw.premises.criteria import CRITERIA
from galen_hw.premises.joints import LEAST_MOTION, joint_columns
from galen_hw.spatial import Array

LATE: Final = 3
"""Times of a joint's answer to a command, in equal steps up to a tenth of a second, at which its velocity is looked for."""


class CommandedRates:
    """Tests whether what was commanded is the joints' velocity and not their position."""

    KEY: ClassVar[str] = "commanded_rates"
    STAGE: ClassVar[Stage] = Stage.UNITS

    def examine(self, seen: Observations) -> Iterator[Remark]:
        """Yield a refusal where the positions of most joints that move follow the integral of the command, not itself."""
        if seen.predict != "position" or seen.time is None or len(seen) < CRITERIA.stretch // 4:
            return
        rates, moving = list[str](), 0
        for name in joint_columns(seen, "command"):
            q = seen.columns.get(name.replace(".command", ".position"))
            if q is None or _range(q) < LEAST_MOTION:
                continue
            moving += 1
            if _is_rate(seen, q, seen.columns[name]):
                rates.append(name)
        if moving and len(rates) > CRITERIA.half * moving:
            what = f"{', '.join(rates)}: the position follows their integral and not them: they are velocities"
            todo = "give the commanded positions, or integrate the commands from where the joints stood"
            yield Remark(self.KEY, what, todo, tuple(rates), Action.REFUSED)


def _is_rate(seen: Observations, q: Array, command: Array) -> bool:
    """Return whether a position (N,) goes as a command (N,) integrated, and is not as the command itself."""
    both = np.isfinite(q) & np.isfinite(command)
    if both.sum() < CRITERIA.fewest_vectors or np.ptp(command[both]) == 0.0 or np.ptp(q[both]) == 0.0:
        return False
    assert seen.time is not None, "asked only with a clock"
    step = float(np.median(np.diff(seen.time)))
    as_it_is = float(np.corrcoef(q[both], command[both])[0, 1])
    late = {max(round(k * 0.1 / LATE / step), 0) for k in range(LATE + 1)} if step > 0.0 else {0}
    for rows in late:
        found = travelled(seen, q, np.concatenate([np.full(rows, command[0]), command[: len(command) - rows]]))
        if found is not None and min(map(np.ptp, found)) > 0.0:
            as_rate = float(np.corrcoef(*found)[0, 1])
            if as_rate > CRITERIA.one_signal and as_it_is < CRITERIA.half * as_rate:
                return True
    return False


class CopiedCommands:
    """Tests whether joints that drive the simulation stand where they were told to, to the last digit: nothing was measured."""

    KEY: ClassVar[str] = "copied_commands"
    STAGE: ClassVar[Stage] = Stage.UNITS

    def examine(self, seen: Observations) -> Iterator[Remark]:
        """Yield a note where all joints that move do, and of what is compared a refusal of two commands that are the same."""
        names = joint_columns(seen, "command")
        pairs = [(n.replace(".command", ".position"), n) for n in names]
        if seen.predict != "position":
            moving = [(q, c) for q, c in pairs if q in seen.columns and _range(seen.columns[c]) > 0.0]
            if moving and all(np.array_equal(seen.columns[q], seen.columns[c], equal_nan=True) for q, c in moving):
                what = "joints stand where they were told to, to the last digit: their positions are commands, and not measured"
                yield Remark(self.KEY, what, "", tuple(q for q, _ in moving))
            return
        for k, name in enumerate(names):
            told = seen.columns[name]
            first = next((n for n in names[:k] if np.array_equal(seen.columns[n], told, equal_nan=True)), None)
            if first is None or _range(told) < LEAST_MOTION:
                continue
            alike = [_follows(seen.columns.get(n.replace(".command", ".position")), told) for n in (first, name)]
            if min(alike) < CRITERIA.half < CRITERIA.one_signal < max(alike):
                what = f"{name} is the same as {first} in every row, and one of the joints does not follow it"
                yield Remark(
                    self.KEY, what, "export it again: one of the two was written twice", (first, name), Action.REFUSED
                )


def _range(values: Array) -> float:
    """Return the range of a signal (N,); 0 where nothing is known of it."""
    there = values[np.isfinite(values)]
    return float(np.ptp(there)) if len(there) else 0.0


def _follows(q: Array | None, command: Array) -> float:
    """Return the correlation of a position (N,) with a command (N,); 1 where there is none."""
    both = np.isfinite(command) if q is None else np.isfinite(q) & np.isfinite(command)
    if q is None or both.sum() < CRITERIA.fewest_vectors or np.ptp(q[both]) == 0.0:
        return 1.0
    return float(np.corrcoef(q[both], command[both])[0, 1])

"""Commands that are no positions, and positions that are but commands."""

from collections.abc import Iterator
from typing import ClassVar

import numpy as np

from galen_hw.physics.observations import Observations
from galen_hw.premises.base import Action, Remark, Stage
from galen_hw.premises.clock import travelled
from galen_hw.premises.criteria import CRITERIA
from galen_hw.premises.joints import LEAST_MOTION, joint_columns
from galen_hw.premises.sampling import copies
from galen_hw.spatial import Array


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
    found = travelled(seen, q, command)
    if found is None or min(map(np.ptp, found)) == 0.0:
        return False
    as_it_is, as_rate = (float(np.corrcoef(*pair)[0, 1]) for pair in ((q[both], command[both]), found))
    return as_rate > CRITERIA.one_signal and as_it_is < CRITERIA.half * as_rate


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
        for first, name in copies(seen, names):
            told = seen.columns[name]
            if _range(told) < LEAST_MOTION:
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

"""Commands that are no positions: those of a robot that was driven by velocities."""

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
            if q is None or np.nanmax(q) - np.nanmin(q) < LEAST_MOTION:
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
    if both.sum() < CRITERIA.fewest_vectors or np.ptp(command[both]) == 0.0:
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

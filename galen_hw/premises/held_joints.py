"""Positions of a joint that stood still in the log while the joint went on: its messages were lost, and the last one stayed."""

from collections.abc import Iterator
from typing import ClassVar, Final

import numpy as np

from galen_hw.physics.observations import Observations
from galen_hw.premises.base import Action, Remark, Stage, with_columns
from galen_hw.premises.cells import Mask, rows_in, runs
from galen_hw.premises.clock import STEP, smooth
from galen_hw.premises.criteria import CRITERIA
from galen_hw.premises.joints import joint_columns
from galen_hw.premises.sampling import compared_names
from galen_hw.spatial import Array

SHORTEST: Final = 5
"""Rows at one reading, to the last digit, that a joint in motion does not have by chance."""


class HeldJoints:
    """Tests for joints that drive the simulation and stand at one reading, and are elsewhere at once when they go on.

    A joint that really rests goes on from where it is.
    """

    KEY: ClassVar[str] = "held_joints"
    STAGE: ClassVar[Stage] = Stage.CELLS

    def examine(self, seen: Observations) -> Iterator[Remark]:
        """Yield one remark; rows in which a joint was held are left out, and a new segment begins behind them."""
        time, ours = seen.time, set(compared_names(seen))
        if time is None or len(seen) < 100 or not smooth(seen):
            return
        lost, says = np.zeros(len(seen), dtype=bool), dict[str, str]()
        for name in joint_columns(seen, "position"):
            if name in ours:
                continue
            held = _held(seen.columns[name], time, seen.segments)
            if held.any():
                stretches = [f"{time[a]:.4g} to {time[b - 1]:.4g} s" for a, b in runs(held)]
                more = f" and {len(stretches) - 3} more times" if len(stretches) > 3 else ""
                says[name] = f"{name} stands at one reading from {', '.join(stretches[:3])}{more}, and then jumps"
                lost |= held
        if not says or lost.mean() > CRITERIA.half:
            return
        segment = np.zeros(len(seen))
        for number, part in enumerate(seen.segments):
            segment[part] = number
        segment += np.cumsum(np.diff(lost.astype(int), prepend=0) < 0)
        repaired = with_columns(seen, {"segment": segment}).taken(~lost)
        what = f"{'; '.join(says.values())}: its messages were lost; {rows_in(int(lost.sum()), len(seen))} left out"
        yield Remark(self.KEY, what, "", tuple(says), Action.REPAIRED, repaired)


def _held(values: Array, time: Array, segments: list[slice]) -> Mask:
    """Return the rows (N,) at which values (N,) stand at one reading before a jump that no other step (of time (N,)) reaches.

    The motion behind it is far slower: a joint that starts goes on.
    """
    out, period = np.zeros(len(values), dtype=bool), np.diff(time)
    inside = period > 0.0
    for part in segments:
        inside[part.stop - 1 : part.stop] = False
    if not inside.any():
        return out
    # Rows may be lost on a clock that shows it: then as much time has passed as the motion needs.
    step = np.abs(np.diff(values)) / np.maximum(period / np.median(period[inside]), 1.0)
    still = [
        (start, stop)
        for start, stop in runs((step == 0.0) & inside)
        if stop - start + 1 >= SHORTEST and stop < len(step) - 1 and inside[stop]
    ]
    others = inside & np.isfinite(step)
    others[[stop for _, stop in still]] = False
    fastest = float(np.max(step[others], initial=0.0))
    for start, stop in still:
        if fastest > 0.0 and step[stop] > max(fastest, STEP * step[stop + 1]):
            # The first of the rows was read.
            out[start + 1 : stop + 1] = True
    return out

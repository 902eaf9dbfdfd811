"""Stamps of seconds and nanoseconds that were joined without leading zeros: 12 s and 50 000 000 ns became 12.50000000."""

from collections.abc import Iterator
from typing import ClassVar

import numpy as np

from galen_hw.physics.observations import Observations
from galen_hw.premises.base import Action, Remark, Stage, with_columns
from galen_hw.premises.cells import rows_in
from galen_hw.premises.clock import STEP, smooth
from galen_hw.premises.criteria import CRITERIA
from galen_hw.spatial import Array

LEADING_ZEROS = 8
"""Of nine digits of nanoseconds; the last one stays."""


class UnpaddedStamps:
    """Tests whether stamps go forth and back once a second, since leading zeros of their fraction are lost."""

    KEY: ClassVar[str] = "unpadded_stamps"
    STAGE: ClassVar[Stage] = Stage.CELLS

    def examine(self, seen: Observations) -> Iterator[Remark]:
        """Yield one remark; the zeros are put back where all stamps are in order then and no larger steps are left."""
        time = seen.time
        if time is None or len(time) < 50 or not smooth(seen):
            return
        steps = np.diff(time)
        if not np.any(steps < 0.0) or not np.any(steps > 0.0):
            return
        usual = float(np.median(steps[steps > 0.0]))
        right = _padded(time)
        far_before, far_after = (int(np.sum(np.abs(np.diff(t)) > STEP * usual)) for t in (time, right))
        if np.any(np.diff(right) < 0.0) or far_after > CRITERIA.gross_left * far_before:
            return
        what = f"stamps of {rows_in(int(np.sum(right != time)), len(time))} go forth and back in the first tenth of a second: "
        what += "their nanoseconds were written without leading zeros; put back"
        yield Remark(
            self.KEY,
            what,
            "write them with nine digits",
            ("time",),
            Action.REPAIRED,
            with_columns(seen, {"time": right}),
        )


def _padded(time: Array) -> Array:
    """Return the stamps (N,) with leading zeros: as many as times that stamps go back from there to the end of their second.

    The lost zeros of a second make its first rows fall into blocks, one for each number of zeros, that each begin below the end
    of the one before.
    """
    whole = np.floor(time)
    zeros = np.zeros(len(time), dtype=int)
    for k in range(len(time) - 2, -1, -1):
        if whole[k] == whole[k + 1]:
            zeros[k] = zeros[k + 1] + (time[k] > time[k + 1])
    return np.asarray(whole + (time - whole) * 10.0 ** -np.minimum(zeros, LEADING_ZEROS))

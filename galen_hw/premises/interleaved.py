"""Rows of two runs that were merged by their stamps: each second row belongs to another motion."""

from collections.abc import Iterator
from typing import ClassVar

import numpy as np

from galen_hw.physics.observations import Observations
from galen_hw.premises.base import Action, Remark, Stage
from galen_hw.premises.clock import PERIODS_S, moving
from galen_hw.premises.criteria import CRITERIA


class InterleavedRuns:
    """Tests whether all that moves is far nearer to the row before the last than to the last one.

    A motion is twice as far away after two rows as after one; poses in any order are as far from all others. Two poses that are
    visited in turn are further apart in time than rows of a motion.
    """

    KEY: ClassVar[str] = "interleaved_runs"
    STAGE: ClassVar[Stage] = Stage.CELLS

    def examine(self, seen: Observations) -> Iterator[Remark]:
        """Yield a refusal."""
        moves = [q for q in moving(seen) if len(q) >= CRITERIA.stretch]
        if seen.time is None or not moves or float(np.median(np.diff(seen.time))) > PERIODS_S[1]:
            return
        steps = [[float(np.mean((q[k:] - q[:-k]) ** 2)) for k in (1, 2)] for q in moves]
        if all(second < CRITERIA.gross_gain * first for first, second in steps):
            what = "every other row belongs to another motion: two runs were merged by their stamps"
            yield Remark(self.KEY, what, "give each run as a recording of its own", ("time",), Action.REFUSED)

"""A motion that was cut: rows are missing, the clock was closed up, and all that moves is elsewhere from one row to the next."""

from collections.abc import Iterator
from typing import ClassVar, Final

import numpy as np
from numpy.typing import NDArray

from galen_hw.physics.observations import Observations
from galen_hw.premises.base import Action, Remark, Stage, with_columns
from galen_hw.premises.clock import ALONE, STEP, moving, smooth
from galen_hw.spatial import Array, continuous

RARE: Final = 0.01
"""Share of the rows up to which what stands out is a cut: of more it is how this machine moves."""


class CutMotion:
    """Tests for rows that were cut out of a motion: several joints jump at one row, and stay there, while the clock goes on."""

    KEY: ClassVar[str] = "cut_motion"
    STAGE: ClassVar[Stage] = Stage.CELLS

    def examine(self, seen: Observations) -> Iterator[Remark]:
        """Yield at most one remark; a new segment begins behind each cut."""
        if seen.time is None or len(seen) < 100 or not smooth(seen):
            return
        columns = _continuous([q for q in moving(seen) if len(q) == len(seen)])
        if len(columns) < 2:
            return
        known = np.zeros(len(seen) - 1, dtype=bool)
        for part in seen.segments[1:]:
            known[part.start - 1] = True
        period = np.diff(seen.time)
        if not np.any(period > 0.0):
            return
        # Rows may be lost on a clock that shows it: then as much time has passed as the motion needs.
        longer = np.maximum(period / np.median(period[period > 0.0]), 1.0)
        cut = (np.sum([_jumps(q, longer) for q in columns], axis=0) >= 2) & ~known
        rows = np.flatnonzero(cut) + 1
        if not len(rows) or len(rows) > RARE * len(seen) / ALONE or np.any(np.diff(rows) <= ALONE):
            return
        first = f"row {rows[0] + 1} ({seen.time[rows[0]]:.5g} s)"
        more = f" and {len(rows) - 1} more times" if len(rows) > 1 else ""
        what = f"a piece of the motion is cut out at {first}{more}: all that moves jumps, and the clock goes on; "
        what += "a new segment begins there, and no motion is taken across it"
        segment = np.concatenate([[0], np.cumsum(cut | known)]).astype(float)
        yield Remark(self.KEY, what, "", ("time",), Action.REPAIRED, with_columns(seen, {"segment": segment}))


def _continuous(columns: list[Array]) -> list[Array]:
    """Return columns (N,), those of a quaternion with the sign that goes on from row to row."""
    q = np.stack(columns or [np.zeros(1)], axis=1)
    if len(columns) != 4 or not np.allclose(np.sum(q**2, axis=1), 1.0, atol=1e-2):
        return columns
    return list(continuous(q).T)


def _jumps(q: Array, longer: Array) -> NDArray[np.bool_]:
    """Return which steps (N - 1,) of a column (N,) are far larger than all but few others, and are not taken back at once.

    Args:
        longer: (N - 1,) times between rows over the usual one, at least 1.
    """
    step = np.diff(q) / longer
    far = np.abs(step) > STEP * np.quantile(np.abs(step), 1.0 - RARE)
    for k in np.flatnonzero(far):
        after, before = step[k + 1 : k + 1 + ALONE], step[max(k - ALONE, 0) : k]
        far[k] = not np.any(np.concatenate([after, before]) * np.sign(step[k]) < -0.5 * abs(step[k]))
    return np.asarray(far)

"""Samples that a device did not send, written as zeros or as the mean of its column."""

from collections.abc import Iterator
from typing import ClassVar

import numpy as np

from galen_hw.physics.observations import Observations
from galen_hw.premises.base import Action, Remark, Stage, with_columns
from galen_hw.premises.cells import Mask, rows_in
from galen_hw.premises.clock import STEP
from galen_hw.premises.criteria import CRITERIA
from galen_hw.premises.wrench_reading import FORCE, TORQUE
from galen_hw.spatial import Array


class BlankSamples:
    """Tests for rows in which every channel of a device reads exactly zero, or one and the same, off the rows beside them.

    Nothing was measured there: zeros, a number that stands for none, or the mean of each column was written instead.
    """

    KEY: ClassVar[str] = "blank_samples"
    STAGE: ClassVar[Stage] = Stage.CELLS

    def examine(self, seen: Observations) -> Iterator[Remark]:
        """Yield one remark for each device; the cells become NaN."""
        efforts = [name for name in seen.columns if name.startswith("joint.") and name.endswith(".effort")]
        for names in ([name for name in (*FORCE, *TORQUE) if name in seen.columns], efforts):
            if len(names) < 3 or len(seen) < 8:
                continue
            values = seen.matrix(*names)
            often = _commonest(values)
            able = (np.zeros(len(names)), *([] if often is None else [often]))
            reading = next((r for r in able if _stands_off(values - r)), None)
            if reading is None:
                continue
            blank = np.all(values == reading, axis=1)
            says = "exactly zero" if not reading.any() else "one and the same"
            what = f"{rows_in(int(blank.sum()), len(seen))} read {says} in all of {names[0]} and {len(names) - 1} more"
            lost = {name: np.where(blank, np.nan, seen.columns[name]) for name in names}
            seen = with_columns(seen, lost)
            yield Remark(self.KEY, f"{what}: taken as not measured", "", tuple(names), Action.REPAIRED, seen)


def _commonest(values: Array) -> Array | None:
    """Return the reading (k,) that most rows (N, k) have to the last digit; None where it does not come and go.

    A device that stops once, or stands, holds one reading too.
    """
    each, count = np.unique(values[np.isfinite(values).all(axis=1)], axis=0, return_counts=True)
    if not len(each):
        return None
    one = each[np.argmax(count)]
    pieces = np.sum(np.diff(np.all(values == one, axis=1).astype(int)) > 0)
    return np.asarray(one) if pieces >= CRITERIA.fewest_split else None


def _stands_off(values: Array) -> bool:
    """Return whether rows (N, k) of zeros are few, are none of chance, and are nowhere near the rows that they stand between."""
    blank: Mask = np.all(values == 0.0, axis=1)
    if not blank.any():
        return False
    there = ~blank & np.isfinite(values).all(axis=1)
    if blank.sum() >= 0.5 * len(values) or there.sum() < 8:
        return False
    by_chance = len(values) * float(np.prod(np.mean(values[there] == 0.0, axis=0)))
    usual = np.quantile(np.abs(np.diff(values[there], axis=0)), 0.95, axis=0)
    edges = np.flatnonzero(np.diff(blank.astype(int)))
    beside = np.where(blank[edges], edges + 1, edges)
    off = np.any(np.abs(values[beside]) > STEP * usual, axis=1)
    return by_chance < 1.0 and len(edges) > 0 and bool(np.mean(off) > 0.5)

"""Cells that have lost their decimal point: a spreadsheet of another language took it for a separator of thousands."""

from collections.abc import Iterator
from typing import ClassVar, Final

import numpy as np

from galen_hw.physics.observations import Observations
from galen_hw.premises.base import Action, Remark, Stage, with_columns
from galen_hw.premises.cells import Mask, rows_in
from galen_hw.premises.criteria import CRITERIA
from galen_hw.spatial import Array

THOUSAND: Final = 1000.0


class DecimalPoints:
    """Tests for whole numbers of thousands among decimals, which divided by a thousand are what the decimals lack.

    Three digits behind a point read as thousands in half of the world; of 1.234 comes 1234, and 12.34 stays.
    """

    KEY: ClassVar[str] = "decimal_points"
    STAGE: ClassVar[Stage] = Stage.CELLS

    def examine(self, seen: Observations) -> Iterator[Remark]:
        """Yield one remark; the points are put back."""
        found = {
            name: lost
            for name, values in seen.columns.items()
            if name not in ("time", "segment") and (lost := _lost(values)).any()
        }
        if not found:
            return
        columns = {
            name: np.where(lost, seen.columns[name] / THOUSAND, seen.columns[name]) for name, lost in found.items()
        }
        each = ", ".join(f"{rows_in(int(lost.sum()), len(seen))} of {name}" for name, lost in found.items())
        what = f"{each} are whole thousands among decimals, which have none of that size: points that were read as separators"
        what += " of thousands are put back"
        yield Remark(self.KEY, what, "", tuple(found), Action.REPAIRED, with_columns(seen, columns))


def _lost(values: Array, *, gap: float = 0.1) -> Mask:
    """Return which cells (N,) are a thousand times what they were.

    Args:
        gap: of the smallest whole number; the largest decimal is less, or the two are one signal.
    """
    known, size = np.isfinite(values), np.abs(values)
    lost = known & (size >= THOUSAND) & (values == np.round(values))
    whole, others, none = size[lost], size[known & ~lost], np.zeros(len(values), dtype=bool)
    if min(len(whole), len(others)) < CRITERIA.fewest_split or np.mean(others == np.round(others)) > CRITERIA.half:
        return none
    low, high, largest = np.min(whole) / THOUSAND, np.max(whole) / THOUSAND, np.max(others)
    among = np.sum((others >= low) & (others <= high))
    # What is so large by itself goes on from the others, and does not fill the hole in them.
    return lost if low < largest < gap * np.min(whole) and among <= CRITERIA.gross_left * len(whole) else none

"""Readings that ran over the end of their integer and came out at the other end."""

from collections.abc import Iterator
from typing import ClassVar, Final

import numpy as np

from galen_hw.physics.observations import Observations
from galen_hw.premises.base import Action, Remark, Stage, with_columns
from galen_hw.premises.cells import rows_in
from galen_hw.premises.sampling import compared_names, steps_within, unwrapped
from galen_hw.spatial import Array

BITS: Final = (8, 10, 12, 14, 16, 18, 20, 24)
"""Of integers in which converters and fieldbuses send readings."""
OFF_GRID: Final = 0.1
"""Of a step, by which readings that are few steps apart may lie off the steps of their integer: what a file's digits round."""
FEW: Final = 20
"""Steps."""


class Overflow:
    """Tests for readings that jump by a power of two of their own steps, from one end of the integer to the other.

    Such a reading lies on both ends of exactly that range, and is continuous when the turns are counted.
    """

    KEY: ClassVar[str] = "overflow"
    STAGE: ClassVar[Stage] = Stage.CELLS

    def examine(self, seen: Observations) -> Iterator[Remark]:
        """Yield a remark for each channel that wraps round."""
        if seen.time is None:
            return
        for name in compared_names(seen):
            values = seen.columns[name]
            found = _range(values[np.isfinite(values)], np.abs(steps_within(values, seen.segments)))
            if found is None:
                continue
            bits, step = found
            whole = step * 2.0**bits
            new = unwrapped(values, seen.segments, whole)
            for part in seen.segments:
                # Where most rows are is where no turn is.
                turns = np.round((new - values)[part] / whole)
                new[part] -= np.round(np.median(turns[np.isfinite(turns)])) * whole if np.isfinite(turns).any() else 0.0
            over = int(np.sum(np.abs(new - values) > step))
            seen = with_columns(seen, {name: new})
            what = f"{name} wraps round: {rows_in(over, len(seen))} ran over the end of {bits} bits of {step:.4g}"
            yield Remark(self.KEY, what, "", (name,), Action.REPAIRED, seen)


def _range(values: Array, moves: Array) -> tuple[int, float] | None:
    """Return bits and step of the integer that readings (n,) run over; None where they do not.

    Args:
        moves: sizes (m,) of the steps from one reading to the next.
    """
    levels = np.unique(values)
    if len(levels) < 16:
        return None
    # The median of the gaps that are about the least: a single one is off by a file's rounding.
    gaps = np.diff(levels)
    step = float(np.median(gaps[gaps < 1.5 * np.quantile(gaps, 0.01)]))
    span = float(levels[-1] - levels[0])
    bits = next((b for b in BITS if 0.99 * 2.0**b <= span / step + 1.0 <= 2.0**b + 0.5), None)
    apart = gaps[gaps < FEW * step] / step
    if bits is None or np.max(np.abs(np.round(apart) - apart)) > OFF_GRID:
        return None
    whole = step * 2.0**bits
    around = moves > 0.5 * whole
    # A turn is nearly the whole range at once; what is really so quick also stops on the way.
    if not around.any() or np.min(moves[around]) < 0.75 * whole or np.max(moves[~around]) > 0.25 * whole:
        return None
    return bits, step

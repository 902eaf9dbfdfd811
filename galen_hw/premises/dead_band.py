"""Readings that were set to zero where they are small, by a controller's dead band."""

from collections.abc import Iterator
from typing import ClassVar

import numpy as np

from galen_hw.physics.observations import Observations
from galen_hw.premises.base import Action, Remark, Stage, with_columns
from galen_hw.premises.cells import rows_in
from galen_hw.premises.criteria import CRITERIA
from galen_hw.premises.sampling import compared_names
from galen_hw.spatial import Array


class DeadBand:
    """Tests for loads that are exactly zero or far from it, and never between: what was small was set to zero."""

    KEY: ClassVar[str] = "dead_band"
    STAGE: ClassVar[Stage] = Stage.CELLS

    def examine(self, seen: Observations) -> Iterator[Remark]:
        """Yield one remark with all such channels; their zeros become NaN."""
        if seen.predict not in ("wrench", "effort"):
            return
        found = {name: band for name in compared_names(seen) if (band := _band(seen.columns[name])) > 0.0}
        if not found:
            return
        zeros = [seen.columns[name] == 0.0 for name in found]
        lost = {name: np.where(zero, np.nan, seen.columns[name]) for name, zero in zip(found, zeros, strict=True)}
        each = ", ".join(f"{name} below {band:.3g}" for name, band in found.items())
        count = rows_in(int(np.any(zeros, axis=0).sum()), len(seen))
        what = f"{each}: read exactly zero, as behind a dead band, in {count}: taken as not measured"
        yield Remark(self.KEY, what, "", tuple(found), Action.REPAIRED, with_columns(seen, lost))


def _band(values: Array) -> float:
    """Return the size below which a signal (N,) was set to zero; 0 where it was not.

    It reads zero again and again, and from there on jumps to either side of a gap that its steps elsewhere would have met.
    """
    y = values[np.isfinite(values)]
    zero = y == 0.0
    if not CRITERIA.gross_left < np.mean(zero) < 1.0 - CRITERIA.gross_left:
        return 0.0
    rest = y[~zero]
    if min(np.sum(rest > 0.0), np.sum(rest < 0.0)) < CRITERIA.pieces:
        return 0.0
    band, step = float(np.min(np.abs(rest))), np.abs(np.diff(y))
    usual = float(np.median(step[~zero[1:] & ~zero[:-1]])) if np.any(~zero[1:] & ~zero[:-1]) else np.inf
    pieces = int(np.sum(np.diff(zero.astype(int)) > 0))
    # Of a reading in steps zero is one, and the next is a step away.
    gap = max(usual, float(np.min(np.diff(np.unique(rest)), initial=np.inf)))
    return band if pieces >= CRITERIA.fewest_split and band > gap / CRITERIA.gross_left else 0.0

"""Dead bands: small readings that were set to zero, and readings that were reported only when they had changed enough."""

from collections.abc import Iterator, Sequence
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


class ReportedOnChange:
    """Tests for readings that stand until they have changed by so much, as a bus that reports by exception delivers them."""

    KEY: ClassVar[str] = "reported_on_change"
    STAGE: ClassVar[Stage] = Stage.CELLS

    def examine(self, seen: Observations) -> Iterator[Remark]:
        """Yield one remark with all such channels."""
        names = compared_names(seen)
        changes = {name: _changes(seen.columns[name], seen.segments) for name in names}
        # One channel with many changes proves it of the others, of which some hardly change.
        if not any(len(one) >= CRITERIA.stretch // CRITERIA.pieces and _in_no_steps(one) for one in changes.values()):
            return
        found = {name: float(one.min()) for name, one in changes.items() if len(one)}
        kept = np.mean([np.diff(seen.columns[name]) == 0.0 for name in found])
        each = ", ".join(f"{name} by {band:.3g}" for name, band in found.items())
        what = f"readings stand, in {100 * kept:.0f} % of the rows, until they have changed ({each}): reported by exception"
        todo = (
            "record every reading (an absolute dead band of 0 in the subscription): what is smaller cannot be compared"
        )
        yield Remark(self.KEY, what, todo, tuple(found), Action.REFUSED)


def _changes(values: Array, segments: Sequence[slice]) -> Array:
    """Return the sizes (k,) of the changes of a signal (N,) that was kept until it had changed enough; none if it was not.

    Noise has changes of any size, half as large as a usual one in every fourth row.
    """
    steps = np.abs(np.concatenate([np.diff(values[part]) for part in segments]))
    steps = steps[np.isfinite(steps)]
    moves = steps[steps > 0.0]
    if not len(moves) or len(moves) > CRITERIA.half * len(steps) or moves.min() < CRITERIA.half * np.median(moves):
        return np.empty(0)
    return np.asarray(moves)


def _in_no_steps(moves: Array) -> bool:
    """Return whether changes (k,) are no multiples of the least, as readings in steps have."""
    odd = moves / moves.min()
    return bool(np.mean(np.abs(odd - np.round(odd)) > CRITERIA.same_factor) > CRITERIA.half)


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

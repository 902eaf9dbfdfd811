"""When frames, units and loads are believed to be wrong; levels that one premise alone needs stand beside it."""

from dataclasses import dataclass
from typing import Final


@dataclass(frozen=True)
class Criteria:
    """Holds the levels of decision.

    All are shares or angles far from what small effects do (a gain of some per cent, a mounting of some degrees, a tool of
    twice its weight), so that none separates two kinds of physics: they separate slips of a pen from physics.

    Args:
        small_turn: unexplained share of a vector signal up to which the named axes are right: two thirds of sin^2 of 10 degrees.
        least_turn: rad; a smaller turn is left to the effects, which are linear about zero.
        gross_left: unexplained share that a believed other reading may leave at most.
        gross_gain: times the unexplained share of the columns as named that it may leave at most.
        as_good: times the least unexplained share within which a simpler reading is preferred.
        half: the same as `gross_gain` between two readings of which one is right.
        fewest_split: rows on which two loads are told from one at least.
        same_factor: log ratio within which a scale is that of a unit: a sensor's gain error.
        least_factor: times, either way, that a gain, a payload or a friction does not change a whole signal.
        longest_lever: m; no tool of a wrist sensor has its centre of mass further away.
        one_signal: correlation from which two signals are one in another scale.
        most_rows: evenly chosen rows on which a motion's axes are looked at first: it takes a hundredth of a second.
        stretch: rows in one piece of which efforts' units are asked.
        pieces: contiguous pieces of the rows, each one value: what wanders slowly inside a piece is one piece of luck.
        standard_errors: over the pieces, or over rows, by which a difference is believed among the hundreds that are looked at.
        paired_errors: the same over the pieces, of two explanations that are compared once: one chance in four thousand.
        fewest_vectors: rows on which a rotation is solved at least; below, too many rotations fit.
    """

    small_turn: float = 0.02
    least_turn: float = 0.2
    gross_left: float = 0.1
    gross_gain: float = 0.25
    as_good: float = 2.0
    fewest_vectors: int = 6
    fewest_split: int = 6
    half: float = 0.5
    same_factor: float = 0.03
    least_factor: float = 3.0
    longest_lever: float = 2.5
    one_signal: float = 0.95
    most_rows: int = 400
    stretch: int = 800
    pieces: int = 20
    standard_errors: float = 5.0
    paired_errors: float = 3.5


CRITERIA: Final = Criteria()

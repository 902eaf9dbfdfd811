"""How far a search goes: caps on what is tried, so that its time is bounded. None of them decides what is believed."""

from dataclasses import dataclass
from typing import Final


@dataclass(frozen=True)
class Limits:
    """Caps of a search.

    Args:
        turns: of the loop over the moves.
        tries: hypotheses that may be refused before a turn gives up, the best first.
        rivals: kinds that are compared at their optimum in the place of a chosen effect.
        leaders: kinds that are tried as the first of several effects.
        chain: effects that may follow one another in the place of one.
        forms: richer forms of one effect that are asked, and passes over the values that such a form searches.
        near: share of the gain of what they replace within which others are worth the time to settle them: by their slopes
            alone, or on a grid, they do not yet do what they do.
        part: share of the gain of what they replace that the first of several must have by itself.
        tie: difference of rank or of the whitened sum of squares within which two models count as equal.
    """

    turns: int = 16
    tries: int = 8
    rivals: int = 3
    leaders: int = 4
    chain: int = 3
    forms: int = 4
    near: float = 0.25
    part: float = 0.1
    tie: float = 1.0


LIMITS: Final = Limits()

"""The table of moves of the search, in the order in which they are tried."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final, Literal

from galen_hw.diagnosis.selection.moves.add import added, hidden
from galen_hw.diagnosis.selection.moves.drop import dropped
from galen_hw.diagnosis.selection.moves.exchange import regrouped
from galen_hw.diagnosis.selection.moves.refine import refined
from galen_hw.diagnosis.selection.moves.swap import simplified, swapped, swapped_again
from galen_hw.diagnosis.selection.moves.tighten import tightened
from galen_hw.diagnosis.selection.moves.timing import reclocked
from galen_hw.diagnosis.selection.search_state import Selection


@dataclass(frozen=True)
class Move:
    """One kind of change to a model.

    Args:
        kind: word for it.
        make: changes the model of a search if the other is better, and returns whether it did.
        tidies: asked in every turn, after the first of the other moves that found something.
    """

    kind: Literal["add", "drop", "swap", "exchange", "refine", "timing"]
    make: Callable[[Selection], bool]
    tidies: bool = False


MOVES: Final = (
    Move("add", added),
    Move("exchange", tightened),
    Move("exchange", regrouped),
    Move("timing", reclocked),
    Move("swap", swapped_again),
    Move("add", hidden),
    Move("swap", simplified),
    Move("drop", dropped, tidies=True),
    Move("swap", swapped, tidies=True),
    Move("refine", refined, tidies=True),
)

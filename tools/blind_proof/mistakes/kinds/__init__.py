"""The kinds of mistakes, one table: KINDS by key."""

from galen_hw.tools.blind_proof.mistakes.kinds import cells, clocks, deflection, frames, load, model, units
from galen_hw.tools.blind_proof.mistakes.kinds.kind import Kind, Made

KINDS: dict[str, Kind] = {
    kind.key: kind for part in (cells, clocks, units, model, frames, load, deflection) for kind in part.KINDS
}
__all__ = ["KINDS", "Kind", "Made"]

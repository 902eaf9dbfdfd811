"""What a kind of mistake is: how it is made, in what, and by which words an answer shows that the cause was seen."""

import re
from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np

from galen_hw.tools.blind_proof.mistakes.recording import Load, Recording

Rng = np.random.Generator


@dataclass
class Made:
    """What one application of a mistake was.

    Args:
        says: in words with its numbers, for the list of failures.
        numbers: what a finding that names the cause must give: effect to value in SI, see `score.NUMBERS`.
        loads: what else than the recording's load a calibration that names the cause may state: in the frame that the
            wrench was turned to, or of the other part of the recording.
    """

    says: str
    numbers: dict[str, float] = field(default_factory=dict)
    loads: list[Load] = field(default_factory=list)

    def as_dict(self) -> dict[str, Any]:
        """Plain values for the sealed file."""
        return {"says": self.says, "numbers": self.numbers, "loads": [asdict(load) for load in self.loads]}


Apply = Callable[[Recording, Rng], Made]


@dataclass(frozen=True)
class Kind:
    """One kind of mistake.

    Args:
        key: its name; about: which part of the list it is of ("cells and clocks", "units", "model", "frames", "load").
        command: "diagnose", "calibrate" or "deflection".
        families: of recordings it is made in; needs: what is asked of them when they are made.
        apply: changes a recording in place.
        named: patterns, any one of which in what the program says shows that the cause was seen; case is ignored.
        effects: findings that name it, or that it truly leaves in the data.
        silent: an answer without a word of it is right too where that answer is right: nothing was spoiled for good.
        fits: whether a recording of these families has what the mistake is made in.
    """

    key: str
    about: str
    command: str
    families: tuple[str, ...]
    apply: Apply
    named: tuple[str, ...]
    effects: frozenset[str] = frozenset()
    silent: bool = False
    needs: frozenset[str] = frozenset()
    fits: Callable[[Recording], bool] = lambda _: True

    def names(self, text: str) -> bool:
        """Return whether a text shows that the cause was seen."""
        return any(re.search(pattern, text, re.IGNORECASE | re.DOTALL) for pattern in self.named)


def both(first: str, second: str, *, within: int = 160) -> str:
    """A pattern for two words near each other, in either order."""
    return f"(?:{first}).{{0,{within}}}(?:{second})|(?:{second}).{{0,{within}}}(?:{first})"

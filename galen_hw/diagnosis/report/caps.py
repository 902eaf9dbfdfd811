"""How much of each kind the page and the summary show."""

from dataclasses import dataclass
from typing import Final


@dataclass(frozen=True)
class Caps:
    """What a reader takes in at once; the JSON answer has everything.

    Args:
        findings: lines of the summary with a reason; names: channels, joints, times or look-alikes in one line.
        alike: pictures or rows of one kind: variables, look-alikes of a finding, recordings, parameters before they fold.
        evidence: rows of the table of what was asked; curves: pictures of effects.
        points: of a drawn line, more than a screen has columns; channels: under each other on one page.
        chance: down to which one is told as a number: what is said of noise holds no further.
    """

    findings: int = 4
    names: int = 3
    alike: int = 6
    evidence: int = 40
    curves: int = 16
    points: int = 5000
    channels: int = 14
    chance: float = 1e-6


CAPS: Final = Caps()

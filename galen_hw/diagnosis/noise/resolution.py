"""How finely a recording's noise is resolved."""

from dataclasses import dataclass
from typing import Final


@dataclass(frozen=True)
class Resolution:
    """Settings of the spectrum.

    Args:
        shortest: rows of a run from which a spectrum is measured: two bands and more.
        fewest: bands from which their shape is asked: a floor, a shelf, flicker noise and the corner are four parameters.
        forgets: times that noise forgets within a recording, at least; what has a longer memory drifts.
        slow: cycles a row of a slow regressor: a motion of some seconds at 100 Hz.
        wanders: cycles in a recording up to which noise is said to wander.
        corners: of noise with a memory that are tried, in equal ratios.
    """

    shortest: int = 96
    fewest: int = 6
    forgets: float = 30.0
    slow: float = 0.003
    wanders: int = 50
    corners: int = 24


RESOLUTION: Final = Resolution()

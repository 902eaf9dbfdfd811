"""How much work a diagnosis may do: rows, rounds and surrogates, in one place."""

from dataclasses import dataclass
from typing import Final


@dataclass(frozen=True)
class Budget:
    """Caps of the numerical method; none of them decides what is believed.

    Args:
        rows: that a search works on, more are averaged: half a minute at 200 Hz unaveraged, columns of 50 kB a channel.
        coarse: rows of a first look, and those that trees learn from: motion is slow beside a force sensor's samples.
        surrogates: recordings of noise alone; the scale of their maxima is then known to a seventh.
        rounds: in which what effects do to each other is told anew.
        steps: damped steps to an optimum; settled: the same of what stood at one before something else changed.
        at_once: hypotheses whose whitened columns stand in memory together while all are made anew.
    """

    rows: int = 6250
    coarse: int = 3000
    surrogates: int = 48
    rounds: int = 4
    steps: int = 30
    settled: int = 4
    at_once: int = 64


BUDGET: Final = Budget()

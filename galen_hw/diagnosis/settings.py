"""Caps and resolutions of the numerical method; none of them decides what is believed."""

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

"""Caps and resolutions of the numerical method; none of them decides what is believed."""

from dataclasses import dataclass
from typing import Final


@dataclass(frozen=True)
class Budget:
    """Caps of the numerical method; none of them decides what is believed.

    Args:
        rows: that a search works on, more are averaged: half a minute at 200 Hz unaveraged, columns of 50 kB a channel.
        coarse: rows of a first look, and those that trees learn from: motion is slow compared with a force sensor's samples.
        surrogates: number of noise recordings; the scale of their maxima is then known to a seventh.
        rounds: of the iteration of interactions.
        steps: damped steps to an optimum; settled: steps of an effect that was at its optimum before.
        at_once: hypotheses whose whitened columns are in memory together while all are made again.
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
        tries: refused hypotheses after which a turn gives up, best first.
        rivals: kinds that are compared at their optimum in the place of a chosen effect.
        leaders: kinds that are tried as the first of several effects.
        chain: effects that may follow one another in the place of one.
        forms: richer forms of one effect that are tested, and passes over their searched values.
        near: share of the replaced gain within which rivals are optimised: by their slopes alone, or on a grid, their gains are
            too small.
        part: share of the replaced gain that the first of several must have by itself.
        tie: difference of rank or of the whitened sum of squares within which two models count as equal.
        seconds: after which no better model is looked for: on two cores one recording in forty took longer, and found nothing.
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
    seconds: float = 480.0


LIMITS: Final = Limits()


@dataclass(frozen=True)
class Resolution:
    """Settings of the spectrum.

    Args:
        shortest: rows of a run from which a spectrum is measured: two bands and more.
        fewest: bands from which their shape is fitted: a floor, a plateau, flicker noise and the corner are four parameters.
        forgets: minimum number of correlation times of noise in a recording; what has a longer memory is a drift.
        slow: frequency of a slow regressor, cycles a row: a motion of some seconds at 100 Hz.
        wanders: cycles in a recording up to which noise counts as low-frequency noise.
        corners: number of corner frequencies that are tried, in equal ratios.
    """

    shortest: int = 96
    fewest: int = 6
    forgets: float = 30.0
    slow: float = 0.003
    wanders: int = 50
    corners: int = 24


RESOLUTION: Final = Resolution()

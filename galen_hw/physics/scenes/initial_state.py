"""What a late stream, or what settles slowly, answers to at the beginning of a recording: nobody recorded it."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Self

import numpy as np
from numpy.typing import NDArray

from galen_hw.spatial import Array

if TYPE_CHECKING:
    from galen_hw.physics.scenes.base import Scene

MOST_UNKNOWN = 0.25
"""Share of a segment that is left out at an end."""
GONE = 1e-5
"""Share of a beginning that is nothing."""
FEW = 8
"""Segments whose beginnings are told apart; where there are more, each is a small part of the recording."""


@dataclass(frozen=True)
class Lagging:
    """A first-order lag by a constant (s): of any state that it began in, exp(-t / T) is left after t.

    Args:
        channels: each of which may have begun in a state of its own; joint: which may instead, and shows where it moves what.
    """

    channels: tuple[int, ...]
    constant: float
    joint: str = ""

    @property
    def places(self) -> tuple[int | str, ...]:
        """The channels, or the joint."""
        return self.channels or (self.joint,)


@dataclass(frozen=True)
class Beginning:
    """Of every segment of a recording whose stream is late by `after` s, or early by `before`, and behind `lags`."""

    after: float = 0.0
    before: float = 0.0
    lags: tuple[Lagging, ...] = ()

    def __add__(self, other: Self) -> Self:
        """Return what both leave open."""
        return type(self)(max(self.after, other.after), max(self.before, other.before), self.lags + other.lags)

    def unknown(self, time: Array, segments: Sequence[slice]) -> NDArray[np.bool_]:
        """Return which rows (N,) answer to what was before the first row of their segment, or after the last."""
        out = np.zeros(len(time), dtype=bool)
        for part in segments if self.after or self.before else ():
            t = time[part]
            most = MOST_UNKNOWN * float(t[-1] - t[0])
            out[part] = (t < t[0] + min(self.after, most)) | (t > t[-1] - min(self.before, most))
        return out

    def columns(self, time: Array, segments: Sequence[slice]) -> list[tuple[Lagging, Array]]:
        """Return what lags, and what (N,) fades of it from the beginning of each segment."""
        out = []
        for lag in self.lags if len(segments) <= FEW else ():
            for part in segments:
                column = np.zeros(len(time))
                fading = np.exp(-(time[part] - time[part][0]) / lag.constant)
                # Of blocks that hold nothing of it nothing may be concluded.
                column[part] = np.where(fading > GONE, fading, 0.0)
                out.append((lag, column))
        return out


def fading(scene: "Scene") -> list[tuple[tuple[int, ...], Array]]:
    """Return channels, and what (N, c) fades in them from the beginning of each segment of a scene, per unit of what lags."""
    out: list[tuple[tuple[int, ...], Array]] = []
    for lag, column in scene.beginning.columns(scene.time, scene.segments):
        if lag.joint:
            out.append((scene.reached(lag.joint), scene.reaching(lag.joint) * column[:, None]))
        out += [((channel,), column[:, None]) for channel in lag.channels]
    return out

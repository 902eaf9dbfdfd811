"""Answers of the compared channels to small causes, as scenes give them to effects."""

from dataclasses import dataclass

from galen_hw.spatial import Array


@dataclass(frozen=True)
class Port:
    """The answer (N, C) of all channels to one small cause, with its name and unit."""

    name: str
    unit: str
    values: Array
    joint: str = ""


@dataclass(frozen=True)
class Carried:
    """Small shifts and turns of something that the arm carries (a marker, the tool), in axes that move with the body.

    Args:
        name: of it; channels: numbers of those that answer; moves: name and unit of each; values: (N, c, k) answer to each.
    """

    name: str
    channels: tuple[int, ...]
    moves: tuple[tuple[str, str], ...]
    values: Array

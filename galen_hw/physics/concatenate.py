"""Several recordings of one machine as one: rows laid end to end, each recording a run (or several) of its own."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from galen_hw.errors import UsageError
from galen_hw.physics.observations import Observations
from galen_hw.spatial import Array

PAUSE = 1.0
"""Seconds between one recording's last row and the next one's first on the common clock."""


def joined(parts: Sequence[Observations], names: Sequence[str]) -> tuple[Observations, list[float]]:
    """Join recordings; return them and the time on their clock at which each begins (its first row without a clock).

    Segments are kept apart, so that memory, filters and blocks never reach from one recording into the next. A column
    that only some recordings have is NaN in the others. The belief is the first one's.

    Args:
        parts: at least one; of one machine, as the caller has made sure.
        names: what to call them in messages.

    Raises:
        UsageError: they do not compare the same channels, or only some have a clock or a simulation.
    """
    first = parts[0]
    if len(parts) == 1:
        return first, [_start(first)]
    for part, name in zip(parts, names, strict=True):
        _check(first, part, names[0], name)
    sizes = [len(part) for part in parts]
    columns = _stacked([part.columns for part in parts], sizes)
    segment, begins = np.empty(sum(sizes)), []
    number, row, now = 0, 0, _start(first)
    for part, size in zip(parts, sizes, strict=True):
        begins.append(now)
        for run in part.segments:
            segment[row + run.start : row + run.stop] = number
            number += 1
        if part.time is not None:
            time = part.time - part.time[0] + now
            columns["time"][row : row + size] = time
            now = float(np.max(time)) + PAUSE
        else:
            now += size
        row += size
    columns["segment"] = segment
    given = [part.simulation for part in parts]
    simulation = None if given[0] is None else _stacked([g for g in given if g is not None], sizes)
    return replace(first, columns=columns, simulation=simulation, apart=True), begins


def _start(part: Observations) -> float:
    return 0.0 if part.time is None else float(part.time[0])


def _stacked(parts: Sequence[Mapping[str, Array]], sizes: Sequence[int]) -> dict[str, Array]:
    names = dict.fromkeys(name for part in parts for name in part)
    absent = [np.full(size, np.nan) for size in sizes]
    return {
        name: np.concatenate([part.get(name, none) for part, none in zip(parts, absent, strict=True)]) for name in names
    }


def _check(first: Observations, part: Observations, first_name: str, name: str) -> None:
    """Check that two recordings can be put into one."""
    different = [
        ("what is compared (predict)", first.predict, part.predict),
        ("the presence of a time column", first.time is not None, part.time is not None),
        ("the presence of a simulation", first.simulation is not None, part.simulation is not None),
        ("the joints", sorted(first.joint_names), sorted(part.joint_names)),
    ]
    for what, a, b in different:
        if a != b:
            raise UsageError(
                f"cannot be taken together with {first_name}: they differ in {what}",
                where=name,
                todo="leave one out, or diagnose them one by one",
            )

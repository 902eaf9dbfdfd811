"""What a premise is: a test of a recording before anything is fitted to it, what it says, and the repair where it is certain."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import Enum
from typing import ClassVar, Protocol

import numpy as np
from numpy.typing import NDArray

from galen_hw.physics.observations import Observations
from galen_hw.spatial import Array


class Action(Enum):
    """Says what follows from a remark."""

    NOTE = "note"
    """The answer is right, and somebody should know."""
    REPAIRED = "repaired"
    """Certain, and put right in memory; the file stays as it is."""
    REFUSED = "refused"
    """Every number that would be fitted would be wrong."""


class Stage(Enum):
    """Names the order: what is asked later is meaningless where something earlier is refused."""

    CELLS = "cells and clocks"
    UNITS = "units"
    FRAMES = "frames and signs"
    LOAD = "load and zeroing"


@dataclass(frozen=True)
class Claim:
    """A repair that is physics with a name of its own: `effect` found exactly, at any size.

    Args:
        effect: key of `shared` vocabulary (docs/diagnosis.md), e.g. `sensor_mounting`.
        parameters: name to (value, standard deviation, unit).
        channels: compared channels that it changes.
        joints: joints that it concerns.
        terms: of a tool's file, so that the live services apply it too.
    """

    effect: str
    parameters: Mapping[str, tuple[float, float, str]]
    channels: tuple[str, ...] = ()
    joints: tuple[str, ...] = ()
    terms: tuple[Mapping[str, object], ...] = ()


@dataclass(frozen=True)
class Remark:
    """States one thing about a recording.

    Args:
        premise: key of the premise that says it.
        what: one plain sentence without a full stop: what is wrong, where, with its figures.
        todo: what the reader can do; empty where nothing is to be done.
        columns: that it concerns.
        action: what follows.
        repaired: the recording without the mistake, for `Action.REPAIRED`; of a note, as it is to be read.
        claim: physics that the repair is.
        split: row before which the recording is to be split; 0: nowhere.
    """

    premise: str
    what: str
    todo: str = ""
    columns: tuple[str, ...] = ()
    action: Action = Action.NOTE
    repaired: Observations | None = field(default=None, compare=False, repr=False)
    claim: Claim | None = None
    split: int = 0

    @property
    def line(self) -> str:
        """One line for people."""
        done = "; repaired" if self.action is Action.REPAIRED and self.claim is None else ""
        return f"{self.what}{done}" + (f": {self.todo}" if self.todo and self.action is not Action.REPAIRED else "")

    def to_json(self) -> dict[str, object]:
        """Return the remark for machines."""
        return {
            "premise": self.premise,
            "action": self.action.value,
            "what": self.what,
            "todo": self.todo,
            "columns": list(self.columns),
        }


class Premise(Protocol):
    """Tests one thing that must hold before anything is fitted."""

    KEY: ClassVar[str]
    STAGE: ClassVar[Stage]

    def examine(self, seen: Observations) -> Iterable[Remark]:
        """Yield what is wrong; at most one remark with `repaired`, which is the recording without all of it.

        Args:
            seen: the recording as earlier premises left it; SI units, NaN where not measured.
        """


@dataclass(frozen=True)
class Examination:
    """What all premises say of a recording.

    Args:
        observations: as repaired.
        remarks: in the order of the premises.
    """

    observations: Observations
    remarks: tuple[Remark, ...] = ()

    @property
    def refused(self) -> tuple[Remark, ...]:
        """Return the remarks that make every fitted number worthless."""
        return tuple(r for r in self.remarks if r.action is Action.REFUSED)

    @property
    def claims(self) -> tuple[Claim, ...]:
        """Return what was repaired and is physics with a name."""
        return tuple(r.claim for r in self.remarks if r.claim is not None and r.action is Action.REPAIRED)


def examine(seen: Observations, premises: Sequence[Premise], *, repair: bool = True) -> Examination:
    """Ask every premise in order, each on the recording as the earlier ones repaired it.

    Where a stage refuses the recording, later stages are not asked: they would name the consequence, not the cause.

    Args:
        seen: the recording.
        premises: in the order of their stages.
        repair: apply what is certain; without it the same remark refuses the recording.
    """
    remarks: list[Remark] = []
    refused: Stage | None = None
    for premise in premises:
        if refused is not None and premise.STAGE is not refused:
            break
        for found in premise.examine(seen):
            remark = found if repair else _unrepaired(found)
            assert remark.action is not Action.REPAIRED or remark.repaired is not None, (
                "a repair comes with its recording"
            )
            if remark.repaired is not None:
                seen = remark.repaired
            elif remark.action is Action.REFUSED:
                refused = premise.STAGE
            remarks.append(remark)
    return Examination(seen, tuple(remarks))


def _unrepaired(remark: Remark) -> Remark:
    """Return the same remark, refusing what it would have repaired."""
    if remark.action is not Action.REPAIRED:
        return remark
    todo = remark.todo or "put it right in the file, or leave out --no-repair"
    return replace(remark, action=Action.REFUSED, todo=todo, repaired=None, claim=None)


def with_columns(seen: Observations, columns: Mapping[str, Array]) -> Observations:
    """Return the recording with other columns (or columns more), each (N,)."""
    return replace(seen, columns=dict(seen.columns) | dict(columns))


def with_matrix(seen: Observations, names: Iterable[str], values: Array) -> Observations:
    """Return the recording with columns `names` set to values (N, k)."""
    return with_columns(seen, dict(zip(names, values.T, strict=True)))


def without_columns(seen: Observations, names: Iterable[str]) -> Observations:
    """Return the recording without some columns."""
    gone = set(names)
    return replace(seen, columns={name: values for name, values in seen.columns.items() if name not in gone})


def known_rows(seen: Observations, names: Iterable[str], most: int | None = None) -> NDArray[np.intp]:
    """Return the rows on which all named columns were measured, at most so many of them, evenly chosen."""
    rows = np.flatnonzero(np.isfinite(seen.matrix(*names)).all(axis=1))
    return rows if most is None or len(rows) <= most else rows[np.linspace(0, len(rows) - 1, most).astype(int)]


def joint_positions(seen: Observations) -> list[str]:
    """Return the columns of positions that the robot's joints have; none without a robot."""
    robot = seen.belief.robot
    return [] if robot is None else [n for j in robot.joint_names if (n := f"joint.{j}.position") in seen.columns]

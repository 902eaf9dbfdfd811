"""Runs of a recording, each asked by itself: a mistake of one of them alone, as after a driver was started anew."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Final

import numpy as np

from galen_hw.physics.observations import Observations
from galen_hw.premises.base import Action, Examination, Remark, Stage
from galen_hw.premises.criteria import CRITERIA

MOST: Final = 8
"""Runs that are asked one by one: many are steps of one experiment, each too short to tell."""
Ask = Callable[[Observations], Examination]


def by_runs(seen: Observations, whole: Examination, ask: Ask, stages: dict[str, Stage]) -> Examination:
    """Return the examination of a recording with what only some of its runs have.

    What refuses all of it where some runs alone are wrong is said of these; what is no fault of the whole refuses it too, for no
    reading of all rows is right. What every run has, or none, is the whole's.

    Args:
        seen: the recording.
        whole: its examination.
        ask: examines a run.
        stages: of the premises by their keys.
    """
    refused = whole.refused[-1] if whole.refused else None
    if refused is not None and stages.get(refused.premise, Stage.CELLS) is Stage.CELLS:
        return whole
    base = seen if refused is not None else whole.observations
    parts = _parts(base, refused)
    if not parts:
        return whole
    runs = [base.taken(part) for part in parts]
    each = [_wrong(ask(run), run, stages) for run in runs]
    bad = [k for k, one in enumerate(each) if one is not None]
    if not 0 < len(bad) < len(parts):
        return whole
    first = each[bad[0]]
    assert first is not None, "chosen for its remark"
    if refused is not None and not refused.split and first.premise != refused.premise:
        return whole
    where = " and ".join(_where(base, parts[k], len(parts)) for k in bad)
    todo = "put right that part" + (f": {first.todo}" if first.todo else " in the file")
    told = replace(
        first, what=f"{where} alone: {first.what}", todo=todo, action=Action.REFUSED, repaired=None, claim=None
    )
    kept = tuple(one for one in whole.remarks if one.action is not Action.REFUSED)
    return Examination(whole.observations, (*kept, told))


def _parts(seen: Observations, refused: Remark | None) -> Sequence[slice]:
    """Return the runs to be asked, or the poses on either side of a row at which the load seems to change."""
    runs = seen.segments
    if len(runs) == 1 and refused is not None and refused.split:
        runs = [slice(0, refused.split), slice(refused.split, len(seen))]
    short = min(run.stop - run.start for run in runs) < CRITERIA.pieces
    return [] if short or not 1 < len(runs) <= MOST else runs


def _wrong(found: Examination, run: Observations, stages: dict[str, Stage]) -> Remark | None:
    """Return the first remark on units or frames of a run by which it is not what it says."""
    asked = (Stage.UNITS, Stage.FRAMES)
    return next((r for r in found.remarks if stages.get(r.premise) in asked and _reads_otherwise(r, run)), None)


def _reads_otherwise(remark: Remark, run: Observations) -> bool:
    """Return whether a remark says that readings or the model are others, and not only that some were not measured."""
    new = remark.repaired
    if remark.action is Action.REFUSED or new is None:
        return remark.action is Action.REFUSED
    return new.belief is not run.belief or any(
        np.any(np.isfinite(new.columns[name]) & np.isfinite(old) & (new.columns[name] != old))
        for name, old in run.columns.items()
        if name in new.columns
    )


def _where(seen: Observations, part: slice, count: int) -> str:
    names = seen.columns.get("segment")
    rows = f"rows {part.start} to {part.stop - 1}"
    if names is not None and len(seen.segments) == count:
        return f"segment {np.asarray(names)[part.start]:g} ({rows})"
    return rows

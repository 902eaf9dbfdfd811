"""Joint positions in no unit at all: normalised to each joint's own range, or counted from drives with gears of their own."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from galen_hw.physics.channels import joint_of
from galen_hw.physics.effects.registry import scene_of
from galen_hw.physics.observations import Observations
from galen_hw.premises.base import Action, Remark, Stage
from galen_hw.premises.channels import compared, slope
from galen_hw.premises.criteria import CRITERIA
from galen_hw.premises.sampling import driver_names, measured
from galen_hw.spatial import Array


@dataclass(frozen=True)
class Reading:
    """Hold how a joint's recorded position follows its simulation: factor times it, and a zero.

    Args:
        name: the joint's column.
        unit: of the simulation, rad or m.
        factor: recorded units per rad or m.
        zero: recorded value where the simulation is at zero.
        log_error: standard error of the factor's logarithm.
    """

    name: str
    unit: str
    factor: float
    zero: float
    log_error: float


class CommonUnit:
    """Tests whether positions of all joints are in one unit, where each is a straight line over its simulation.

    Factors of one unit are alike, whatever the unit. Percent of each joint's calibrated range, or motor counts before different
    gears, are not; each is far from one, which tells them from errors of a scale.
    """

    KEY: ClassVar[str] = "common_unit"
    STAGE: ClassVar[Stage] = Stage.UNITS

    def examine(self, seen: Observations) -> Iterator[Remark]:
        """Yield one remark for joints that turn and one for those that slide, which refuses the recording."""
        readings = _readings(seen)
        for unit in ("rad", "m"):
            joints = [one for one in readings if one is not None and one.unit == unit]
            if len(joints) < 2 or None in readings or not _each_its_own(joints):
                continue
            each = ", ".join(f"{joint_of(one.name)} {one.factor:.4g} and {one.zero:.3g}" for one in joints)
            what = f"joint positions are in no common unit, each has its own factor per {unit} and zero: {each}"
            todo = "give rad and m; if each joint is normalised to its calibrated range, undo it with these ranges"
            yield Remark(self.KEY, what, todo, tuple(one.name for one in joints), Action.REFUSED)


def _each_its_own(joints: list[Reading]) -> bool:
    """Return whether factors are all far from one, and further apart than two joints of one unit can be."""
    logs = np.log(np.abs([one.factor for one in joints]))
    if np.min(np.abs(logs)) < np.log(CRITERIA.least_factor):
        return False
    least, most = joints[int(np.argmin(logs))], joints[int(np.argmax(logs))]
    error = float(np.hypot(least.log_error, most.log_error))
    return bool(np.ptp(logs) > 2.0 * CRITERIA.same_factor + CRITERIA.standard_errors * error)


def _readings(seen: Observations) -> list[Reading | None]:
    """Return how each joint that moves is read; None for one that is no straight line over its simulation."""
    simulation = seen.simulation or {}
    if seen.predict == "position":
        first = compared(seen)
        # Mostly a glance at some rows is enough: they are what they are called.
        if first is None or not any(
            (s := slope(x, y)) is not None and abs(np.log(abs(s))) > np.log(CRITERIA.least_factor)
            for x, y in zip(first.simulated.T, first.measured.T, strict=True)
        ):
            return []
        scene = scene_of(measured(seen))
        columns = zip(scene.channels, scene.units, scene.simulated.T, scene.measured.T, strict=True)
        return [_reading(*one) for one in columns if _moves(*one[2:])]
    names = [n for n in driver_names(seen) if n in simulation and n.endswith(".position")]
    pairs = [(n, simulation[n], seen.columns[n]) for n in names if len(simulation[n]) == len(seen)]
    units = {n: "m" if seen.belief.slides(joint_of(n)) else "rad" for n in names}
    return [_reading(n, units[n], theirs, ours) for n, theirs, ours in pairs if _moves(theirs, ours)]


def _moves(simulated: Array, recorded: Array) -> bool:
    """Return whether a joint (N,) moves where both are known: of one that stands still no factor can be told."""
    there = np.isfinite(simulated) & np.isfinite(recorded)
    return bool(there.any() and np.ptp(simulated[there]) > 0.0 and np.ptp(recorded[there]) > 0.0)


def _reading(name: str, unit: str, simulated: Array, recorded: Array) -> Reading | None:
    """Return how a position (N,) follows its simulation (N,); None where the two are not one signal."""
    there = np.isfinite(simulated) & np.isfinite(recorded)
    x, y = simulated[there], recorded[there]
    factor = slope(x, y)
    if factor is None:
        return None
    zero = float(np.mean(y) - factor * np.mean(x))
    # What is left wanders: so many contiguous pieces are so many values.
    left = float(np.std(y - factor * x - zero)) / float(np.sqrt(CRITERIA.pieces))
    return Reading(name, unit, factor, zero, left / float(abs(factor) * np.std(x)))

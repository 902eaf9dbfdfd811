"""Readings whose sign was lost: the size alone was logged, or the minus of numbers that begin with a nought."""

from collections.abc import Iterator
from typing import ClassVar, Final

import numpy as np

from galen_hw.physics.observations import Observations
from galen_hw.physics.scenes.base import Scene
from galen_hw.premises.base import Action, Remark, Stage
from galen_hw.premises.channels import compared
from galen_hw.premises.criteria import CRITERIA
from galen_hw.premises.efforts import FEWEST_ROWS
from galen_hw.premises.wrench_reading import FORCE, TORQUE

LOST: Final = {
    -np.inf: (
        "never negative",
        "log the value with its sign: the size alone, of a current or a force, does not say which way it acts",
    ),
    -1.0: (
        "never between -1 and 0",
        "write numbers as such: a whole part of 0 printed by itself, as %d.%03d does, loses its minus",
    ),
}
"""Where readings without a sign would be, from such a number to zero: what is said, and what to do."""


class Magnitudes:
    """Tests for loads that are never negative (or never between -1 and 0) where their simulation is, whose size they follow."""

    KEY: ClassVar[str] = "magnitudes"
    STAGE: ClassVar[Stage] = Stage.FRAMES

    def examine(self, seen: Observations) -> Iterator[Remark]:
        """Yield one refusal with all channels that have no sign; friction, of either sign, may be larger than a load."""
        whole = seen.predict == "effort" or (seen.predict == "wrench" and seen.has_all(*FORCE, *TORQUE))
        scene = compared(seen) if whole else None
        if scene is None or len(scene) < FEWEST_ROWS:
            return
        # Where both fit, as of torques below 1, what more channels say.
        found = {least: _folded(seen, scene, least) for least in LOST}
        least = max(found, key=lambda one: len(found[one]))
        if not found[least]:
            return
        says, todo = LOST[least]
        names, x = tuple(scene.channels[c] for c in found[least]), scene.simulated[:, found[least]]
        share = 100.0 * np.mean((x < 0.0) & (x > least))
        what = f"{', '.join(names)}: {says}; the simulation, whose size fits, is in {share:.0f} % of the rows"
        yield Remark(self.KEY, what, todo, names, Action.REFUSED)


def _folded(seen: Observations, scene: Scene, least: float) -> list[int]:
    """Return the channels that have no reading between a number and zero, and follow a simulation that is folded there."""
    readings = [seen.columns[name] for name in scene.channels]
    never = [c for c, y in enumerate(readings) if not np.any((y < 0.0) & (y > least))]
    x, y = scene.simulated[:, never], scene.measured[:, never]
    inside = (x < 0.0) & (x > least)
    # A constant may lift all readings above zero; a fold is at zero itself.
    folded, plain = (
        np.sum((y - np.where(inside, -x, x)) ** 2, axis=0),
        np.sum((y - x - np.mean(y - x, axis=0)) ** 2, axis=0),
    )
    crosses = np.minimum(np.mean(inside, axis=0), np.mean(x > 0.0, axis=0)) > CRITERIA.gross_left
    whole = np.sum((y - np.mean(y, axis=0)) ** 2, axis=0)
    # Of poses that are wrong a folded simulation may be less wrong; efforts have friction that no simulation has.
    explained = (folded < CRITERIA.half * whole) | (scene.observations.predict == "effort")
    alone = (folded < CRITERIA.gross_gain * plain) & crosses & explained
    # All that a joint's motor does has both signs in a motion, whatever it bears: where none has, one load is enough to tell.
    if len(never) == len(scene.channels) > 1 and np.sum(folded) < CRITERIA.half * np.sum(plain):
        return never
    found = {c for c, own in zip(never, alone, strict=True) if own}
    # Readings on both sides of a gap show it by themselves.
    both = {
        c
        for c in never
        if np.sum(readings[c] <= least) > FEWEST_ROWS < np.sum((readings[c] >= 0.0) & (readings[c] < -least))
    }
    return sorted(found | both) if found else []

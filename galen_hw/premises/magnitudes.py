"""Readings without a sign: the size of a current or a force was logged."""

from collections.abc import Iterator
from typing import ClassVar

import numpy as np

from galen_hw.physics.observations import Observations
from galen_hw.premises.base import Action, Remark, Stage
from galen_hw.premises.channels import compared
from galen_hw.premises.criteria import CRITERIA


class Magnitudes:
    """Tests for loads that are never negative where their simulation is, and follow its absolute value far better."""

    KEY: ClassVar[str] = "magnitudes"
    STAGE: ClassVar[Stage] = Stage.FRAMES

    def examine(self, seen: Observations) -> Iterator[Remark]:
        """Yield one refusal with all channels that have no sign; friction, of either sign, may be larger than a load."""
        if seen.predict not in ("effort", "wrench"):
            return
        scene = compared(seen)
        if scene is None or len(scene) < 50:
            return
        unsigned = [c for c, name in enumerate(scene.channels) if np.nanmin(seen.columns[name]) >= 0.0]
        x, y = scene.simulated[:, unsigned], scene.measured[:, unsigned]
        folded, plain = (np.sum((y - one) ** 2, axis=0) for one in (np.abs(x), x))
        negative = np.mean(x < -np.std(y, axis=0), axis=0)
        alone = (folded < CRITERIA.gross_gain * plain) & (negative > CRITERIA.gross_left)
        # All that a joint's motor does has both signs in a motion, whatever it bears: where none has, one load is enough to tell.
        together = len(unsigned) == len(scene.channels) > 1 and np.sum(folded) < CRITERIA.half * np.sum(plain)
        found = unsigned if together else [c for c, own in zip(unsigned, alone, strict=True) if own]
        if not found:
            return
        names = tuple(scene.channels[c] for c in found)
        share = 100.0 * np.mean(scene.simulated[:, found] < 0.0)
        what = f"{', '.join(names)}: never negative; the simulation, whose absolute value fits, is in {share:.0f} % of the rows"
        todo = "log the value with its sign: the size alone, of a current or a force, does not say which way it acts"
        yield Remark(self.KEY, what, todo, names, Action.REFUSED)

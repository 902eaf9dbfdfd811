"""Columns that were scaled for machine learning: each less its mean over its standard deviation, or to its own range."""

from collections.abc import Iterator
from typing import ClassVar, Final

import numpy as np

from galen_hw.physics.observations import Observations
from galen_hw.premises.base import Action, Remark, Stage
from galen_hw.premises.criteria import CRITERIA
from galen_hw.premises.sampling import compared_names, driver_names
from galen_hw.spatial import Array

LOADS: Final = (".effort", ".force.x", ".torque.x")
PRINTED: Final = 1e-3
"""By which a mean or a deviation of printed numbers may be off."""


class Standardised:
    """Tests whether every column of a group has mean 0 and standard deviation 1, or, of loads, just fills 0 to 1 or -1 to 1.

    Nothing does so by itself in several channels; but that joints turn by one radian is a motion that people command.
    """

    KEY: ClassVar[str] = "standardised"
    STAGE: ClassVar[Stage] = Stage.UNITS

    def examine(self, seen: Observations) -> Iterator[Remark]:
        """Yield a refusal of what is compared, and of the positions that drive the simulation."""
        for names in (compared_names(seen), [n for n in driver_names(seen) if n.startswith("joint.")]):
            columns = [seen.columns[n][np.isfinite(seen.columns[n])] for n in names]
            live = [c for c in columns if len(c) >= CRITERIA.fewest_vectors and np.ptp(c) > 0.0]
            if len(live) < 2:
                continue
            if all(abs(float(np.mean(c))) < PRINTED and abs(float(np.std(c)) - 1.0) < PRINTED for c in live):
                how = "have mean 0 and standard deviation 1"
            elif names[0].endswith(LOADS) and (_fill(live, 0.0) or _fill(live, -1.0)):
                how = "go just from " + ("0" if _fill(live, 0.0) else "-1") + " to 1"
            else:
                continue
            what = f"{', '.join(names)}: all {how}: each was scaled by itself, as for machine learning"
            yield Remark(self.KEY, what, "give them in SI units, before they were scaled", tuple(names), Action.REFUSED)


class RunMeans:
    """Tests whether every channel of a load has mean 0 in each of several runs: each was tared by its own mean."""

    KEY: ClassVar[str] = "run_means"
    STAGE: ClassVar[Stage] = Stage.UNITS

    def examine(self, seen: Observations) -> Iterator[Remark]:
        """Yield a refusal: offsets of their own in each run are nobody's physics."""
        names, runs = compared_names(seen), seen.segments
        if len(runs) < 2 or seen.predict not in ("wrench", "effort") or len(names) < 2:
            return
        y = seen.matrix(*names)
        if min(run.stop - run.start for run in runs) < CRITERIA.pieces or not np.isfinite(y).all():
            return
        size = np.std(y, axis=0)
        means = np.array([np.mean(y[run], axis=0) for run in runs])
        if np.all(size > 0.0) and np.all(np.abs(means) < PRINTED * size):
            what = f"every channel has mean 0 in each of {len(runs)} segments: each was tared by its own mean"
            yield Remark(self.KEY, what, "give the readings before that, with one zero", tuple(names), Action.REFUSED)


def _fill(columns: list[Array], low: float) -> bool:
    """Return whether every column just fills the range from `low` to 1."""
    return all(abs(float(np.min(c)) - low) < PRINTED and abs(float(np.max(c)) - 1.0) < PRINTED for c in columns)

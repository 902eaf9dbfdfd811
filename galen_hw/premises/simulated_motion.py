"""Whether a simulation that comes with a recording is of the motion that was recorded."""

from collections.abc import Iterator
from typing import ClassVar

import numpy as np

from galen_hw.physics.observations import Observations
from galen_hw.premises.base import Action, Remark, Stage
from galen_hw.premises.criteria import CRITERIA
from galen_hw.premises.sampling import driver_names
from galen_hw.spatial import Array


class SimulatedMotion:
    """Tests whether the joints that a simulation names go as the recorded ones do: else it is of another motion, or late."""

    KEY: ClassVar[str] = "simulated_motion"
    STAGE: ClassVar[Stage] = Stage.CELLS

    def examine(self, seen: Observations) -> Iterator[Remark]:
        """Yield at most one remark, which refuses the recording."""
        simulation = seen.simulation or {}
        names = [name for name in driver_names(seen) if name in simulation and name.endswith(".position")]
        pairs = [(_moves(seen.columns[name]), _moves(simulation[name])) for name in names]
        pairs = [(ours, theirs) for ours, theirs in pairs if ours.any() and len(ours) == len(theirs)]
        if len(seen) < 100 or not pairs or _unlike(pairs, 0) < CRITERIA.gross_left:
            return
        joints = f"joint positions of the simulation and of the recording ({len(pairs)})"
        late = _late(pairs) if seen.time is not None else 0
        if late and seen.time is not None and _unlike(pairs, late) < CRITERIA.gross_left:
            seconds = late * float(np.ptp(seen.time)) / (len(seen) - 1)
            what = (
                f"the {joints} are the same motion {abs(seconds):.4g} s {'later' if seconds > 0.0 else 'earlier'} there"
            )
            yield Remark(self.KEY, what, "give both the same clock", tuple(names), Action.REFUSED)
            return
        what = f"the simulation is of another motion: the {joints} do not go together"
        yield Remark(self.KEY, what, "give the simulation of this recording", tuple(names), Action.REFUSED)


def _moves(x: Array) -> Array:
    """Return a column (N,) less its mean over its standard deviation; zeros where it does not move, or is not known."""
    there = np.isfinite(x)
    if not there.any() or not np.ptp(x[there]) > 0.0:
        return np.zeros(len(x))
    return np.asarray(np.where(there, x - np.mean(x[there]), 0.0) / np.std(x[there]))


def _unlike(pairs: list[tuple[Array, Array]], late: int) -> float:
    """Return the mean share of recorded columns that simulated ones, `late` rows later, do not explain."""
    each = []
    for ours, theirs in pairs:
        a, b = (ours[: len(ours) - late], theirs[late:]) if late >= 0 else (ours[-late:], theirs[:late])
        size = float(np.sqrt(np.sum(a**2) * np.sum(b**2)))
        each.append(1.0 - max(float(np.sum(a * b)) / size, 0.0) ** 2 if size > 0.0 else 1.0)
    return float(np.mean(each))


def _late(pairs: list[tuple[Array, Array]], *, count: int = 100) -> int:
    """Return by how many rows, up to a third of them, the simulated columns are later where they go together best.

    Args:
        count: lags to either side that are tried first; then those beside the best.
    """
    furthest = len(pairs[0][0]) // 3
    step = max(furthest // count, 1)
    best = min(range(-furthest, furthest + 1, step), key=lambda late: _unlike(pairs, late))
    return min(range(best - step, best + step + 1), key=lambda late: _unlike(pairs, late))

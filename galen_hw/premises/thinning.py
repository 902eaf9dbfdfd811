"""A few rows of a motion, with the joints' speeds and accelerations as all rows tell them."""

from typing import Final

import numpy as np

from galen_hw.physics.effects.registry import scene_of
from galen_hw.physics.observations import Observations
from galen_hw.premises.base import joint_positions, known_rows
from galen_hw.premises.criteria import CRITERIA
from galen_hw.premises.sampling import compared_names, measured
from galen_hw.premises.wrench_reading import at_rest
from galen_hw.spatial import Array

Rates = tuple[Array, Array] | None
"""Of joints, (N, n) rad/s and rad/s^2, or m."""
DIFFERENTIABLE_S: Final = 0.05
"""Time between rows up to which a motion of an arm can be differentiated: ten rows of its quickest half second."""


def thinned(seen: Observations, most: int = CRITERIA.most_rows) -> tuple[Observations, Rates] | None:
    """Return rows with all joints and compared channels, evenly chosen, and the joints' speeds and accelerations (N, n) there.

    As if at rest where the rows are too far apart for a motion. None where nothing can be simulated.

    Args:
        most: rows.
    """
    seen = measured(seen)
    robot, names, driven = seen.belief.robot, compared_names(seen), joint_positions(seen)
    if not names or (robot is None and seen.simulation is None and seen.predict != "position"):
        return None
    lacking = robot is not None and len(driven) < len(robot.joint_names)
    if lacking and seen.simulation is None and seen.predict != "position":
        return None
    rows = known_rows(seen, (*names, *driven))
    if seen.simulation is not None:  # it may end before the recording
        rows = rows[np.isfinite([seen.simulation[n][rows] for n in names if n in seen.simulation]).all(axis=0)]
    if len(rows) < CRITERIA.fewest_vectors:
        return None
    known, step = seen if len(rows) == len(seen) else seen.taken(rows), -(-len(rows) // most)
    some = known.taken(np.arange(len(rows))[::step])
    if known.time is None:
        return (some if seen.simulation is not None else at_rest(some)), None
    # Between all rows: those that are chosen may be too far apart.
    speed, acceleration = (x[::step] for x in scene_of(known).rates)
    if not (np.isfinite(speed).all() and np.isfinite(acceleration).all()):
        return at_rest(some), scene_of(some).rates  # of a clock that stands
    close = seen.simulation is not None or float(np.median(np.diff(known.time))) <= DIFFERENTIABLE_S
    return (some if close else at_rest(some)), (speed, acceleration)

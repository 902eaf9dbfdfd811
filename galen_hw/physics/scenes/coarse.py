"""Work out what is smooth along the motion on a part of the rows."""

from collections.abc import Callable
from typing import Any

import numpy as np
from scipy.interpolate import CubicSpline

from galen_hw.physics.scenes.base import Scene
from galen_hw.spatial import Array


def coarse(scene: Scene, run: Callable[[Any], Array], *, most: int = 4000) -> Array:
    """Return run(rows) -> (M, ...) of an even choice of the rows of each run, cubic in between; exact where there are few.

    Args:
        most: rows: a rigid body's function row by row takes as long as all else together.
    """
    n = len(scene)
    if n <= most:
        return np.asarray(run(np.arange(n)))
    chosen = [
        np.unique(np.linspace(s.start, s.stop - 1, max(4, most * (s.stop - s.start) // n)).astype(int))
        for s in scene.segments
    ]
    values = np.asarray(run(np.concatenate(chosen)))
    own = np.split(values, np.cumsum([len(rows) for rows in chosen])[:-1])
    each = [
        CubicSpline(rows, at, axis=0)(np.arange(s.start, s.stop)) if len(rows) > 1 else at
        for s, rows, at in zip(scene.segments, chosen, own, strict=True)
    ]
    return np.concatenate(each)

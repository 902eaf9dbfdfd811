"""Propose saturation limits from a residual."""

import numpy as np

from galen_hw.diagnosis.detection.proposal import Sought
from galen_hw.physics.effects.sensor import Saturation
from galen_hw.physics.scenes.base import Scene
from galen_hw.spatial import Array


def saturations(scene: Scene, residual: Array, simulated: Array, *, few: int = 5, fewest: float = 1e-3) -> list[Sought]:
    """Return the saturation limit at each end of each channel whose clipping explains most of the residual (M, C).

    `simulated` (M, C) holds no excluded rows: interpolated values would say that nothing was clipped.

    Clipping takes all that goes beyond the limit L, so that only L is free: the gain of h = max(w - L, 0) with the factor -1, -2
    sum r h - sum h^2, is computed for every L at once from running sums over the rows in order of w.

    Args:
        few: rows beyond a limit that are too few to show that it is one.
        fewest: the same as a share of all rows; the larger of the two holds.
    """
    out = []
    for c, name in enumerate(scene.channels):
        if name in scene.turned:
            continue
        for sign in (1.0, -1.0):
            w, r = sign * simulated[:, c], sign * (residual[:, c] - np.median(residual[:, c]))
            order = np.argsort(-w)
            w, r = w[order], r[order]
            k = np.arange(1, len(w))
            limit, s, q = w[1:], np.cumsum(w)[:-1], np.cumsum(w * w)[:-1]
            gain = -2.0 * (np.cumsum(r * w)[:-1] - limit * np.cumsum(r)[:-1]) - (q - 2.0 * limit * s + k * limit**2)
            gain[: max(int(fewest * len(w)), few)] = 0.0
            gain[len(w) // 2 :] = 0.0
            if len(gain) and gain.max() > 0.0:
                out.append(Sought(Saturation(name, float(sign * limit[int(np.argmax(gain))]), sign > 0.0), len(w) // 4))
    return out

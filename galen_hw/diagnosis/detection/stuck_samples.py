"""Find samples that repeat the one before: a sensor that hangs, or that drops out to a constant."""

import numpy as np

from galen_hw.diagnosis.detection.proposal import FEW_ROWS
from galen_hw.diagnosis.stats.sampling import Mask, true_runs
from galen_hw.physics.scenes.base import Scene


def repeated(
    scene: Scene,
    *,
    most: float = 0.2,
    least: float = 1e-9,
    once: float = 0.99,
    often: float = 0.01,
    grids: float = 3.0,
    jump: float = 6.0,
) -> Mask:
    """Return samples (N, C) that repeat the one before where readings do not repeat by themselves.

    Readings without noise repeat where nothing moves. Readings on a grid repeat by chance: such a stretch must be too long for
    that, and the simulation must change over it by more than it usually does from row to row. A single channel is tested only in
    a wrench, off a grid, and must jump into the stretch or out of it: a joint's effort and position stand still with the joint.
    Of two and more samples the first is marked with them, for nobody knows when the sensor stopped.

    Args:
        most: share of repeated samples; where there are more, the sensor is slower than its record.
        least: times its usual change by which a simulated channel must move from row to row to move at all.
        once: share of readings that are different from one another where they are on no grid.
        often: stretches of readings on a grid that may repeat by chance, in a recording.
        grids: times its usual change, a step or two of a grid, that the simulation must move over a stretch on a
            grid.
        jump: the same, by which one channel must jump into such a stretch or out of it: readings at a limit come
            and go by small changes.
    """
    y, N = scene.observations.matrix(*scene.channels), len(scene)
    again, moved = np.zeros(y.shape, dtype=bool), np.zeros(N)
    usual = np.array([np.median(d[d > 0.0]) if np.any(d > 0.0) else np.inf for d in np.abs(np.diff(y, axis=0)).T])
    for part in scene.segments:
        again[part][1:] = y[part][1:] == y[part][:-1]
        moved[part][1:] = np.max(np.abs(np.diff(scene.simulated[part], axis=0)) / usual, axis=1)
    # Values that occurred before, but not just before, are on a grid.
    grid = np.array([len(np.unique(x[~a])) < once * np.sum(~a) for x, a in zip(y.T, again.T, strict=True)])
    chance = np.where(grid, np.log(np.maximum(np.mean(again, axis=0), 1.0 / N)), -np.inf)
    still, out = moved < least, np.zeros(y.shape, dtype=bool)

    def by_itself(channels: list[int], same: Mask) -> bool:
        """Return whether the sensor is slower than its record, or has no noise."""
        resting = still.sum() >= FEW_ROWS and float(np.mean(again[still][:, channels].all(axis=1))) > 0.5
        return float(np.mean(same)) > most or resting

    every = list(range(y.shape[1]))
    together = np.all(again, axis=1)
    for a, b in true_runs(together) if not by_itself(every, together) else ():
        changed = float(np.max(np.abs(scene.simulated[b - 1] - scene.simulated[a - 1]) / usual))
        by_chance = np.log(N) + (b - a) * float(np.sum(chance)) >= np.log(often)
        if not by_chance and (not grid.all() or changed > grids):
            out[a - (b > a + 1) : b] = True
    for c in every if scene.observations.predict == "wrench" else ():
        alone = again[:, c] & ~out[:, c]
        for a, b in true_runs(alone) if not by_itself([c], alone) else ():
            jumps = np.abs(y[[a - 1, min(b, N - 1)], c] - y[[max(a - 2, 0), b - 1], c])
            if not grid[c] and float(np.max(jumps)) > jump * usual[c]:
                out[a - (b > a + 1) : b, c] = True
    return out

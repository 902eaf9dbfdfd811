"""Propose slow movement of a residual: random walks, drifts and temperatures that several channels share."""

from dataclasses import replace

import numpy as np

from galen_hw.diagnosis.detection.proposal import FEW_ROWS, SHARED, Sought, slow_spread
from galen_hw.diagnosis.noise.spectrum import Noise
from galen_hw.diagnosis.stats.sampling import Rows
from galen_hw.physics.effects.drift import WALK, Drift, Temperature
from galen_hw.physics.scenes.base import Scene
from galen_hw.spatial import Array


def random_walks(scene: Scene, residual: Array, noise: Noise) -> list[Sought]:
    """Return drifts with every wave slower than the noise, for each channel whose residual (M, C) is a random walk."""
    proposed = {d.channel: d for d in Drift.propose(scene) if d.form == "wander"}
    walking = [name for name, walks in zip(scene.channels, noise.random_walks(residual, WALK), strict=True) if walks]
    return [Sought(replace(proposed[name], waves=WALK), 1) for name in walking if name in proposed]


def drifts(scene: Scene, residual: Array, rows: Rows) -> list[Sought]:
    """Return slow movement that several channels share: the best drift of each form, in the channels that show it.

    Args:
        residual: (M, C).
    """
    if len(scene.channels) < 2 or len(residual) < FEW_ROWS:
        return []
    z, best, time = _scaled(residual), dict[str, tuple[float, Drift]](), rows.average(scene.time)
    proposed = {(d.form, d.constant): d for d in Drift.propose(scene)}
    for one in proposed.values():
        names, gain = _shared(scene, z, one.shapes(time))
        if len(names) > 1 and gain > best.get(one.form, (0.0, one))[0]:
            best[one.form] = gain, replace(one, channel="", channels=names)
    return [Sought(effect, len(scene.channels)) for _, effect in best.values()]


def temperatures(scene: Scene, residual: Array, rows: Rows) -> list[Sought]:
    """Return each thermometer that several channels follow, with the time constant that explains most, and without one.

    As one effect of these channels: a drift in all of them at once would otherwise be found before it is in one.

    Args:
        residual: (M, C).
    """
    if len(scene.channels) < 2 or len(residual) < FEW_ROWS:
        return []
    z, best = _scaled(residual), dict[tuple[str, bool], tuple[float, Temperature]]()
    for one in {(t.place, t.constant): t for t in Temperature.propose(scene)}.values():
        kind = one.place, one.constant is None
        names, gain = _shared(scene, z, rows.average(one.warmth(scene)[:, None]))
        if len(names) > 1 and gain > best.get(kind, (0.0, one))[0]:
            best[kind] = gain, replace(one, channel="", channels=names, form="zero")
    return [Sought(effect, len(scene.channels)) for _, effect in best.values()]


def _scaled(residual: Array) -> Array:
    return np.asarray((residual - residual.mean(axis=0)) / np.maximum(slow_spread(residual), 1e-300))


def _shared(scene: Scene, z: Array, shapes: Array) -> tuple[tuple[str, ...], float]:
    """Return the channels of a scaled residual (M, C) that contain shapes (M, k), and the gain over all channels."""
    gain = np.sum((np.linalg.qr(shapes - shapes.mean(axis=0))[0].T @ z) ** 2, axis=0)
    return tuple(n for n, g in zip(scene.channels, gain, strict=True) if g > SHARED * gain.max()), float(gain.sum())

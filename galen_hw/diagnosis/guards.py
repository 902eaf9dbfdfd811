"""Before any fitting: is the recording what it says it is? Each thing that is not becomes one line."""

from dataclasses import dataclass, field
from itertools import permutations

import numpy as np

from galen_hw.errors import UsageError
from galen_hw.physics.scene import Scene
from galen_hw.physics.table import scene_of
from galen_hw.spatial import Array

FEWEST = 8


@dataclass
class Premise:
    """What the guards say.

    Args:
        scene: without the rows that cannot be compared.
        notes: one line each.
        wrong: lines that make every finding worthless (axes, signs, units); channels they concern.
    """

    scene: Scene
    notes: list[str] = field(default_factory=list)
    wrong: list[str] = field(default_factory=list)
    channels: list[str] = field(default_factory=list)


def premises(scene: Scene) -> Premise:
    """Leaves out rows that cannot be compared and looks for wrong axes, signs, units and clocks.

    Raises:
        UsageError: no channel, or too few rows to compare.
    """
    if not scene.channels:
        group = scene.observations.predict
        raise UsageError(f"no column of the group {group!r} is there to compare", where="recording", todo="see predict")
    notes: list[str] = []
    scene = _ordered(scene, notes)
    scene = _complete(scene, notes)
    out = Premise(scene, notes)
    if scene.observations.predict == "wrench":
        _axes(out)
    _units(out)
    out.notes += out.wrong
    return out


def _ordered(scene: Scene, notes: list[str]) -> Scene:
    """Rows whose clock stands or runs backwards inside a segment go."""
    if not scene.clock:
        return scene
    good = np.ones(len(scene), dtype=bool)
    for part in scene.segments:
        t = scene.time[part]
        good[part] = t > np.concatenate([[-np.inf], np.maximum.accumulate(t)[:-1]])
    if good.all():
        return scene
    notes.append(f"time repeats or runs backwards in {int((~good).sum())} rows, which are left out")
    return scene_of(scene.observations.taken(good))


def _complete(scene: Scene, notes: list[str]) -> Scene:
    """Rows without a measured or simulated value, or without a joint position, go; a dead channel is named."""
    y, s = scene.measured, scene.simulated
    for c, name in enumerate(scene.channels):
        if not np.isfinite(y[:, c]).any() or not np.isfinite(s[:, c]).any():
            raise UsageError(f"{name} has no value that can be compared", where="recording", todo="check the column")
        if len(y) > 2 and np.nanmax(y[:, c]) == np.nanmin(y[:, c]) and np.nanstd(s[:, c]) > 0:
            notes.append(f"{name} is constant: the channel may be dead")
    good = np.isfinite(y).all(axis=1) & np.isfinite(s).all(axis=1)
    if good.sum() < FEWEST:
        raise UsageError(
            f"only {int(good.sum())} rows can be compared", where="recording", todo=f"record at least {FEWEST}"
        )
    if good.all():
        return scene
    notes.append(f"{int((~good).sum())} rows have no value to compare and are left out")
    return scene_of(scene.observations.taken(good))


def _axes(out: Premise) -> None:
    """Whether another order or sign of the axes meets the simulation far better than the one that is named."""
    scene = out.scene
    y = scene.measured - scene.measured.mean(axis=0)
    s = scene.simulated - scene.simulated.mean(axis=0)
    for block, name in ((slice(0, 3), "wrench.force"), (slice(3, 6), "wrench.torque")):
        best, text = _best_axes(y[:, block], s[:, block])
        plain = float(np.sum((y[:, block] - s[:, block]) ** 2))
        if best < 0.15 * plain and text:
            out.wrong.append(f"{name}: {text}; the axes or signs are probably mixed up")
            out.channels += [f"{name}.{a}" for a in "xyz"]


def _best_axes(y: Array, s: Array) -> tuple[float, str]:
    best, text = np.inf, ""
    energy = np.sum(s**2, axis=0)
    if np.any(energy < 1e-3 * energy.max()):
        return best, text
    for order in permutations(range(3)):
        for signs in np.array(np.meshgrid([1, -1], [1, -1], [1, -1])).reshape(3, -1).T:
            error = float(np.sum((y - signs * s[:, order]) ** 2))
            if error < best:
                names = [f"{'-' if g < 0 else ''}{'xyz'[o]}" for g, o in zip(signs, order, strict=True)]
                best = error
                text = "" if names == ["x", "y", "z"] else f"x, y, z read like {', '.join(names)} of the simulation"
    return best, text


def _units(out: Premise) -> None:
    """Whether recorded and simulated channels differ by a factor that is a change of units."""
    scene = out.scene
    factors = {1000.0: "milli", 57.29578: "degrees", 9.80665: "kilograms-force", 4.44822: "pounds-force"}
    for c, name in enumerate(scene.channels):
        y, s = scene.measured[:, c], scene.simulated[:, c]
        y, s = y - y.mean(), s - s.mean()
        size = float(s @ s)
        if size <= 0.0 or float(np.corrcoef(y, s)[0, 1] if np.std(y) > 0 else 0.0) < 0.95:
            continue
        scale = float(y @ s) / size
        for factor, text in factors.items():
            if min(abs(scale / factor - 1.0), abs(scale * factor - 1.0)) < 0.1:
                out.wrong.append(f"{name} is {scale:.3g} times what is simulated: is it in other units ({text})?")
                out.channels.append(name)

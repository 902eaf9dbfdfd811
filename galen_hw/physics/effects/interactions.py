"""What several effects do together: a gain scales what a new load adds too, and a joint that is off turns that load as well.

The order is the machine's: what hangs on it, how it stands and moves, what the sensor makes of its load (memory before the
calibration matrix), and what belongs to moments or to the wire, which the others do not meet. Errors of geometry meet each
other: a scale that is off carries the zero that is off beside it, and turns what a tilted base weighs.
"""

from collections.abc import Sequence
from copy import copy
from typing import TYPE_CHECKING

import numpy as np

from galen_hw.spatial import Array

if TYPE_CHECKING:
    from galen_hw.physics.effects.base import Effect
    from galen_hw.physics.scenes.base import Scene

Placed = tuple["Effect", Array]
"""An effect with its linear parameters (k,)."""


def compound(scene: "Scene", placed: Sequence[Placed]) -> list[Array]:
    """Return the change (N, C) of each effect where the others are too; `effect.change` where it is alone.

    Row by row every effect keeps a memory of its own.
    """
    out = [np.zeros((len(scene), len(scene.channels))) for _ in placed]
    read = [k for k, (effect, _) in enumerate(placed) if effect.reads(scene)]
    read.sort(key=lambda k: placed[k][0].READ_ORDER)
    meets = {k: _own(scene, k) for k in range(len(placed))}
    carrying = scene
    for k, (effect, theta) in enumerate(placed):
        body = effect.body(scene, theta)
        if body is not None:
            out[k] = effect.change(meets[k], theta)
            carrying = carrying.with_body(body) or carrying
    wrong = _wrong(placed)
    standing = carrying
    for k in wrong:
        effect, theta = placed[k]
        out[k] = effect.change(_own(standing, k), theta)
        if k != wrong[-1]:
            standing = effect.stands(standing, theta) or standing
    for k, (effect, theta) in enumerate(placed):
        if k in read or k in wrong or effect.body(scene, theta) is not None:
            continue
        own = effect.EPISODIC or effect.DOWNSTREAM or not effect.MEETS_BODIES
        out[k] = effect.change(meets[k] if own else _own(carrying, k), theta)
    loads = [x for x, (effect, _) in zip(out, placed, strict=True) if not (effect.EPISODIC or effect.DOWNSTREAM)]
    whole = sum(loads, np.zeros((len(scene), len(scene.channels))))
    for k in read:
        effect, theta = placed[k]
        out[k] = effect.change(meets[k].reading(scene.simulated + whole), theta)
        whole = whole + out[k]
    return out


def meet(scene: "Scene", placed: Sequence[Placed]) -> bool:
    """Return whether any of them does otherwise because of the others."""
    if len(placed) > 1 and any(e.reads(scene) or e.body(scene, theta) is not None for e, theta in placed):
        return True
    wrong = [placed[k] for k in _wrong(placed)]
    return len(wrong) > 1 and any(effect.stands(scene, theta) is not None for effect, theta in wrong)


def _wrong(placed: Sequence[Placed]) -> list[int]:
    """Return the places of what is wrong about how the arm stands, in the order in which they meet."""
    found = [k for k, (effect, _) in enumerate(placed) if np.isfinite(effect.GEOMETRY_ORDER)]
    return sorted(found, key=lambda k: placed[k][0].GEOMETRY_ORDER)


def _own(scene: "Scene", k: int) -> "Scene":
    """Return the scene with the memory of the k-th effect; a batch has none."""
    if scene.memory is None:
        return scene
    one = copy(scene)
    one.memory = scene.memory.setdefault(k, {})
    return one

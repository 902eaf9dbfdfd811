"""What came before a recording: what the first look leaves open of it, and who presumes to know it."""

from collections.abc import Sequence

import numpy as np

from galen_hw.physics.effects.base import Effect
from galen_hw.physics.effects.columns import Columns
from galen_hw.physics.effects.hysteresis import Creep
from galen_hw.physics.effects.sensor import Drift
from galen_hw.physics.effects.timing import Timing
from galen_hw.physics.scenes.base import Scene
from galen_hw.physics.scenes.initial_state import Beginning, Lagging
from galen_hw.spatial import Array


def left_open(scene: Scene, effects: Sequence[tuple[Effect, Array]]) -> Beginning:
    """What effects with parameters theta (k,) answer to that nobody recorded: late streams, and creep that had not settled."""
    drifts = [effect for effect, _ in effects if isinstance(effect, Drift)]
    out = Beginning()
    for effect, theta in effects:
        if isinstance(effect, Timing):
            out += effect.beginning(scene, theta)
        elif isinstance(effect, Creep) and any(_fades_alike(effect, drift) for drift in drifts):
            out += Beginning(lags=effect.lags(scene))
    return out


def supposable(scene: Scene, effects: list[Effect], columns: list[Columns]) -> list[tuple[Effect, Columns]]:
    """Effects with their columns; no creep that began rested where any beginning as quick is fitted: it is the same there."""
    known = [(c, lag) for lag in scene.beginning.lags for c in _places(lag)]

    def moot(effect: Effect) -> bool:
        if not isinstance(effect, Creep) or not effect.rested:
            return False
        return all(
            any(c == place and _as_quick(one.constant, lag.constant) for c, one in known)
            for lag in effect.lags(scene)
            for place in _places(lag)
        )

    return [(effect, own) for effect, own in zip(effects, columns, strict=True) if not moot(effect)]


def _fades_alike(creep: Creep, drift: Drift) -> bool:
    """Whether an offset fades as a creep that has not settled does: settled and rested are not all that may have been before."""
    if drift.constant is None or creep.channel not in ("", drift.channel):
        return False
    return _as_quick(drift.constant, creep.constant)


def _places(lag: Lagging) -> tuple[int | str, ...]:
    """The channels, or the joint, that may have begun in a state of their own."""
    return lag.channels or (lag.joint,)


def _as_quick(one: float, other: float, *, ratio: float = 1.5) -> bool:
    """Return whether two time constants are as good as one.

    Args:
        ratio: of two time constants within which what fades may be what had not settled of a creep.
    """
    return bool(abs(np.log(one / other)) < np.log(ratio))

"""Parameters of an effect, linear and searched, and the scales of a scene that their grids and units are taken from."""

from dataclasses import dataclass

import numpy as np

from galen_hw.physics.scenes.base import Scene

IN_PROPORTION = " a unit of "
"""What stands in a unit between SI and the name of a covariate, where a number is so much for each unit of that."""
FARTHEST_SCALE = 0.5
"""Relative error of a scale, or leak into a channel of the same unit, beyond which no sensor or encoder is in service: a unit or
an axis is mixed up instead, or other physics is missing."""


@dataclass(frozen=True, slots=True)
class Parameter:
    """A linear parameter: its null value is 0, where the effect vanishes exactly.

    Args:
        name: as it stands in findings and files.
        unit: SI, as text.
        low, high: physical bounds.
        expected: what it must be if the physics is what it is called (the share of a plain play is 1).
        furthest: size beyond which no machine is so wrong, whatever the data say: noise of the joints is made large by it.
    """

    name: str
    unit: str
    low: float = -np.inf
    high: float = np.inf
    expected: float | None = None
    furthest: float = np.inf

    def plausible(self, value: float, std: float) -> bool:
        """Return whether it is within the bounds and near an expected value: two fifths or three standard deviations."""
        return self.low - 3.0 * std <= value <= self.high + 3.0 * std and self.near(value, std)

    def near(self, value: float, std: float) -> bool:
        """Return whether it is of a believable size and near an expected value: two fifths or three standard deviations."""
        if abs(value) > self.furthest:
            return False
        return self.expected is None or abs(value - self.expected) <= max(0.4, min(3.0 * std, 0.9))


@dataclass(frozen=True, slots=True)
class Searched:
    """A nonlinear parameter (a field of the effect) with its unit and bounds; searched on a logarithmic scale."""

    low: float
    high: float
    unit: str


def unit_of(scene: Scene, channel: str) -> str:
    """Return the unit of a channel by name."""
    return scene.units[scene.channels.index(channel)]


def log_grid(low: float, high: float, count: int) -> tuple[float, ...]:
    """Return points of equal ratio; empty where the range is."""
    return tuple(np.geomspace(low, high, count).tolist()) if high > low > 0.0 else ()


def spacing(scene: Scene) -> float:
    """Return the median step of the clock, s."""
    steps = np.diff(scene.time)
    steps = steps[steps > 0]
    return float(np.median(steps)) if len(steps) else 1.0


def duration(scene: Scene) -> float:
    """Return the time from first to last row, s."""
    return float(scene.time[-1] - scene.time[0]) if len(scene) else 0.0

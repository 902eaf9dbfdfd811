"""Judging a hold: is it still, was it touched, and what is its average."""

from dataclasses import dataclass
from typing import Final

import numpy as np

from galen_hw.physics.rigid import gravity_in_sensor
from galen_hw.spatial import Array, skew

BLOCK: Final = 40
"""Samples of one block: 40 ms at 1 kHz."""
STEADY_SIGMA: Final = 5.0
RESTLESS: Final = 2.5
LEAST_POSES: Final = 6
Sample = tuple[float, float, float, float, float, float]


@dataclass(frozen=True, slots=True)
class Average:
    """Mean (6,), scatter of one sample (6,) and number of samples of a hold."""

    mean: Array
    std: Array
    samples: int


def average(samples: list[Sample]) -> Average:
    """Average of a hold."""
    values = np.array(samples)
    return Average(values.mean(axis=0), values.std(axis=0, ddof=1), len(values))


def unsteady(samples: list[Sample], noise: Array | None) -> str:
    """Why the newest two blocks are not still, empty if they are: the mean moves, or it scatters more than noise."""
    values = np.array(samples[-2 * BLOCK :])
    if len(values) < 2 * BLOCK:
        return "too few samples yet"
    early, late = values[:BLOCK], values[BLOCK:]
    std = np.sqrt(0.5 * (early.var(axis=0, ddof=1) + late.var(axis=0, ddof=1)))
    level = std if noise is None else np.maximum(noise, 1e-12)
    moved = np.abs(late.mean(axis=0) - early.mean(axis=0)) / (np.sqrt(2.0 / BLOCK) * np.maximum(level, 1e-12))
    if moved.max() > STEADY_SIGMA:
        return f"{_channel(int(moved.argmax()))} still moves"
    if noise is not None and np.max(std / level) > RESTLESS:
        return f"{_channel(int(np.argmax(std / level)))} scatters more than the sensor's noise"
    return ""


def touched(samples: list[Sample], force: float, torque: float) -> str:
    """What changed during a hold by more than `force` (N) or `torque` (N m), empty if nothing did."""
    blocks = len(samples) // BLOCK
    if blocks < 2:
        return ""
    first, last = (np.mean(samples[i * BLOCK : (i + 1) * BLOCK], axis=0) for i in (0, blocks - 1))
    return _jump(np.abs(last - first), force, torque, "changed by {} while the robot stood still")


def _jump(change: Array, force: float, torque: float, text: str) -> str:
    share = change / np.array([force] * 3 + [torque] * 3)
    if not share.max() > 1.0:
        return ""
    k = int(share.argmax())
    size = f"{change[k]:.2f} N" if k < 3 else f"{1e3 * change[k]:.0f} N mm"
    return f"{_channel(k)} {text.format(size)}"


def _channel(k: int) -> str:
    return ("Fx", "Fy", "Fz", "Tx", "Ty", "Tz")[k]


class Expectation:
    """What the poses so far say of the next one: weight, first moment and offsets by least squares.

    Args:
        gravity: (3,) in the base, m/s^2.
    """

    def __init__(self, gravity: Array) -> None:
        self._gravity = gravity
        self._s: list[Array] = []
        self._wrench: list[Array] = []

    def add(self, R: Array, wrench: Array) -> None:
        """Take a good pose: R (3, 3), wrench (6,)."""
        self._s.append(gravity_in_sensor(R, self._gravity))
        self._wrench.append(wrench)

    def __len__(self) -> int:
        """Number of poses."""
        return len(self._s)

    @property
    def mass(self) -> float | None:
        """What hangs on the sensor, kg, from the change of force with the change of gravity; None if it cannot be told.

        An offset of the sensor, and so its zeroing, has no part in it.
        """
        if len(self._s) < 2:
            return None
        ds, df = np.array(self._s) - self._s[0], np.array(self._wrench)[:, :3] - self._wrench[0][:3]
        size = float(np.sum(ds**2))
        return float(np.sum(ds * df)) / size if size > 4.0 else None

    def surprise(self, R: Array, wrench: Array, force: float, torque: float) -> str:
        """How a pose disagrees with the others by more than `force` or `torque`, empty if it does not."""
        if len(self._s) < LEAST_POSES:
            return ""
        s = np.array(self._s)
        rows = np.zeros((len(s), 6, 10))
        rows[:, :3, 0], rows[:, 3:, 1:4] = s, -skew(s)
        rows[:, :, 4:] = np.eye(6)
        theta, _, rank, _ = np.linalg.lstsq(rows.reshape(-1, 10), np.concatenate(self._wrench), rcond=1e-3)
        if rank < 10:
            return ""
        here = gravity_in_sensor(R, self._gravity)
        expected = np.concatenate([theta[0] * here, np.cross(theta[1:4], here)]) + theta[4:]
        return _jump(np.abs(wrench - expected), force, torque, "is {} off what the other poses say")

"""Deflection sample by sample: where the arm is for a joint state, and what every live model offers."""

from abc import ABC, abstractmethod
from dataclasses import dataclass
from math import cos, sin, sqrt
from typing import Any, TypeAlias

import numpy as np

from galen_hw.kinematics import Robot
from galen_hw.spatial import Array, quaternion_from_rotation

Triple: TypeAlias = tuple[float, float, float]
Six: TypeAlias = tuple[float, float, float, float, float, float]
NONE: Six = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


@dataclass(frozen=True, slots=True)
class Place:
    """The rigid arm at one joint state, base frame, worked out once and used for all samples until the next.

    Args:
        names: of the joints; q: (n,) joints; R: (3, 3) sensor to base; sensor, tip: (3,) m; quaternion of R, x y z w.
        screws: (6, n) motion [v, w] per joint rate, v at the base's origin.
        velocity: (6,) [v, w] of the tip from the joints' rates, m/s and rad/s.
    """

    names: tuple[str, ...]
    q: Array
    R: Array
    sensor: Array
    tip: Array
    quaternion: tuple[float, ...]
    screws: Array
    velocity: Six

    @classmethod
    def of(cls, robot: Robot, tip: Triple, q: Array, dq: Array) -> "Place":
        """The place of joints q (n,) that move at dq (n,), with a tip in the sensor frame, m."""
        T, J = robot.sensor_pose(q)[0], robot.sensor_jacobian(q)[0]
        R, p = T[:3, :3], T[:3, 3]
        arm = R @ np.asarray(tip)
        turn = J[3:]
        screws = np.concatenate([J[:3] - np.cross(turn, p[:, None], axis=0), turn])
        rate = J @ dq
        velocity = np.concatenate([rate[:3] + np.cross(rate[3:], arm), rate[3:]])
        quaternion, rates = tuple(quaternion_from_rotation(R).tolist()), tuple(velocity.tolist())
        return cls(tuple(robot.joint_names), q, R, p, p + arm, quaternion, screws, rates)


class GiveStream(ABC):
    """A model at work: one sample after the other, with what it remembers."""

    @abstractmethod
    def place(self, place: Place) -> None:
        """The arm is somewhere else from now on."""

    @abstractmethod
    def step(self, t_s: float, force: Triple, moment: Triple) -> Six:
        """The tip's give [move m, rotation vector rad] in the base, and remember.

        Args:
            t_s: time, not falling; force: N on the tool, base axes; moment: N m about the base's origin.
        """

    @abstractmethod
    def covariance(self) -> list[float]:
        """(36,) row-major of the last give [m, rad]; empty where the model does not know."""

    def gap(self) -> None:  # noqa: B027 - most models remember nothing
        """Samples were missed: what happened meanwhile is not known; the memory stands, the covariance grows."""

    def reset(self) -> None:  # noqa: B027
        """Forget everything, as at rest."""

    def memory(self) -> dict[str, Any]:
        """What is remembered, plain values."""
        return {}

    def remember(self, memory: dict[str, Any]) -> None:  # noqa: B027
        """Take back what was remembered before a restart; the covariance grows as after a gap."""


class LinearStream(GiveStream):
    """Give in proportion to the force.

    Args:
        matrix: (d, 3) m/N and rad/N; std: (d,) one sigma of the held-out error, or None.
    """

    def __init__(self, matrix: Array, std: Array | None = None) -> None:
        rows = np.zeros((6, 3))
        rows[: len(matrix)] = matrix
        self._rows: list[list[float]] = rows.tolist()
        self._covariance: list[float] = []
        if std is not None:
            full = np.zeros(6)
            full[: len(std)] = std
            self._covariance = np.diag(full**2).ravel().tolist()

    def place(self, place: Place) -> None:
        """The same everywhere."""

    def step(self, t_s: float, force: Triple, moment: Triple) -> Six:
        """Matrix times force."""
        del t_s, moment
        x, y, z = force
        return tuple([a * x + b * y + c * z for a, b, c in self._rows])  # type: ignore[return-value]

    def covariance(self) -> list[float]:
        """The held-out error, the same everywhere."""
        return self._covariance


def turned(quaternion: tuple[float, ...], x: float, y: float, z: float) -> tuple[float, float, float, float]:
    """Quaternion (x, y, z, w) of a rotation turned further by the rotation vector (x, y, z), base axes, rad."""
    angle = sqrt(x * x + y * y + z * z)
    k, w = (sin(0.5 * angle) / angle, cos(0.5 * angle)) if angle > 1e-12 else (0.5, 1.0)
    a, b, c = k * x, k * y, k * z
    i, j, l, r = quaternion  # noqa: E741 - the field's letters
    return (
        w * i + a * r + b * l - c * j,
        w * j + b * r + c * i - a * l,
        w * l + c * r + a * j - b * i,
        w * r - a * i - b * j - c * l,
    )

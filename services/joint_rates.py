"""Joint rates that give the contact point a wanted twist, within the joints' limits."""

from collections.abc import Mapping

import numpy as np

from galen_hw.kinematics import Robot
from galen_hw.spatial import Array, skew


class JointRates:
    """Damped least squares on the Jacobian of the contact point (Nakamura and Hanafusa 1986).

    A joint that reaches its limit is held there. The others do what they still can, the turning of the tool first: a
    push against the end of a carriage must not make the tool tip over.

    Args:
        robot: with its limits.
        max_speed: of any joint, m/s or rad/s; beyond it all are slowed down together.
        margin: distance from a limit at which a joint stops, m or rad.
        damping: lets the solution stay small near singular poses.
        length: m that one radian is worth in the least squares.
        horizon_s: a joint may not go so fast that it would pass its limit within this time.
    """

    def __init__(
        self,
        robot: Robot,
        *,
        max_speed: float,
        margin: float,
        damping: float = 0.005,
        length: float = 0.1,
        horizon_s: float = 0.15,
    ) -> None:
        self._robot, self._max_speed, self._damping, self._horizon_s = robot, max_speed, damping, horizon_s
        self._lower, self._upper = robot.lower + margin, robot.upper - margin
        self._weights = np.array([1.0, 1.0, 1.0, length, length, length])
        self._turning_first = np.array([1.0, 1.0, 1.0, 10.0, 10.0, 10.0])

    def contact_jacobian(self, q: Array, contact: Array) -> Array:
        """Twist of the contact point (sensor frame, m) per joint rate, (6, n), base axes."""
        R = self._robot.sensor_pose(q)[0, :3, :3]
        J = self._robot.sensor_jacobian(q)[0].copy()
        J[:3] -= skew(R @ contact) @ J[3:]
        return np.asarray(J)

    def solve(
        self, q: Array, contact: Array, twist: Array, at_lower: Mapping[str, bool], at_upper: Mapping[str, bool]
    ) -> Array:
        """Joint rates (n,), m/s or rad/s.

        Args:
            q: (n,) positions; contact: (3,) m, sensor frame; twist: (6,) of the contact point, base axes.
            at_lower, at_upper: limit switches, by joint name.
        """
        J, weights = self.contact_jacobian(q, contact), self._weights
        low, high = self._bounds(q, at_lower, at_upper)
        rates, free = np.zeros(len(q)), np.ones(len(q), dtype=bool)
        for _ in range(len(q)):
            left = twist - J[:, ~free] @ rates[~free]
            rates[free] = self._least(weights[:, None] * J[:, free], weights * left)
            beyond = free & ((rates < low) | (rates > high))
            if not beyond.any():
                break
            rates = np.clip(rates, low, high)
            free &= ~beyond
            weights = self._turning_first
        rates = np.clip(rates, low, high)
        fastest = float(np.abs(rates).max())
        return rates * min(1.0, self._max_speed / fastest) if fastest > 0.0 else rates

    def _bounds(self, q: Array, at_lower: Mapping[str, bool], at_upper: Mapping[str, bool]) -> tuple[Array, Array]:
        names = self._robot.joint_names
        low = np.minimum(0.0, (self._lower - q) / self._horizon_s)
        high = np.maximum(0.0, (self._upper - q) / self._horizon_s)
        low[[at_lower.get(name, False) for name in names]] = 0.0
        high[[at_upper.get(name, False) for name in names]] = 0.0
        return low, high

    def _least(self, A: Array, b: Array) -> Array:
        if not A.shape[1]:
            return np.zeros(0)
        return np.asarray(A.T @ np.linalg.solve(A @ A.T + self._damping**2 * np.eye(6), b))

"""The report's equations (1) to (8): the two-step fit of bias body and tool, derived with R(0) on both sides.

Polevoy and Singh, "Tool gravity compensation and deflection characterization for the Galen", JHU, 2019. The sensor
was zeroed at theta = 0 with the bias body b on it; R_i takes sensor to base coordinates; a weight f (base) with its
centre of mass at p (sensor frame) reads R^T f and p x R^T f = -R^T hat(f) R p. So at pose i

    f_s(i)   = R_i^T f_t + (R_i^T - R_0^T) f_b
    tau_s(i) = -R_i^T hat(f_t) R_i p_t - (R_i^T hat(f_b) R_i - R_0^T hat(f_b) R_0) p_b

and `docs/calibration.md` says where the printed (3) and (7) differ. No sensor bias is in these equations.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from galen_hw.spatial import Array, skew
from galen_hw.units import STANDARD_GRAVITY


@dataclass(frozen=True, slots=True)
class WeightedPoint:
    """A weight and where it acts.

    Args:
        force: (3,) weight vector in the base frame, N.
        com: (3,) centre of mass in the sensor frame, m.
    """

    force: Array
    com: Array

    @property
    def mass(self) -> float:
        """Mass under standard gravity, kg."""
        return float(np.linalg.norm(self.force) / STANDARD_GRAVITY)


NOTHING = WeightedPoint(np.zeros(3), np.zeros(3))


def bias_force(R: ArrayLike, R0: ArrayLike, force: ArrayLike) -> Array:
    """Equations (1), (2): weight f_b (3,) from readings with no tool.

    Args:
        R: (n, 3, 3) sensor to base; R0: (3, 3) where the sensor was zeroed; force: (n, 3) readings, N.
    """
    A1 = _transposed(R) - np.asarray(R0).T
    return _least_squares(A1, force)


def bias_point(R: ArrayLike, R0: ArrayLike, torque: ArrayLike, f_b: ArrayLike) -> Array:
    """Equations (3), (4): centre of mass p_b (3,) from readings with no tool, R(0) on both sides of its term.

    Args:
        R, R0: as in `bias_force`; torque: (n, 3) readings, N m; f_b: (3,) from `bias_force`.
    """
    return _least_squares(_lever(R, f_b) - _lever(R0, f_b), torque)


def tool_force(R: ArrayLike, R0: ArrayLike, force: ArrayLike, f_b: ArrayLike) -> Array:
    """Equations (5), (6): weight f_t (3,) from readings with the tool, less what the bias body explains."""
    Y3 = np.asarray(force) - (_transposed(R) - np.asarray(R0).T) @ np.asarray(f_b)
    return _least_squares(_transposed(R), Y3)


def tool_point(R: ArrayLike, R0: ArrayLike, torque: ArrayLike, f_t: ArrayLike, body: WeightedPoint) -> Array:
    """Equations (7), (8): centre of mass p_t (3,) from readings with the tool."""
    Y4 = np.asarray(torque) - (_lever(R, body.force) - _lever(R0, body.force)) @ body.com
    return _least_squares(_lever(R, f_t), Y4)


def two_step(
    R: ArrayLike,
    wrench: ArrayLike,
    *,
    zero: ArrayLike | None = None,
    bare: tuple[ArrayLike, ArrayLike] | None = None,
    body: WeightedPoint = NOTHING,
) -> tuple[WeightedPoint, WeightedPoint]:
    """The whole procedure: bias body from the readings with no tool, then the tool.

    Args:
        R: (n, 3, 3) and wrench (n, 6): with the tool.
        zero: (3, 3) where the sensor was zeroed; any rotation will do if there is no bias body.
        bare: (R, wrench) with no tool; without them `body` is taken.

    Returns:
        Bias body and tool.
    """
    R0 = np.eye(3) if zero is None else np.asarray(zero)
    if bare is not None:
        bare_R, bare_wrench = bare[0], np.asarray(bare[1])
        f_b = bias_force(bare_R, R0, bare_wrench[:, :3])
        body = WeightedPoint(f_b, bias_point(bare_R, R0, bare_wrench[:, 3:], f_b))
    wrench = np.asarray(wrench)
    f_t = tool_force(R, R0, wrench[:, :3], body.force)
    return body, WeightedPoint(f_t, tool_point(R, R0, wrench[:, 3:], f_t, body))


def predict(R: ArrayLike, zero: ArrayLike | None, body: WeightedPoint, tool: WeightedPoint) -> Array:
    """Wrench (n, 6) that the two-step model expects, equation (11)."""
    R0 = np.eye(3) if zero is None else np.asarray(zero)
    Rt = _transposed(R)
    force = Rt @ tool.force + (Rt - R0.T) @ body.force
    torque = _lever(R, tool.force) @ tool.com + (_lever(R, body.force) - _lever(R0, body.force)) @ body.com
    return np.concatenate([force, torque], axis=-1)


def bias_point_as_printed(R: ArrayLike, R0: ArrayLike, torque: ArrayLike, f_b: ArrayLike) -> Array:
    """Equations (3), (4) as the report prints them, for comparison only: right for theta_i = 0 and no other.

    Its rows are (R_i^T - R_0^T) hat(f_b) (-R_i): the zeroing term bears R_i where the derivation has R_0.
    """
    A2 = (_transposed(R) - np.asarray(R0).T) @ skew(f_b) @ -np.asarray(R)
    return _least_squares(A2, torque)


def _transposed(R: ArrayLike) -> Array:
    return np.swapaxes(np.asarray(R, dtype=float), -1, -2)


def _lever(R: ArrayLike, f: ArrayLike) -> Array:
    """-R^T hat(f) R, so that `_lever @ p` is the torque p x R^T f; (..., 3, 3)."""
    lever: Array = -_transposed(R) @ skew(f) @ np.asarray(R, dtype=float)
    return lever


def _least_squares(rows: Array, readings: ArrayLike) -> Array:
    """(A^T A)^-1 A^T Y over the stacked rows, by orthogonal factors and so without squaring the condition."""
    solution: Array = np.linalg.lstsq(rows.reshape(-1, 3), np.asarray(readings, dtype=float).reshape(-1), rcond=None)[0]
    return solution

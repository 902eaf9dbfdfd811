"""Newton and Euler for what hangs on the sensor, written for the virtual robot alone.

A reading is what the sensor must bear: for a body of mass m, centre of mass c and inertia I about it, all in the sensor
frame, whose origin accelerates by a and turns by omega, alpha under gravity g,

    force  = m (g - a) - alpha x h - omega x (omega x h),          h = m c
    torque = h x (g - a) - J alpha - omega x (J omega),            J = I + m (c.c 1 - c c^T)

so a tool of weight vector w at rest reads R^T w and c x R^T w (spec/recording). Both are linear in g - a, alpha and the
products of omega; the (6, 12) matrix of several bodies is the sum of theirs.
"""

from collections.abc import Iterable

import numpy as np

from galen_hw.drivers.virtual.motion import SensorMotion
from galen_hw.drivers.virtual.truth import Body
from galen_hw.spatial import Array, skew

_PRODUCTS = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))


def load_matrix(bodies: Iterable[Body]) -> Array:
    """(6, 12): wrench per [g - a (3), alpha (3), omega_xx, yy, zz, xy, xz, yz], everything in the sensor frame."""
    out = np.zeros((6, 12))
    for body in bodies:
        c = np.asarray(body.com)
        h = body.mass * c
        J = np.diag(body.inertia) + body.mass * (c @ c * np.eye(3) - np.outer(c, c))
        out[:3, :3] += body.mass * np.eye(3)
        out[3:, :3] += skew(h)
        out[:3, 3:6] += skew(h)
        out[3:, 3:6] -= J
        for column, (i, j) in enumerate(_PRODUCTS):
            S = np.zeros((3, 3))  # omega omega^T of unit products
            S[i, j] = S[j, i] = 1.0
            out[:3, 6 + column] -= (S - np.trace(S) * np.eye(3)) @ h
            K = J @ S  # omega x (J omega) has the components K_zy - K_yz and so on
            out[3:, 6 + column] -= (K[2, 1] - K[1, 2], K[0, 2] - K[2, 0], K[1, 0] - K[0, 1])
    return out


def load_wrench(matrix: Array, R: Array, motion: SensorMotion, gravity: Array, *, inertial: bool) -> Array:
    """(6,) N, N m in the sensor frame, of what `matrix` describes, held at orientation `R` (sensor to base)."""
    if motion.rest or not inertial:
        return np.asarray(matrix[:, :3] @ (gravity @ R))
    w = motion.omega @ R
    wx, wy, wz = w.tolist()
    u = np.concatenate(
        ((gravity - motion.a) @ R, motion.alpha @ R, (wx * wx, wy * wy, wz * wz, wx * wy, wx * wz, wy * wz))
    )
    return np.asarray(matrix @ u)

"""A slope that wears off along the way and is whole again at a reversal: Bouc-Wen hysteresis, of which Dahl's model is one."""

import itertools
import math
from dataclasses import dataclass

import numpy as np

from galen_hw.spatial import Array


@dataclass(frozen=True)
class WearState:
    """Last input and last output."""

    input: float
    output: float


def wear(x: Array, reach: float, shape: float, state: WearState | None) -> tuple[Array, WearState]:
    """Return the Bouc-Wen output of power one: dz = dx / reach (1 - |z| (beta sgn(z dx) + 1 - beta)), |z| <= 1.

    On a way s = |x - x_0| / reach without a turn w = z sgn(dx) grows by w' = 1 - w where w > 0, and by w' = 1 + (1 - 2 beta) w
    before; both are solved exactly. Sources: Wen, J. Eng. Mech. Div. ASCE 102 (1976) 249; Dahl, AIAA J. 14 (1976) 1675 (beta 1).

    Args:
        x: (N,) inputs; reach: in their unit; shape: beta, 0 to 1.
        state: what the last row left; None: nothing is worn at the first input.
    """
    way = x if state is None else np.concatenate([[state.input], x])
    z, out = 0.0 if state is None else state.output, np.empty_like(way)
    moves = np.flatnonzero(np.diff(way))
    rising = way[moves + 1] > way[moves]
    turns = moves[1:][rising[1:] != rising[:-1]]
    edges = [0, *turns.tolist(), len(way) - 1]
    out[0] = z
    # Without growth the slope below zero is constant: so is it, to six digits, here.
    growth = 1.0 - 2.0 * shape if abs(1.0 - 2.0 * shape) > 1e-6 else 1e-6
    for a, b in itertools.pairwise(edges):
        sign = 1.0 if way[b] >= way[a] else -1.0
        if b == a + 1:
            # Poses without a motion between them turn at every other row: arrays of one would cost ten times as much.
            out[b] = sign * _worn_once(sign * float(out[a]), abs(float(way[b] - way[a])) / reach, growth)
        else:
            out[a : b + 1] = sign * _worn(sign * out[a], np.abs(way[a : b + 1] - way[a]) / reach, growth)
    own = out if state is None else out[1:]
    return own, WearState(float(x[-1]), float(own[-1]))


def _worn_once(start: float, s: float, growth: float) -> float:
    """Return w after one way s from w = start, see `_worn`."""
    if start >= 0.0:
        return 1.0 - (1.0 - start) * math.exp(-s)
    left = 1.0 + growth * max(start, -1.0)
    zero = -math.log(left) / growth if left > 0.0 else math.inf
    return -math.expm1(zero - s) if s >= zero else (left * math.exp(growth * s) - 1.0) / growth


def _worn(start: float, s: Array, growth: float) -> Array:
    """Return w (n,) along a way s (n,) from w = start, with w' = 1 + growth w below zero and 1 - w above."""
    if start >= 0.0:
        return np.asarray(1.0 - (1.0 - start) * np.exp(-s))
    left = 1.0 + growth * max(start, -1.0)
    zero = -math.log(left) / growth if left > 0.0 else np.inf
    below = (left * np.exp(growth * np.minimum(s, zero)) - 1.0) / growth
    return np.asarray(np.where(s < zero, below, -np.expm1(np.minimum(zero - s, 0.0))))

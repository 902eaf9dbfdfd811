"""A link with momentum between the two stops of a gap with grease in it: the same code over a batch and row by row."""

from dataclasses import dataclass

import numpy as np

from galen_hw.physics.operators.filters import lagging
from galen_hw.spatial import Array


@dataclass(frozen=True)
class GapState:
    """Last time (s), last place, speed and load of links in their gaps."""

    time: float
    place: Array
    speed: Array
    load: Array


def gap(time: Array, load: Array, coasting: Array, state: GapState | None) -> tuple[Array, GapState]:
    """Return y of T y'' + y' = u between stops at y = -1 and 1 that throw nothing back; exact for a straight load.

    Between the stops the speed is a first-order lag of the load (`filters.lagging`).
    T is the link's inertia over the grease's drag, u the load over drag and half width. For T = 0 it is the stop operator of
    the load's impulse (`filters.impulse` less its `filters.play`). From the speed v = y' at one row to the next

        v_k = p v_(k-1) + (s - p) u_(k-1) + (1 - s) u_k with p = exp(-dt / T), s = (1 - p) T / dt, and
        y_k = y_(k-1) + dt (u_(k-1) + u_k) / 2 - T (v_k - v_(k-1)),

    and where that lies beyond a stop, y_k is at it and v_k zero.

    Args:
        time: (N,) s.
        load: (N, m) u, 1/s.
        coasting: (m,) T > 0, s.
        state: what the last row left; None: it starts in the middle, at rest.
    """
    before = time[0] if state is None else state.time
    steps = np.maximum(np.diff(np.concatenate([[before], time])), 0.0)
    nothing = np.zeros(load.shape[1])
    place, speed, last = (nothing, nothing, load[0]) if state is None else (state.place, state.speed, state.load)
    out, left = np.empty_like(load, dtype=float), np.empty(load.shape[1])
    u = np.concatenate([last[None], load])
    kept, earlier, now = lagging(steps[:, None], coasting, held=False)
    gained, pushed = earlier * u[:-1] + now * u[1:], 0.5 * steps[:, None] * (u[:-1] + u[1:])
    for j, (T, y, v) in enumerate(zip(*(x.tolist() for x in (coasting, place, speed)), strict=True)):
        out[:, j], left[j] = _walked(y, v, T, kept[:, j].tolist(), gained[:, j].tolist(), pushed[:, j].tolist())
    return out, GapState(float(time[-1]), out[-1].copy(), left, load[-1].copy())


def _walked(
    y: float, v: float, coasting: float, kept: list[float], gained: list[float], pushed: list[float]
) -> tuple[list[float], float]:
    """Return the places, and the last speed, of one link row by row."""
    at = []
    for p, more, impulse in zip(kept, gained, pushed, strict=True):
        was = v
        v = p * v + more
        y += impulse - coasting * (v - was)
        if y > 1.0:
            y, v = 1.0, 0.0
        elif y < -1.0:
            y, v = -1.0, 0.0
        at.append(y)
    return at, v

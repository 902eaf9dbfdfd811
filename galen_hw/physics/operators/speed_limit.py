"""A servo with a speed limit: the same over a batch of rows and over one row after the other."""

import numpy as np

from galen_hw.physics.operators.filters import LagState, lagging
from galen_hw.spatial import Array


def limited_lag(
    time: Array, x: Array, constant: float, speed: float, state: LagState | None, *, held: bool = False
) -> tuple[Array, LagState]:
    """Return the lag of a servo whose supply or profile limits its speed: T dy/dt = x - y, at most T times the speed.

    Exact below the limit and at it; a step in which the limit begins or ends is as long as the whole of it allows.

    Args:
        time: (N,) s.
        x: (N, m) inputs.
        constant: T, s.
        speed: above zero, in the unit of x over s.
        state: what the last row left; None: the output starts at the first input.
        held: see `filters.lag`.
    """
    before = time[0] if state is None else state.time
    start, last = (x[0], x[0]) if state is None else (state.output, state.input)
    steps = np.maximum(np.diff(np.concatenate([[before], time])), 0.0)
    kept, earlier, now = lagging(steps, np.asarray(constant), held=held)
    driven = earlier[:, None] * np.concatenate([last[None], x[:-1]]) + now[:, None] * x
    gone, most = (1.0 - kept).tolist(), (speed * steps).tolist()
    out = np.empty_like(x, dtype=float)
    for j, first in enumerate(start.tolist()):
        y, at = first, []
        for share, new, reach in zip(gone, driven[:, j].tolist(), most, strict=True):
            y += min(max(new - share * y, -reach), reach)
            at.append(y)
        out[:, j] = at
    return out, LagState(float(time[-1]), out[-1].copy(), x[-1].copy())

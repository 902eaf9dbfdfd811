"""Operators with memory: the same code over a batch of rows and over one row after the other.

Each takes the state that the last row left behind (None at a start) and returns its output and the new state, so that
a batch cut anywhere gives the same numbers.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

from galen_hw.spatial import Array

Index = NDArray[np.intp]
LONG = 400
FEW_CORNERS = 0.02
"""Share of the rows, of so many or more, below which the corners of a signal are walked one by one."""
FORGOTTEN = 1e-30
"""Share of a past value below which it is gone, whatever the value."""
EVEN = 1e-9
"""Spread of the clock's steps, as a share of one, that is rounding."""


def play(x: Array, half_width: Array, state: Array | None) -> tuple[Array, Array]:
    """Play (backlash) operator: the output rests until the input has crossed the band of +- half_width.

    p_k = min(max(p_{k-1}, x_k - r), x_k + r). Source: Brokate and Sprekels, Hysteresis and Phase Transitions, ch. 2.

    Args:
        x: (N, m) inputs.
        half_width: (m,) r >= 0 in the unit of x.
        state: (m,) last output; None: the output starts at the first input.
    """
    low, high = x - half_width, x + half_width
    start = x[0] if state is None else state
    corners = [_corners(x[:, j]) for j in range(x.shape[1])] if len(x) >= LONG else []
    if corners and all(len(at) < FEW_CORNERS * len(x) for at in corners):
        out = np.stack([_along(low[:, j], high[:, j], start[j], at) for j, at in enumerate(corners)], axis=-1)
        return out, out[-1].copy()
    # One step clamps to a band, and clamps after one another are a clamp: all of them by doubling, not row by row.
    reach = 1
    while reach < len(x) and not np.array_equal(low[reach:], high[reach:]):
        after_low, after_high = low[reach:].copy(), high[reach:].copy()
        low[reach:] = np.minimum(np.maximum(low[:-reach], after_low), after_high)
        high[reach:] = np.minimum(np.maximum(high[:-reach], after_low), after_high)
        reach *= 2
    out = np.minimum(np.maximum(start, low), high)
    return out, out[-1].copy()


def _corners(x: Array) -> Index:
    """First row, rows at which x (N,) turns round, last row."""
    moves = np.flatnonzero(np.diff(x))
    rising = x[moves + 1] > x[moves]
    turns = moves[1:][rising[1:] != rising[:-1]]
    return np.concatenate([[0], turns, [len(x) - 1]]).astype(np.intp)


def _along(low: Array, high: Array, start: float, corners: Index) -> Array:
    """Play where the input turns round seldom: between two corners the band moves one way, and one clamp to it is enough."""
    at, state = [], float(start)
    for below, above in zip(low[corners].tolist(), high[corners].tolist(), strict=True):
        state = min(max(state, below), above)
        at.append(state)
    held = np.repeat(at[:-1], np.diff(corners))
    return np.asarray(np.minimum(np.maximum(np.concatenate([at[:1], held]), low), high))


@dataclass(frozen=True)
class LagState:
    """Last time (s) and last output of a first-order lag."""

    time: float
    output: Array


def lag(time: Array, x: Array, constant: Array, state: LagState | None) -> tuple[Array, LagState]:
    """First-order lag, exact for inputs held over each step: y += (1 - exp(-dt / T)) (x - y).

    Args:
        time: (N,) s.
        x: (N, m) inputs.
        constant: (m,) time constants T, s.
        state: what the last row left; None: the output starts at the first input.
    """
    before = time[0] if state is None else state.time
    steps = np.diff(np.concatenate([[before], time]))
    start = x[0] if state is None else state.output
    if len(x) > 2 and np.ptp(steps[1:]) <= EVEN * steps[1]:
        out = _lag_evenly(steps[:2], x, constant, start)
        return out, LagState(float(time[-1]), out[-1].copy())
    share = -np.expm1(-np.maximum(steps, 0.0)[:, None] / constant)
    # y_k = kept y_(k-1) + new, and such steps after one another are such a step: all of them by doubling.
    kept, new = 1.0 - share, share * x
    reach = 1
    while reach < len(x) and np.any(kept[reach:] > FORGOTTEN):
        new[reach:] = kept[reach:] * new[:-reach] + new[reach:]
        kept[reach:] = kept[reach:] * kept[:-reach]
        reach *= 2
    out = kept * start + new
    return out, LagState(float(time[-1]), out[-1].copy())


def _lag_evenly(steps: Array, x: Array, constant: Array, start: Array) -> Array:
    """The same on an even clock, where it is a digital filter; steps: to the first row and between all others, s."""
    first, share = -np.expm1(-np.maximum(steps, 0.0)[:, None] / constant)
    out = np.empty_like(x, dtype=float)
    out[0] = start + first * (x[0] - start)
    for j, b in enumerate(np.broadcast_to(share, x.shape[1:]).tolist()):
        out[1:, j] = lfilter([b], [1.0, b - 1.0], x[1:, j], zi=[(1.0 - b) * out[0, j]])[0]
    return out


@dataclass(frozen=True)
class ServoState:
    """Last time (s) and last output of servos that stick."""

    time: float
    output: Array


def servo(
    time: Array, command: Array, band: Array, constant: Array, settling: Array, state: ServoState | None
) -> tuple[Array, ServoState]:
    """A servo without integral action against dry friction: T dq/dt = z(c - q), z the dead zone of +- `band`.

    It sticks while the stiffness times c - q cannot overcome the friction, then follows, a friction's width behind. T is its
    damping over its stiffness: play of the command for T = 0, a first-order lag for a band of zero. Friction that is viscous
    at creeping speed, up to its full size at some v, gives way while it sticks: (T + band / v) dq/dt = c - q. Source:
    Armstrong-Helouvry, Dupont, Canudas de Wit 1994, sec. 2 and 4 (friction over speed; stand-off under PD control).

    Args:
        time: (N,) s.
        command: (N, m) c, held over each step.
        band: (m,) friction over stiffness, in the unit of c.
        constant: (m,) T, s.
        settling: (m,) T + band / v > T, s; infinite where it holds for good.
        state: what the last row left; None: the output starts at the first command.
    """
    before = time[0] if state is None else state.time
    steps = np.maximum(np.diff(np.concatenate([[before], time])), 0.0)
    start = command[0] if state is None else state.output
    out = np.empty_like(command, dtype=float)
    for j, (r, lag_j, slow, first) in enumerate(
        zip(band.tolist(), constant.tolist(), settling.tolist(), start.tolist(), strict=True)
    ):
        q, at, breaks = first, [], r if np.isinf(slow) else r * slow / (slow - lag_j)
        quick, creeping = ((-np.expm1(-steps / one)).tolist() for one in (lag_j, slow))
        for share, little, c in zip(quick, creeping, command[:, j].tolist(), strict=True):
            error = c - q
            if error > breaks:
                q += share * (error - r)
            elif error < -breaks:
                q += share * (error + r)
            else:
                q += little * error
            at.append(q)
        out[:, j] = at
    return out, ServoState(float(time[-1]), out[-1].copy())


@dataclass(frozen=True)
class DelayState:
    """Past times (s) and rows that a pure delay still needs."""

    time: Array
    rows: Array


def delay(time: Array, x: Array, seconds: float, state: DelayState | None) -> tuple[Array, DelayState]:
    """Pure delay by linear interpolation of the past; before the first row the first row stands.

    Args:
        time: (N,) s, rising.
        x: (N, m) inputs.
        seconds: >= 0 for a stream; a batch may look ahead (negative) inside its rows.
        state: what the last rows left.
    """
    t = time if state is None else np.concatenate([state.time, time])
    rows = x if state is None else np.concatenate([state.rows, x])
    if state is None and len(t) > 2 and np.ptp(steps := np.diff(t)) <= EVEN * steps[0]:
        out = _shifted(rows, seconds / (t[-1] - t[0]) * (len(t) - 1))
    else:
        out = np.stack([np.interp(time - seconds, t, rows[:, j]) for j in range(x.shape[1])], axis=-1)
    keep = max(int(np.searchsorted(t, t[-1] - max(seconds, 0.0), side="right")) - 2, 0)
    return out, DelayState(t[keep:], rows[keep:])


def _shifted(x: Array, steps: float) -> Array:
    """The same on an even clock, where every row lies at the same share of the way between two; the ends stand."""
    count, whole = len(x), int(np.floor(steps))
    share = steps - whole
    out = np.empty_like(x, dtype=float)
    first, end = min(max(whole + 1, 0), count), max(min(count + whole, count), 0)
    out[:first], out[end:] = x[0], x[-1]
    if first < end:
        here, before = x[first - whole : end - whole], x[first - whole - 1 : end - whole - 1]
        np.subtract(before, here, out=out[first:end])
        out[first:end] *= share
        out[first:end] += here
    return out

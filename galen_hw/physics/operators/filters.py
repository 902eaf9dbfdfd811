"""Operators with memory: the same code over a batch of rows and over one row after the other.

Each takes the state that the last row left behind (None at a start) and returns its output and the new state, so that
a batch cut anywhere gives the same numbers.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import cumulative_trapezoid
from scipy.signal import lfilter

from galen_hw.spatial import Array

Index = NDArray[np.intp]
LONG = 400
FORGOTTEN = 1e-30
"""Share of a past value below which it is gone, whatever the value."""
EVEN = 1e-9
"""Spread of the clock's steps, as a share of one, that is rounding."""


def evenly(time: Array) -> bool:
    """Return whether a clock (N,) is even but for rounding; of less than three rows nobody knows."""
    steps = np.diff(time)
    return len(steps) > 1 and bool(np.ptp(steps) <= EVEN * steps[0])


def play(x: Array, half_width: Array, state: Array | None, *, few: float = 0.02) -> tuple[Array, Array]:
    """Return the play (backlash) operator's output: it rests until the input has crossed the band of +- half_width.

    p_k = min(max(p_{k-1}, x_k - r), x_k + r). Source: Brokate and Sprekels, Hysteresis and Phase Transitions, ch. 2.

    Args:
        x: (N, m) inputs.
        half_width: (m,) r >= 0 in the unit of x.
        state: (m,) last output; None: the output starts at the first input.
        few: share of the rows below which the corners of a long signal are walked one by one.
    """
    low, high = x - half_width, x + half_width
    start = x[0] if state is None else state
    corners = [_corners(x[:, j]) for j in range(x.shape[1])] if len(x) >= LONG else []
    if corners and all(len(at) < few * len(x) for at in corners):
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
    """Return the first row, the rows at which x (N,) turns round, and the last row."""
    moves = np.flatnonzero(np.diff(x))
    rising = x[moves + 1] > x[moves]
    turns = moves[1:][rising[1:] != rising[:-1]]
    return np.concatenate([[0], turns, [len(x) - 1]]).astype(np.intp)


def _along(low: Array, high: Array, start: float, corners: Index) -> Array:
    """Return the play where the input turns seldom: between two corners the band moves one way, and one clamp to it is enough."""
    at, state = [], float(start)
    for below, above in zip(low[corners].tolist(), high[corners].tolist(), strict=True):
        state = min(max(state, below), above)
        at.append(state)
    held = np.repeat(at[:-1], np.diff(corners))
    return np.asarray(np.minimum(np.maximum(np.concatenate([at[:1], held]), low), high))


@dataclass(frozen=True)
class LagState:
    """Last time (s), last output and last input of a first-order lag."""

    time: float
    output: Array
    input: Array


def lag(
    time: Array,
    x: Array,
    constant: Array,
    state: LagState | None,
    *,
    held: bool = False,
    even: bool | None = None,
    bows: Array | None = None,
) -> tuple[Array, LagState]:
    """Return the first-order lag T dy/dt = x - y, exact for inputs straight between the rows, however short T is.

    y_k = p y_(k-1) + (s - p) x_(k-1) + (1 - s) x_k with p = exp(-dt / T), s = (1 - p) T / dt.

    Args:
        time: (N,) s.
        x: (N, m) inputs.
        constant: (m,) time constants T, s.
        state: what the last row left; None: the output starts at the first input.
        held: for inputs that are held over each step instead, as `servo.servo` has them: s = p.
        even: `evenly` of the clock, where it is known.
        bows: (N, m) how the inputs `bow`: parabolas between the rows instead of straight lines.
    """
    before = time[0] if state is None else state.time
    start, last = (x[0], x[0]) if state is None else (state.output, state.input)
    if evenly(time) if even is None else even:
        steps = np.maximum([time[0] - before, time[1] - time[0]], 0.0)
        out = _lag_evenly(steps, x, constant, start, last, held=held, bows=bows)
        return out, LagState(float(time[-1]), out[-1].copy(), x[-1].copy())
    steps = np.maximum(np.diff(np.concatenate([[before], time])), 0.0)
    kept, earlier, now = lagging(steps[:, None], constant, held=held)
    # y_k = kept y_(k-1) + new, and such steps after one another are such a step: all of them by doubling.
    new = earlier * np.concatenate([last[None], x[:-1]]) + now * x
    if bows is not None:
        new -= below(steps[:, None], constant) * bows
    reach = 1
    while reach < len(x) and np.any(kept[reach:] > FORGOTTEN):
        new[reach:] = kept[reach:] * new[:-reach] + new[reach:]
        kept[reach:] = kept[reach:] * kept[:-reach]
        reach *= 2
    out = kept * start + new
    return out, LagState(float(time[-1]), out[-1].copy(), x[-1].copy())


def lagging(steps: Array, constant: Array, *, held: bool) -> tuple[Array, Array, Array]:
    """Return the shares of the last output, the last input and this one in a lag's output after steps (s); they add to one."""
    ratio = steps / constant
    gone = -np.expm1(-ratio)
    if held:
        return 1.0 - gone, np.zeros_like(gone), gone
    straight = np.where(ratio > 0.0, gone / np.where(ratio > 0.0, ratio, 1.0), 1.0)
    return 1.0 - gone, straight - 1.0 + gone, 1.0 - straight


def below(steps: Array, constant: Array, *, least: float = 1e-2) -> Array:
    """Return by what share of its bow a lag's output after steps (s) is below a straight input's: half the mean of s (1 - s).

    Args:
        least: of a step over the constant from which its shares are no series.
    """
    ratio = steps / constant
    r = np.maximum(ratio, least)
    left = np.exp(-r)
    first, second = (1.0 - left * (1.0 + r)) / r, (2.0 - left * (2.0 + 2.0 * r + r * r)) / r**2
    # Of short steps the rest of a series: the terms above cancel.
    return np.where(ratio < least, ratio / 12.0 - ratio**2 / 24.0, 0.5 * (first - second))


def _lag_evenly(
    steps: Array, x: Array, constant: Array, start: Array, last: Array, *, held: bool, bows: Array | None
) -> Array:
    """Return the lag on an even clock, where it is a digital filter; steps: to the first row and between all others, s."""
    kept, earlier, now = (
        np.broadcast_to(part, (2, x.shape[1])) for part in lagging(steps[:, None], constant, held=held)
    )
    out = np.empty_like(x, dtype=float)
    out[0] = kept[0] * start + earlier[0] * last + now[0] * x[0]
    if bows is not None:
        less = below(steps[:, None], constant) * np.ones((2, x.shape[1]))
        out[0] -= less[0] * bows[0]
        new = now[1] * x[1:] + earlier[1] * x[:-1] - less[1] * bows[1:]
        for j, p in enumerate(kept[1].tolist()):
            out[1:, j] = lfilter([1.0], [1.0, -p], new[:, j], zi=[p * out[0, j]])[0]
        return out
    for j, (p, a, b) in enumerate(zip(kept[1].tolist(), earlier[1].tolist(), now[1].tolist(), strict=True)):
        out[1:, j] = lfilter([b, a], [1.0, -p], x[1:, j], zi=[a * x[0, j] + p * out[0, j]])[0]
    return out


@dataclass(frozen=True)
class ImpulseState:
    """Last time (s), last sum and last input of an integral over the clock."""

    time: float
    sum: Array
    input: Array


def impulse(time: Array, x: Array, state: ImpulseState | None) -> tuple[Array, ImpulseState]:
    """Return the integral of x over the clock, exact for inputs that are straight between the rows; zero at the start.

    Args:
        time: (N,) s.
        x: (N, m) inputs.
        state: what the last row left.
    """
    before = ImpulseState(float(time[0]), np.zeros_like(x[0]), x[0]) if state is None else state
    rows, clock = np.concatenate([before.input[None], x]), np.concatenate([[before.time], time])
    out = before.sum + cumulative_trapezoid(rows, clock, axis=0)
    return out, ImpulseState(float(time[-1]), out[-1].copy(), x[-1].copy())


@dataclass(frozen=True)
class SecondOrderState:
    """Last time (s), last output, its rate times the constant, and last input of a second-order response."""

    time: float
    output: Array
    rate: Array
    input: Array


def second_order(
    time: Array,
    x: Array,
    constant: float,
    damping: float,
    state: SecondOrderState | None,
    *,
    held: bool = False,
    even: bool | None = None,
    ends: bool = False,
) -> tuple[Array, SecondOrderState]:
    """Return y of T^2 y'' + 2 z T y' + y = x, exact for inputs straight between the rows: a servo, or a filter of two poles.

    Args:
        time: (N,) s.
        x: (N, m) inputs.
        constant: T, s: one over the natural frequency in rad/s.
        damping: z, below 1.
        state: what the last row left; None: the output starts at rest at the first input.
        held: for inputs that are held over each step instead, as `servo.servo` has them.
        even: `evenly` of the clock, where it is known.
        ends: nobody goes on from the state that is left: on an even clock its rate is not computed.
    """
    if state is None and (evenly(time) if even is None else even):
        step = max(float(time[1] - time[0]), 0.0) / constant
        return _second_order_evenly(time, x, step, damping, held=held, ends=ends)
    before = time[0] if state is None else state.time
    steps = np.maximum(np.diff(np.concatenate([[before], time])), 0.0) / constant
    output, rate, last = (
        (x[0], np.zeros(x.shape[1]), x[0]) if state is None else (state.output, state.rate, state.input)
    )
    turned = [part.tolist() for part in _turned(steps, damping)]
    out, quick = np.empty_like(x, dtype=float), np.empty(x.shape[1])
    for j, (y, r, old) in enumerate(zip(output.tolist(), rate.tolist(), last.tolist(), strict=True)):
        out[:, j], quick[j] = _swung(turned, steps.tolist(), [old, *x[:, j].tolist()], damping, (y, r), held=held)
    return out, SecondOrderState(float(time[-1]), out[-1].copy(), quick, x[-1].copy())


def _swung(
    turned: list[list[float]],
    steps: list[float],
    x: list[float],
    damping: float,
    state: tuple[float, float],
    *,
    held: bool,
) -> tuple[list[float], float]:
    """Return the outputs, and the last rate, row by row; x: the input before the first row, and all others."""
    (y, r), at = state, []
    for a, b, c, d, step, old, new in zip(*turned, steps, x[:-1], x[1:], strict=True):
        if step > 0.0:
            # What follows a straight line does so by as much behind it as the damping takes.
            slope = 0.0 if held else (new - old) / step
            behind, ahead = y - (new - (step + 2.0 * damping) * slope), r - slope
            y = new - 2.0 * damping * slope + a * behind + b * ahead
            r = slope + c * behind + d * ahead
        at.append(y)
    return at, r


def _second_order_evenly(
    time: Array, x: Array, step: float, damping: float, *, held: bool, ends: bool
) -> tuple[Array, SecondOrderState]:
    """Return the response from rest on an even clock, where it is a digital filter; step: in units of the constant."""
    a, b, c, d = (float(part[0]) for part in _turned(np.array([step]), damping))
    # Of this input and the last one: (I - turn) (2 z, -1) over the step is what a straight line's slope leaves; held, the
    # last one is gone.
    straight = ((1.0 - a) * 2.0 * damping + b) / step, (-c * 2.0 * damping - (1.0 - d)) / step
    w = (a, c) if held else straight
    (y_new, r_new), (y_old, r_old) = (1.0 - w[0], -w[1]), (w[0] - a, w[1] - c)
    poles = [1.0, -(a + d), a * d - b * c]
    moved = x - x[0]
    out = lfilter([y_new, y_old - d * y_new + b * r_new, b * r_old - d * y_old], poles, moved, axis=0)
    out += x[0]
    slopes = [r_new, r_old - a * r_new + c * y_new, c * y_old - a * r_old]
    quick = np.full(x.shape[1], np.nan) if ends else lfilter(slopes, poles, moved, axis=0)[-1]
    return out, SecondOrderState(float(time[-1]), out[-1].copy(), quick, x[-1].copy())


def _turned(steps: Array, damping: float) -> tuple[Array, Array, Array, Array]:
    """Return the four elements (N,) of what (y, T y') becomes over steps (N,) in units of the constant, without input."""
    swing = np.sqrt(1.0 - damping**2)
    fade, cosine, sine = np.exp(-damping * steps), np.cos(swing * steps), np.sin(swing * steps) / swing
    return fade * (cosine + damping * sine), fade * sine, -fade * sine, fade * (cosine - damping * sine)


@dataclass(frozen=True)
class BowState:
    """Last two times (s) and rows."""

    time: Array
    rows: Array


def bow(time: Array, x: Array, state: BowState | None) -> tuple[Array, BowState]:
    """Return how signals bow over the last step: the second difference of the parabola through the last three rows.

    A straight line between two rows lies above such a signal by s (1 - s) / 2 of it, s the share of the way, and by a twelfth in
    the mean.

    Args:
        time: (N,) s.
        x: (N, m) inputs.
        state: what the last rows left; None: straight up to the second row.
    """
    t = time if state is None else np.concatenate([state.time, time])
    rows = x if state is None else np.concatenate([state.rows, x])
    out = np.zeros_like(rows, dtype=float)
    if len(t) > 2:
        steps = np.diff(t)[:, None]
        slopes = np.diff(rows, axis=0) / np.where(steps > 0.0, steps, np.inf)
        over = steps[1:] + steps[:-1]
        out[2:] = steps[1:] ** 2 * 2.0 * np.diff(slopes, axis=0) / np.where(over > 0.0, over, np.inf)
    return out[len(t) - len(time) :], BowState(t[-2:], rows[-2:])


@dataclass(frozen=True)
class DelayState:
    """Past times (s) and rows that a pure delay still needs."""

    time: Array
    rows: Array


def delay(
    time: Array,
    x: Array,
    seconds: float,
    state: DelayState | None,
    *,
    even: bool | None = None,
    bowed: bool = False,
) -> tuple[Array, DelayState]:
    """Return the pure delay by interpolation of the past; before the first row the first row stands.

    Args:
        time: (N,) s, rising.
        x: (N, m) inputs.
        seconds: >= 0 for a stream; a batch may look ahead (negative) inside its rows.
        state: what the last rows left.
        even: `evenly` of the clock, where it is known.
        bowed: between the rows by parabolas (`bow`) instead of straight lines.
    """
    t = time if state is None else np.concatenate([state.time, time])
    rows = x if state is None else np.concatenate([state.rows, x])
    if state is None and (evenly(t) if even is None else even):
        out = _shifted(rows, seconds / (t[-1] - t[0]) * (len(t) - 1), bowed=bowed)
    else:
        at = time - seconds
        out = np.stack([np.interp(at, t, rows[:, j]) for j in range(x.shape[1])], axis=-1)
        if bowed and len(t) > 2:
            end = np.clip(np.searchsorted(t, at), 1, len(t) - 1)
            steps = t[end] - t[end - 1]
            share = np.clip((t[end] - at) / np.where(steps > 0.0, steps, np.inf), 0.0, 1.0)
            out -= (0.5 * share * (1.0 - share))[:, None] * bow(t, rows, None)[0][end]
    keep = max(int(np.searchsorted(t, t[-1] - max(seconds, 0.0), side="right")) - 2, 0)
    return out, DelayState(t[keep:], rows[keep:])


def _shifted(x: Array, steps: float, *, bowed: bool) -> Array:
    """Return the delay on an even clock, where every row lies at the same share of the way between two; the ends stand."""
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
        if bowed and (past := max(first, whole + 2)) < end:
            out[past:end] -= 0.5 * share * (1.0 - share) * np.diff(x[past - whole - 2 : end - whole], 2, axis=0)
    return out

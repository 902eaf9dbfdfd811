"""Operators with memory along the rows of a recording, segment by segment, or from one live row to the next."""

from collections.abc import Callable
from typing import Any

import numpy as np

from galen_hw.lazy import cached_property
from galen_hw.physics.operators.bouc_wen import wear
from galen_hw.physics.operators.filters import (
    DelayState,
    LagState,
    SecondOrderState,
    bow,
    delay,
    evenly,
    impulse,
    lag,
    play,
    second_order,
)
from galen_hw.physics.operators.gap_dynamics import gap
from galen_hw.physics.operators.speed_limit import limited_lag
from galen_hw.physics.operators.stick_slip_servo import ServoState, servo
from galen_hw.spatial import Array

Memory = dict[Any, Any]
"""What operators remember from row to row, by the name of their place in the effect."""


class Operated:
    """What has a clock, and rows along which operators carry their state.

    Attributes:
        time: (N,) s; segments: runs of continuous rows.
        memory: states of the operators; None for a batch, which starts afresh in every segment.
    """

    time: Array
    segments: list[slice]
    memory: Memory | None

    @cached_property
    def even(self) -> bool:
        """Return whether the clock is even in every segment of a batch."""
        return all(self._evenly.values())

    @cached_property
    def steps(self) -> list[float]:
        """The mean steps (s) of a batch's segments."""
        clocks = (self.time[part] for part in self.segments)
        return [float(t[-1] - t[0]) / (len(t) - 1) for t in clocks]

    @cached_property
    def _evenly(self) -> dict[int, bool]:
        """Whether the clock is even in each segment of a batch, by their first rows. Looked at once for many operators."""
        return {part.start: evenly(self.time[part]) for part in self.segments}

    def _even(self, part: slice) -> bool | None:
        return None if self.memory is not None else self._evenly[part.start]

    def _carried(self, name: Any, x: Array, run: Callable[[slice, Any], tuple[Array, Any]], start: Any = None) -> Array:
        if self.memory is not None:
            out, self.memory[name] = run(slice(None), self.memory.get(name, None if start is None else start[0]))
            return out
        if len(self.segments) == 1:
            return run(self.segments[0], None if start is None else start[0])[0]
        out = np.empty_like(x)
        for number, part in enumerate(self.segments):
            out[part] = run(part, None if start is None else start[number])[0]
        return out

    def play(self, name: Any, x: Array, half_width: Any, start: Array | None = None) -> Array:
        """Return the play of (N, m) inputs, carried along the rows, see `filters.play`; `start` (segments, m): first outputs."""
        r = np.broadcast_to(np.asarray(half_width, dtype=float), x.shape[1:])
        return self._carried(name, x, lambda part, state: play(x[part], r, state), start)

    def lag(
        self, name: Any, x: Array, constant: Any, *, empty: bool = False, held: bool = False, bowed: bool = False
    ) -> Array:
        """Return the first-order lag of (N, m) inputs over the clock, see `filters.lag`; `empty`: its output begins at zero."""
        bows = self._bows((name, "bow"), x) if bowed else None
        c = np.broadcast_to(np.asarray(constant, dtype=float), x.shape[1:])

        def run(part: slice, state: Any) -> tuple[Array, LagState]:
            if state is not None and not isinstance(state, LagState):
                state = LagState(float(self.time[part][0]), state, x[part][0])
            own = None if bows is None else bows[part]
            return lag(self.time[part], x[part], c, state, held=held, even=self._even(part), bows=own)

        # Behind a gap nobody knows; it had time to settle.
        start = [np.zeros(x.shape[1:]), *(None for _ in self.segments[1:])] if empty else None
        return self._carried(name, x, run, start)

    def limited_lag(self, name: Any, x: Array, constant: float, speed: float, *, held: bool = False) -> Array:
        """Return servos with a speed limit, of (N, m) inputs over the clock, see `speed_limit.limited_lag`."""

        def run(part: slice, state: Any) -> tuple[Array, LagState]:
            return limited_lag(self.time[part], x[part], constant, speed, state, held=held)

        return self._carried(name, x, run)

    def second_order(self, name: Any, x: Array, constant: float, damping: float, *, held: bool = False) -> Array:
        """Return the second-order response of (N, m) inputs over the clock, see `filters.second_order`."""
        ends = self.memory is None

        def run(part: slice, state: Any) -> tuple[Array, SecondOrderState]:
            time, even = self.time[part], self._even(part)
            return second_order(time, x[part], constant, damping, state, held=held, even=even, ends=ends)

        return self._carried(name, x, run)

    def servo(
        self, name: Any, command: Array, band: Any, constant: Any, settling: Any, start: Array | None = None
    ) -> Array:
        """Return servos that stick, of (N, m) commands, see `stick_slip_servo.servo`; `start` as of `play`, inside the band."""
        wide = command.shape[1:]
        r, quick, slow = (np.broadcast_to(np.asarray(x, dtype=float), wide) for x in (band, constant, settling))

        def run(part: slice, state: Any) -> tuple[Array, ServoState]:
            if state is not None and not isinstance(state, ServoState):
                first = command[part][0]
                state = ServoState(float(self.time[part][0]), np.clip(state, first - r, first + r))
            return servo(self.time[part], command[part], r, quick, slow, state, even=self._even(part))

        return self._carried(name, command, run, start)

    def impulse(self, name: Any, x: Array) -> Array:
        """Return (N, m) inputs summed over the clock, straight between the rows, from zero, see `filters.impulse`."""
        return self._carried(name, x, lambda part, state: impulse(self.time[part], x[part], state))

    def gap(self, name: Any, load: Array, coasting: float) -> Array:
        """Return the places (N, m) of links with momentum between the stops of their gaps, see `gap_dynamics.gap`."""
        T = np.full(load.shape[1:], coasting)
        return self._carried(name, load, lambda part, state: gap(self.time[part], load[part], T, state))

    def wear(self, name: Any, x: Array, reach: float, shape: float) -> Array:
        """Return the Bouc-Wen hysteresis (N,) of an input, carried along the rows, see `bouc_wen.wear`."""
        return self._carried(name, x, lambda part, state: wear(x[part], reach, shape, state))

    def delay(self, name: Any, x: Array, seconds: float, *, bowed: bool = False) -> Array:
        """Return (N, m) inputs delayed by seconds, see `filters.delay`."""

        def run(part: slice, state: Any) -> tuple[Array, DelayState]:
            return delay(self.time[part], x[part], seconds, state, even=self._even(part), bowed=bowed)

        return self._carried(name, x, run)

    def straightened(self, name: Any, x: Array) -> Array:
        """Return (N, m) inputs whose straight lines between the rows are in the mean what the inputs are, see `filters.bow`."""
        # A straight line lies above its parabola by half the mean of s (1 - s) of the second difference.
        return x - 1.0 / 12.0 * self._bows(name, x)

    def _bows(self, name: Any, x: Array) -> Array:
        return self._carried(name, x, lambda part, state: bow(self.time[part], x[part], state))

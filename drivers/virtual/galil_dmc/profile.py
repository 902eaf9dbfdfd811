"""Trapezoidal profiles in closed form: what the controller's profiler does between two commands.

A path is a list of pieces of constant acceleration, so that it can be evaluated at any time, however late.
Times are seconds since power-up, positions counts, speeds counts/s, accelerations counts/s^2.
"""

import math
from bisect import bisect_right
from dataclasses import dataclass
from typing import Literal, NamedTuple

Phase = Literal["hold", "accel", "slew", "decel"]


class State(NamedTuple):
    """Position, velocity and acceleration at one time."""

    p: float
    v: float
    a: float


@dataclass(frozen=True, slots=True)
class Piece:
    """Constant acceleration `a` from `t`, beginning at position `p` with speed `v`."""

    t: float
    p: float
    v: float
    a: float
    phase: Phase

    def at(self, t: float) -> State:
        """State at `t`, also outside the piece."""
        dt = t - self.t
        return State(self.p + dt * (self.v + 0.5 * self.a * dt), self.v + self.a * dt, self.a)


class Path:
    """A motion over all time: at rest before its first piece, its last piece for ever."""

    def __init__(self, position: float) -> None:
        self._pieces = [Piece(0.0, position, 0.0, 0.0, "hold")]
        self._times = [0.0]

    @property
    def end(self) -> float:
        """When the last piece begins: the end of a move, or of the acceleration of a jog."""
        return self._times[-1]

    @property
    def settles(self) -> bool:
        """The last piece is at rest."""
        return self._pieces[-1].phase == "hold"

    def piece(self, t: float) -> Piece:
        """The piece that holds at `t`."""
        return self._pieces[max(bisect_right(self._times, t) - 1, 0)]

    def at(self, t: float) -> State:
        """State at `t`."""
        if t < self._times[0]:
            return State(self._pieces[0].p, 0.0, 0.0)
        return self.piece(t).at(t)

    def replace(self, pieces: list[Piece], *, keep_after: float) -> None:
        """Let `pieces` take over from their first time on; forget what ended before `keep_after`."""
        start = pieces[0].t
        kept = [p for p in self._pieces if p.t < start]
        first = max((i for i, p in enumerate(kept) if p.t <= keep_after), default=0)
        self._pieces = kept[first:] + pieces
        self._times = [p.t for p in self._pieces]

    def shift(self, offset: float) -> None:
        """Add `offset` to every position."""
        self._pieces = [Piece(p.t, p.p + offset, p.v, p.a, p.phase) for p in self._pieces]


class Rates(NamedTuple):
    """Greatest speed, acceleration and deceleration of a move."""

    speed: float
    acceleration: float
    deceleration: float


def hold(t: float, position: float) -> list[Piece]:
    """At rest at once."""
    return [Piece(t, position, 0.0, 0.0, "hold")]


def stop(t: float, now: State, deceleration: float) -> list[Piece]:
    """Brake to rest."""
    if now.v == 0.0:
        return hold(t, now.p)
    time = abs(now.v) / deceleration
    brake = Piece(t, now.p, now.v, -math.copysign(deceleration, now.v), "decel")
    return [brake, *hold(t + time, brake.at(t + time).p)]


def jog(t: float, now: State, speed: float, acceleration: float, deceleration: float) -> list[Piece]:
    """Change to the signed `speed` and keep it; through rest where the direction changes."""
    pieces: list[Piece] = []
    p, v = now.p, now.v
    for target in [0.0, speed] if v * speed < 0.0 else [speed]:
        faster = abs(target) > abs(v)
        rate = math.copysign(acceleration if faster else deceleration, target - v)
        piece = Piece(t, p, v, rate, "accel" if faster else "decel")
        if target != v:
            pieces.append(piece)
            t += (target - v) / rate
            p = piece.at(t).p
        v = target
    return [*pieces, Piece(t, p, v, 0.0, "slew" if v else "hold")]


def move(t: float, now: State, target: float, rates: Rates) -> list[Piece]:
    """Go to `target` from any state and rest there: a trapezoid, or a triangle where it is near.

    A motion that cannot stop before the target brakes first and comes back.
    """
    ahead = target - now.p - math.copysign(now.v**2 / (2.0 * rates.deceleration), now.v)
    if ahead == 0.0 or ahead * now.v < 0.0 or rates.speed == 0.0:
        pieces = stop(t, now, rates.deceleration)
        rest = pieces[-1]
        if abs(rest.p - target) < 0.5 or rates.speed == 0.0:
            return pieces[:-1] + hold(rest.t, target if rates.speed else rest.p)
        return pieces[:-1] + move(rest.t, State(rest.p, 0.0, 0.0), target, rates)
    return _trapezoid(t, now, math.copysign(1.0, ahead), target, rates)


def _trapezoid(t: float, now: State, sign: float, target: float, rates: Rates) -> list[Piece]:
    """Speed up (or slow down to `speed`), slew, brake; `now` does not run past the target nor away from it."""
    speed, ac, dc = rates
    distance, v0 = sign * (target - now.p), sign * now.v
    peak = min(speed, math.sqrt((2.0 * distance + v0**2 / ac) * ac * dc / (ac + dc)))
    rate = ac if peak >= v0 else -dc
    ramp, brake = (peak - v0) / rate, peak / dc
    ramp_distance = 0.5 * (peak + v0) * ramp
    slew = max(distance - ramp_distance - 0.5 * peak * brake, 0.0) / peak
    up = Piece(t, now.p, now.v, sign * rate, "accel" if rate > 0.0 else "decel")
    even = Piece(t + ramp, now.p + sign * ramp_distance, sign * peak, 0.0, "slew")
    down = Piece(t + ramp + slew, even.p + sign * peak * slew, sign * peak, -sign * dc, "decel")
    pieces = [piece for piece, time in ((up, ramp), (even, slew), (down, brake)) if time > 0.0]
    return pieces + hold(t + ramp + slew + brake, target)

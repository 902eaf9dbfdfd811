"""Joint positions at the time of a wrench sample: interpolated between joint states, extrapolated within a bound.

Joint states come at about 40 Hz, wrenches at 1 kHz, so that nearly every sample is younger than the newest joint state.
Its position is then q + dq dt with the measured velocity; the error is at most a dt^2 / 2 for an acceleration a.
"""

from collections import deque
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import islice

from galen_hw.clock import NS_PER_S
from galen_hw.messages import JointsState

LARGEST = 1e6
"""No joint position or velocity has this size; beyond it a number is damage."""
RESET_NS = NS_PER_S
"""A step back in time by more than this is another clock: what was known is forgotten."""


@dataclass(frozen=True, slots=True)
class JointSample:
    """One joint state, in the order of the history's names: rad or m, and per second."""

    t_ns: int
    q: tuple[float, ...]
    dq: tuple[float, ...]


class JointHistory:
    """The last joint states.

    Args:
        names: joints wanted; a state without one of them, or not valid, or not finite, is passed over.
        bound_s: extrapolation ends here; older positions are held at it and are not fresh.
        length: states kept.
    """

    def __init__(self, names: tuple[str, ...], bound_s: float, length: int = 32) -> None:
        self.names = names
        self.unusable = 0
        self.late = 0
        self._bound_ns = round(bound_s * NS_PER_S)
        self._states: deque[JointSample] = deque(maxlen=length)

    @property
    def newest(self) -> JointSample | None:
        """The latest state, None before the first."""
        return self._states[-1] if self._states else None

    def last(self, count: int) -> list[JointSample]:
        """Up to `count` latest states, oldest first."""
        return list(islice(self._states, max(0, len(self._states) - count), None))

    def add(self, message: JointsState) -> bool:
        """Take a joint state; False when it could not be used."""
        t_ns, q = message.t_ns, _values(message.position, self.names)
        if not message.valid or q is None:
            self.unusable += 1
            return False
        if self._states and t_ns <= self._states[-1].t_ns:
            if self._states[-1].t_ns - t_ns <= RESET_NS:
                self.late += 1
                return False
            self._states.clear()
        dq = _values(message.velocity, self.names) or self._difference(t_ns, q)
        self._states.append(JointSample(t_ns, q, dq))
        return True

    def at(self, t_ns: int) -> tuple[tuple[float, ...], int, bool] | None:
        """(positions, age in ns of the newest state used, fresh) at a time; None before the first state.

        Fresh means interpolated, or extrapolated within the bound.
        """
        if not self._states:
            return None
        newest = self._states[-1]
        age = t_ns - newest.t_ns
        if age >= 0:
            fresh = age <= self._bound_ns
            dt = (age if fresh else self._bound_ns) / NS_PER_S
            return tuple([q + dq * dt for q, dq in zip(newest.q, newest.dq, strict=True)]), age, fresh
        return self._between(t_ns)

    def _between(self, t_ns: int) -> tuple[tuple[float, ...], int, bool]:
        after = self._states[-1]
        for before in self._backwards():
            if before.t_ns <= t_ns:
                part = (t_ns - before.t_ns) / (after.t_ns - before.t_ns)
                return tuple([a + (b - a) * part for a, b in zip(before.q, after.q, strict=True)]), 0, True
            after = before
        return after.q, 0, False

    def _backwards(self) -> Iterator[JointSample]:
        states = reversed(self._states)
        next(states)
        return states

    def _difference(self, t_ns: int, q: tuple[float, ...]) -> tuple[float, ...]:
        """Velocity from the last two positions, where the controller does not measure it."""
        if not self._states:
            return (0.0,) * len(q)
        last = self._states[-1]
        dt = (t_ns - last.t_ns) / NS_PER_S
        return tuple([(b - a) / dt for a, b in zip(last.q, q, strict=True)])


def _values(by_name: Mapping[str, float], names: tuple[str, ...]) -> tuple[float, ...] | None:
    """The named values, or None where one is absent, not finite or impossibly large."""
    try:
        found = tuple([by_name[name] for name in names])
    except KeyError:
        return None
    return found if all(abs(value) < LARGEST for value in found) else None

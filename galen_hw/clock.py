"""Time: monotonic nanoseconds inside, epoch seconds for viewers, and a clock that tests can turn by hand."""

import time
from dataclasses import dataclass, field
from typing import Protocol

NS_PER_S = 1_000_000_000


@dataclass(frozen=True, slots=True)
class TimeBase:
    """The fixed difference between the wall clock and CLOCK_MONOTONIC, measured once a process.

    Fixed, so that a stepped wall clock never makes published time run backwards.

    Args:
        wall_minus_monotonic_ns: epoch nanoseconds minus monotonic nanoseconds.
    """

    wall_minus_monotonic_ns: int = 0

    @classmethod
    def now(cls) -> "TimeBase":
        """Measure the difference now."""
        return cls(time.time_ns() - time.monotonic_ns())

    def timestamp(self, t_ns: int) -> float:
        """Seconds since the epoch of a monotonic time in nanoseconds."""
        return (t_ns + self.wall_minus_monotonic_ns) / NS_PER_S


class Clock(Protocol):
    """Where the shell takes its time from; devices and services are handed times instead."""

    def monotonic_ns(self) -> int:
        """Nanoseconds on CLOCK_MONOTONIC."""
        ...

    def sleep(self, seconds: float) -> None:
        """Let `seconds` pass."""
        ...


class SystemClock:
    """The machine's own clock."""

    def monotonic_ns(self) -> int:
        """Nanoseconds on CLOCK_MONOTONIC."""
        return time.monotonic_ns()

    def sleep(self, seconds: float) -> None:
        """Let `seconds` pass."""
        time.sleep(seconds)


@dataclass(slots=True)
class SimulatedClock:
    """A clock that moves only when told to: tests and replays run as fast as they can."""

    now_ns: int = field(default=0)

    def monotonic_ns(self) -> int:
        """Nanoseconds since the simulation began."""
        return self.now_ns

    def sleep(self, seconds: float) -> None:
        """Advance by `seconds` at once."""
        self.now_ns += round(seconds * NS_PER_S)

"""Two ends of a wire in memory, for tests and for devices that live in the same process."""

from collections import deque
from dataclasses import dataclass
from typing import Generic, Self

from galen_hw.clock import Clock, SimulatedClock
from galen_hw.drivers.device import Wire
from galen_hw.drivers.transport import Transport
from galen_hw.errors import HardwareError


@dataclass(slots=True)
class _Cut:
    broken: bool = False


class MemoryTransport(Transport[Wire], Generic[Wire]):
    """One end; make both with `MemoryTransport.pair(clock)`.

    What one end sends the other receives, in order and at once. With a `SimulatedClock` an empty `receive` lets its
    `timeout_s` pass on that clock, so that nothing ever waits.

    Args:
        clock: stamps what is received.
        address: for error messages.
    """

    def __init__(self, clock: Clock, address: str = "memory") -> None:
        self.address = address
        self._clock = clock
        self._inbox: deque[Wire] = deque()
        self._peer: MemoryTransport[Wire] | None = None
        self._is_open = False
        self._cut = _Cut()
        self._counters = {"received": 0, "sent": 0}

    @classmethod
    def pair(cls, clock: Clock | None = None) -> tuple[Self, Self]:
        """Both ends of a new wire."""
        clock = clock or SimulatedClock()
        left, right = cls(clock, "memory:left"), cls(clock, "memory:right")
        left._join(right)
        return left, right

    def open(self) -> None:
        """See `Transport.open`; fails while the wire is broken."""
        if self._cut.broken:
            raise HardwareError("the wire is broken", where=self.address)
        self._is_open = True

    def send(self, wires: list[Wire]) -> None:
        """See `Transport.send`."""
        self._check()
        if self._peer is not None:
            self._peer.deliver(wires)
        self._counters["sent"] += len(wires)

    def receive(self, timeout_s: float) -> list[tuple[Wire, int]]:
        """See `Transport.receive`."""
        self._check()
        if not self._inbox:
            self._clock.sleep(timeout_s)
        t_ns = self._clock.monotonic_ns()
        received = [(wire, t_ns) for wire in self._inbox]
        self._inbox.clear()
        self._counters["received"] += len(received)
        return received

    def close(self) -> None:
        """See `Transport.close`; what was on its way is gone."""
        self._is_open = False
        self._inbox.clear()

    def break_wire(self, *, broken: bool = True) -> None:
        """Cut the wire, or mend it; both ends notice."""
        self._cut.broken = broken

    @property
    def counters(self) -> dict[str, int]:
        """Frames or chunks received and sent."""
        return dict(self._counters)

    def _check(self) -> None:
        if self._cut.broken or not self._is_open:
            what = "the wire is broken" if self._cut.broken else "the wire is not open"
            raise HardwareError(what, where=self.address)

    def deliver(self, wires: list[Wire]) -> None:
        """Called by the other end; what comes to a closed end is gone."""
        if self._is_open:
            self._inbox.extend(wires)

    def _join(self, other: Self) -> None:
        self._peer = other
        other._peer = self
        other._cut = self._cut

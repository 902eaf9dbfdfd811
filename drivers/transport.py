"""Transports: the only place that opens and reads a wire. Each read is stamped once, with CLOCK_MONOTONIC."""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import Generic

from galen_hw.drivers.device import Wire


class Transport(ABC, Generic[Wire]):
    """An open wire.

    Args:
        address: how the configuration names it, for error messages.
        alone: to be set before `open`: refuse a wire that another process uses, though it can be shared.
    """

    address: str
    alone: bool = False
    news: Sequence[tuple[str, str]] = ()
    """What has befallen the open wire since this was emptied: what, what to do."""

    bus_bit_rate: int = 0
    """Bit/s of a bus that is shared with other nodes; 0 for a line of one's own."""

    @abstractmethod
    def open(self) -> None:
        """Open the wire.

        Raises:
            HardwareError: no such port, busy, no permission, no such interface: one line with what to do.
        """

    @abstractmethod
    def send(self, wires: list[Wire]) -> None:
        """Write all of `wires`, in order.

        Raises:
            HardwareError: the wire is gone.
        """

    @abstractmethod
    def receive(self, timeout_s: float) -> list[tuple[Wire, int]]:
        """What has arrived, each with its time of reading in ns; empty after `timeout_s` without any.

        Raises:
            HardwareError: the wire is gone.
        """

    @abstractmethod
    def close(self) -> None:
        """Close the wire; closing twice is fine."""

    def tend(self, now_ns: int) -> None:
        """Look after the open wire; called when `wakeup_ns` has come, at the latest.

        Raises:
            HardwareError: the wire is gone.
        """

    @property
    def wakeup_ns(self) -> int:
        """When `tend` is due, in ns of CLOCK_MONOTONIC."""
        return 1 << 62

    def fileno(self) -> int | None:
        """A descriptor that becomes readable when `receive` has something, None where there is none."""
        return None

    @property
    @abstractmethod
    def counters(self) -> dict[str, int]:
        """Bytes or frames in and out, errors, overruns: whole numbers that only grow."""

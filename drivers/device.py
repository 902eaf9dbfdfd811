"""The shape of a device: a state machine without I/O (as h11 is for HTTP).

Frames or bytes in, messages out; requests in, frames or bytes out. No socket, thread, sleep or clock inside: time
arrives as an argument, stamped once where the transport reads. A misbehaving peer is never an exception: what is
lost, late, doubled, short or foreign changes no state and is counted; what the user must know becomes a `Fault`.
"""

from abc import ABC, abstractmethod
from typing import Any, ClassVar, Generic, TypeAlias, TypeVar

import msgspec

from galen_hw.messages import Message, Reply, Request

Output: TypeAlias = tuple[str, Message] | Reply
"""A device's output: a message with its topic, or the answer to a request."""


class CanFrame(msgspec.Struct, frozen=True, gc=False):
    """A CAN 2.0A data frame: 11-bit identifier and up to eight bytes. Made by the thousand a second, hence no dataclass."""

    arbitration_id: int
    data: bytes = b""


Wire = TypeVar("Wire", CanFrame, bytes)


class Device(ABC, Generic[Wire]):
    """One device of the configuration, between its wire and the bus.

    Args:
        name: of the device in the configuration; the `source` of its messages and the `target` of its requests.

    `motions`: its requests that may set something in motion; empty for what only measures.
    """

    motions: ClassVar[frozenset[str]] = frozenset()
    name: str

    @abstractmethod
    def start(self, now_ns: int) -> None:
        """Begin (or begin again after a reconnect): forget the peer's state; what must be sent comes from `poll`."""

    @abstractmethod
    def poll(self, now_ns: int) -> tuple[list[Wire], list[Output]]:
        """What to send now, and what time alone brings (time-outs, status); call at `wakeup_ns` or earlier."""

    @abstractmethod
    def feed(self, wire: Wire, t_ns: int) -> list[Output]:
        """Take what the transport read at `t_ns`; any chunking of bytes gives the same outputs."""

    @abstractmethod
    def request(self, request: Request, now_ns: int) -> list[Output]:
        """Begin a command; the bytes come from `poll`, the `Reply` now or later.

        Raises:
            CommandRejectedError: not now, not so, or not known; nothing is sent.
        """

    @abstractmethod
    def stop(self, now_ns: int) -> list[Wire]:
        """Bring the device to rest at once (a motor stops, a stream ends); what to send for it."""

    def snapshot(self, now_ns: int) -> dict[str, Any]:
        """State worth keeping should this process die (a zero that the host holds); empty for none."""
        del now_ns
        return {}

    def restore(self, state: dict[str, Any], obstacle: str) -> None:
        """Take a snapshot back before `start`, to be used once the peer shows that it is the one it belongs to.

        Args:
            obstacle: why it must not be used; that is then said, and no more.
        """

    def trip(self, what: str, now_ns: int) -> list[Output]:
        """Come to rest and refuse `motions` until an operator clears it; `what` is why. Nothing to do by default."""
        del what, now_ns
        return []

    @property
    def held(self) -> str:
        """Why `motions` are refused until an operator clears it; empty if nothing is."""
        return ""

    @property
    def live(self) -> bool:
        """Power is on that moves something, or may."""
        return False

    @property
    @abstractmethod
    def wakeup_ns(self) -> int:
        """The monotonic time at which `poll` wants to be called next."""

    @property
    @abstractmethod
    def ready(self) -> bool:
        """The peer has been identified and samples flow."""

    @property
    @abstractmethod
    def counters(self) -> dict[str, int]:
        """Whole numbers that only grow: samples, lost, late, doubled, short, foreign, timeouts, ..."""

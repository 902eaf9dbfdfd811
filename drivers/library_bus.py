"""A CAN bus of python-can: SocketCAN, udp multicast and `virtual`. Loaded only by a wire that is one of them.

python-can takes a second to import where `asammdf` is installed (it reads MF4 logs), more than all the rest of the daemon.
"""

import logging
import time
from typing import Any, Final

import can

from galen_hw.drivers.can_errors import count_error_frame, is_full, news_of
from galen_hw.drivers.device import CanFrame

MOST_FRAMES: Final = 4096
"""Frames that one `receive` returns at most."""


class LibraryBus:
    """An open bus; standard data frames only, all else is counted.

    Each frame is stamped with CLOCK_MONOTONIC right after it was read; python-can's own stamps are of different clocks from
    interface to interface and are not used.

    Args:
        interface, channel, options: python-can's.
        counters: of the transport.

    Raises:
        OSError: it cannot be opened; python-can's own exception is its cause. Other kinds: an option is wrong.
    """

    def __init__(self, interface: str, channel: str, counters: dict[str, int], **options: Any) -> None:
        logging.getLogger("can").setLevel(logging.CRITICAL)  # it logs what we say better, once, as HardwareError
        self._interface, self._counters = interface, counters
        self.news: list[tuple[str, str]] = []
        """Of error frames since this was emptied: what they say, and what to do."""
        try:
            self._bus = can.Bus(channel, interface, ignore_config=True, **options)
        except can.CanError as error:
            raise OSError(str(error)) from error

    def send(self, frames: list[CanFrame]) -> None:
        """Send in order; what a full queue does not take is counted as `unsent`, not waited for.

        Raises:
            OSError: the bus is gone.
        """
        for frame in frames:
            message = can.Message(arbitration_id=frame.arbitration_id, data=frame.data, is_extended_id=False)
            try:
                self._bus.send(message, timeout=0.0 if self._interface == "socketcan" else 0.1)
                self._counters["sent"] += 1
            except can.CanError as error:
                if not (isinstance(error, can.CanTimeoutError) or is_full(error)):
                    raise OSError(str(error)) from error
                self._counters["unsent"] += 1

    def receive(self, timeout_s: float) -> list[tuple[CanFrame, int]]:
        """Frames that have arrived, each with its time of reading in ns; empty after `timeout_s` without any.

        Raises:
            OSError: the bus is gone.
        """
        received: list[tuple[CanFrame, int]] = []
        while len(received) < MOST_FRAMES:
            message = self._receive_one(0.0 if received else timeout_s)
            t_ns = time.monotonic_ns()
            if message is None:
                break
            frame = self._sort(message)
            if frame is not None:
                received.append((frame, t_ns))
        self._counters["received"] += len(received)
        return received

    def _receive_one(self, timeout_s: float) -> can.Message | None:
        try:
            return self._bus.recv(timeout_s)
        except can.CanOperationError as error:
            if self._interface != "udp_multicast" or isinstance(error.__cause__, OSError):
                raise OSError(str(error)) from error
            self._counters["malformed"] += 1  # a datagram of somebody else on the group
            return None
        except can.CanError as error:
            raise OSError(str(error)) from error

    def _sort(self, message: can.Message) -> CanFrame | None:
        if message.is_error_frame:
            count_error_frame(message.arbitration_id, bytes(message.data), self._counters)
            self.news += news_of(message.arbitration_id)
            return None
        if message.is_extended_id or message.is_remote_frame or message.is_fd:
            self._counters["not_data"] += 1
            return None
        return CanFrame(message.arbitration_id, bytes(message.data))

    def fileno(self) -> int | None:
        """A descriptor that becomes readable with a frame; none for `virtual`."""
        try:
            return self._bus.fileno()
        except NotImplementedError:
            return None

    def close(self) -> None:
        """Close the bus.

        Raises:
            OSError: it was gone.
        """
        try:
            self._bus.shutdown()
        except can.CanError as error:
            raise OSError(str(error)) from error

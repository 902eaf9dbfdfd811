"""What slcan adapters and socketcand servers share: CAN frames as text on a descriptor, read and written in chunks."""

import os
import select
import time
from abc import ABC, abstractmethod
from typing import Final

from galen_hw.drivers.device import CanFrame

CHUNK: Final = 65536
WRITE_PATIENCE_S: Final = 0.5


class CanWire(ABC):
    """An open wire that carries CAN frames as text.

    Args:
        fd: open and non-blocking; whoever makes the wire closes it.
        counters: of the transport; counts malformed, not_data, rejected, reopened and error frames.
    """

    def __init__(self, fd: int, counters: dict[str, int]) -> None:
        self.fd, self.counters = fd, counters
        self._readers = (fd,)

    @abstractmethod
    def parse(self, chunk: bytes) -> list[CanFrame]:
        """The data frames of what has arrived; all else is counted."""

    @abstractmethod
    def encode(self, frames: list[CanFrame]) -> bytes:
        """The text that sends frames."""

    @abstractmethod
    def close(self) -> None:
        """Close it; twice is fine."""

    def tend(self, now_ns: int) -> None:  # noqa: B027 - most wires need no care
        """Look after the wire; called at `wakeup_ns` at the latest.

        Raises:
            OSError: it is gone.
        """

    @property
    def wakeup_ns(self) -> int:
        """When `tend` is due."""
        return 1 << 62

    def read_frames(self, timeout_s: float) -> tuple[list[CanFrame], int]:
        """All frames that have arrived, and when they were read (CLOCK_MONOTONIC, ns); none after `timeout_s`.

        Raises:
            OSError: the wire is gone.
        """
        # select, for it alone waits for parts of a millisecond. Who does not wait knows as a rule that something is there:
        # select then only tells a port without data, which reads as empty, from one whose far end is gone.
        if timeout_s > 0.0 and not select.select(self._readers, (), (), timeout_s)[0]:
            return [], time.monotonic_ns()
        try:
            chunk = os.read(self.fd, CHUNK)
            if not chunk:
                if not select.select(self._readers, (), (), 0.0)[0]:
                    return [], time.monotonic_ns()
                chunk = os.read(self.fd, CHUNK)
        except BlockingIOError:
            return [], time.monotonic_ns()
        t_ns = time.monotonic_ns()
        if not chunk:
            raise ConnectionResetError("its far end was closed")
        return self.parse(chunk), t_ns

    def send_frames(self, frames: list[CanFrame]) -> None:
        """Write frames in one go.

        Raises:
            OSError: the wire is gone or does not take them.
        """
        self.write(self.encode(frames))

    def write(self, text: bytes) -> None:
        """Write all of `text`.

        Raises:
            OSError: the wire is gone or does not take it.
        """
        while text:
            try:
                text = text[os.write(self.fd, text) :]
            except BlockingIOError:
                if not select.select([], [self.fd], [], WRITE_PATIENCE_S)[1]:
                    raise TimeoutError("it takes no more data") from None

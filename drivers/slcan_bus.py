"""python-can's slcan bus, read and written in chunks.

python-can 4.6 reads the port byte by byte (two system calls each) and drains it after each write: fine for a trickle,
too slow for a sensor polled at 1 kHz. This subclass keeps its opening sequence and wire format and replaces what is
hot.
"""

import os
import select
import time
from collections import deque
from typing import Any, Final

import can
from can.interfaces.slcan import slcanBus

from galen_hw.drivers.device import CanFrame

CHUNK: Final = 65536
WRITE_PATIENCE_S: Final = 0.5
_LONGEST_LINE: Final = 64
_BELL: Final = 0x07


class ChunkedSlcanBus(slcanBus):
    """A LAWICEL adapter on a serial port or pty.

    Args:
        channel: of the port.
        exclusive: refuse a port that another process has open, and keep others out.
        options: of python-can's bus (bitrate, tty_baudrate, sleep_after_open, rtscts, listen_only).
    """

    def __init__(self, channel: str, *, exclusive: bool = True, **options: Any) -> None:
        self.rejected = self.malformed = self.not_data = 0
        self._fd = -1
        self._rest = b""
        self._ready: deque[CanFrame] = deque()
        super().__init__(channel, **options)
        if exclusive:
            self.serialPortOrig.exclusive = True
        self._fd = self.serialPortOrig.fileno()
        os.set_blocking(self._fd, False)
        self._readers = (self._fd,)

    def read_frames(self, timeout_s: float) -> tuple[list[CanFrame], int]:
        """All frames that have arrived, and when they were read (CLOCK_MONOTONIC, ns); none after `timeout_s`.

        Raises:
            can.CanOperationError: the port is gone.
        """
        # select, for it alone waits for parts of a millisecond; a port without data reads as empty, hence always
        if not select.select(self._readers, (), (), timeout_s)[0]:
            return [], time.monotonic_ns()
        try:
            chunk = os.read(self._fd, CHUNK)
        except BlockingIOError:
            return [], time.monotonic_ns()
        except OSError as error:
            raise can.CanOperationError(f"the port is gone ({error.strerror})", error.errno) from error
        t_ns = time.monotonic_ns()
        if not chunk:
            raise can.CanOperationError("the port is gone (end of file)")
        return self._parse(chunk), t_ns

    def _parse(self, chunk: bytes) -> list[CanFrame]:
        if _BELL in chunk:  # the adapter refused something; a bell ends a line as a carriage return does
            self.rejected += chunk.count(b"\a")
            chunk = chunk.replace(b"\a", b"\r")
        *lines, rest = (self._rest + chunk).split(b"\r")
        if len(rest) > _LONGEST_LINE:
            self.malformed += 1
            rest = b""
        self._rest = rest
        return [frame for line in lines if line and (frame := self._frame(line)) is not None]

    def _frame(self, line: bytes) -> CanFrame | None:
        """The data frame of a line; None for acknowledgements and all else, which is counted."""
        if line[0] != 0x74:  # "t"
            if line[:1] not in (b"z", b"Z"):
                self.not_data += 1
            return None
        try:
            data = bytes.fromhex(line[5:].decode("ascii"))
            arbitration_id, length = int(line[1:4], 16), line[4] - 0x30
        except (ValueError, IndexError):
            arbitration_id, length, data = -1, -1, b""
        if arbitration_id < 0 or len(data) - length not in (0, 2):  # an adapter may add a time stamp of two bytes
            self.malformed += 1
            return None
        return CanFrame(arbitration_id, data[:length])

    def send_frames(self, frames: list[CanFrame]) -> None:
        """Write frames in one go.

        Raises:
            can.CanOperationError: the port is gone or does not take them.
        """
        lines = [b"t%03X%d%s\r" % (f.arbitration_id, len(f.data), f.data.hex().upper().encode()) for f in frames]
        self._write_all(b"".join(lines))

    def _write(self, string: str) -> None:
        self._write_all(string.encode() + self.LINE_TERMINATOR)

    def _write_all(self, text: bytes) -> None:
        fd = self._fd if self._fd >= 0 else self.serialPortOrig.fileno()
        while text:
            try:
                text = text[os.write(fd, text) :]
            except BlockingIOError as error:
                if not select.select([], [fd], [], WRITE_PATIENCE_S)[1]:
                    raise can.CanOperationError("the port takes no more data") from error
            except OSError as error:
                raise can.CanOperationError(f"the port is gone ({error.strerror})", error.errno) from error

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        """For users of python-can's own interface; `read_frames` is the quick way."""
        if not self._ready:
            frames, _ = self.read_frames(1.0 if timeout is None else timeout)
            self._ready.extend(frames)
        if not self._ready:
            return None, False
        frame = self._ready.popleft()
        message = can.Message(
            timestamp=time.time(), arbitration_id=frame.arbitration_id, data=frame.data, is_extended_id=False
        )
        return message, False

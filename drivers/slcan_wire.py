"""A LAWICEL (slcan) adapter on a serial port or pty, without python-can: strict, in chunks, and looked after.

Lines end with CR. `tIIILDD..` is a standard data frame, and `T`, `r`, `R` (and `d`, `D`, `b`, `B` of CAN FD adapters)
are frames of other kinds; an adapter may add a time stamp, of 16 bits in ms (LAWICEL's `Z1`) or of 32 bits in us (`Z2`
of CANable and WeAct firmware). What is accepted is hexadecimal digits, identifiers up to 7FF and lengths up to 8, and
nothing that Python would take for a number besides.

An adapter's channel may be closed behind our back: another program wrote `C` to the port, or the adapter restarted. It
then answers everything with BELL, or not at all, and hands on no frames. So a wire on which nothing has been heard for
a while is opened anew, in place and at once: that costs nothing where nothing is heard anyway.
"""

import os
import re
import select
import time
from binascii import unhexlify
from functools import lru_cache
from typing import Final

import serial

from galen_hw.drivers.can_wire import CanWire
from galen_hw.drivers.device import CanFrame
from galen_hw.drivers.wire_claim import is_pseudo_terminal, keep_others_out

BITRATES: Final = {
    10_000: "S0",
    20_000: "S1",
    50_000: "S2",
    100_000: "S3",
    125_000: "S4",
    250_000: "S5",
    500_000: "S6",
    750_000: "S7",
    1_000_000: "S8",
    83_300: "S9",
}
"""Bit rates and their commands (LAWICEL CANUSB manual; S9 is python-can's)."""
SETTLE_S: Final = 2.0
"""Adapters that boot when their port is opened are left alone so long."""
QUIET_NS: Final = 400_000_000
"""After so long without a frame the channel is opened anew, then every second; shorter than sensors are waited for."""
AGAIN_NS: Final = 1_000_000_000
_LONGEST_LINE: Final = 160
_HEAD_LENGTH: Final = 5
_HEAD: Final = re.compile(rb"t([0-7][0-9A-Fa-f]{2})([0-8])")
_OTHER: Final = re.compile(rb"(?:[rdb][0-7][0-9A-Fa-f]{2}|[TRDB][01][0-9A-Fa-f]{7})[0-9A-Fa-f][0-9A-Fa-f]*")
_ANSWERS: Final = re.compile(rb"[zZ]?|[VN][0-9A-Za-z]{4}|F[0-9A-Fa-f]{2}")
_SENT: Final = b"z"
"""An adapter's answer to each frame that it was given."""
_STAMPS: Final = (0, 4, 8)
"""Digits of a time stamp."""


@lru_cache(maxsize=64)
def _head(text: bytes) -> tuple[int, int] | None:
    """Return identifier and digits of data of a data frame's head; a bus has few of them, again and again."""
    found = _HEAD.fullmatch(text)
    return None if found is None else (int(found[1], 16), 2 * int(found[2]))


def parse_line(line: bytes) -> CanFrame | None:
    """The data frame of a line, None for a line of another kind.

    Raises:
        ValueError: the line is none that an adapter writes.
    """
    head = _head(line[:_HEAD_LENGTH])
    if head is not None:
        identifier, digits = head
        rest = line[_HEAD_LENGTH:]
        if len(rest) - digits not in _STAMPS:
            raise ValueError("length and data do not fit")
        return CanFrame(identifier, unhexlify(rest)[: digits // 2])  # binascii.Error is a ValueError
    if line == _SENT or _OTHER.fullmatch(line) or _ANSWERS.fullmatch(line):
        return None
    raise ValueError("not a line of an adapter")


class SlcanWire(CanWire):
    """An open adapter.

    Args:
        channel: its port.
        bitrate: a key of `BITRATES`.
        counters: see `CanWire`.
        tty_baudrate: of the port; rtscts: flow control by lines; listen_only: send nothing, acknowledge nothing.
        sleep_after_open: s until the adapter takes commands; by itself 2, on a pty 0.

    Raises:
        OSError: (serial.SerialException) no such port, or another program has it.
    """

    def __init__(
        self,
        channel: str,
        bitrate: int,
        counters: dict[str, int],
        *,
        tty_baudrate: int = 115200,
        sleep_after_open: float | None = None,
        rtscts: bool = False,
        listen_only: bool = False,
    ) -> None:
        # Locked before a byte is written: the first command closes the channel of whoever has it open.
        self._port = serial.serial_for_url(channel, tty_baudrate, timeout=0, rtscts=rtscts, exclusive=True)
        try:
            super().__init__(int(self._port.fileno()), counters)
            self._rest = b""
            self._opening = f"C\r{BITRATES[bitrate]}\r{'L' if listen_only else 'O'}\r".encode()
            os.set_blocking(self.fd, False)
            keep_others_out(self.fd, channel)
            settle_s = 0.0 if is_pseudo_terminal(channel) else SETTLE_S
            time.sleep(settle_s if sleep_after_open is None else sleep_after_open)
            self.write(self._opening)
        except BaseException:
            self._port.close()
            raise
        self._due_ns = time.monotonic_ns() + QUIET_NS

    @property
    def wakeup_ns(self) -> int:
        """When the channel counts as closed unless a frame comes first."""
        return self._due_ns

    def tend(self, now_ns: int) -> None:
        """Open the channel anew when nothing has been heard for long, unless something has arrived and was not read."""
        if now_ns < self._due_ns or select.select(self._readers, (), (), 0.0)[0]:
            return
        self._due_ns = now_ns + AGAIN_NS
        self.counters["reopened"] += 1
        self.write(self._opening)

    def read_frames(self, timeout_s: float) -> tuple[list[CanFrame], int]:
        """See `CanWire.read_frames`."""
        frames, t_ns = super().read_frames(timeout_s)
        if frames:
            self._due_ns = t_ns + QUIET_NS
        return frames, t_ns

    def parse(self, chunk: bytes) -> list[CanFrame]:
        """See `CanWire.parse`; a bell (something was refused) ends a line as a carriage return does."""
        if b"\a" in chunk:
            self.counters["rejected"] += chunk.count(b"\a")
            chunk = chunk.replace(b"\a", b"\r")
        *lines, rest = (self._rest + chunk).split(b"\r")
        if len(rest) > _LONGEST_LINE:
            self.counters["malformed"] += 1
            rest = b""
        self._rest = rest
        return [frame for line in lines if line and (frame := self._frame(line)) is not None]

    def _frame(self, line: bytes) -> CanFrame | None:
        try:
            frame = parse_line(line)
        except ValueError:
            self.counters["malformed"] += 1
            return None
        if frame is None and line != _SENT and not _ANSWERS.fullmatch(line):
            self.counters["not_data"] += 1
        return frame

    def encode(self, frames: list[CanFrame]) -> bytes:
        """See `CanWire.encode`."""
        return b"".join(
            [b"t%03X%d%s\r" % (f.arbitration_id, len(f.data), f.data.hex().upper().encode()) for f in frames]
        )

    def close(self) -> None:
        """See `CanWire.close`; the channel too."""
        if self._port.is_open:
            try:
                self.write(b"C\r")
            finally:
                self._port.close()

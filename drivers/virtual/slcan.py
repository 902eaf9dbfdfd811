"""A virtual LAWICEL (slcan) adapter: ASCII on a serial line on one side, a CAN bus on the other.

Lines end with CR; an accepted line is answered with CR (a frame with `z` CR or `Z` CR), a refused one with BELL
(LAWICEL CANUSB manual, chapter 2). As in python-can's own use, a bare CR, a second `O` and a `C` while closed are fine.
Time stamps: none (`Z0`), 16 bits in ms (`Z1`), or 32 bits in us (`Z2`, as CANable and WeAct firmware has it).
"""

import re
from collections.abc import Callable
from typing import Final

from galen_hw.drivers.device import CanFrame

_OK: Final = b"\r"
_BELL: Final = b"\x07"
_BIT_RATES: Final = (10_000, 20_000, 50_000, 100_000, 125_000, 250_000, 500_000, 750_000, 1_000_000, 83_300)
_LONGEST_LINE: Final = 32
_FRAME: Final = re.compile(rb"t([0-7][0-9A-Fa-f]{2})([0-8])((?:[0-9A-Fa-f]{2}){0,8})")


class SlcanAdapter:
    """The adapter, a state machine without I/O.

    Args:
        bus_bit_rate: of the nodes on the bus; at another rate nothing gets through either way.
    """

    def __init__(self, bus_bit_rate: Callable[[], int]) -> None:
        self._bus_bit_rate = bus_bit_rate
        self._buffer = b""
        self._bit_rate = 0
        self._stamps = 0
        self.open = self._listen_only = False
        self.counters = {"frames_in": 0, "frames_out": 0, "refused": 0, "wrong_bit_rate": 0}

    def feed(self, data: bytes) -> tuple[bytes, list[CanFrame]]:
        """Take what the host wrote; (what the adapter answers, frames it puts on the bus)."""
        lines = (self._buffer + data).split(b"\r")
        self._buffer = lines.pop()
        answer, frames = bytearray(), list[CanFrame]()
        for line in lines:
            if line[:1] == b"t":
                answer += self._transmit(line, frames)
            else:
                answer += self._command(line)
        if len(self._buffer) > _LONGEST_LINE:
            self._buffer = b""
            answer += self._refuse()
        return bytes(answer), frames

    def encode(self, frames: list[CanFrame], t_ns: int) -> bytes:
        """What the host reads when `frames` pass on the bus; nothing while closed or at another bit rate."""
        if not self.open or self._bit_rate != self._bus_bit_rate():
            return b""
        self.counters["frames_in"] += len(frames)
        stamps = ("\r", f"{t_ns // 1_000_000 % 60_000:04X}\r", f"{t_ns // 1_000 % 2**32:08X}\r")
        stamp = stamps[self._stamps]
        return "".join([f"t{f.arbitration_id:03X}{len(f.data)}{f.data.hex().upper()}{stamp}" for f in frames]).encode()

    def _transmit(self, line: bytes, frames: list[CanFrame]) -> bytes:
        """`tIIILDD..`: a standard data frame."""
        found = _FRAME.fullmatch(line)
        if found is None or len(found[3]) != 2 * int(found[2]) or not self.open or self._listen_only:
            return self._refuse()
        if self._bit_rate == self._bus_bit_rate():
            self.counters["frames_out"] += 1
            frames.append(CanFrame(int(found[1], 16), bytes.fromhex(found[3].decode())))
        else:
            self.counters["wrong_bit_rate"] += 1  # Taken into the adapter's queue; nobody on the bus understands it.
        return b"z\r"

    def _command(self, line: bytes) -> bytes:
        """Everything but a standard data frame."""
        head, rest = line[:1], line[1:]
        answer: bytes | None = {b"": _OK, b"V": b"V1013\r", b"N": b"NGALN\r"}.get(line)
        if head in {b"O", b"L", b"C"} and not rest:
            self.open, self._listen_only = head != b"C", head == b"L"
            answer = _OK
        elif self.open:
            answer = answer or self._while_open(line)
        elif head in {b"S", b"s"}:
            answer = self._set_bit_rate(head, rest)
        elif line in {b"Z0", b"Z1", b"Z2"}:
            self._stamps = line[1] - 0x30
            answer = _OK
        elif head in {b"M", b"m"} and len(rest) == 8:
            answer = _OK  # Acceptance code and mask are taken and not used: everything passes, as after power-up.
        return answer or self._refuse()

    def _while_open(self, line: bytes) -> bytes | None:
        if line == b"F":
            return b"F00\r"
        if line[:1] in {b"T", b"r", b"R"} and not self._listen_only:
            return b"z\r" if line[:1] == b"r" else b"Z\r"  # No node here knows extended or remote frames.
        return None

    def _set_bit_rate(self, head: bytes, rest: bytes) -> bytes:
        """`Sn`, or `sxxyy` with the SJA1000's timing registers at 8 MHz."""
        if head == b"S" and len(rest) == 1 and rest.isdigit():
            self._bit_rate = _BIT_RATES[int(rest)]
            return _OK
        if head != b"s" or not re.fullmatch(rb"[0-9A-Fa-f]{4}", rest):
            return self._refuse()
        btr0, btr1 = bytes.fromhex(rest.decode("ascii"))
        quanta = 3 + (btr1 & 15) + (btr1 >> 4 & 7)
        self._bit_rate = 8_000_000 // (((btr0 & 63) + 1) * quanta)
        return _OK

    def _refuse(self) -> bytes:
        self.counters["refused"] += 1
        return _BELL

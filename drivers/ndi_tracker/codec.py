"""NDI Combined API wire format: commands and replies with their CRC, TX and BX transforms, tables of errors and bits.

Sources: NDI's own open client (ndicapi) and sawNDITracker, which agree on the framing.
"""

import math
import struct
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Final

START_WORD: Final = b"\xc4\xa5"
"""A5C4 little-endian: a binary reply begins."""

HEADER_BYTES: Final = 6
ROM_CHUNK: Final = 64
ROM_LIMIT: Final = 1024
ROM_SIGNATURE: Final = b"NDI"
"""First bytes of a tool definition (sawNDITracker's tool converter)."""

ERRORS: Final[Mapping[int, str]] = {
    0x01: "invalid command",
    0x02: "command too long",
    0x03: "command too short",
    0x04: "bad CRC of the command",
    0x05: "time-out of the command",
    0x06: "bad communication settings",
    0x07: "wrong number of parameters",
    0x08: "invalid port handle",
    0x0C: "not valid in the current mode",
    0x0D: "no tool in the port",
    0x0E: "port not initialised",
    0x0F: "port not enabled",
    0x10: "system not initialised",
    0x11: "tracking could not be stopped",
    0x12: "tracking could not be started",
    0x13: "port could not be initialised",
    0x23: "parameter out of range",
    0x2B: "handle not allocated",
    0x2C: "handle is empty",
    0x32: "invalid operation",
    0x42: "device not present",
}

SYSTEM_FAULTS: Final[Mapping[int, tuple[str, str]]] = {
    0x01: ("communication out of step", "check the cable"),
    0x02: ("too much external infrared light", "remove lamps and sunlight from the view"),
    0x04: ("communication CRC error", "check the cable"),
    0x08: ("recoverable system exception", "look at the tracker's log"),
    0x10: ("hardware failure", "have the tracker serviced"),
    0x20: ("hardware changed", "restart the tracker"),
}
"""System status bits that people must know; 0x40 and 0x80 tell of ports being occupied or left."""

HARDWARE_FAILURE: Final = 0x10
OUT_OF_VOLUME: Final = 0x40

BAUD_CODES: Final[Mapping[int, str]] = {
    9600: "0",
    14400: "1",
    19200: "2",
    38400: "3",
    57600: "4",
    115200: "5",
    921600: "6",
    1228739: "7",
    230400: "A",
}


def _crc_table() -> tuple[int, ...]:
    table = []
    for value in range(256):
        crc = value
        for _ in range(8):
            crc = crc >> 1 ^ (0xA001 if crc & 1 else 0)
        table.append(crc)
    return tuple(table)


_TABLE: Final = _crc_table()


def crc16(data: bytes) -> int:
    """CRC-16 of x16 + x15 + x2 + 1, reflected (0xA001), from 0, no final change."""
    crc = 0
    for byte in data:
        crc = crc >> 8 ^ _TABLE[(crc ^ byte) & 0xFF]
    return crc


def command(text: str) -> bytes:
    """A command such as "INIT:" with its CRC and CR."""
    data = text.encode("ascii")
    return data + b"%04X\r" % crc16(data)


class BadReplyError(Exception):
    """A reply that cannot be what the tracker sent: bad CRC, wrong length, or words that do not fit."""


def reply_text(line: bytes) -> str:
    """The text of a reply line (without CR).

    Raises:
        BadReplyError: the CRC does not fit.
    """
    body, crc = line[:-4], line[-4:]
    if len(line) < 4 or crc != b"%04X" % crc16(body) or not body.isascii():
        raise BadReplyError("bad CRC of a reply")
    return body.decode("ascii")


def binary_size(header: bytes) -> int:
    """The whole size of the binary reply that begins with `header` (6 bytes).

    Raises:
        BadReplyError: no header, or its CRC does not fit.
    """
    _, length, crc = struct.unpack("<HHH", header)
    if header[:2] != START_WORD or crc != crc16(header[:4]):
        raise BadReplyError("bad header of a binary reply")
    return HEADER_BYTES + int(length) + 2


def binary_body(data: bytes) -> bytes:
    """The body of a whole binary reply.

    Raises:
        BadReplyError: its CRC does not fit.
    """
    body = data[HEADER_BYTES:-2]
    if int.from_bytes(data[-2:], "little") != crc16(body):
        raise BadReplyError("bad CRC of a binary reply")
    return body


@dataclass(frozen=True, slots=True)
class Transform:
    """What a tracking reply says of one handle.

    Args:
        handle: two hex digits.
        state: "ok", "missing", "disabled" or "unoccupied"; the last two bear neither status nor frame.
        quaternion: q0 qx qy qz; position_mm, error_mm: NaN unless "ok".
    """

    handle: str
    state: str
    quaternion: tuple[float, float, float, float] = (math.nan,) * 4
    position_mm: tuple[float, float, float] = (math.nan,) * 3
    error_mm: float = math.nan
    port_status: int = 0
    frame: int | None = None


@dataclass(frozen=True, slots=True)
class Tracking:
    """A whole tracking reply."""

    transforms: tuple[Transform, ...]
    system_status: int


def parse_tx(text: str) -> Tracking:
    """The reply to TX:0801.

    Raises:
        BadReplyError: it does not have the shape of one.
    """
    cursor = _Text(text)
    try:
        transforms = tuple(_tx_handle(cursor) for _ in range(cursor.hexadecimal(2)))
        status = cursor.hexadecimal(4)
    except ValueError:
        raise BadReplyError(f"no tracking reply: {text[:40]!r}") from None
    if cursor.rest:
        raise BadReplyError(f"{len(cursor.rest)} characters too many in a tracking reply")
    return Tracking(transforms, status)


def _tx_handle(cursor: "_Text") -> Transform:
    handle = cursor.take(2)
    for word in ("DISABLED", "UNOCCUPIED"):
        if cursor.rest.startswith(word):
            cursor.take(len(word))
            cursor.skip_line_end()
            return Transform(handle, word.lower())
    if cursor.rest.startswith("MISSING"):
        cursor.take(7)
        found = Transform(handle, "missing", port_status=cursor.hexadecimal(8), frame=cursor.hexadecimal(8))
    else:
        q0, qx, qy, qz = (cursor.fixed(6, 4) for _ in range(4))
        tx, ty, tz = (cursor.fixed(7, 2) for _ in range(3))
        error = cursor.fixed(6, 4)
        port_status, frame = cursor.hexadecimal(8), cursor.hexadecimal(8)
        found = Transform(handle, "ok", (q0, qx, qy, qz), (tx, ty, tz), error, port_status, frame)
    cursor.skip_line_end()
    return found


class _Text:
    """Reads fields of fixed width from a reply."""

    def __init__(self, text: str) -> None:
        self.rest = text

    def take(self, count: int) -> str:
        if len(self.rest) < count:
            raise ValueError("too short")
        taken, self.rest = self.rest[:count], self.rest[count:]
        return taken

    def hexadecimal(self, count: int) -> int:
        field = self.take(count)
        if not all(c in "0123456789abcdefABCDEF" for c in field):
            raise ValueError(field)
        return int(field, 16)

    def fixed(self, count: int, decimals: int) -> float:
        field = self.take(count)
        if field[0] not in "+-" or not field[1:].isdecimal():
            raise ValueError(field)
        return int(field) / float(10**decimals)

    def skip_line_end(self) -> None:
        self.rest = self.rest.removeprefix("\n")


_STATES: Final = {1: "ok", 2: "missing", 4: "disabled"}


def parse_bx(body: bytes) -> Tracking:
    """The body of the reply to BX:0801.

    Raises:
        BadReplyError: it does not have the shape of one.
    """
    try:
        transforms, place = [], 1
        for _ in range(body[0]):
            transform, place = _bx_handle(body, place)
            transforms.append(transform)
        (status,) = struct.unpack_from("<H", body, place)
    except (struct.error, IndexError, KeyError):
        raise BadReplyError("no tracking reply") from None
    if place + 2 != len(body):
        raise BadReplyError(f"{len(body) - place - 2} bytes too many in a tracking reply")
    return Tracking(tuple(transforms), status)


def _bx_handle(body: bytes, place: int) -> tuple[Transform, int]:
    handle, state = f"{body[place]:02X}", _STATES[body[place + 1]]
    place += 2
    if state == "disabled":
        return Transform(handle, state), place
    if state == "missing":
        port_status, frame = struct.unpack_from("<II", body, place)
        return Transform(handle, state, port_status=port_status, frame=frame), place + 8
    q0, qx, qy, qz, tx, ty, tz, error, port_status, frame = struct.unpack_from("<8fII", body, place)
    return Transform(handle, state, (q0, qx, qy, qz), (tx, ty, tz), error, port_status, frame), place + 40


def handles(text: str) -> dict[str, int]:
    """The handles of a PHSR reply and their status.

    Raises:
        BadReplyError: it does not have the shape of one.
    """
    cursor = _Text(text)
    try:
        count = cursor.hexadecimal(2)
        return {cursor.take(2): cursor.hexadecimal(3) for _ in range(count)}
    except ValueError:
        raise BadReplyError(f"no list of handles: {text[:40]!r}") from None


def rom_writes(handle: str, rom: bytes) -> Iterator[str]:
    """PVWR commands that load a tool definition, 64 bytes each, the last filled up with zeros."""
    for address in range(0, len(rom), ROM_CHUNK):
        chunk = rom[address : address + ROM_CHUNK].ljust(ROM_CHUNK, b"\0")
        yield f"PVWR:{handle}{address:04X}{chunk.hex().upper()}"

"""Framing of NDI's Combined API as the measurement system sees it: CRC, commands in, replies out, line settings."""

import struct
from dataclasses import dataclass, field
from typing import Final

CR: Final = 0x0D
COMMAND_LIMIT: Final = 255
BINARY_START: Final = 0xA5C4
BAUD_RATES: Final = {
    "0": 9600,
    "1": 14400,
    "2": 19200,
    "3": 38400,
    "4": 57600,
    "5": 115_200,
    "6": 921_600,
    "7": 1_228_739,
    "A": 230_400,
}


class NdiError(Exception):
    """A command that is answered with ERRORnn.

    Args:
        code: nn.
    """

    def __init__(self, code: int) -> None:
        super().__init__(code)
        self.code = code


INVALID_COMMAND: Final = 0x01
TOO_LONG: Final = 0x02
TOO_SHORT: Final = 0x03
BAD_CRC: Final = 0x04
BAD_COMM: Final = 0x06
WRONG_PARAMETERS: Final = 0x07
INVALID_HANDLE: Final = 0x08
INVALID_PRIORITY: Final = 0x09
WRONG_MODE: Final = 0x0C
NO_TOOL: Final = 0x0D
TOOL_NOT_INITIALISED: Final = 0x0E
TOOL_NOT_ENABLED: Final = 0x0F
NOT_INITIALISED: Final = 0x10
NOT_INITIALISABLE: Final = 0x13
OUT_OF_RANGE: Final = 0x23
NO_HANDLE_LEFT: Final = 0x2D


def crc16(data: bytes) -> int:
    """CRC-16 with x^16 + x^15 + x^2 + 1, reflected, from 0."""
    value = 0
    for byte in data:
        value ^= byte
        for _ in range(8):
            value = value >> 1 ^ (0xA001 if value & 1 else 0)
    return value


def text_reply(text: str) -> bytes:
    """Text, its CRC in four hexadecimal digits, CR."""
    data = text.encode("latin-1")
    return data + f"{crc16(data):04X}\r".encode()


def binary_reply(body: bytes) -> bytes:
    """Start word, length, CRC of these, body, CRC of the body."""
    head = struct.pack("<HH", BINARY_START, len(body))
    return head + struct.pack("<H", crc16(head)) + body + struct.pack("<H", crc16(body))


@dataclass(frozen=True, slots=True)
class Command:
    """One command: its keyword in capitals and what follows the `:` or the space, without the CRC."""

    name: str
    parameters: str


def parse(line: bytes) -> Command:
    """A command without its CR.

    Raises:
        NdiError: too long, too short, wrong CRC, or neither `:` nor space.
    """
    if len(line) > COMMAND_LIMIT:
        raise NdiError(TOO_LONG)
    text = line.decode("latin-1")
    head, colon, _ = text.partition(":")
    if colon and " " not in head:
        if len(text) < len(head) + 5:
            raise NdiError(TOO_SHORT)
        if f"{crc16(line[:-4]):04X}" != text[-4:].upper():
            raise NdiError(BAD_CRC)
        return Command(head.upper(), text[len(head) + 1 : -4])
    head, _, rest = text.partition(" ")
    return Command(head.upper(), rest)


@dataclass(frozen=True, slots=True)
class LineSettings:
    """What COMM sets: bits/s, data bits, parity N, O or E, stop bits, whether RTS/CTS are used."""

    baud_rate: int = 9600
    data_bits: int = 8
    parity: str = "N"
    stop_bits: int = 1
    handshake: bool = False

    @classmethod
    def from_digits(cls, digits: str) -> "LineSettings":
        """The settings of COMM's five digits.

        Raises:
            NdiError: not five, or one of them unknown.
        """
        if len(digits) != 5:
            raise NdiError(WRONG_PARAMETERS)
        baud, data, parity, stop, handshake = list(digits)
        if baud not in BAUD_RATES or data not in "01" or parity not in "012" or {stop, handshake} - {"0", "1"}:
            raise NdiError(BAD_COMM)
        return cls(BAUD_RATES[baud], 8 - int(data), "NOE"[int(parity)], 1 + int(stop), handshake == "1")


@dataclass(slots=True)
class CommandReader:
    """Collects bytes up to CR; what is far too long is cut, so that noise costs no memory."""

    _line: bytearray = field(default_factory=bytearray)

    def feed(self, byte: int) -> bytes | None:
        """A whole line without CR, or nothing yet."""
        if byte == CR:
            line = bytes(self._line)
            self._line.clear()
            return line
        if byte != 0x0A and len(self._line) <= COMMAND_LIMIT:
            self._line.append(byte)
        return None

    def clear(self) -> None:
        """Forget what was begun."""
        self._line.clear()


def garble(data: bytes) -> bytes:
    """What a receiver at another speed makes of it: bytes with framing errors, none of them a CR."""
    return bytes((byte * 7 + 0x95) & 0xFF | 0x80 for byte in data)

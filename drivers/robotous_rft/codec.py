"""Frames of the Robotous RFT series over CAN, both directions (RFT series manual, revision 1.7, chapter 3).

Every frame has eight bytes. A command is one frame: its number, then parameters. A response is sixteen bytes in two
frames, transmitter 1 then transmitter 2: the command's number D1, then R1 to R15. Numbers are big-endian.
"""

import struct
from dataclasses import dataclass
from enum import IntEnum
from typing import Final

from galen_hw.drivers.device import CanFrame
from galen_hw.drivers.pairing import PairLayout

LENGTH: Final = 8
DATA: Final = struct.Struct(">x6hB2x")
"""A data response: D1, the six raw axes, the overload flags; the torque about x straddles the two frames."""


class Command(IntEnum):
    """Command numbers; 0x0D and 0x0E are reserved."""

    READ_MODEL = 0x01
    READ_SERIAL_NUMBER = 0x02
    READ_FIRMWARE = 0x03
    SET_IDS = 0x04
    READ_IDS = 0x05
    SET_BAUD_RATE = 0x06
    READ_BAUD_RATE = 0x07
    SET_FILTER = 0x08
    READ_FILTER = 0x09
    READ_ONCE = 0x0A
    START_OUTPUT = 0x0B
    STOP_OUTPUT = 0x0C
    SET_OUTPUT_RATE = 0x0F
    READ_OUTPUT_RATE = 0x10
    SET_BIAS = 0x11
    READ_OVERLOADS = 0x12


PARAMETERS: Final = {
    Command.SET_IDS: 3,
    Command.SET_BAUD_RATE: 1,
    Command.SET_FILTER: 2,
    Command.SET_OUTPUT_RATE: 1,
    Command.SET_BIAS: 1,
}
"""How many parameter bytes a command takes; the others take none."""
SILENT: Final = frozenset({Command.STOP_OUTPUT, Command.SET_BIAS})
"""Commands without a response; also the only ones carried out while the sensor streams."""
OUTPUT_RATES_HZ: Final = {0: 200, 1: 10, 2: 20, 3: 50, 4: 100, 5: 200, 6: 333, 7: 500, 8: 1000}
"""Rate of the stream by its code; 0 is the factory's."""
RATE_CODES: Final = {rate: code for code, rate in OUTPUT_RATES_HZ.items() if code}
FILTERS_HZ: Final = (0, 500, 300, 200, 150, 100, 50, 40, 30, 20, 10, 5, 3, 2, 1)
"""Cut-off of the first-order low-pass by its parameter; 0 is off."""
ERRORS: Final = {1: "unsupported command", 2: "parameter out of range", 3: "setting failed"}
OVERLOAD_BITS: Final = {5: "Fx", 4: "Fy", 3: "Fz", 2: "Tx", 1: "Ty", 0: "Tz"}
"""Set when the axis exceeds its rating by more than 20 %."""
OVERLOAD_MASK: Final = 0x3F


@dataclass(frozen=True, slots=True)
class Model:
    """Scaling of a model: counts per N and per N m, and the highest rate it is rated for."""

    counts_per_newton: float
    counts_per_newton_metre: float
    max_rate_hz: int


MODELS: Final = {
    "RFT40-SA01": Model(50.0, 2000.0, 200),
    "RFT44-SB01": Model(50.0, 2000.0, 200),
    "RFT60-HA01": Model(50.0, 2000.0, 1000),
    "RFT64-SB01": Model(50.0, 2000.0, 1000),
    "RFT76-HA01": Model(50.0, 2000.0, 1000),
    "RFT82-HA02": Model(50.0, 1000.0, 1000),
    "RFT80-6A01": Model(50.0, 1000.0, 1000),
}


def layout(transmitter1_id: int, transmitter2_id: int) -> PairLayout:
    """Return what the two frames of a sample are; the first bears the stream's number."""
    return PairLayout(transmitter1_id, transmitter2_id, (LENGTH,), bytes([Command.START_OUTPUT]))


def command(receiver_id: int, number: Command, *parameters: int) -> CanFrame:
    """A command frame.

    Raises:
        ValueError: an identifier outside 1 to 255, or parameters that do not fit the command.
    """
    if not 1 <= receiver_id <= 255:
        raise ValueError(f"identifier {receiver_id} is not in 1 to 255")
    wanted = PARAMETERS.get(number, 0)
    if len(parameters) != wanted:
        raise ValueError(f"{number.name} takes {wanted} parameters, not {len(parameters)}")
    return CanFrame(receiver_id, bytes([number, *parameters]).ljust(LENGTH, b"\0"))


def decode_data(response: bytes) -> tuple[tuple[int, ...], int]:
    """Raw Fx, Fy, Fz, Tx, Ty, Tz and the overload flags, from the sixteen bytes of a data response."""
    *axes, overload = DATA.unpack(response)
    return tuple(axes), overload


def encode_data(axes: tuple[int, ...], overload: int, number: Command = Command.START_OUTPUT) -> tuple[bytes, bytes]:
    """The data of the two frames of a data response."""
    response = bytes([number]) + DATA.pack(*axes, overload)[1:]
    return response[:LENGTH], response[LENGTH:]


def decode_text(response: bytes) -> str:
    """The text R1 to R15; what is not printable shows as "?"."""
    text = response[1:].rstrip(b"\0 ").decode("ascii", "replace").strip("\0 ")
    return "".join(char if char.isprintable() and char.isascii() else "?" for char in text)


def decode_result(response: bytes) -> str:
    """Empty when a setting was accepted, else why not."""
    accepted, error = response[1], response[2]
    return "" if accepted == 1 else ERRORS.get(error, f"error code {error}")


def overloaded_axes(flags: int) -> list[str]:
    """Names of the axes whose overload flag is set."""
    return [name for bit, name in OVERLOAD_BITS.items() if flags >> bit & 1]

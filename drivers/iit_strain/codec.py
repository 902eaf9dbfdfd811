"""Encode and decode frames of IIT's STRAIN and STRAIN2 boards over CAN, both directions (the iCub CAN protocol).

Sources, public, all by the maker: robotology/icub-firmware-shared, `can/canProtocolLib/iCubCanProto_analogSensorMessages.h`
(numbers of commands and messages) and `iCubCanProto_types.h` (types of boards); robotology/icub-firmware,
`embot_prot_can.cpp` (identifiers, the version's answer), `embot_prot_can_analog_polling.cpp` and `_periodic.cpp` (fields), the
board's program `theSTRAIN` (what a saturated sample holds); robotology/icub-main, `CanBusFtSensor.cpp` (how the maker's own host
starts, stops and scales it); the page "F/T Sensors" of icub-tech-iit's documentation (axes, ranges).

Identifiers have 11 bits: class (3), sender (4), receiver or kind of message (4). The host is 0. A command is class 2: its
number, then parameters; the answer is class 2 back to the host and begins with the same number. Samples are class 3, broadcast:
force and then torque, three unsigned 16-bit numbers each, little-endian, where 0x8000 is zero and the full scale is 0x8000 more.
Full scales are big-endian, in whole N and N m. A seventh byte is there only while a channel of the converter is at its limit; the
numbers are then those of the last good sample. Channel k of the full scales is the k-th number of force and torque, as the
maker's host takes it; a STRAIN2 whose program is of the first ones kept torque first inside, and has not been looked at.
"""

import struct
from enum import IntEnum
from typing import Final

from galen_hw.drivers.device import CanFrame
from galen_hw.drivers.pairing import PairLayout

HOST: Final = 0
CLASS_COMMAND, CLASS_STREAM = 2, 3
LENGTHS: Final = (6, 7)
"""Of a frame of the stream, in bytes: the longer one tells which channels are at their limit."""
ZERO: Final = 0x8000
LIMITS: Final = {1: "low", 2: "high"}
"""Of a channel in the seventh byte: two bits each from bit 2 up, below them whether there is any."""
_VECTOR: Final = struct.Struct("<3H")


class Command(IntEnum):
    """Number the commands that are used here."""

    SET_TRANSMISSION = 0x07
    SET_PERIOD = 0x08
    SET_TARE = 0x15
    GET_FULL_SCALE = 0x18
    GET_SERIAL_NUMBER = 0x1A
    GET_FIRMWARE = 0x1C


class Stream(IntEnum):
    """Number the kinds of messages of class 3 that are used here."""

    FORCE = 0xA
    TORQUE = 0xB


PARAMETERS: Final = {
    Command.SET_TRANSMISSION: 1,
    Command.SET_PERIOD: 1,
    Command.SET_TARE: 1,
    Command.GET_FULL_SCALE: 1,
    Command.GET_SERIAL_NUMBER: 0,
    Command.GET_FIRMWARE: 2,
}
"""How many parameter bytes a command takes as it is used here: mode; period in ms; mode; channel; none; protocol version."""
ANSWER_LENGTHS: Final = {Command.GET_FULL_SCALE: 4, Command.GET_SERIAL_NUMBER: 8, Command.GET_FIRMWARE: 8}
"""In bytes, the number of the command included; other commands have no answer."""
TRANSMIT_CALIBRATED, TRANSMIT_NOTHING = 0, 1
"""Modes of `SET_TRANSMISSION`."""
TARE_NONE: Final = 0
"""Mode of `SET_TARE`: the board's own zero, which is lost when it is switched off, is taken away."""
BOARDS: Final = {6: "STRAIN", 12: "STRAIN2"}
"""Types of boards that are force/torque sensors of six axes."""


def command_id(address: int) -> int:
    """Return the identifier of commands to the board of this address."""
    return CLASS_COMMAND << 8 | HOST << 4 | address


def answer_id(address: int) -> int:
    """Return the identifier of the board's answers to the host."""
    return CLASS_COMMAND << 8 | address << 4 | HOST


def stream_id(address: int, kind: Stream) -> int:
    """Return the identifier of the board's messages of this kind."""
    return CLASS_STREAM << 8 | address << 4 | kind


def layout(address: int) -> PairLayout:
    """Return what the two frames of a sample are: force, then torque."""
    return PairLayout(stream_id(address, Stream.FORCE), stream_id(address, Stream.TORQUE), LENGTHS)


def command(address: int, number: Command, *parameters: int) -> CanFrame:
    """Encode a command.

    Raises:
        ValueError: an address outside 1 to 14 (0 is the host, 15 is everybody), or parameters that do not fit the command.
    """
    if not 1 <= address <= 14:
        raise ValueError(f"address {address} is not in 1 to 14")
    if len(parameters) != PARAMETERS[number]:
        raise ValueError(f"{number.name} takes {PARAMETERS[number]} parameters, not {len(parameters)}")
    return CanFrame(command_id(address), bytes([number, *parameters]))


def decode_vector(data: bytes) -> tuple[tuple[int, int, int], int]:
    """Decode force or torque in counts (signed, 0x8000 a full scale in N or N m), and the seventh byte, 0 where there is none."""
    x, y, z = _VECTOR.unpack_from(data)
    return (x - ZERO, y - ZERO, z - ZERO), data[6] if len(data) > 6 else 0


def encode_vector(counts: tuple[int, int, int], limits: int = 0) -> bytes:
    """Encode what `decode_vector` takes apart; the seventh byte only where it says something."""
    data = _VECTOR.pack(*(count + ZERO for count in counts))
    return data + bytes([limits]) if limits else data


def limited(limits: int) -> list[str]:
    """Name what the seventh byte says of the three channels of a frame: "0 low", "2 high"."""
    found = ((channel, LIMITS.get(limits >> 2 + 2 * channel & 3)) for channel in range(3))
    return [f"{channel} {limit}" for channel, limit in found if limit]


def decode_full_scale(data: bytes) -> int:
    """Decode the full scale of a channel, N or N m."""
    return int.from_bytes(data[2:4], "big")


def decode_text(data: bytes) -> str:
    """Decode the text behind a command's number; what is not printable shows as "?"."""
    text = data[1:].split(b"\0")[0].decode("ascii", "replace").strip()
    return "".join(char if char.isprintable() and char.isascii() else "?" for char in text)


def decode_firmware(data: bytes) -> tuple[int, str, str]:
    """Decode the type of board, the firmware's version, and the protocol's."""
    _, board, major, minor, build, protocol_major, protocol_minor, _ = data
    return board, f"{major}.{minor}.{build}", f"{protocol_major}.{protocol_minor}"

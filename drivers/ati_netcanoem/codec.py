"""Frames of the ATI NETCANOEM board, both directions (ATI manual 9610-05-1030, chapters 7 and 10).

Identifier = base id << 4 | opcode; everything is big-endian. Requests and replies share identifiers: a sample request
is opcode 0 without data, its reply opcode 0 with eight bytes and opcode 1 with six.
"""

import struct
from dataclasses import dataclass
from enum import IntEnum
from typing import Final

import numpy as np
import numpy.typing as npt

from galen_hw.drivers.device import CanFrame

GAUGES: Final = 6
FIRST: Final = struct.Struct(">H3h")
"""Opcode 0: status, then the gauges 0, 2, 4."""
SECOND: Final = struct.Struct(">3h")
"""Opcode 1: the gauges 1, 3, 5."""
BOTH: Final = struct.Struct(">H6h")
"""The data of both frames: status, then the gauges in the order of `WIRE_ORDER`."""
WIRE_ORDER: Final = (0, 2, 4, 1, 3, 5)
"""The gauges in the order in which the two frames bring them."""
SATURATED_COUNTS: Final = 32767
"""A gauge at this magnitude is overloaded or its cable is broken (manual, figure 7.1); not a status bit."""
ABNORMAL_NOISE_COUNTS: Final = 80
"""Jumps of an unloaded gauge above this are abnormal (manual, chapter 7)."""
DEFAULT_COUNTS_PER_UNIT: Final = 1_000_000
"""Counts per unit of force and of torque where the firmware cannot tell (and of every Mini45)."""
COUNTS_SINCE: Final = (3, 7)
"""Firmware from which counts per unit and unit codes can be read."""
DIAGNOSTICS_SINCE: Final = (3, 8)
"""Firmware from which the diagnostic ADC channels can be read."""


class Op(IntEnum):
    """Opcodes (manual, table 4.2); 1, 3 and 4 exist only in replies."""

    SAMPLE = 0x0
    SAMPLE_SECOND = 0x1
    MATRIX_ROW = 0x2
    MATRIX_SECOND = 0x3
    MATRIX_THIRD = 0x4
    SERIAL_NUMBER = 0x5
    SELECT_CALIBRATION = 0x6
    COUNTS_PER_UNIT = 0x7
    UNIT_CODES = 0x8
    DIAGNOSTIC = 0x9
    RESET = 0xC
    SET_BASE_ID = 0xD
    SET_BIT_RATE = 0xE
    FIRMWARE = 0xF


BIT_RATE_CODES: Final = {2_000_000: 0, 1_000_000: 1, 500_000: 3, 250_000: 7}
"""Divisor codes of opcode 0xE: 2 Mbit/s / (code + 1)."""
FORCE_UNITS: Final = {1: "lbf", 2: "N", 3: "klbf", 4: "kN", 5: "kgf", 6: "gf"}
TORQUE_UNITS: Final = {1: "lbf-in", 2: "lbf-ft", 3: "N-m", 4: "N-mm", 5: "kgf-cm", 6: "kN-m"}


@dataclass(frozen=True, slots=True)
class StatusBit:
    """One bit of the status word: what it says, and whether the data are then unusable."""

    text: str
    critical: bool


STATUS_BITS: Final = {
    0: StatusBit("the board was reset by its watchdog", critical=False),
    1: StatusBit("DAC/ADC check too high", critical=True),
    2: StatusBit("DAC/ADC check too low", critical=True),
    3: StatusBit("artificial analog ground out of range", critical=True),
    4: StatusBit("supply voltage too high", critical=True),
    5: StatusBit("supply voltage too low", critical=True),
    6: StatusBit("the selected calibration is damaged or empty", critical=True),
    7: StatusBit("EEPROM failure", critical=True),
    8: StatusBit("stored configuration invalid, default settings in use", critical=False),
    11: StatusBit("sensor too hot", critical=True),
    12: StatusBit("sensor too cold", critical=True),
    14: StatusBit("CAN bus error detected by the board", critical=False),
}
"""Manual, table 4.3. Bit 15 is a summary that real boards do not keep; 9, 10, 13 are reserved: none of them decides."""
CRITICAL_MASK: Final = sum(1 << bit for bit, meaning in STATUS_BITS.items() if meaning.critical)
WATCHDOG_MASK: Final = 1 << 0
DEFAULTS_MASK: Final = 1 << 8
BUS_ERROR_MASK: Final = 1 << 14


def status_texts(status: int) -> list[str]:
    """What the set bits of a status word mean; bits without a meaning of their own are left out."""
    return [meaning.text for bit, meaning in STATUS_BITS.items() if status >> bit & 1]


COUNTERS: Final = (
    "samples",  # published
    "lost",  # asked for, but no whole reply came
    "missed",  # slots of the schedule that passed while a reply was waited for
    "timeouts",
    "late",  # frames nobody waited for any more
    "doubled",  # frames that came twice
    "short",  # frames of a wrong length
    "foreign",  # frames of another device
    "echoes",  # requests, ours or another host's, shown to us by the wire
    "repeated",  # samples equal to the one before, examined
    "saturated",  # samples with a gauge at its limit
    "restarts",
)
"""What the device counts."""
REPLY_LENGTHS: Final = {0: 8, 1: 6, 2: 8, 3: 8, 4: 8, 5: 8, 6: 1, 7: 8, 8: 2, 9: 2, 0xF: 4}
"""Data bytes of the replies, by opcode."""
ECHOING: Final = frozenset({Op.MATRIX_ROW, Op.SELECT_CALIBRATION, Op.DIAGNOSTIC})
"""Requests with one byte of data; no reply of a running board is so short."""


def request(base_id: int, op: Op, data: bytes = b"") -> CanFrame:
    """A request frame.

    Raises:
        ValueError: the base id has more than seven bits, or the data do not fit the opcode.
    """
    if not 0 <= base_id <= 0x7F:
        raise ValueError(f"base id {base_id:#x} is not in 0x00 to 0x7F")
    if len(data) != _REQUEST_LENGTHS.get(op, 0):
        raise ValueError(f"{op.name} takes {_REQUEST_LENGTHS.get(op, 0)} data bytes, not {len(data)}")
    return CanFrame(base_id << 4 | op, data)


_REQUEST_LENGTHS: Final = {
    Op.MATRIX_ROW: 1,
    Op.SELECT_CALIBRATION: 1,
    Op.DIAGNOSTIC: 1,
    Op.SET_BASE_ID: 1,
    Op.SET_BIT_RATE: 1,
}


def decode_sample(first: bytes, second: bytes) -> tuple[int, tuple[int, ...]]:
    """Status word and the gauges 0 to 5, counts.

    Raises:
        struct.error: a frame is not eight and six bytes long.
    """
    status, sg0, sg2, sg4 = FIRST.unpack(first)
    sg1, sg3, sg5 = SECOND.unpack(second)
    return status, (sg0, sg1, sg2, sg3, sg4, sg5)


def encode_sample(status: int, gauges: tuple[int, ...]) -> tuple[bytes, bytes]:
    """The data of the two frames that carry a status word and the gauges 0 to 5."""
    sg0, sg1, sg2, sg3, sg4, sg5 = gauges
    return FIRST.pack(status, sg0, sg2, sg4), SECOND.pack(sg1, sg3, sg5)


def decode_matrix_row(data: bytes) -> tuple[float, ...]:
    """Coefficients of the gauges 0 to 5, from the 24 bytes of the three frames."""
    return struct.unpack(">6f", data)


def decode_serial_number(data: bytes) -> str:
    """The serial number, without its padding; what is not printable shows as "?"."""
    text = data.rstrip(b"\0 ").decode("ascii", "replace").strip()
    return "".join(char if char.isprintable() and char.isascii() else "?" for char in text)


def decode_firmware(data: bytes) -> tuple[int, int, int]:
    """Major, minor, build."""
    major, minor, build = struct.unpack(">BBH", data)
    return major, minor, build


def decode_counts_per_unit(data: bytes) -> tuple[int, int]:
    """Counts per unit of force and per unit of torque."""
    force, torque = struct.unpack(">II", data)
    return force, torque


def decode_unit_codes(data: bytes) -> tuple[str, str]:
    """Units of force and torque.

    Raises:
        KeyError: a code is not in the manual.
    """
    force, torque = struct.unpack(">BB", data)
    return FORCE_UNITS[force], TORQUE_UNITS[torque]


def si_matrix(
    rows: npt.NDArray[np.float64],
    counts_per_unit: tuple[float, float],
    to_si: tuple[float, float],
) -> npt.NDArray[np.float64]:
    """The matrix (6, 6) from gauges 0 to 5 in counts to force (N) and torque (N m).

    Args:
        rows: as received, one row an axis Fx .. Tz, without any gauge correction factor (as all drivers use them).
        counts_per_unit: of force and of torque.
        to_si: factors from the device's units of force and torque to N and N m.
    """
    scale = np.repeat(np.array(to_si) / np.array(counts_per_unit, dtype=float), 3)
    return np.ascontiguousarray(rows * scale[:, None])

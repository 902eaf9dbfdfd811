"""Galil DMC wire format: command lines, the binary data record, error and stop codes.

Sources: Galil DMC-40x0 and DMC-2x00 user manuals and command references; record layout as in Galil's own gclib
(DMC-40x0, 41x3, 42x0, 500x0).
"""

import re
import struct
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Final

LINE_LENGTH: Final = 80
"""Longest line the controller accepts, `;` included, the closing CR not."""

HEADER_BYTES: Final = 4
GENERAL_BYTES: Final = 52
CONTOUR_BYTES: Final = 6
COORDINATE_BYTES: Final = 26
AXIS_BYTES: Final = 36
VELOCITY_SCALE: Final = 64
"""The record's velocity is 64 times what TV tells."""

VOLTS_PER_TORQUE_COUNT: Final = 9.9982 / 32767

AMPLIFIER_STATUS_OFFSET: Final = 52
ERROR_CODE_OFFSET: Final = 50
SAMPLE_COUNTER_OFFSET: Final = 4
ELO_A_D: Final = 1 << 24
ELO_E_H: Final = 1 << 25

_AXIS = struct.Struct("<HBBiiiiiiHBBi")

ERROR_CODES: Final[Mapping[int, tuple[str, str]]] = {
    1: ("unrecognized command", "check the controller's model and firmware"),
    2: ("command only valid from a program", ""),
    5: ("input buffer full", "send less at once"),
    6: ("number out of range", "check counts_per_unit, offset_counts and the limits of the axis"),
    7: ("command not valid while running", "stop first"),
    8: ("command not valid when not running", ""),
    13: ("JG only valid in jog mode", "stop first"),
    20: ("begin not valid with motor off", "enable first"),
    21: ("begin not valid while running", "wait until the robot is at rest, or stop it"),
    22: ("begin not possible due to limit switch", "move the axis the other way"),
    60: ("download error", ""),
    106: ("privilege violation", ""),
    110: ("brushless axis not set up", "load the controller's set-up program"),
    131: ("serial port timeout", "check cable and baud rate"),
    134: ("motors must be off", "disable first"),
    135: ("motors must be off", "disable first"),
    140: ("serial encoder error", "check the encoder cable"),
    141: ("feature not supported", ""),
}
"""TC codes: what, and what to do."""

STOP_CODES: Final[Mapping[int, tuple[str, bool]]] = {
    0: ("running", False),
    1: ("stopped at target", False),
    2: ("stopped at the forward limit", True),
    3: ("stopped at the reverse limit", True),
    4: ("stopped by ST", False),
    6: ("stopped by the abort input", True),
    7: ("stopped by the AB command", False),
    8: ("position error too large, motor switched off", True),
    9: ("stopped after finding edge", False),
    10: ("stopped after homing", False),
    11: ("stopped by the selective abort input", True),
    12: ("encoder failure", True),
    15: ("amplifier fault", True),
    16: ("stepper position maintenance error", True),
    30: ("running in PVT mode", False),
    31: ("PVT mode done", False),
    32: ("PVT buffer empty", True),
    50: ("contour running", False),
    51: ("contour stopped", False),
    70: ("EtherCAT communication fault", True),
    71: ("EtherCAT drive fault", True),
    99: ("time-out while waiting for the end of motion", True),
    100: ("vector motion running", False),
    101: ("vector motion stopped", False),
}
"""SC codes: what, and whether it is a fault."""

DONE: Final = 1
LIMIT_STOPS: Final = frozenset({2, 3})


@dataclass(frozen=True, slots=True)
class AxisBlock:
    """One axis of a data record, in counts; `velocity_64` is 64 times counts/s, `torque` is +-32767 for +-10 V."""

    status: int
    switches: int
    stop_code: int
    reference: int
    position: int
    error: int
    auxiliary: int
    velocity_64: int
    torque: int
    analog: int
    hall: int
    variable: int

    @property
    def moving(self) -> bool:
        """A move is in progress (bit 15)."""
        return bool(self.status & 0x8000)

    @property
    def motor_on(self) -> bool:
        """The servo loop is closed (bit 0 is "motor off")."""
        return not self.status & 0x0001

    @property
    def positioning(self) -> bool:
        """In PA or PR mode rather than jogging (bit 14)."""
        return bool(self.status & 0x4000)

    @property
    def forward_bit(self) -> int:
        """The forward limit's bit as sent; its polarity is a setting."""
        return self.switches >> 3 & 1

    @property
    def reverse_bit(self) -> int:
        """The reverse limit's bit as sent; its polarity is a setting."""
        return self.switches >> 2 & 1


@dataclass(frozen=True, slots=True)
class DataRecord:
    """A data record (QR): blocks by axis letter; the general fields are None where block I was not asked for."""

    axes: Mapping[str, AxisBlock]
    sample_counter: int | None
    error_code: int | None
    amplifier_status: int | None


def letters(mask: int) -> str:
    """The axis letters of the header's second byte."""
    return "".join(chr(ord("A") + n) for n in range(8) if mask >> n & 1)


def axis_mask(axes: Iterable[str]) -> int:
    """The header's second byte for some axis letters."""
    return sum(1 << (ord(letter) - ord("A")) for letter in set(axes))


def record_size(header: bytes) -> int | None:
    """Size of the record that begins with `header` (4 bytes), None if that is no header.

    The size bytes must agree with the blocks the header announces. Whether the six contour bytes come with block I or
    with the coordinate blocks is not written anywhere, so both are taken; axis blocks are last in either case.
    """
    flags, mask, size = struct.unpack("<BBH", header)
    if flags & 0xF8 != 0x80:
        return None
    fixed = HEADER_BYTES + AXIS_BYTES * mask.bit_count() + (GENERAL_BYTES if flags & 4 else 0)
    planes = {0: {0, CONTOUR_BYTES} if flags & 4 else {0}, 3: {COORDINATE_BYTES}}.get(flags & 3, {10, 16})
    return size if size - fixed in planes and mask else None


def parse_record(data: bytes) -> DataRecord:
    """The record in `data`, whose length is what `record_size` said."""
    flags, mask = data[0], data[1]
    names = letters(mask)
    start = len(data) - AXIS_BYTES * len(names)
    axes = {n: _axis(data[start + AXIS_BYTES * i : start + AXIS_BYTES * (i + 1)]) for i, n in enumerate(names)}
    if not flags & 4:
        return DataRecord(axes, None, None, None)
    counter = int.from_bytes(data[SAMPLE_COUNTER_OFFSET : SAMPLE_COUNTER_OFFSET + 2], "little")
    amplifier = int.from_bytes(data[AMPLIFIER_STATUS_OFFSET : AMPLIFIER_STATUS_OFFSET + 4], "little")
    return DataRecord(axes, counter, data[ERROR_CODE_OFFSET], amplifier)


def _axis(block: bytes) -> AxisBlock:
    (status, switches, stop, reference, position, error, auxiliary, velocity, torque, analog, hall, _, variable) = (
        _AXIS.unpack(block)
    )
    return AxisBlock(
        status, switches, stop, reference, position, error, auxiliary, velocity, torque, analog, hall, variable
    )


def numbers(text: str) -> list[float]:
    """The numbers of an answer, separated by commas or spaces, with or without leading zeros; all are finite.

    A controller prints at most ten digits before and four after the point (PF, VF); `float` would
    take "1e999", "nan" and "1_0" too.

    Raises:
        ValueError: something else stands there.
    """
    words = text.replace(",", " ").split()
    if not all(_NUMBER.fullmatch(word) for word in words):
        raise ValueError(f"no numbers: {text[:40]!r}")
    return [float(word) for word in words]


_NUMBER: Final = re.compile(r"[+-]?(?:[0-9]{1,16}(?:\.[0-9]{0,16})?|\.[0-9]{1,16})")


def error_code(text: str) -> tuple[int, str]:
    """Code and words of an answer to TC 1 ("6 Number out of range"); -1 where it bears no code."""
    code, _, words = text.partition(" ")
    return (int(code), words) if re.fullmatch(r"[0-9]{1,3}", code) else (-1, text)


def per_axis(command: str, values: Mapping[str, int]) -> list[str]:
    """`command` with one value an axis in its slot (`PA 1,,3`), split where a line would be longer than allowed."""
    commands: list[str] = []
    slots: dict[int, int] = {}
    for letter in sorted(values):
        grown = slots | {ord(letter) - ord("A"): values[letter]}
        if slots and len(_slotted(command, grown)) > LINE_LENGTH:
            commands.append(_slotted(command, slots))
            grown = {ord(letter) - ord("A"): values[letter]}
        slots = grown
    return [*commands, _slotted(command, slots)] if slots else commands


def _slotted(command: str, slots: Mapping[int, int]) -> str:
    return f"{command} " + ",".join(str(slots.get(n, "")) for n in range(max(slots) + 1))


def lines(commands: Iterable[str]) -> list[str]:
    """Commands joined by `;` into as few lines of at most 80 characters as their order allows."""
    packed: list[str] = []
    for command in commands:
        if packed and len(packed[-1]) + 1 + len(command) <= LINE_LENGTH:
            packed[-1] += ";" + command
        else:
            packed.append(command)
    return packed


def axes_of_model(text: str) -> int | None:
    """Number of axes in the answer to ^R^V ("DMC4143 Rev 1.2"), None if that is no DMC.

    The digit at index 5, at index 6 for the longer names of the 500x0.
    """
    words = text.split()
    name = words[0] if words else ""
    index = 6 if name.startswith("DMC5") and len(name) > 7 else 5
    if not name.startswith("DMC") or len(name) <= index or not name[index].isdigit():
        return None
    return int(name[index])

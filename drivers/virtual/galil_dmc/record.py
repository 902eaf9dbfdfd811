"""The binary data record of the DMC-40x0 family, little-endian (QR), and its sizes (QZ)."""

import struct
from typing import Final

from galen_hw.drivers.virtual.galil_dmc.axis import Axis
from galen_hw.drivers.virtual.galil_dmc.controller import Controller
from galen_hw.drivers.virtual.galil_dmc.format import Rejected
from galen_hw.drivers.virtual.galil_dmc.grammar import axes_of
from galen_hw.drivers.virtual.galil_dmc.parts import Mode

GENERAL_BYTES: Final = 52
COORDINATE_BYTES: Final = 26
AXIS_BYTES: Final = 36
HEADER_BYTES: Final = 4
FULL_VOLTS: Final = 9.9982


def sizes(controller: Controller) -> str:
    """QZ: axes, general bytes, coordinate bytes, axis bytes."""
    return f"{len(controller.axes)}, {GENERAL_BYTES}, {COORDINATE_BYTES}, {AXIS_BYTES}"


def record(controller: Controller, blocks: str = "") -> bytes:
    """QR. Without a list of blocks everything; else the named axes, I (inputs and state), S and T.

    Raises:
        Rejected: a block that is not there (code 4).
    """
    count = len(controller.axes)
    asked = blocks.replace(" ", "")
    planes = {"I", "S", "T"} & set(asked) if asked else {"I", "S", "T"}
    letters = "".join(c for c in asked if c not in "IST")
    axes = sorted(set(axes_of(letters, count))) if letters or not asked else []
    if any(asked.count(letter) > 1 for letter in set(asked)):
        raise Rejected(4)
    body = b""
    if "I" in planes:
        body += _general(controller)
    if "S" in planes:
        body += struct.pack("<IH", 0, 511) + bytes(10)  # The contour fields go with the S plane.
    if "T" in planes:
        body += bytes(10)
    body += b"".join(_axis(controller, controller.axes[i]) for i in axes)
    first = 0x80 | ("I" in planes) << 2 | ("T" in planes) << 1 | ("S" in planes)
    return struct.pack("<BBH", first, sum(1 << i for i in axes), HEADER_BYTES + len(body)) + body


def _general(controller: Controller) -> bytes:
    inputs = sum(controller.input_level(n) << (n - 1) for n in range(1, 9))
    threads = sum(1 << n for n in controller.program.threads)
    head = struct.pack("<H10B10B", controller.tick & 0xFFFF, inputs, *bytes(9), controller.outputs & 0xFF, *bytes(9))
    tail = struct.pack("<BBI", controller.error_code, threads, controller.amplifier_status)
    return head + bytes(16) + bytes(8) + tail


def _axis(controller: Controller, axis: Axis) -> bytes:
    t = controller.tick_time
    torque = round(controller.torque(axis) / FULL_VOLTS * 32767)
    return struct.pack(
        "<HBBiiiiiiHBBi",
        status_word(axis, t),
        controller.switches(axis),
        axis.code,
        _int32(axis.commanded(t)),
        _int32(axis.position(t)),
        _int32(axis.error(t)),
        _int32(round(axis.position(t) - axis.auxiliary_zero)),
        _int32(round(64.0 * axis.actual(t).v)),
        torque,
        0,
        0,
        0,
        _int32(int(axis.registers.ZA)),
    )


def status_word(axis: Axis, t: float) -> int:
    """Status bits of an axis block."""
    mode, phase = axis.running_mode, axis.reference.piece(t).phase
    bits = {
        15: axis.moving,
        14: mode in {Mode.ABSOLUTE, Mode.RELATIVE},
        13: mode is Mode.ABSOLUTE,
        12: axis.moving and mode is Mode.FIND_EDGE,
        11: axis.moving and mode is Mode.HOME,
        10: axis.moving and mode is Mode.HOME and axis.home_phase > 0,
        9: axis.moving and mode is Mode.FIND_INDEX,
        7: axis.moving and axis.reference.at(t).v < 0.0,
        5: axis.moving and phase == "slew",
        4: axis.moving and axis.stopping,
        3: axis.moving and phase == "decel" and not axis.stopping,
        0: not axis.motor_on,
    }
    return sum(1 << bit for bit, on in bits.items() if on)


def _int32(value: int) -> int:
    """Counts are 32-bit signed and wrap."""
    return (value + 0x8000_0000) % 0x1_0000_0000 - 0x8000_0000

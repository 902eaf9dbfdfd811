"""Lines between a Bota sensor's device and the process that has the vendor's driver, both directions; they are our own.

The wire of a Bota sensor (EtherCAT, serial, CAN, UDP) is the vendor's secret: its package gives decoded frames as Python
objects. `process` writes each as a line of JSON, an array that begins with its kind; the device writes words. What a frame
holds follows the package's docstrings (bota-driver 1.1.16, `BotaFrame` and `DataStatus`).
"""

from typing import Annotated, Final, TypeAlias

import msgspec

IDENTIFY: Final = b"identify\n"
"""Ask for `Sensor`."""
START: Final = b"start\n"
"""Let frames flow (the package's `activate`)."""
STOP: Final = b"stop\n"
"""Let none flow (the package's `deactivate`)."""

THROTTLED: Final = 1
OVERRANGE: Final = 2
INVALID: Final = 4
RAW: Final = 8
STATUS_TEXTS: Final = {
    THROTTLED: "the sensor puts out fewer samples than it was asked for",
    OVERRANGE: "a measurement is beyond the sensor's range",
    INVALID: "the sensor calls its measurement invalid",
    RAW: "the sensor sends raw measurements, which are no N and N m",
}
"""Bits of `DataStatus.val`."""
LONGEST: Final = 1024
"""Bytes of a line."""

Number: TypeAlias = Annotated[float, msgspec.Meta(ge=-1e6, le=1e6)]
"""N, N m or degrees C; no sensor measures more. What is no number is `null` in JSON, and then no frame."""
Triple: TypeAlias = tuple[Number, Number, Number]
Count: TypeAlias = Annotated[int, msgspec.Meta(ge=0, lt=1 << 40)]


class Sensor(msgspec.Struct, frozen=True, array_like=True, tag="sensor"):
    """Who answers.

    Args:
        model, serial_number, firmware: as the sensor says, empty where its interface does not tell (CAN).
        period_us: between samples, as the package expects it; 0 where it does not know.
    """

    model: str
    serial_number: str
    firmware: str
    period_us: Count


class Frame(msgspec.Struct, frozen=True, array_like=True, tag="frame", gc=False):
    """One sample.

    Args:
        stamp_us: the package's own, modulo 2^32, rounded to float32 on its way (see `stream`).
        status: `DataStatus.val`.
        force, torque: N and N m, in the sensor's frame about its origin.
        celsius: of the sensor; None where it does not tell.
    """

    stamp_us: Count
    status: Count
    force: Triple
    torque: Triple
    celsius: Number | None = None


_decoder = msgspec.json.Decoder(Sensor | Frame)
_encoder = msgspec.json.Encoder()


def encode(message: Sensor | Frame) -> bytes:
    """Return the line of a message."""
    return _encoder.encode(message) + b"\n"


def decode(line: bytes) -> Sensor | Frame | None:
    """Return what a line says (without its end), None where it is none of ours."""
    if len(line) > LONGEST:
        return None
    try:
        return _decoder.decode(line)
    except (msgspec.MsgspecError, ValueError):
        return None


def status_texts(word: int) -> list[str]:
    """Return what the bits of a status word mean, one text each; bits without a name are told together."""
    texts = [text for bit, text in STATUS_TEXTS.items() if word & bit]
    other = word & ~sum(STATUS_TEXTS)
    return [*texts, f"status bits 0x{other:X}, which this driver does not know"] if other else texts

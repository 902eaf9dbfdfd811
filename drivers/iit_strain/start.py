"""Bring a STRAIN board to stream: its settings, and the conversation of the start."""

from collections.abc import Generator
from dataclasses import dataclass
from typing import Self

from pydantic import Field, model_validator

from galen_hw.clock import NS_PER_S
from galen_hw.drivers.dialogue import DialogueError, Expect, Query
from galen_hw.drivers.iit_strain import codec
from galen_hw.drivers.iit_strain.codec import Command
from galen_hw.drivers.paired_sensor import AXES, PairedSettings

MS_PER_S = 1000


class IitStrainSettings(PairedSettings):
    """Set up an `iit_strain` device.

    Args:
        rate_hz: of the stream: 1000 divided by a whole number up to 255. What a board keeps up with is not published: the
            status tells what comes.
        address: of the board on the bus, 1 to 14, as it was set when the sensor was configured.
        zero_samples: averaged for `zero`, unless the request says otherwise.
        zero_kept_s: a restarted daemon goes on with the zero it had if the sensor was out of its sight for no longer.
    """

    rate_hz: float = Field(default=100.0, gt=0.0, le=1000.0)
    address: int = Field(default=1, ge=1, le=14)
    zero_samples: int = Field(default=100, ge=1, le=1_000_000)
    zero_kept_s: float = Field(default=60.0, ge=0.0, le=86400.0)

    @model_validator(mode="after")
    def _check(self) -> Self:
        period_ms = MS_PER_S / self.rate_hz
        if round(period_ms) > 255 or abs(period_ms - round(period_ms)) > 0.01:
            raise ValueError(
                "rate_hz must be 1000 divided by a whole number from 1 to 255 (1000, 500, 333.333, 250, 200, ...)"
            )
        return self

    @property
    def period_ms(self) -> int:
        """Return the time from sample to sample, ms."""
        return round(MS_PER_S / self.rate_hz)

    @property
    def period_ns(self) -> int:
        """Return the time from sample to sample, ns."""
        return self.period_ms * NS_PER_S // MS_PER_S


@dataclass(frozen=True)
class IitStrainIdentity:
    """Hold what the start found out: who answers, and its full scales, (6,) N and N m."""

    board: str
    serial_number: str
    firmware: str
    full_scales: tuple[int, ...]

    @property
    def described(self) -> str:
        """Describe the sensor for people, full scales in N and N m."""
        *force, tx, ty, tz = self.full_scales
        scales = f"full scales {', '.join(map(str, force))} N, {tx}, {ty}, {tz} N m"
        return f"{self.board}, sensor {self.serial_number or 'of unknown number'}, firmware {self.firmware}, {scales}"


def query(settings: IitStrainSettings, name: str, number: Command, *parameters: int, wait_s: float = 0.001) -> Query:
    """Return the question of a command; what has no answer is left in peace for `wait_s`, s."""
    request = codec.command(settings.address, number, *parameters)
    if number not in codec.ANSWER_LENGTHS:
        return Query(name, request, wait_ns=round(wait_s * NS_PER_S))
    # The answer of a channel bears the channel too.
    prefix = bytes([number, *parameters]) if number is Command.GET_FULL_SCALE else bytes([number])
    return Query(name, request, (Expect(codec.answer_id(settings.address), codec.ANSWER_LENGTHS[number], prefix),))


def identify(settings: IitStrainSettings) -> Generator[Query, bytes, IitStrainIdentity]:
    """Stop, ask, set: everything but the start of the stream; full scales in N and N m, the period in ms.

    The board's own tare is taken away: whether another program made one is not known, and it is lost with the power.

    Raises:
        DialogueError: an answer that cannot be used.
    """
    for _ in range(2):
        yield query(settings, "stop", Command.SET_TRANSMISSION, codec.TRANSMIT_NOTHING, wait_s=0.02)
    firmware = yield query(settings, "the firmware version", Command.GET_FIRMWARE, 1, 0)
    board, version, _ = codec.decode_firmware(firmware)
    if board not in codec.BOARDS:
        raise DialogueError(
            f"a board of type {board} answers, which is no force/torque sensor",
            f"another address than {settings.address}?",
        )
    serial_number = codec.decode_text((yield query(settings, "the serial number", Command.GET_SERIAL_NUMBER)))
    settings.require(serial_number)
    full_scales = []
    for channel, axis in enumerate(AXES):
        answer = yield query(settings, f"the full scale of {axis}", Command.GET_FULL_SCALE, channel)
        full_scales.append(codec.decode_full_scale(answer))
    if not all(full_scales):
        none = ", ".join(axis for axis, scale in zip(AXES, full_scales, strict=True) if not scale)
        raise DialogueError(f"the full scale of {none} is 0", "write the sensor's calibration into the board again")
    yield query(settings, "no tare", Command.SET_TARE, codec.TARE_NONE)
    yield query(settings, "the period", Command.SET_PERIOD, settings.period_ms)
    return IitStrainIdentity(codec.BOARDS[board], serial_number, version, tuple(full_scales))

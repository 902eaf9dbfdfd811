"""How a Robotous RFT sensor is brought to stream: the conversation of the start and the settings it carries out."""

from collections.abc import Generator
from dataclasses import dataclass
from typing import Self

from pydantic import Field, model_validator

from galen_hw.clock import NS_PER_S
from galen_hw.drivers.dialogue import DialogueError, Expect, Query
from galen_hw.drivers.paired_sensor import AXES, PairedSettings
from galen_hw.drivers.robotous_rft import codec
from galen_hw.drivers.robotous_rft.codec import Command, Model


class RobotousSettings(PairedSettings):
    """Keys of a `robotous_rft` device.

    Args:
        rate_hz: of the stream: 10, 20, 50, 100, 200, 333, 500 or 1000 (RFT40 and RFT44 at most 200).
        filter_hz: cut-off of the sensor's low-pass: 500, 300, 200, 150, 100, 50, 40, 30, 20, 10, 5, 3, 2, 1, or 0 for
            off; none leaves what the sensor has stored.
        receiver_id, transmitter1_id, transmitter2_id: CAN identifiers, 1 to 255, all different.
        model: instead of the name that the sensor gives.
        counts_per_newton, counts_per_newton_metre: instead of the model's scaling (the manual's DF and DT).
        zero_samples: samples that show whether a `zero` took, unless the request says otherwise.
        zero_force_n, zero_torque_nm: what their mean may be at most.
    """

    rate_hz: int = 200
    filter_hz: int | None = None
    receiver_id: int = Field(default=0x64, ge=1, le=255)
    transmitter1_id: int = Field(default=0x01, ge=1, le=255)
    transmitter2_id: int = Field(default=0x02, ge=1, le=255)
    model: str | None = None
    counts_per_newton: float | None = Field(default=None, gt=0.0)
    counts_per_newton_metre: float | None = Field(default=None, gt=0.0)
    zero_samples: int = Field(default=100, ge=1, le=1_000_000)
    zero_force_n: float = Field(default=1.0, gt=0.0)
    zero_torque_nm: float = Field(default=0.05, gt=0.0)

    @model_validator(mode="after")
    def _check(self) -> Self:
        if self.rate_hz not in codec.RATE_CODES:
            raise ValueError(f"rate_hz must be one of {sorted(codec.RATE_CODES)}")
        if self.filter_hz is not None and self.filter_hz not in codec.FILTERS_HZ:
            raise ValueError(f"filter_hz must be one of {sorted(codec.FILTERS_HZ)}")
        if len({self.receiver_id, self.transmitter1_id, self.transmitter2_id}) < 3:
            raise ValueError("receiver_id, transmitter1_id and transmitter2_id must differ")
        if self.model is not None and self.model not in codec.MODELS and not self._scaled:
            raise ValueError(f"model must be one of {sorted(codec.MODELS)}, or counts_per_newton and _metre be given")
        return self

    @property
    def period_ns(self) -> int:
        """Return the time from sample to sample, ns."""
        return NS_PER_S // self.rate_hz

    @property
    def _scaled(self) -> bool:
        return self.counts_per_newton is not None and self.counts_per_newton_metre is not None


@dataclass(frozen=True)
class RobotousIdentity:
    """What the start found out: names, scaling (N and N m a count), and the overloads in the sensor's memory."""

    model: str
    serial_number: str
    firmware: str
    newton: float
    newton_metre: float
    overloads: tuple[int, ...]

    @property
    def described(self) -> str:
        """For people."""
        worn = [f"{axis} {count}" for axis, count in zip(AXES, self.overloads, strict=True) if count]
        overloads = f", overloads in its life: {', '.join(worn)}" if worn else ""
        return f"{self.model}, sensor {self.serial_number}, firmware {self.firmware}{overloads}"


def query(settings: RobotousSettings, name: str, number: Command, *parameters: int, wait_s: float = 0.0) -> Query:
    """The question of a command; the first frame of its response bears its number, the second nothing."""
    request = codec.command(settings.receiver_id, number, *parameters)
    if number in codec.SILENT:
        return Query(name, request, wait_ns=round(wait_s * NS_PER_S))
    first = Expect(settings.transmitter1_id, codec.LENGTH, bytes([number]))
    return Query(name, request, (first, Expect(settings.transmitter2_id, codec.LENGTH)))


def identify(settings: RobotousSettings) -> Generator[Query, bytes, RobotousIdentity]:
    """Stop, ask, set: everything but the start of the stream.

    The sensor obeys nothing but stop and bias while it streams, and both without a response; so it is stopped twice,
    with time for what is on its way. The bias is taken away: whether it survived what made us start is not known.

    Raises:
        DialogueError: an answer that cannot be used.
    """
    for _ in range(2):
        yield query(settings, "stop", Command.STOP_OUTPUT, wait_s=0.02)
    model = codec.decode_text((yield query(settings, "the model name", Command.READ_MODEL)))
    serial_number = codec.decode_text((yield query(settings, "the serial number", Command.READ_SERIAL_NUMBER)))
    settings.require(serial_number)
    firmware = codec.decode_text((yield query(settings, "the firmware version", Command.READ_FIRMWARE)))
    scaling = _scaling(settings, settings.model or model)
    yield from _set_rate_and_filter(settings)
    overloads = yield query(settings, "the overload counts", Command.READ_OVERLOADS)
    yield query(settings, "un-bias", Command.SET_BIAS, 0, wait_s=0.001)
    return RobotousIdentity(
        model,
        serial_number,
        firmware,
        1.0 / scaling.counts_per_newton,
        1.0 / scaling.counts_per_newton_metre,
        tuple(overloads[1:7]),
    )


def _scaling(settings: RobotousSettings, name: str) -> Model:
    known = codec.MODELS.get(name)
    newton = settings.counts_per_newton or (known and known.counts_per_newton)
    newton_metre = settings.counts_per_newton_metre or (known and known.counts_per_newton_metre)
    if not newton or not newton_metre:
        raise DialogueError(
            f"unknown model {name!r}", "set model, or counts_per_newton and counts_per_newton_metre from its manual"
        )
    max_rate_hz = known.max_rate_hz if known else 1000
    if settings.rate_hz > max_rate_hz:
        raise DialogueError(f"{name} streams at {max_rate_hz} Hz at most", f"set rate_hz to {max_rate_hz} or less")
    return Model(newton, newton_metre, max_rate_hz)


def _set_rate_and_filter(settings: RobotousSettings) -> Generator[Query, bytes, None]:
    """Both are stored in the sensor: write only what differs."""
    rate = (yield query(settings, "the output rate", Command.READ_OUTPUT_RATE))[1]
    if codec.OUTPUT_RATES_HZ.get(rate) != settings.rate_hz:
        code = codec.RATE_CODES[settings.rate_hz]
        _accept("rate_hz", (yield query(settings, "the new output rate", Command.SET_OUTPUT_RATE, code)))
    if settings.filter_hz is None:
        return
    wanted = codec.FILTERS_HZ.index(settings.filter_hz)
    stored = (yield query(settings, "the filter", Command.READ_FILTER))[1:3]
    kind = 1 if wanted else 0
    if stored[0] != kind or (kind and stored[1] != wanted):
        _accept("filter_hz", (yield query(settings, "the new filter", Command.SET_FILTER, kind, wanted)))


def _accept(key: str, response: bytes) -> None:
    error = codec.decode_result(response)
    if error:
        raise DialogueError(f"the sensor refuses {key}: {error}", f"choose a {key} that this model knows")

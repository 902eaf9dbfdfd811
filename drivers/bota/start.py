"""How a Bota sensor is brought to stream: its settings, and the one question of the start."""

from dataclasses import dataclass

from pydantic import BaseModel, ConfigDict, Field

from galen_hw.clock import NS_PER_S
from galen_hw.drivers.bota import codec
from galen_hw.drivers.bota.codec import IDENTIFY, STOP, Sensor
from galen_hw.drivers.dialogue import DialogueError


class BotaSettings(BaseModel):
    """Keys of a `bota` device; mode, filter and address belong to its wire.

    Args:
        rate_hz: that the sensor's mode (or sinc length) gives; another rate is an error of the start that names it.
        serial_number: refuse any other sensor; none accepts what answers. Over CAN the sensor does not say its own: this
            one is then taken on trust.
        stall_s: a sample that waited longer in the package's buffer (or longer than half a period) counts as late and is
            not published; at the start none is for five times as long.
        sample_timeout_s: a stream silent for this long is started anew.
        start_timeout_s: the first sample comes within this time (the vendor's package waits half a second itself).
        reply_timeout_s, tries, retry_s: patience with the question of the start.
        zero_samples: averaged by `zero` unless the request says otherwise.
        zero_kept_s: a restarted daemon goes on with the zero it had if the sensor was out of its sight for no longer.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    rate_hz: float = Field(default=1000.0, ge=1.0, le=10_000.0)
    serial_number: str | None = Field(default=None, min_length=1)
    stall_s: float = Field(default=0.02, gt=0.0)
    sample_timeout_s: float = Field(default=0.5, gt=0.0)
    start_timeout_s: float = Field(default=5.0, gt=0.0, le=60.0)
    reply_timeout_s: float = Field(default=1.0, gt=0.0, le=10.0)
    tries: int = Field(default=3, ge=1, le=100)
    retry_s: float = Field(default=1.0, gt=0.0, le=60.0)
    zero_samples: int = Field(default=500, ge=1, le=1_000_000)
    zero_kept_s: float = Field(default=60.0, ge=0.0, le=86400.0)


@dataclass(frozen=True)
class BotaIdentity:
    """What the start found out.

    Args:
        model, firmware: as the sensor says, empty where it does not.
        serial_number: the sensor's word, or the configuration's (`told` is then false), or empty.
    """

    model: str
    serial_number: str
    firmware: str
    told: bool

    @property
    def described(self) -> str:
        """For people."""
        serial = f"sensor {self.serial_number or 'of unknown number'}"
        trust = "" if self.told or not self.serial_number else " (as configured, it does not say)"
        firmware = f", firmware {self.firmware}" if self.firmware else ""
        return f"{self.model or 'model unknown'}, {serial}{trust}{firmware}"


@dataclass(slots=True)
class Question:
    """Asks who answers; a `Conversation` of `WrenchSensor`.

    Args:
        settings: of the device; due_ns: when to begin.
    """

    settings: BotaSettings
    due_ns: int
    result: BotaIdentity | None = None
    failure: DialogueError | None = None
    timeouts: int = 0
    _asked: int = 0

    def poll(self, now_ns: int) -> list[bytes]:
        """Stop what may be streaming and ask; again after a time-out, `tries` times."""
        if self.result is not None or self.failure is not None or now_ns < self.due_ns:
            return []
        self.timeouts += self._asked > 0
        if self._asked >= self.settings.tries:
            self.failure = DialogueError(f"no answer to who it is, asked {self._asked} times", "")
            return []
        self._asked += 1
        self.due_ns = now_ns + round(self.settings.reply_timeout_s * NS_PER_S)
        return [STOP, IDENTIFY]

    def feed(self, wire: bytes, t_ns: int, /) -> bool:
        """Take a line (without its end); false when it is no answer."""
        said = codec.decode(wire)
        if not self._asked or not isinstance(said, Sensor):
            return False
        self.due_ns = t_ns
        try:
            self.result = identity_of(said, self.settings)
        except DialogueError as error:
            self.failure = error
        return True


def identity_of(said: Sensor, settings: BotaSettings) -> BotaIdentity:
    """Return who answers, if that is the sensor of the settings at the rate of the settings.

    Raises:
        DialogueError: another sensor, or another rate (by more than 1 %: periods are whole microseconds).
    """
    if said.serial_number and settings.serial_number not in (None, said.serial_number):
        raise DialogueError(
            f"sensor {said.serial_number} answers, but sensor {settings.serial_number} is configured",
            "connect the right sensor or change its serial_number in the configuration",
        )
    rate_hz = 1e6 / said.period_us if said.period_us else settings.rate_hz
    if abs(rate_hz - settings.rate_hz) > 0.01 * settings.rate_hz:
        raise DialogueError(
            f"the sensor streams at {rate_hz:g} Hz, but rate_hz is {settings.rate_hz:g}",
            f"set rate_hz = {rate_hz:g}, or another app_mode, app_submode or sinc_length of its transport",
        )
    serial_number = said.serial_number or settings.serial_number or ""
    return BotaIdentity(said.model, serial_number, said.firmware, bool(said.serial_number))

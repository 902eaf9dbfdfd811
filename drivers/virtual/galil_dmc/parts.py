"""Parts of an axis: stop codes, modes, mechanics and registers."""

from dataclasses import dataclass, field
from enum import Enum, IntEnum

TICKS_PER_S = 1024


class Stop(IntEnum):
    """Stop codes, SC."""

    RUNNING = 0
    AT_TARGET = 1
    FORWARD_LIMIT = 2
    REVERSE_LIMIT = 3
    COMMAND = 4
    ABORT_INPUT = 6
    ABORT_COMMAND = 7
    OFF_ON_ERROR = 8
    FIND_EDGE = 9
    HOME = 10
    AMPLIFIER = 15


class Mode(Enum):
    """What the next BG does."""

    ABSOLUTE = "PA"
    RELATIVE = "PR"
    JOG = "JG"
    FIND_EDGE = "FE"
    FIND_INDEX = "FI"
    HOME = "HM"


@dataclass(frozen=True, slots=True)
class Plant:
    """What is bolted to the axis, in counts of the motor from its own zero.

    Args:
        reverse_switch, forward_switch: where the limit switches close.
        home_switch: where the home input changes.
        margin: from a switch to the hard stop behind it.
        index_spacing: counts from one index pulse to the next.
        lag_s: how much later the motor is than the reference.
        brake: deceleration of a motor without power, counts/s^2.
        offset: what an absolute encoder reads at the axis' zero.
    """

    reverse_switch: float = -1e9
    forward_switch: float = 1e9
    home_switch: float = 0.0
    margin: float = 1e4
    index_spacing: float = 4096.0
    lag_s: float = 0.002
    brake: float = 2e6
    offset: int = 0


@dataclass(slots=True)
class Registers:
    """What commands set, with the controller's power-up values."""

    SP: float = 25_000
    AC: float = 256_000
    DC: float = 256_000
    JG: float = 25_000
    FL: float = 2_147_483_647
    BL: float = -2_147_483_648
    ER: float = 16_384
    OE: float = 0
    LD: float = 0
    TL: float = 9.9982
    ZA: float = 0
    tuning: dict[str, float] = field(default_factory=dict)

"""Commands that set and read registers: of the axes (SP AC DC FL ...) or of the controller (LZ PF VF EO CW ...)."""

from dataclasses import dataclass
from typing import Final

from galen_hw.drivers.virtual.galil_dmc.controller import Controller
from galen_hw.drivers.virtual.galil_dmc.format import Rejected
from galen_hw.drivers.virtual.galil_dmc.grammar import number, slots_of
from galen_hw.drivers.virtual.galil_dmc.motion import SPEED_LIMIT, Handler

_INT_MIN: Final = -2_147_483_648
_INT_MAX: Final = 2_147_483_647


@dataclass(frozen=True, slots=True)
class Register:
    """Range of a register of the axes, and the step its values are rounded down to (0: any fraction)."""

    low: float
    high: float
    step: float = 1.0

    def rounded(self, value: float) -> float:
        """The value that is kept.

        Raises:
            Rejected: out of range (code 6).
        """
        if not self.low <= value <= self.high:
            raise Rejected(6)
        return float(int(value / self.step) * self.step) if self.step else value


REGISTERS: Final[dict[str, Register]] = {
    "SP": Register(0, SPEED_LIMIT, 2),
    "AC": Register(1024, 1_073_740_800, 1024),
    "DC": Register(1024, 1_073_740_800, 1024),
    "FL": Register(_INT_MIN, _INT_MAX),
    "BL": Register(_INT_MIN, _INT_MAX),
    "ER": Register(0, _INT_MAX),
    "OE": Register(0, 3),
    "LD": Register(0, 3),
    "TL": Register(0, 9.9982, 0),
    "ZA": Register(_INT_MIN, _INT_MAX),
}

_TUNING: Final[dict[str, float]] = {
    **dict.fromkeys(("KI", "AU", "BR", "CE", "TK", "OF", "SS", "FA", "FV"), 0.0),
    **dict.fromkeys(("AG", "MT", "IT"), 1.0),
    **dict.fromkeys(("SD", "VA"), 256_000.0),
    "KP": 6.0,
    "KD": 64.0,
    "IL": 9.9982,
}

_REPLAN: Final = {"SP", "AC", "DC"}


def _register(name: str) -> Handler:
    def handler(controller: Controller, rest: str) -> str | None:
        asked, wanted = [], []
        for index, text in slots_of(rest, len(controller.axes)):
            if text == "?":
                asked.append(read_register(controller, name, index))
            else:
                wanted.append((index, REGISTERS[name].rounded(controller.value(text))))
        for index, value in wanted:
            axis = controller.axes[index]
            setattr(axis.registers, name, value)
            if name in _REPLAN:
                axis.replan(controller.next_tick)
        return _show(controller, name, asked)

    return handler


def _show(controller: Controller, name: str, asked: list[float]) -> str | None:
    if not asked:
        return None
    return controller.tell_variables(asked) if name == "TL" else controller.tell(asked)


def read_register(controller: Controller, name: str, index: int) -> float:
    """A register or tuning value of an axis."""
    registers = controller.axes[index].registers
    if name in REGISTERS:
        return float(getattr(registers, name))
    return registers.tuning.get(name, _TUNING[name])


def _tuning(name: str) -> Handler:
    def handler(controller: Controller, rest: str) -> str | None:
        asked = []
        for index, text in slots_of(rest, len(controller.axes)):
            if text == "?":
                asked.append(read_register(controller, name, index))
            else:
                controller.axes[index].registers.tuning[name] = controller.value(text)
        return controller.tell_variables(asked) if asked else None

    return handler


def polarity(controller: Controller, rest: str) -> str | None:
    """CN: limit switches active low (-1) or high (1), then home, latch and two more fields."""
    asked, wanted = [], []
    for place, text in slots_of(rest, len(controller.polarity)):
        if text == "?":
            asked.append(float(controller.polarity[place]))
        else:
            value = int(number(text))
            if value not in {-1, 0, 1}:
                raise Rejected(6)
            wanted.append((place, value))
    for place, value in wanted:
        controller.polarity[place] = value
        for axis in controller.axes:
            axis.limit_active_high = controller.polarity[0] > 0
    return controller.tell(asked) if asked else None


def echo(controller: Controller, rest: str) -> str | None:
    """EO."""
    if rest == "?":
        return str(int(controller.format.echo))
    controller.format.echo = _choice(rest, 0, 1) == 1
    return None


def leading_zeros(controller: Controller, rest: str) -> str | None:
    """LZ: 1 leaves leading zeros out."""
    if rest == "?":
        return str(int(controller.format.suppress_zeros))
    controller.format.suppress_zeros = _choice(rest, 0, 1) == 1
    return None


def position_format(controller: Controller, rest: str) -> str | None:
    """PF m.n."""
    if rest == "?":
        return "{}.{}".format(*controller.format.position)
    controller.format.position = _format(rest)
    return None


def variable_format(controller: Controller, rest: str) -> str | None:
    """VF m.n."""
    if rest == "?":
        return "{}.{}".format(*controller.format.variable)
    controller.format.variable = _format(rest)
    return None


def unsolicited(controller: Controller, rest: str) -> str | None:
    """CW: 1 marks unsolicited bytes with their highest bit, 2 does not."""
    if rest == "?":
        return "1" if controller.format.mark_unsolicited else "2"
    controller.format.mark_unsolicited = _choice(rest.partition(",")[0], 1, 2) == 1
    return None


def unsolicited_port(controller: Controller, rest: str) -> str | None:
    """CF: S sends unsolicited lines to the serial port, a handle elsewhere."""
    port = rest.strip()
    if port not in {"S", "I", "A", "B", "C", "D", "E", "F", "G", "H"}:
        raise Rejected(6)
    controller.format.unsolicited_here = port == "S"
    return None


def sample_time(_controller: Controller, rest: str) -> str | None:
    """TM: the servo's sample time in microseconds; only the standard 1000 is there."""
    if rest == "?":
        return "1000"
    if number(rest) != 1000:
        raise Rejected(6)
    return None


def _choice(text: str, *choices: int) -> int:
    value = int(number(text))
    if value not in choices:
        raise Rejected(6)
    return value


def _format(text: str) -> tuple[int, int]:
    number(text)
    whole, _, fraction = text.strip().partition(".")
    if not 1 <= int(whole) <= 10 or int(fraction or 0) > 4:
        raise Rejected(6)
    return int(whole), int(fraction or 0)


SETTINGS: Final[dict[str, Handler]] = {
    **{name: _register(name) for name in REGISTERS},
    **{name: _tuning(name) for name in _TUNING},
    "CN": polarity,
    "EO": echo,
    "LZ": leading_zeros,
    "PF": position_format,
    "VF": variable_format,
    "CW": unsolicited,
    "CF": unsolicited_port,
    "TM": sample_time,
}
TUNING: Final = frozenset(_TUNING)

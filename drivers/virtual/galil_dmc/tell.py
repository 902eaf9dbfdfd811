"""Commands that tell: TP TD TE TV TT TS SC RP, MG and its operands, TC, QR, QZ; and the program's DL UL LS XQ HX."""

import re
from collections.abc import Callable
from typing import Final

from galen_hw.drivers.virtual.galil_dmc import record
from galen_hw.drivers.virtual.galil_dmc.axis import Axis
from galen_hw.drivers.virtual.galil_dmc.controller import Controller
from galen_hw.drivers.virtual.galil_dmc.format import Rejected, error_text
from galen_hw.drivers.virtual.galil_dmc.grammar import axes_of, number
from galen_hw.drivers.virtual.galil_dmc.motion import Handler
from galen_hw.drivers.virtual.galil_dmc.registers import REGISTERS, TUNING, read_register

Reading = Callable[[Controller, Axis], float]

TELL: Final[dict[str, Reading]] = {
    "TP": lambda c, a: a.position(c.tick_time),
    "TD": lambda c, a: a.position(c.tick_time) - a.auxiliary_zero,
    "TE": lambda c, a: a.error(c.tick_time),
    "TV": lambda c, a: round(a.actual(c.tick_time).v),
    "TT": lambda c, a: c.torque(a),
    "TS": lambda c, a: c.tell_switches(a),
    "SC": lambda _, a: a.code,
    "RP": lambda c, a: a.commanded(c.tick_time),
}

_ONLY_OPERANDS: Final[dict[str, Reading]] = {
    "BG": lambda _, a: a.moving,
    "MO": lambda _, a: not a.motor_on,
    "LF": lambda c, a: a.switch_level(c.tick_time, 1),
    "LR": lambda c, a: a.switch_level(c.tick_time, -1),
    "HM": lambda c, a: a.home_level(c.tick_time),
    "PA": lambda _, a: a.target,
    "PR": lambda _, a: a.step_by,
    "JG": lambda _, a: a.registers.JG,
    "DP": lambda c, a: a.position(c.tick_time),
    "DE": lambda c, a: a.position(c.tick_time) - a.auxiliary_zero,
}

_WHOLE: Final[dict[str, Callable[[Controller], float]]] = {
    "_AB": lambda c: not c.inputs.abort,
    "_TC": lambda c: c.error_code,
    "_EO": lambda c: c.format.echo,
    "_LZ": lambda c: c.format.suppress_zeros,
    "_PF": lambda c: float("{}.{}".format(*c.format.position)),
    "_VF": lambda c: float("{}.{}".format(*c.format.variable)),
    "_CW": lambda c: 1 if c.format.mark_unsolicited else 2,
    "_TM": lambda _: 1000,
    "_BN": lambda c: c.model.serial_number,
    "_DL": lambda _: 62,
    "TIME": lambda c: c.tick,
}
_FUNCTION: Final = re.compile(r"@(IN|OUT|AN)\[(\d+)\]$")


def operand(controller: Controller, text: str) -> float:
    """A number, `_TPA`, `_AB`, `@IN[7]`, `TIME` or a variable.

    Raises:
        Rejected: none of them.
    """
    text = text.strip()
    if text in _WHOLE:
        return float(_WHOLE[text](controller))
    if match := _FUNCTION.match(text):
        return _function(controller, match[1], int(match[2]))
    if text.startswith("_"):
        return _axis_operand(controller, text[1:3], text[3:])
    if text in controller.variables:
        return controller.variables[text]
    return number(text)


def _function(controller: Controller, name: str, index: int) -> float:
    if name == "IN":
        return controller.input_level(index)
    if not 1 <= index <= 16:
        raise Rejected(57)
    return float(controller.outputs >> (index - 1) & 1) if name == "OUT" else 0.0


def _axis_operand(controller: Controller, name: str, where: str) -> float:
    if name in {"XQ", "HX"}:
        thread = controller.program.threads.get(int(number(where or "0")))
        return float(thread.line if name == "XQ" else 1) if thread else (-1.0 if name == "XQ" else 0.0)
    if name == "CN":
        return float(controller.polarity[min(int(number(where or "0")), 4)])
    if len(where) > 1:
        raise Rejected(58)
    index = axes_of(where or "A", len(controller.axes))[0]
    readings = TELL | _ONLY_OPERANDS
    if name in readings:
        return float(readings[name](controller, controller.axes[index]))
    if name in REGISTERS or name in TUNING:
        return read_register(controller, name, index)
    raise Rejected(58)


def _tell(name: str) -> Handler:
    def handler(controller: Controller, rest: str) -> str:
        axes = [controller.axes[i] for i in axes_of(rest, len(controller.axes))]
        values = [float(TELL[name](controller, axis)) for axis in axes]
        return controller.tell_variables(values) if name == "TT" else controller.tell(values)

    return handler


def message(controller: Controller, rest: str) -> str:
    """MG: texts in quotes as they are, numbers in VF format."""
    out = ""
    values: list[float] = []
    for part in re.findall(r'"[^"]*"?|\{[^}]*\}?|[^,"{]+', rest):
        if part.startswith('"'):
            if len(part) < 2 or not part.endswith('"'):
                raise Rejected(52)
            out += (controller.tell_variables(values) if values else "") + part[1:-1]
            values = []
        elif part.strip() and not part.startswith("{"):
            values.append(operand(controller, part))
    if not rest:
        raise Rejected(50)
    return out + (controller.tell_variables(values) if values else "")


def tell_code(controller: Controller, rest: str) -> str:
    """TC: the last error, and clear it; TC 1 with its text."""
    if rest not in {"", "0", "1"}:
        raise Rejected(6)
    code, controller.error_code = controller.error_code, 0
    return error_text(code) if rest == "1" else str(code)


def tell_inputs(controller: Controller, rest: str) -> str:
    """TI: inputs 1 to 8 as a byte."""
    if rest not in {"", "0"}:
        raise Rejected(6)
    return str(sum(controller.input_level(n) << (n - 1) for n in range(1, 9)))


def tell_amplifier(controller: Controller, rest: str) -> str:
    """TA n: amplifier status bytes; TA 3 is the ELO."""
    if rest not in {"0", "1", "2", "3"}:
        raise Rejected(6)
    return str(controller.amplifier_status >> 24 if rest == "3" else 0)


def _output(level: int) -> Handler:
    def handler(controller: Controller, rest: str) -> None:
        index = int(number(rest)) - 1
        if not 0 <= index < 16:
            raise Rejected(6)
        controller.outputs = controller.outputs & ~(1 << index) | level << index

    return handler


def download(controller: Controller, rest: str) -> None:
    """DL: the following lines are a program, up to a backslash; DL # adds them to the end of the one that is there."""
    if controller.program.running:
        raise Rejected(17)
    if rest not in {"", "0", "#"}:
        raise Rejected(6)
    controller.program.incoming, controller.downloading = [], True
    controller.program.append = rest == "#"


def listing(controller: Controller, _rest: str) -> str:
    """LS: the program with line numbers."""
    return "\r\n".join(f"{i} {line}" for i, line in enumerate(controller.program.lines))


def upload(controller: Controller, _rest: str) -> str:
    """UL: the program, ended by ^Z."""
    return "".join(f"{line}\r\n" for line in controller.program.lines) + "\x1a"


def execute(controller: Controller, rest: str) -> None:
    """XQ #label, thread."""
    label, _, thread = rest.partition(",")
    controller.program.start(label.strip(), int(number(thread)) if thread.strip() else 0)


def halt(controller: Controller, rest: str) -> None:
    """HX: one thread, or all."""
    controller.program.halt(int(number(rest)) if rest else None)


def reset(controller: Controller, _rest: str) -> None:
    """RS: as after power-up."""
    controller.reset_requested = True


def burn(controller: Controller, _rest: str) -> None:
    """BN, BP, BV: keep what is set; a virtual controller keeps the formats."""
    controller.keep()


def list_variables(controller: Controller, _rest: str) -> str:
    """LV."""
    lines = [f"{name}={controller.tell_variables([value])}" for name, value in controller.variables.items()]
    return "\r\n".join(lines)


REPORTS: Final[dict[str, Handler]] = {
    **{name: _tell(name) for name in TELL},
    "MG": message,
    "TC": tell_code,
    "TI": tell_inputs,
    "TA": tell_amplifier,
    "QR": record.record,
    "QZ": lambda controller, _: record.sizes(controller),
    "SB": _output(1),
    "CB": _output(0),
    "DL": download,
    "LS": listing,
    "UL": upload,
    "LV": list_variables,
    "XQ": execute,
    "HX": halt,
    "RS": reset,
    "BN": burn,
    "BP": burn,
    "BV": burn,
}

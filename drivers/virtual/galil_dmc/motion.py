"""Commands that move: SH MO BG ST AB PA PR JG FE FI HM DP DE; each takes the controller and the text behind it."""

from collections.abc import Callable
from typing import Final

from galen_hw.drivers.virtual.galil_dmc.axis import Axis
from galen_hw.drivers.virtual.galil_dmc.controller import Controller
from galen_hw.drivers.virtual.galil_dmc.format import Rejected
from galen_hw.drivers.virtual.galil_dmc.grammar import axes_of, number, slots_of
from galen_hw.drivers.virtual.galil_dmc.parts import Mode, Stop

Handler = Callable[[Controller, str], str | bytes | None]
"""A command: its data, or None for a bare colon. Raises `Rejected`."""

COUNT_LIMIT: Final = 2_147_483_647
SPEED_LIMIT: Final = 22_000_000


def _named(controller: Controller, rest: str) -> list[Axis]:
    return [controller.axes[i] for i in axes_of(rest, len(controller.axes))]


def _standing(axes: list[Axis]) -> list[Axis]:
    if any(axis.moving for axis in axes):
        raise Rejected(7)
    return axes


def servo_here(controller: Controller, rest: str) -> None:
    """SH: power on, hold the present position."""
    for axis in _standing(_named(controller, rest)):
        axis.servo_here(controller.t)


def motor_off(controller: Controller, rest: str) -> None:
    """MO: power off; not while moving."""
    for axis in _standing(_named(controller, rest)):
        axis.off(controller.t)


def begin(controller: Controller, rest: str) -> None:
    """BG: all named axes at the same tick, or none."""
    axes = _named(controller, rest)
    if any(not axis.motor_on for axis in axes):
        raise Rejected(20)
    if any(axis.moving for axis in axes):
        raise Rejected(21)
    t = controller.t
    for axis in axes:
        way = axis.direction(t)
        if way and axis.limited(t, way):
            raise Rejected(22)
    for axis in axes:
        axis.begin(t, controller.next_tick)


def stop(controller: Controller, rest: str) -> None:
    """ST: brake; without axes the program halts too."""
    for axis in _named(controller, rest):
        axis.stop(controller.next_tick)
    if not rest:
        controller.program.halt()


def abort(controller: Controller, rest: str) -> None:
    """AB: stand at once, the program too; AB 1 spares the program. Axes with OE lose power."""
    if rest not in {"", "0", "1"}:
        raise Rejected(6)
    for axis in controller.axes:
        axis.abort(controller.t, Stop.ABORT_COMMAND)
        if int(axis.registers.OE) & 1 and axis.motor_on:
            axis.off(controller.t, Stop.ABORT_COMMAND)
    if rest != "1":
        controller.program.halt()


def absolute(controller: Controller, rest: str) -> str | None:
    """PA: targets; `?` reads them back."""
    return _targets(controller, rest, Mode.ABSOLUTE)


def relative(controller: Controller, rest: str) -> str | None:
    """PR: distances; `?` reads them back."""
    return _targets(controller, rest, Mode.RELATIVE)


def _targets(controller: Controller, rest: str, mode: Mode) -> str | None:
    asked: list[float] = []
    wanted: list[tuple[Axis, float | None]] = []
    for index, text in slots_of(rest, len(controller.axes)):
        axis = controller.axes[index]
        if text == "?":
            asked.append(axis.target if mode is Mode.ABSOLUTE else axis.step_by)
        else:
            wanted.append((axis, _ranged(controller.value(text), -COUNT_LIMIT - 1, COUNT_LIMIT)))
    _standing([axis for axis, _ in wanted])
    for axis, value in wanted or ([(axis, None) for axis in controller.axes] if not asked else []):
        axis.mode = mode
        if value is not None and mode is Mode.ABSOLUTE:
            axis.target = float(int(value))
        elif value is not None:
            axis.step_by = float(int(value))
    return controller.tell(asked) if asked else None


def jog(controller: Controller, rest: str) -> str | None:
    """JG: jog speeds, at once for axes that jog already; it overwrites SP."""
    asked: list[float] = []
    wanted: list[tuple[Axis, float | None]] = []
    for index, text in slots_of(rest, len(controller.axes)):
        axis = controller.axes[index]
        if text == "?":
            asked.append(axis.registers.JG)
        else:
            wanted.append((axis, _ranged(controller.value(text), -SPEED_LIMIT, SPEED_LIMIT)))
    if any(axis.moving and axis.running_mode is not Mode.JOG for axis, _ in wanted):
        raise Rejected(13)
    for axis, value in wanted or ([(axis, None) for axis in controller.axes if not axis.moving] if not asked else []):
        axis.mode = Mode.JOG
        if value is not None:
            speed = float(int(value / 2) * 2)
            axis.registers.JG, axis.registers.SP = speed, abs(speed)
            axis.replan(controller.next_tick)
    return controller.tell(asked) if asked else None


def _search(mode: Mode) -> Handler:
    def handler(controller: Controller, rest: str) -> None:
        for axis in _standing(_named(controller, rest)):
            axis.mode = mode

    return handler


def define_position(controller: Controller, rest: str) -> str | None:
    """DP: this place is called so from now on; not while moving."""
    asked, wanted = [], []
    for index, text in slots_of(rest, len(controller.axes)):
        axis = controller.axes[index]
        if text == "?":
            asked.append(float(axis.position(controller.tick_time)))
        else:
            wanted.append((axis, _ranged(controller.value(text), -COUNT_LIMIT - 1, COUNT_LIMIT)))
    _standing([axis for axis, _ in wanted])
    for axis, value in wanted:
        axis.define_position(controller.t, float(int(value)))
    return controller.tell(asked) if asked else None


def define_auxiliary(controller: Controller, rest: str) -> str | None:
    """DE: the auxiliary encoder, which here reads the same shaft, reads so from now on."""
    asked = []
    for index, text in slots_of(rest, len(controller.axes)):
        axis, t = controller.axes[index], controller.tick_time
        if text == "?":
            asked.append(axis.position(t) - axis.auxiliary_zero)
        else:
            axis.auxiliary_zero = axis.position(t) - int(number(text))
    return controller.tell(asked) if asked else None


def _ranged(value: float, low: float, high: float) -> float:
    if not low <= value <= high:
        raise Rejected(6)
    return value


MOTION: Final[dict[str, Handler]] = {
    "SH": servo_here,
    "MO": motor_off,
    "BG": begin,
    "ST": stop,
    "AB": abort,
    "PA": absolute,
    "PR": relative,
    "JG": jog,
    "FE": _search(Mode.FIND_EDGE),
    "FI": _search(Mode.FIND_INDEX),
    "HM": _search(Mode.HOME),
    "DP": define_position,
    "DE": define_auxiliary,
}

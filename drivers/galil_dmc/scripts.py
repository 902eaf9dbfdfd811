"""What each command does on a Galil's line, as scripts: generators that yield lines to send and are sent the answers.

A script ends with the result of its request, or with one of the errors below.
"""

from collections.abc import Generator, Iterable, Mapping
from dataclasses import dataclass
from typing import Any, Final, TypeAlias

from galen_hw.clock import NS_PER_S
from galen_hw.drivers.galil_dmc.axes import Axes
from galen_hw.drivers.galil_dmc.codec import (
    AXIS_BYTES,
    COORDINATE_BYTES,
    ERROR_CODES,
    GENERAL_BYTES,
    DataRecord,
    axes_of_model,
    error_code,
    lines,
    numbers,
)
from galen_hw.drivers.galil_dmc.link import Answer, Exchange

STOP_TIME_NS: Final = 5 * NS_PER_S
"""Longest wait for axes to come to rest before their motors are switched off."""


class Quiet:
    """A step of a script: drain the line."""


Step: TypeAlias = Exchange | Quiet
Result: TypeAlias = dict[str, Any]
Script: TypeAlias = Generator[Step, Answer | None, Result]


class RefusedError(Exception):
    """The controller answered `?`."""

    def __init__(self, command: str, code: int, text: str) -> None:
        what, self.todo = ERROR_CODES.get(code, (text or "no reason given", ""))
        error = f" with error {code}" if code >= 0 else ""
        super().__init__(f"controller refused {command!r}{error}: {what}")
        self.code = code


class SilentError(Exception):
    """No (whole) answer in time; the command may or may not have been carried out."""


class CancelledError(Exception):
    """A stop came first."""


class WrongDeviceError(Exception):
    """What answers is not a controller that this driver knows."""


@dataclass(frozen=True, slots=True)
class Controller:
    """What the connection found: name and firmware, and LD of each axis."""

    model: str
    disabled_limits: Mapping[str, int]


def ask(line: str) -> Generator[Step, Answer | None, list[str]]:
    """The answers of a line's commands.

    Raises:
        RefusedError: one was refused; code and text by TC 1.
    """
    answer = yield Exchange(line)
    assert answer is not None
    if not any(answer.refused):
        return list(answer.parts)
    command = answer.exchange.commands[answer.refused.index(True)]
    told = yield Exchange("TC 1")
    assert told is not None
    raise RefusedError(command, *error_code(told.parts[0]))


def send(commands: Iterable[str]) -> Generator[Step, Answer | None, None]:
    """Commands without answers, in as few lines as fit."""
    for line in lines(commands):
        yield from ask(line)


def record(axes: str, *, general: bool = False) -> Generator[Step, Answer | None, DataRecord]:
    """A data record of some axes, with block I if `general`."""
    answer = yield record_exchange(axes, general=general)
    assert answer is not None
    if answer.record is None:
        raise RefusedError(answer.exchange.line, -1, "no data record")
    return answer.record


def record_exchange(axes: str, *, general: bool = False) -> Exchange:
    """The line that asks for a record, and the shape of its answer."""
    return Exchange(f"QR {axes}{'I' if general else ''}", record=axes)


def connect(axes: Axes, *, write_limits: bool) -> Script:
    """Identify the controller and bring it to a known state: echo off, side talk marked, at rest.

    Raises:
        WrongDeviceError: another device, too few axes, a record layout that is not known.
    """
    yield Quiet()
    yield from ask("EO 0")
    yield from send(["CW 1", "CF S", "LZ 1", "PF 10.0"])
    (model,) = yield from ask("\x12\x16")
    yield Quiet()  # some firmware answers on ^V already, and once more to the CR
    count = axes_of_model(model)
    if count is None:
        raise WrongDeviceError(f"not a Galil DMC, it calls itself {model[:40]!r}")
    (sizes,) = yield from ask("QZ")
    _check_layout(sizes, axes.letters)
    disabled = yield from _disabled_limits(axes.letters)
    state = yield from record(axes.letters, general=True)
    if any(block.moving for block in state.axes.values()):  # nobody has watched over that motion
        yield from ask(f"ST {axes.letters}")
    if write_limits:
        yield from send(axes.limit_commands())
    found = yield from status(axes.letters)
    return {"controller": Controller(model, disabled), **found}


def _check_layout(sizes: str, letters: str) -> None:
    try:
        found = [int(n) for n in numbers(sizes)]
    except ValueError:
        found = []
    if found[1:] != [GENERAL_BYTES, COORDINATE_BYTES, AXIS_BYTES]:
        raise WrongDeviceError(f"its data record is laid out as {sizes!r} (QZ), not as the DMC-40x0 family's")
    if ord(letters[-1]) - ord("A") >= found[0]:
        raise WrongDeviceError(f"it has {found[0]} axes, the configuration names axis {letters[-1]}")


def _disabled_limits(letters: str) -> Generator[Step, Answer | None, Mapping[str, int]]:
    """LD of each axis; all enabled where the controller will not tell."""
    try:
        (text,) = yield from ask("MG " + ",".join(f"_LD{letter}" for letter in letters))
        values = [int(number) for number in numbers(text)]
    except (RefusedError, ValueError):
        return {}
    return dict(zip(letters, values, strict=False))


def status(letters: str) -> Script:
    """Amplifier status and abort input: what the short records do not hold."""
    state = yield from record(letters, general=True)
    (text,) = yield from ask("MG _AB")
    try:
        (abort,) = numbers(text)
    except ValueError:
        raise SilentError from None
    return {"amplifier_status": state.amplifier_status or 0, "abort_input": abort != 1}


def move(axes: str, commands: list[str], joints: list[str]) -> Script:
    """Prepare, and begin only when all was accepted."""
    yield from send(commands)
    yield from _begin(axes)
    return {"begun": joints}


def jog(axes: Axes, velocity: Mapping[str, float], jogging: set[str]) -> Script:
    """New jog speeds; joints that do not jog yet (what `jogging` says when the script starts) are begun and join it."""
    fresh = [joint for joint, value in velocity.items() if value and joint not in jogging]
    wanted = {joint: value for joint, value in velocity.items() if value or joint in jogging}
    fastest = {joint: axes.by_joint[joint].max_velocity for joint in fresh}  # later ones change the speed alone
    ramps = axes.ramps(axes.pick(fresh, {}, "acceleration"), fastest) if fresh else []
    yield from send([*ramps, *axes.jog(wanted)])
    if fresh:
        yield from _begin(axes.letters_of(fresh))
        jogging.update(fresh)
    return {}


def _begin(axes: str) -> Generator[Step, Answer | None, None]:
    """BG; where one axis is refused, those that did begin are stopped."""
    try:
        yield from ask(f"BG {axes}")
    except RefusedError:
        state = yield from record(axes)
        if any(state.axes[letter].moving for letter in axes):
            yield from ask(f"ST {axes}")
        raise


def one(line: str, result: Result) -> Script:
    """One line that must be accepted."""
    yield from ask(line)
    return result


def enable(letters: str) -> Script:
    """Servo on where the axes stand, and proof that all are on."""
    yield from ask(f"SH {letters}")
    state = yield from record(letters, general=True)
    off = [letter for letter in letters if not state.axes[letter].motor_on]
    if off:
        raise RefusedError(f"SH {letters}", -1, f"motor of axis {', '.join(off)} stays off")
    return {"enabled": True}


def disable(letters: str) -> Script:
    """ST only when moving, wait for rest, then MO (ST and MO at once are known not to behave)."""
    answer = yield record_exchange(letters)
    began_ns = answer.t_ns if answer is not None else 0
    stopping = False
    while answer is not None and answer.record is not None and any(b.moving for b in answer.record.axes.values()):
        if answer.t_ns - began_ns > STOP_TIME_NS:
            break
        if not stopping:
            yield from ask(f"ST {letters}")
            stopping = True
        answer = yield record_exchange(letters)
    yield from ask(f"MO {letters}")
    yield from record(letters)
    return {"enabled": False}

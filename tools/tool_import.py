"""What `galen-hw tool import` takes: a file that this version can serve whole, on the hardware that is configured here."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from galen_hw.documents import load_json
from galen_hw.errors import GalenError, UsageError

if TYPE_CHECKING:
    from galen_hw.config.tool_file import ToolFile
    from galen_hw.config.tool_store import ToolStore
    from galen_hw.kinematics import Robot

LISTEN_S: Final = 1.0
"""How long the running daemon's sensor is listened to for its serial number; it says it with every sample."""


@dataclass(frozen=True, slots=True)
class Here:
    """What is known of the hardware here.

    Args:
        robot: of the settings; serial: of the sensor, empty where not known; virtual: it is a virtual robot.
        running: the daemon told it, else settings and stored calibrations did.
    """

    robot: "Robot"
    serial: str
    virtual: bool
    running: bool


def read_tool(path: Path) -> "ToolFile":
    """A tool's file from outside the store.

    Raises:
        UsageError: it cannot be read, holds effects alone, or is impossible; one line.
    """
    from galen_hw.config.tool_file import parse_tool

    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise UsageError(f"cannot be read ({error})", where=str(path), todo="give a tool's file") from None
    _refuse_bare_terms(text, path)
    return parse_tool(text, str(path))


def _refuse_bare_terms(text: str, file: Path) -> None:
    """Terms that a diagnosis saved without knowing the tool."""
    try:
        data = load_json(text)
    except ValueError:
        return
    if isinstance(data, dict) and "terms" in data and "name" not in data:
        todo = "galen-hw diagnose ... --tool NAME --save-model writes a whole one"
        raise UsageError("holds effects, but no tool that they belong to", where=str(file), todo=todo)


def hardware_here(info: dict[str, Any], store: "ToolStore", bus: str) -> Here:
    """The hardware of the running daemon, or of the settings where none runs.

    Args:
        info: the daemon's word on itself, empty if none runs; store: of its tools; bus: address to listen at.

    Raises:
        UsageError: the settings cannot be read, or their robot is impossible.
    """
    from galen_hw.config.load import read_document
    from galen_hw.config.paths import config_path
    from galen_hw.config.problems import ConfigError, check
    from galen_hw.config.robot import build_robot
    from galen_hw.config.schema import Config, RobotSection

    document, places = read_document(config_path(info.get("config")))
    section, problems = check(RobotSection, document.get("robot", {}), ("robot",), places)
    if section is None:
        raise ConfigError(problems)
    # A device that is set up wrongly (`galen-hw check`) does not matter here.
    robot, virtual = build_robot(Config.model_construct(robot=section)), bool(info.get("virtual"))
    serial = _heard_serial(bus) if info else ""
    return Here(robot, serial or _stored_serial(store, virtual=virtual), virtual, bool(info))


def _heard_serial(bus: str) -> str:
    """Of the sensor on the bus; empty where it is silent."""
    from galen_hw.bus import Subscriber
    from galen_hw.messages import WrenchRaw

    with Subscriber(bus, ["wrench/raw"]) as subscriber:
        received = subscriber.receive(LISTEN_S)
    return received[1].serial_number if received is not None and isinstance(received[1], WrenchRaw) else ""


def _stored_serial(store: "ToolStore", *, virtual: bool) -> str:
    """Of the sensor of the newest calibration in use; empty where there is none."""
    from galen_hw.config.tool_file import Origin

    of_kind, found = replace(store, virtual=virtual), list[Origin]()
    for name in of_kind.names():
        try:
            origin = of_kind.load(name).origin
        except GalenError:
            continue  # A damaged file says nothing of the sensor.
        if origin is not None and origin.sensor_serial:
            found.append(origin)
    return max(found, key=lambda o: o.date).sensor_serial if found else ""


def refuse_foreign(tool: "ToolFile", here: Here, file: Path) -> None:
    """A calibration of another sensor or robot, which `--foreign` takes nevertheless.

    Raises:
        UsageError: it belongs to other hardware; one line with all that differs.
    """
    from galen_hw.config.tool_store import binding_problems

    problems = binding_problems(tool, sensor_serial=here.serial, robot=here.robot.name, virtual=here.virtual)
    if not problems:
        return
    todo = "calibrate it here, or --foreign"
    if not here.running and tool.origin is not None and tool.origin.virtual:
        todo = "start the virtual robot first (galen-hw run --virtual), or --foreign"
    raise UsageError(f"tool {tool.name!r} {' and '.join(problems)}", where=str(file), todo=todo)


def refuse_unservable(tool: "ToolFile", robot: "Robot", file: Path) -> None:
    """A tool that the compensation would refuse: it is built as there, and asked once; nothing forces it.

    Args:
        tool: from `file`; robot: that it would be used on.

    Raises:
        UsageError: an effect that this version does not know or cannot serve, a joint that is missing, a wrench that
            no sensor reads.
    """
    from galen_hw.config.tool_file import MAX_FORCE, MAX_TORQUE
    from galen_hw.messages import Vector3, WrenchRaw
    from galen_hw.services.compensation.model import CompensationModel

    if not tool.calibrated:
        return  # The store says that there is nothing to save.
    todo = "correct the file, or calibrate again"
    try:
        model = CompensationModel(tool, robot)
        q = [0.5 * float(a + b) for a, b in zip(robot.lower, robot.upper, strict=True)]
        turning = model.direction.joints
        order = [*turning, *(i for i in range(len(q)) if i not in turning)]
        at = model.predict([q[i] for i in turning])
        zero = Vector3(0.0, 0.0, 0.0)
        head: dict[str, Any] = {"timestamp": 0.0, "t_ns": 1, "seq": 0, "valid": True, "source": ""}
        found = model.add_terms(at, [q[i] for i in order], WrenchRaw(**head, force=zero, torque=zero))
    except GalenError as error:
        raise UsageError(f"{error.where}: {error.what}", where=str(file), todo=error.todo or todo) from error
    # An effect is made for what a diagnosis wrote, and asserts it: in a file by hand that is the file's fault.
    except (ArithmeticError, AssertionError, AttributeError, LookupError, TypeError, ValueError) as error:
        effects = ", ".join(dict.fromkeys(term.effect for term in tool.terms))
        raise UsageError(f"terms: {effects} cannot be applied ({error})", where=str(file), todo=todo) from error
    limits = (MAX_FORCE,) * 3 + (MAX_TORQUE,) * 3
    if not all(abs(x) <= limit for x, limit in zip(found, limits, strict=True)):  # NaN is not within any limit
        raise UsageError("predicts a wrench beyond any sensor's range", where=str(file), todo=todo)

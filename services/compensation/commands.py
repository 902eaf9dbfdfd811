"""The commands of the compensation: which tool, on or off, tare, contact point."""

from typing import Any, Final

from galen_hw.clock import NS_PER_S
from galen_hw.config.tool_file import ToolFile
from galen_hw.config.tool_store import ToolStore, binding_problems
from galen_hw.errors import CommandRejectedError, GalenError, WrongCommandError
from galen_hw.messages import CommandError, Reply, Request, WrenchRaw
from galen_hw.services.compensation.correction import Correction
from galen_hw.services.compensation.model import ZERO, Six
from galen_hw.services.compensation.settings import CompensationSettings
from galen_hw.services.compensation.tare import Tare
from galen_hw.services.service import Output

COMMANDS: Final = {
    # command: the arguments that it takes
    "select_tool": ("tool",),
    "set_enabled": ("enabled",),
    "tare": (),
    "untare": (),
    "set_contact": ("x", "y", "z"),
    "reload": (),
}
FARTHEST_CONTACT_M: Final = 2.0


class CompensationCommands:
    """Carries requests out on a `Correction`.

    Args:
        name: of the service; store: of the tools on this kind of hardware; robot: name of the configured robot.
    """

    def __init__(
        self, name: str, settings: CompensationSettings, correction: Correction, store: ToolStore, robot: str
    ) -> None:
        self.name, self._settings, self._correction, self._store, self._robot = name, settings, correction, store, robot
        self.tare: Tare | None = None
        self.serial = ""
        self.problem = self.todo = ""
        """Why no wrench can be valid, and what to do; empty when nothing is wrong."""

    def take_up_selected(self) -> None:
        """Use the tool that was in hand when the daemon last ran; what is wrong with it goes to `problem`."""
        try:
            selected = self._store.selected()
            if selected is not None:
                self.use(selected)
        except GalenError as error:
            self.problem, self.todo = error.problem, error.todo

    def carry_out(self, request: Request, now_ns: int) -> list[Output]:
        """Carry out a command; see the class.

        Raises:
            CommandRejectedError: not known, or not now.
            UsageError: no such tool, or impossible arguments.
        """
        args, name = request.args, request.name
        if name not in COMMANDS:
            raise WrongCommandError(f"no command {name!r}", where=self.name, todo=f"one of: {', '.join(COMMANDS)}")
        request.require_only(*COMMANDS[name])
        if name == "select_tool":
            return [Reply(id=request.id, result=self._select(args.get("tool", ...)))]
        if name == "reload":
            return [Reply(id=request.id, result=self._reload())]
        if name == "tare":
            return self._begin_tare(request, now_ns)
        if name == "untare":
            self._correction.set(tare=ZERO)
        elif name == "set_enabled":
            self._correction.set(enabled=_flag(args.get("enabled")))
        else:
            self._correction.set(contact=(_metres(args, "x"), _metres(args, "y"), _metres(args, "z")))
        return [Reply(id=request.id)]

    def use(self, tool: str) -> None:
        """Take a tool in hand.

        Raises:
            CommandRejectedError: never calibrated, or on another sensor or robot.
            UsageError: no such tool.
        """
        self._correction.use(self._usable(tool))
        self.problem = ""

    def _usable(self, tool: str) -> ToolFile:
        """The tool in use of this name, if it is one of this hardware; nothing is changed yet."""
        file = self._store.load(tool)
        if not file.calibrated:
            todo, here = f"galen-hw calibrate --tool {tool}", " on a virtual robot" if self._store.virtual else ""
            raise CommandRejectedError(f"tool {tool!r} was never calibrated{here}", where=self.name, todo=todo)
        problems = self._binding_problems(file)
        if problems:
            todo = f"galen-hw calibrate --tool {tool}"
            raise CommandRejectedError(f"tool {tool!r} {' and '.join(problems)}", where=self.name, todo=todo)
        return file

    def _binding_problems(self, file: ToolFile) -> list[str]:
        return binding_problems(file, sensor_serial=self.serial, robot=self._robot, virtual=self._store.virtual)

    def _select(self, tool: object) -> dict[str, Any]:
        if tool is not None and not isinstance(tool, str):
            raise CommandRejectedError("tool must be a name or null", where=self.name, todo='send {"tool": "NAME"}')
        file = None if tool is None else self._usable(tool)
        # First what can be refused (a disk that is full or may not be written), then what changes the wrench.
        self._store.select(tool)
        self._correction.use(file)
        self.problem = ""
        # A tare belongs to the tool that was in hand.
        self._correction.set(tare=ZERO)
        return self._identity()

    def _reload(self) -> dict[str, Any]:
        if self._correction.model is None:
            raise CommandRejectedError("no tool is selected", where=self.name, todo="select_tool first")
        contact = self._correction.contact
        own = contact != self._correction.model.tool.contact_point
        self.use(self._correction.model.tool.name)
        if own:
            self._correction.set(contact=contact)
        return self._identity()

    def _begin_tare(self, request: Request, now_ns: int) -> list[Output]:
        if self.tare is not None:
            raise CommandRejectedError("a tare is under way", where=self.name, todo="wait for its reply")
        until_ns = now_ns + round(self._settings.tare_timeout_s * NS_PER_S)
        self.tare = Tare(request.id, self._settings.tare_samples, until_ns)
        return []

    def _identity(self) -> dict[str, Any]:
        model = self._correction.model
        return {"tool": model.name if model else None, "calibration": model.calibration if model else ""}

    def check_serial(self, serial: str) -> None:
        """A calibration of another sensor must not be used, whenever its serial number becomes known."""
        self.serial, model = serial, self._correction.model
        if model is None:
            return  # Why the selected tool could not be taken up stays a problem.
        problems = self._binding_problems(model.tool)
        self.problem = f"tool {model.name!r} {' and '.join(problems)}" if problems else ""
        self.todo = f"galen-hw calibrate --tool {model.name}, or select another tool" if problems else ""

    def feed_tare(self, tare: Tare, raw: WrenchRaw, predicted: Six) -> list[Output]:
        """Add one valid sample to a running tare; its reply when there are enough."""
        a, b, c, d, e, f = predicted
        left = (
            raw.force.x - a,
            raw.force.y - b,
            raw.force.z - c,
            raw.torque.x - d,
            raw.torque.y - e,
            raw.torque.z - f,
        )
        if not tare.feed(left):
            return []
        self.tare = None
        if self._correction.unseen or self._correction.holds_offset(raw):
            # No sample was valid until now, and those that an offset fades out of must not be.
            self._correction.retare(tare.mean)
        else:
            self._correction.set(tare=tare.mean)
        return [Reply(id=tare.request_id, result={"tare": list(tare.mean), "std": list(tare.std)})]

    def abandon_tare(self, what: str) -> list[Output]:
        """Answer a running tare that cannot be finished."""
        tare, self.tare = self.tare, None
        if tare is None:
            return []
        error = CommandError(kind="fault", what=f"not tared: {what}", where=self.name, todo="tare again")
        return [Reply(id=tare.request_id, error=error)]

    def time_out(self, now_ns: int) -> list[Output]:
        """Give a tare up that takes too long."""
        tare = self.tare
        if tare is None or now_ns <= tare.until_ns:
            return []
        self.tare = None
        what = f"only {tare.count} of {tare.samples} valid samples came in time"
        error = CommandError(kind="timeout", what=what, where=self.name, todo="see galen-hw monitor")
        return [Reply(id=tare.request_id, error=error)]


def _flag(value: object) -> bool:
    if not isinstance(value, bool):
        raise CommandRejectedError("enabled must be true or false", todo='send {"enabled": true}')
    return value


def _metres(args: dict[str, Any], key: str) -> float:
    value = args.get(key)
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not abs(value) <= FARTHEST_CONTACT_M:
        what = f"{key} must be a number of metres within {FARTHEST_CONTACT_M} of the sensor, not {value!r}"
        raise CommandRejectedError(what, todo="send x, y, z in the sensor frame")
    return float(value)

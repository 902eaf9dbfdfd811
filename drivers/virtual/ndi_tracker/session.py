"""Commands of the virtual tracker and the modes in which they are valid."""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Final, Literal

from galen_hw.drivers.virtual.ndi_tracker import replies
from galen_hw.drivers.virtual.ndi_tracker.ports import Ports
from galen_hw.drivers.virtual.ndi_tracker.scene import Scene
from galen_hw.drivers.virtual.ndi_tracker.wire import (
    INVALID_COMMAND,
    NOT_INITIALISED,
    OUT_OF_RANGE,
    WRONG_MODE,
    Command,
    LineSettings,
    NdiError,
    text_reply,
)

Mode = Literal["reset", "setup", "tracking"]
_ALWAYS: Final = {"INIT", "COMM", "VER", "GETINFO", "BEEP", "RESET", "APIREV"}
_SETUP_ONLY: Final = {"PHRQ", "PVWR", "PINIT", "PENA", "PDIS", "PHF", "TSTART"}
_TRACKING_ONLY: Final = {"TX", "BX", "TSTOP"}


@dataclass(frozen=True, slots=True)
class Identity:
    """What the tracker says of itself."""

    model: str = "Polaris Spectra"
    revision: str = "010"
    serial_number: str = "P6-00123"

    def version(self, part: str) -> str:
        """VER: 0 the control firmware, 4 and 5 the combined revision."""
        if part in {"4", "5"}:
            return self.revision
        if part not in {"0", "3"}:
            raise NdiError(OUT_OF_RANGE)
        return (
            f"{self.model} Control Firmware\nNDI S/N: {self.serial_number}\nCharacterization Date: 03/24/25\n"
            f"Freeze Tag: {self.model} {self.revision}\nFreeze Date: 11/02/24\n(C) Northern Digital Inc.\n"
        )

    def feature(self, name: str) -> str:
        """GETINFO: value; type; attribute; minimum; maximum; enumeration; description."""
        features = {
            "Features.Firmware.Version": f"{self.revision}.000.012;3;1;0;12;;Current firmware revision number",
            "Info.Status.System Mode": "Normal;3;1;0;30;;Current system mode",
        }
        if name not in features:
            raise NdiError(OUT_OF_RANGE)
        return f"{name}={features[name]}"


@dataclass
class Session:
    """The state that commands change.

    Args:
        scene: what the camera sees; identity: what it says of itself.
    """

    scene: Scene
    identity: Identity
    mode: Mode = "reset"
    line: LineSettings = field(default_factory=LineSettings)
    ports: Ports = field(default_factory=Ports)
    system_status: int = 0

    def power_up(self, now_ns: int) -> None:
        """As after power-up or a break: default line, no handles, frames from 0."""
        self.mode, self.line = "reset", LineSettings()
        self.ports.clear()
        self.scene.origin_ns = now_ns

    def carry_out(self, command: Command, now_ns: int) -> bytes:
        """The reply to a command.

        Raises:
            NdiError: it is answered with ERRORnn.
        """
        name, parameters = command.name, command.parameters
        if name == "TX":
            return text_reply(replies.text(self.ports, self.scene, *self._frame(name, parameters, now_ns)))
        if name == "BX":
            return replies.binary(self.ports, self.scene, *self._frame(name, parameters, now_ns))
        handler = self._handlers().get(name)
        if handler is None:
            raise NdiError(INVALID_COMMAND)
        self._check_mode(name)
        if name == "TSTART":
            return text_reply(self._start(parameters, now_ns))
        return text_reply(handler(parameters))

    def _handlers(self) -> dict[str, Callable[[str], str]]:
        ports = self.ports
        return {
            "INIT": self._init,
            "COMM": self._comm,
            "VER": lambda p: self.identity.version(p or "0"),
            "APIREV": lambda _: "G.003.004",
            "GETINFO": self.identity.feature,
            "BEEP": lambda _: "1",
            "PHSR": ports.search,
            "PHF": ports.free,
            "PHRQ": ports.request,
            "PVWR": ports.write,
            "PINIT": ports.initialise,
            "PENA": ports.enable,
            "PDIS": ports.disable,
            "PHINF": ports.information,
            "TSTART": lambda _: "OKAY",
            "TSTOP": self._stop,
        }

    def _check_mode(self, name: str) -> None:
        if name in _ALWAYS:
            return
        if self.mode == "reset":
            raise NdiError(NOT_INITIALISED)
        if (name in _SETUP_ONLY and self.mode != "setup") or (name in _TRACKING_ONLY and self.mode != "tracking"):
            raise NdiError(WRONG_MODE)

    def _frame(self, name: str, parameters: str, now_ns: int) -> tuple[int, int, int]:
        self._check_mode(name)
        options = replies.options_of(parameters)
        return self.scene.latest(now_ns), options, self.system_status

    def _init(self, _parameters: str) -> str:
        self.mode = "setup"
        self.ports.clear()
        return "OKAY"

    def _comm(self, parameters: str) -> str:
        self.line = LineSettings.from_digits(parameters)
        return "OKAY"

    def _start(self, parameters: str, now_ns: int) -> str:
        """TSTART; 80 lets the frames count from 0 again."""
        if parameters not in {"", "20", "40", "80"}:
            raise NdiError(OUT_OF_RANGE)
        if parameters == "80":
            self.scene.origin_ns = now_ns
        self.mode = "tracking"
        return "OKAY"

    def _stop(self, _parameters: str) -> str:
        self.mode = "setup"
        return "OKAY"

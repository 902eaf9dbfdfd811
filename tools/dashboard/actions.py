"""What the buttons do: requests to the daemon, answered in an operator's words."""

from contextlib import suppress
from pathlib import Path
from typing import Any, Final, TypeAlias

from galen_hw.bus import CommandClient
from galen_hw.config.paths import Addresses
from galen_hw.config.tool_store import ToolStore
from galen_hw.errors import GalenError
from galen_hw.tools.dashboard import frames
from galen_hw.tools.dashboard.calibration import Calibration

STOP_S: Final = 1.0
ANSWER_S: Final = 15.0
MOST_TOOLS: Final = 24
MOST_REPORTS: Final = 12
SENSOR: Final = "ft"
MOTORS: Final = "motors"
Call: TypeAlias = tuple[str, str, dict[str, Any]]


class Actions:
    """Carries out the frames of pages that may command.

    Args:
        addresses: of the daemon; calibration: the one that pages lead.
    """

    def __init__(self, addresses: Addresses, calibration: Calibration) -> None:
        self._addresses, self._calibration = addresses, calibration

    def carry_out(self, frame: frames.Frame, page: object) -> str:
        """Do it; what was done, in words.

        Raises:
            GalenError: it was refused, or nobody answers.
        """
        if isinstance(frame, frames.Stop):
            return self.stop()
        wanted = requests_of(frame)
        if wanted is None:
            return self._calibrate(frame, page)
        calls, text = wanted
        for target, name, args in calls:
            self._call(target, name, **args)
        return text

    def _calibrate(self, frame: frames.Frame, page: object) -> str:
        match frame:
            case frames.Calibrate(tool=tool):
                self._calibration.start(tool, page)
                return f"Calibrating {tool}"
            case frames.GoOn():
                self._calibration.go_on()
            case frames.Decide(accept=accept):
                self._calibration.decide(accept=accept)
            case frames.Abort():
                self._calibration.abort()
                return "Aborted"
        return ""

    def stop(self) -> str:
        """Motors first, then whatever would move them again; what fails of the rest is no reason to say "not stopped".

        Raises:
            GalenError: the motors did not answer.
        """
        failed: GalenError | None = None
        try:
            self._call(MOTORS, "stop", STOP_S)
        except GalenError as error:
            failed = error
        self._calibration.abort("stopped")
        for target, name, args in (("calibration", "stop", {}), ("admittance", "set_enabled", {"enabled": False})):
            with suppress(GalenError):
                self._call(target, name, STOP_S, **args)
        with suppress(GalenError):  # whatever moved meanwhile
            self._call(MOTORS, "stop", STOP_S)
        if failed is not None:
            raise failed
        return "Stopped"

    def _call(self, target: str, name: str, timeout_s: float = ANSWER_S, /, **args: Any) -> dict[str, Any]:
        self._addresses.require_daemon()
        with CommandClient(self._addresses.command) as client:
            return client.call(target, name, args, timeout_s)


def requests_of(frame: frames.Frame) -> tuple[list[Call], str] | None:
    """The requests (target, name, arguments) that a button stands for, and what to say when they are done."""
    match frame:
        case frames.Select(tool=tool):
            calls: list[Call] = [("compensation", "select_tool", {"tool": tool})]
            text = f"{tool} is in hand" if tool else "No tool in hand"
        case frames.Enable(on=on):
            calls, text = [("compensation", "set_enabled", {"enabled": on})], f"Compensation is {'on' if on else 'off'}"
        case frames.Tare():
            calls, text = [("compensation", "tare", {})], "Tared"
        case frames.Untare():
            calls, text = [("compensation", "untare", {})], "The tare is taken back"
        case frames.Zero():
            calls, text = [(SENSOR, "zero", {})], "The sensor is zeroed"
        case frames.Motors():
            calls, text = [(MOTORS, "clear_fault", {}), (MOTORS, "enable", {})], "The motors are on"
        case _:
            return None
    return calls, text


def tools(info: dict[str, Any]) -> list[dict[str, Any]]:
    """The tools of the daemon's store: name, whether and when calibrated, mass; empty where they cannot be read."""
    if not info:
        return []
    store, found = ToolStore(Path(info["state_dir"]), virtual=bool(info["virtual"])), []
    with suppress(GalenError, OSError):
        for name in store.names()[:MOST_TOOLS]:
            row: dict[str, Any] = {"name": name, "calibrated": False}
            try:
                file = store.load(name)
            except GalenError as error:
                row["problem"] = str(error)
            else:
                row |= {"calibrated": file.calibrated, "mass_g": 1e3 * file.mass if file.mass is not None else None}
                row["date"] = file.origin.date if file.origin else ""
            found.append(row)
    return found


def reports(info: dict[str, Any]) -> list[dict[str, Any]]:
    """The newest report pages of the state directory: name, link below /reports/, time in s since the epoch."""
    if not info:
        return []
    found = []
    with suppress(OSError):
        for page in (Path(info["state_dir"]) / "reports").glob("*/*.html"):
            with suppress(OSError):
                at = page.stat().st_mtime
                found.append({"name": page.parent.name, "link": f"{page.parent.name}/{page.name}", "at": at})
    return sorted(found, key=lambda report: -float(str(report["at"])))[:MOST_REPORTS]


def report_file(info: dict[str, Any], folder: str, name: str) -> Path | None:
    """The file of a report that a page may be given; None if there is none of that name."""
    if not info:
        return None
    root = (Path(info["state_dir"]) / "reports").resolve()
    path = (root / folder / name).resolve()
    plain = path.parent.parent == root and path.suffix in (".html", ".png", ".svg", ".json")
    return path if plain and path.is_file() else None

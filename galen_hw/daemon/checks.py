"""Every problem of a set-up at once, as a tree: settings, devices, tools, machine."""

import ctypes
import math
import os
import shutil
import tempfile
import time
from collections.abc import Iterable
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Final

from pydantic import ValidationError

from galen_hw.config.load import Setup
from galen_hw.config.problems import Problem, unknown
from galen_hw.config.robot import build_robot
from galen_hw.config.schema import Config, RobotSection
from galen_hw.config.tool_store import ToolStore, binding_problems
from galen_hw.daemon.layout import MOTORS, SENSOR, TRACKER
from galen_hw.daemon.machine import joint_problems, robot_notes
from galen_hw.daemon.probe import QUIET_TOPICS, Seen, nominal_hz
from galen_hw.errors import EXIT_FOUND, EXIT_HARDWARE, EXIT_OK, EXIT_USAGE, UsageError
from galen_hw.messages import TOPICS

OK, NOTE, PROBLEM = "ok", "note", "problem"
RATE_TOLERANCE: Final = 0.1
OLD_AFTER_DAYS: Final = 90.0
LITTLE_DISK: Final = 1 << 30
KEPT: Final = ("tools", "services", "sweeps", "reports")
"""Folders of the state directory."""
_CLOCK_UNSYNCHRONISED: Final = 5
_WORRYING: Final = ("error", "bus_off", "overrun", "malformed", "unsent", "short", "reopened")


@dataclass
class Finding:
    """A line of the tree and what hangs below it.

    Args:
        name, text, todo: what was looked at, what was found, what to do.
        state: "ok", "note" (worth knowing) or "problem".
        exit_code: of the command if this is a problem.
    """

    name: str
    text: str = ""
    state: str = OK
    todo: str = ""
    exit_code: int = EXIT_FOUND
    below: list["Finding"] = field(default_factory=list)

    def all(self) -> Iterable["Finding"]:
        """This one and everything below."""
        yield self
        for finding in self.below:
            yield from finding.all()

    def as_dict(self) -> dict[str, Any]:
        """For JSON."""
        own = {"name": self.name, "state": self.state, "text": self.text, "todo": self.todo}
        return {**own, "below": [f.as_dict() for f in self.below]}


def exit_status(root: Finding) -> int:
    """0 without problems; else wrong settings (2) before hardware (3) before the rest (1)."""
    found = {f.exit_code for f in root.all() if f.state == PROBLEM}
    return next((code for code in (EXIT_USAGE, EXIT_HARDWARE, EXIT_FOUND) if code in found), EXIT_OK)


def check_settings(path: Path, problems: list[Problem]) -> Finding:
    """The settings file."""
    below = [
        Finding(p.where.partition(": ")[0], f"{p.where.partition(': ')[2]}: {p.what}", PROBLEM, p.todo, EXIT_USAGE)
        for p in problems
    ]
    return Finding("settings", str(path), below=below)


def check_robot(document: dict[str, Any], setup: Setup) -> Finding:
    """The robot of a settings file, built as the daemon builds it: a URDF and its links are read, not just named.

    Below it: joints that no motor has, and what is odd about the model.
    """
    try:
        section = RobotSection.model_validate(document.get("robot", {}))
        robot = build_robot(Config.model_construct(robot=section))
    except ValidationError:
        return Finding("robot", "cannot be built from these settings", NOTE, "correct the settings first")
    except UsageError as error:
        text = f"{error.where}: {error.what}" if error.where else error.what
        return Finding("robot", text, PROBLEM, error.todo, EXIT_USAGE)
    found = [Finding("joints", p.what, PROBLEM, p.todo, EXIT_USAGE) for p in joint_problems(robot, setup)]
    # The daemon weighs no links: what they lack matters to a diagnosis of efforts alone.
    found += [Finding("model", f"{p.where}: {p.what}", NOTE, p.todo) for p in robot_notes(robot, setup)]
    return Finding("robot", f"{section.name}: {', '.join(robot.joint_names)}", below=found)


def check_names(names: Iterable[str]) -> list[Finding]:
    """Devices that nothing is made of: services ask for theirs by name, so that a slip leaves them without."""
    known = (SENSOR, MOTORS, TRACKER)
    what = "no service uses a device of this name"
    return [Finding(name, what, NOTE, unknown(name, known)) for name in names if name not in known]


def check_device(name: str, setup: Setup, seen: Seen) -> Finding:
    """One device: its wire, whether it is the right one, its rates, its sample quality."""
    device = setup.devices[name]
    finding = Finding(name, type_name(device.driver))
    trouble = NOTE if device.optional else PROBLEM
    if seen.wire != "open":
        what, where, todo = seen.error or ("could not be opened in time", "", "see whether another program holds it")
        finding.below = [Finding("port", f"{where}: {what}" if where else what, trouble, todo, EXIT_HARDWARE)]
        return finding
    finding.below.append(Finding("port", "open"))
    if not seen.ready:
        faults = list(seen.faults.values())
        what, todo = seen.detail, ""
        if faults:
            what, todo = faults[-1].what, faults[-1].todo
        elif seen.error is not None:
            what, todo = seen.error[0], seen.error[2]
        text = what or "does not answer"
        todo = todo or "is it switched on, connected, and the right device?"
        finding.below.append(Finding("answer", text, trouble, todo, EXIT_HARDWARE))
        return finding
    finding.below.append(Finding("answer", seen.detail or "answers"))
    for topic, rate in sorted(seen.rates_hz().items()):
        if topic not in QUIET_TOPICS:
            nominal = nominal_hz(device, topic, TOPICS[topic].rate_hz)
            # A virtual robot shares this machine's cores: its rate says nothing about a wire.
            finding.below.append(_rate(topic, rate, nominal, NOTE if setup.virtual else PROBLEM))
    finding.below += _quality(seen)
    return finding


def type_name(driver: type[Any]) -> str:
    """A driver's name for people."""
    return driver.__name__


def _rate(topic: str, rate: float, nominal: float, trouble: str) -> Finding:
    text = f"{rate:.1f} Hz, nominal {nominal:g} Hz"
    if rate >= (1.0 - RATE_TOLERANCE) * nominal:
        return Finding(topic, text)
    return Finding(topic, text, trouble, "check the wire's bit rate, other traffic on it, and this machine's load")


def _quality(seen: Seen) -> list[Finding]:
    found = []
    samples = seen.counts.get("wrench/raw", 0)
    if seen.saturated:
        text = f"{seen.saturated} of {samples} samples"
        found.append(
            Finding("saturation", text, PROBLEM, "take the load off the sensor; if it stays, it is overloaded")
        )
    elif samples:
        found.append(Finding("saturation", "none"))
    if seen.invalid:
        found.append(Finding("validity", f"{seen.invalid} samples not valid", PROBLEM, "see the device's status word"))
    worries = {k: n for k, n in seen.counters.items() if n and any(word in k for word in _WORRYING)}
    if worries:
        text = ", ".join(f"{name} {n}" for name, n in worries.items())
        found.append(Finding("wire", text, NOTE, "check cable, termination and bit rate if this grows"))
    found += [Finding("fault", fault.what, NOTE, fault.todo) for fault in seen.faults.values()]
    return found


def check_tools(setup: Setup, state_dir: Path, sensor_serial: str) -> Finding:
    """The tools' files: readable, possible, calibrated, on this hardware, not long ago."""
    store = ToolStore(state_dir, virtual=setup.virtual)
    finding = Finding("tools", str(state_dir))
    try:
        selected, names = store.selected(), store.names()
    except UsageError as error:
        return Finding("tools", str(error), PROBLEM, error.todo)
    text = selected or "none: the wrench holds the tool's weight"
    todo = "" if selected else "galen-hw tool select NAME"
    finding.below.append(Finding("selected", text, OK if selected else NOTE, todo))
    for name in names:
        finding.below.append(_tool(store, name, setup.config.robot.name, sensor_serial, selected == name))
    return finding


def _tool(store: ToolStore, name: str, robot: str, sensor_serial: str, selected: bool) -> Finding:
    trouble = PROBLEM if selected else NOTE
    again = f"galen-hw calibrate --tool {name}"
    try:
        tool = store.load(name)
    except UsageError as error:
        return Finding(name, str(error), PROBLEM, error.todo)
    if tool.origin is None:
        here = " on a virtual robot" if store.virtual else ""
        return Finding(name, f"never calibrated{here}", trouble, again)
    wrong = binding_problems(tool, sensor_serial=sensor_serial, robot=robot, virtual=store.virtual)
    if wrong:
        return Finding(name, "; ".join(wrong), trouble, again)
    days = _age_days(tool.origin.date)
    text = f"calibrated {tool.origin.date}" + (f", {_ago(days)}" if math.isfinite(days) else "")
    if days > OLD_AFTER_DAYS:
        return Finding(name, text, NOTE, again)
    return Finding(name, text)


def _ago(days: float) -> str:
    whole = math.floor(max(days, 0.0))
    return f"{whole} days ago" if whole > 1 else ("a day ago" if whole == 1 else "less than a day ago")


def _age_days(date: str) -> float:
    try:
        when = datetime.fromisoformat(date)
    except ValueError:
        return math.inf
    return (datetime.now(UTC) - (when if when.tzinfo else when.replace(tzinfo=UTC))).total_seconds() / 86400.0


def check_machine(setup: Setup, state_dir: Path) -> Finding:
    """Disk, clock and real-time priority."""
    below = [_disk(state_dir), _clock()]
    if setup.config.daemon.realtime_priority:
        text = "permitted" if _may_be_realtime() else "not permitted: the loop runs at ordinary priority"
        permitted = _may_be_realtime()
        below.append(
            Finding("real time", text, OK if permitted else NOTE, "" if permitted else "LimitRTPRIO in the unit")
        )
    return Finding("machine", os.uname().nodename, below=below)


def _disk(state_dir: Path) -> Finding:
    there = next(p for p in (state_dir, *state_dir.absolute().parents) if p.exists())
    # Below it there may be folders that another user has made, e.g. root before the service ran.
    for folder in (there, *(p for name in KEPT if there == state_dir and (p := state_dir / name).exists())):
        if (why := _not_writable(folder)) is not None:
            text = f"{folder} cannot be written ({why})"
            return Finding("disk", text, PROBLEM, "check its owner and its disk, or set GALEN_HW_STATE")
    free = shutil.disk_usage(there).free
    text = f"{free / 1e9:.1f} GB free at {there}"
    return (
        Finding("disk", text) if free > LITTLE_DISK else Finding("disk", text, PROBLEM, "make room: recordings need it")
    )


def _not_writable(folder: Path) -> str | None:
    """Why no file can be made there, found by making one that leaves no trace; None if it can."""
    try:
        with tempfile.TemporaryFile(dir=folder):
            return None
    except OSError as error:
        return error.strerror or str(error)


def _clock() -> Finding:
    if time.time() < datetime(2024, 1, 1, tzinfo=UTC).timestamp():
        return Finding(
            "clock", f"says {datetime.now(UTC):%Y-%m-%d}", PROBLEM, "set the clock: recordings are dated by it"
        )
    buffer = ctypes.create_string_buffer(256)  # struct timex, all zero: only read
    if ctypes.CDLL(None).adjtimex(buffer) == _CLOCK_UNSYNCHRONISED:
        return Finding("clock", "not synchronised", NOTE, "start a time service if recordings of machines are compared")
    return Finding("clock", "synchronised")


def _may_be_realtime() -> bool:
    """Tried in a child, so that this process stays as it is."""
    pid = os.fork()
    if pid == 0:
        try:
            os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(1))
        except OSError:
            os._exit(1)
        os._exit(0)
    return os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1]) == 0

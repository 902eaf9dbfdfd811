"""The operator's side of a sweep: starts it over the bus, shows how it goes, and stops the robot on the way out."""

import sys
import threading
import time
import uuid
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any, Final, Self

from rich.console import Console
from rich.progress import BarColumn, Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

from galen_hw.bus import CommandClient, Subscriber
from galen_hw.config.paths import Addresses
from galen_hw.errors import CommandRejectedError, GalenError, HardwareError
from galen_hw.messages import CalibrationProgress

SILENT_S: Final = 2.0
"""Without progress, which comes five times a second, the service is gone; where it ends in order, it says so itself."""
SIMULATED_SILENT_S: Final = 20.0
"""The same where five times a second is of simulated time, which a busy machine makes at a tenth of the clock's pace."""
HEARTBEAT_S: Final = 0.2
ANSWER_S: Final = 0.3
STOP_S: Final = 1.0


class Heartbeat:
    """Tells the calibration service, from a thread, that its client lives; the robot stops when this ends early.

    Args:
        address: of the daemon's command socket; owner: the word given with `start`.
    """

    def __init__(self, address: str, owner: str) -> None:
        self._address, self._owner = address, owner
        self._end = threading.Event()
        self._thread = threading.Thread(target=self._beat, daemon=True)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._end.set()
        self._thread.join(timeout=5.0)

    def _beat(self) -> None:
        with CommandClient(self._address) as client:
            while not self._end.wait(HEARTBEAT_S):
                with suppress(GalenError):
                    client.call("calibration", "heartbeat", {"owner": self._owner}, ANSWER_S)


@dataclass(frozen=True)
class Operator:
    """Who puts the tool on.

    Args:
        bare: called once the sweep is accepted, before it moves: no tool may be on; tool: called when the tool is to be put on.
    """

    bare: Callable[[], None]
    tool: Callable[[], None]


def run_sweep(
    addresses: Addresses, tool: str, overrides: dict[str, Any], operator: Operator, console: Console
) -> tuple[Path, str]:
    """Run a sweep to its end or to what stopped it.

    Returns:
        Folder of the raw sweep, and why it stopped early (empty if it did not).

    Raises:
        CommandRejectedError: it cannot be started. HardwareError: the daemon is gone.
        KeyboardInterrupt: Ctrl-C; the robot has been stopped.
    """
    owner = uuid.uuid4().hex
    with (
        Subscriber(addresses.bus, ("calibration/progress",)) as subscriber,
        CommandClient(addresses.command) as client,
        Heartbeat(addresses.command, owner),
        _stopping(client, owner),
    ):
        # Held: whoever is refused because another sweep runs has asked nobody to touch the sensor.
        started = _start(client, {"tool": tool, "kind": "sweep", "owner": owner, "hold": True, **overrides})
        operator.bare()
        client.call("calibration", "resume")
        reason = _follow(subscriber, client, operator, console, started)
    return Path(started["sweep"]), reason


def run_check(addresses: Addresses, tool: str, console: Console) -> None:
    """Run the slow motion that checks the compensation to its end.

    Raises:
        HardwareError: it was stopped, with the reason.
    """
    nobody, owner = Operator(lambda: None, lambda: None), uuid.uuid4().hex
    with (
        Subscriber(addresses.bus, ("calibration/progress",)) as subscriber,
        CommandClient(addresses.command) as client,
        Heartbeat(addresses.command, owner),
        _stopping(client, owner),
    ):
        started = _start(client, {"tool": tool, "kind": "check", "owner": owner})
        reason = _follow(subscriber, client, nobody, console, started)
    if reason:
        raise HardwareError(reason, where="check of the compensation")


def _start(client: CommandClient, args: dict[str, Any]) -> dict[str, Any]:
    """Start, waiting for samples that have just begun to flow."""
    until = time.monotonic() + 5.0
    while True:
        try:
            return client.call("calibration", "start", args)
        except CommandRejectedError as error:
            if "no samples" not in error.what or time.monotonic() > until:
                raise
            time.sleep(0.2)


@contextmanager
def _stopping(client: CommandClient, owner: str) -> Iterator[None]:
    """Stop the robot if the block does not end by itself; only a sweep of ours, never another client's."""
    try:
        yield
    except BaseException:
        with suppress(GalenError):
            client.call("calibration", "stop", {"owner": owner}, STOP_S)
        raise


def patience(info: dict[str, Any]) -> float:
    """Return how long the service may say nothing, s, for a daemon that tells this of itself."""
    return SILENT_S if info.get("speed", 1.0) == 1.0 else SIMULATED_SILENT_S


def _follow(
    subscriber: Subscriber, client: CommandClient, operator: Operator, console: Console, started: dict[str, Any]
) -> str:
    """Show progress until the end; why it stopped early, or empty."""
    info = client.call("daemon", "info")
    patience_s = patience(info)
    with Display(console, int(started["poses"]), float(info.get("speed", 1.0))) as display:
        heard, resumed = time.monotonic(), False
        while True:
            received = subscriber.receive(0.2)
            if received is None or not isinstance(received[1], CalibrationProgress):
                if time.monotonic() - heard > patience_s:
                    raise HardwareError("the calibration service is silent", where="bus", todo="galen-hw monitor")
                continue
            heard, message = time.monotonic(), received[1]
            if message.t_ns < started["began_ns"]:
                continue  # of the sweep before ours
            display.update(message)
            if message.state in ("done", "stopped"):
                return "" if message.state == "done" else message.detail
            if message.state == "waiting" and not resumed:
                resumed = True
                display.pause()
                operator.tool()
                client.call("calibration", "resume")
                display.resume()
                heard = time.monotonic()


class Display:
    """A bar on a terminal, a line every ten poses elsewhere.

    Args:
        console: where; poses: how many there are; speed: of the robot's time, in which the time left is told.
    """

    def __init__(self, console: Console, poses: int, speed: float = 1.0) -> None:
        self._console, self._poses, self._speed, self._shown = console, poses, speed, -10
        columns = (
            SpinnerColumn(),
            TextColumn("[bold]{task.fields[state]:<9}[/]"),
            BarColumn(bar_width=32),
            TextColumn("{task.completed:>3.0f}/{task.total:.0f} poses"),
            TimeElapsedColumn(),
            TextColumn("[cyan]{task.fields[left]}[/]"),
            TextColumn("[dim]{task.fields[detail]}[/]"),
        )
        self._bar = Progress(*columns, console=console) if console.is_terminal else None
        self._task = self._bar.add_task("", total=poses, state="", left="", detail="") if self._bar else None

    def __enter__(self) -> Self:
        self.resume()
        return self

    def __exit__(self, *_: object) -> None:
        self.pause()

    def pause(self) -> None:
        """Leave the terminal to others."""
        if self._bar is not None:
            self._bar.stop()

    def resume(self) -> None:
        """Show again."""
        if self._bar is not None:
            self._bar.start()

    def update(self, message: CalibrationProgress) -> None:
        """Show where the sweep stands."""
        ended = message.state in ("done", "stopped")
        done = message.pose if message.state == "done" else max(message.pose - 1, 0)
        left = "" if ended else f"{_clock(message.remaining_s / self._speed)} left"
        detail = "" if ended else message.detail
        if self._bar is not None and self._task is not None:
            self._bar.update(self._task, completed=done, state=message.state, left=left, detail=detail)
        elif ended or done >= self._shown + 10:
            self._shown = done
            self._console.print(f"  {message.state:<9} {done:>3}/{self._poses} poses  {left}", highlight=False)


def _clock(seconds: float) -> str:
    whole = round(seconds)
    return f"{whole // 60}:{whole % 60:02d}"


def by_hand(console: Console, tool: str, addresses: Addresses, *, ask: bool) -> Operator:
    """A person at the robot; without `ask` the tool is felt by its weight instead of waiting for Enter."""

    def bare() -> None:
        if ask:
            _enter(console, "Take any tool off the sensor, keep hands and cables clear. The robot will move.")

    def put_on() -> None:
        if ask:
            _enter(console, f"Put the {tool} on, then keep clear.")
        else:
            console.print(f"put the {tool} on; its weight is waited for ...")
            _feel(addresses)

    return Operator(bare, put_on)


def _enter(console: Console, text: str) -> None:
    console.print(f"[bold yellow]{text}[/] Enter to go on, Ctrl-C to stop.")
    if not sys.stdin.isatty():
        raise CommandRejectedError("nobody can be asked: the input is not a terminal", todo="add --yes")
    sys.stdin.readline()


def _feel(addresses: Addresses) -> None:
    """Return when the force has changed by more than 0.15 N and has been steady for two seconds."""
    from galen_hw.messages import WrenchRaw

    with Subscriber(addresses.bus, ("wrench/raw",)) as subscriber:
        first: float | None = None
        level, since = 0.0, time.monotonic()
        while True:
            received = subscriber.receive(1.0)
            if received is None or not isinstance(received[1], WrenchRaw):
                continue
            force = received[1].force
            size = (force.x**2 + force.y**2 + force.z**2) ** 0.5
            first = size if first is None else first
            if abs(size - level) > 0.1:
                level, since = size, time.monotonic()
            if abs(level - first) > 0.15 and time.monotonic() - since > 2.0:
                return


def by_virtual_hand(console: Console, tool: str, folder: Path) -> Operator:
    """The virtual robot's own hand."""
    from galen_hw.drivers.virtual.control import VirtualControl

    def attach(name: str | None) -> None:
        with VirtualControl(folder) as control:
            control.attach_tool(name)

    def put_on() -> None:
        attach(tool)
        console.print(f"[dim]virtual hand: the {tool} is on[/]")

    return Operator(lambda: attach(None), put_on)

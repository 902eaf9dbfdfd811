"""`galen-hw monitor`: what flows on the bus: rates, ages, losses, validity, the wrench, and how everything is doing."""

import argparse
import json
import math
import sys
import time
from collections import deque
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from galen_hw.errors import EXIT_FOUND, EXIT_OK, UsageError

if TYPE_CHECKING:
    from rich.console import Group
    from rich.table import Table

    from galen_hw.bus import Subscriber
    from galen_hw.messages import Message, Status

WINDOW_S: Final = 2.0
BAR_WIDTH: Final = 21
FULL_SCALE: Final = {"force": 10.0, "torque": 1.0}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of the command."""
    parser.add_argument("--once", action="store_true", help="listen for --seconds, print, and end")
    parser.add_argument("--seconds", type=float, default=WINDOW_S, metavar="S", help="how long --once listens")
    parser.add_argument("--json", action="store_true", help="JSON, one object each time (with --once: one object)")
    parser.add_argument("--dir", metavar="RUNTIME", type=Path, help="runtime directory of the daemon")
    parser.epilog = "example: galen-hw monitor --once --json"


def run(args: argparse.Namespace) -> int:
    """Show until Ctrl-C, or once; with --once, 1 when nothing was heard."""
    from galen_hw.bus import Subscriber
    from galen_hw.config.paths import Addresses, client_runtime_dir

    if not 0.0 < args.seconds <= 3600.0:
        raise UsageError("must be between 0 and 3600", where="--seconds", todo="e.g. --seconds 2")
    addresses = Addresses(args.dir or client_runtime_dir())
    addresses.require_daemon()
    view = View()
    with Subscriber(addresses.bus) as subscriber:
        if args.once:
            view.listen(subscriber, args.seconds)
            _print_once(view, subscriber, as_json=args.json)
            return EXIT_OK if view.topics else EXIT_FOUND
        if args.json:
            while True:
                view.listen(subscriber, 1.0)
                print(json.dumps(view.as_json(subscriber.lost)), flush=True)
        return _live(view, subscriber)


@dataclass
class TopicView:
    """What has been heard of one topic within the last seconds."""

    message: "Message"
    times: "deque[float]" = field(default_factory=deque)
    messages: int = 0
    valid: int = 0


class View:
    """What has been heard of every topic, and the last status of each source."""

    def __init__(self) -> None:
        self.topics: dict[str, TopicView] = {}
        self.statuses: dict[str, Status] = {}
        self.last_fault = ""
        self._since = time.monotonic()

    def listen(self, subscriber: "Subscriber", seconds: float) -> None:
        """Take what comes for so long."""
        until = time.monotonic() + seconds
        while (left := until - time.monotonic()) > 0:
            received = subscriber.receive(left)
            if received is not None:
                self.take(*received, now=time.monotonic())

    def take(self, topic: str, message: "Message", now: float) -> None:
        """Count one message."""
        from galen_hw.messages import Fault, Status

        seen = self.topics.setdefault(topic, TopicView(message))
        seen.message = message
        seen.messages += 1
        seen.valid += message.valid
        seen.times.append(now)
        while seen.times[0] < now - WINDOW_S:
            seen.times.popleft()
        if isinstance(message, Status):
            self.statuses[message.source] = message
        elif isinstance(message, Fault):
            self.last_fault = f"{message.where or message.source}: {message.what}; {message.todo}".rstrip("; ")

    def rate_hz(self, topic: str, now: float) -> float:
        """Messages a second over the window."""
        recent = [t for t in self.topics[topic].times if t > now - WINDOW_S]
        return len(recent) / max(1e-3, min(WINDOW_S, now - self._since))

    def as_json(self, lost: dict[str, int]) -> dict[str, Any]:
        """Everything, for scripts; numbers that are not finite become null."""
        import msgspec

        now, now_ns = time.monotonic(), time.monotonic_ns()
        topics = {
            name: {
                "rate_hz": round(self.rate_hz(name, now), 2),
                "age_s": round((now_ns - seen.message.t_ns) / 1e9, 6),
                "messages": seen.messages,
                "lost": lost.get(name, 0),
                "valid": seen.message.valid,
                "valid_share": round(seen.valid / seen.messages, 4),
                "last": _finite(msgspec.to_builtins(seen.message)),
            }
            for name, seen in sorted(self.topics.items())
        }
        status = {name: _finite(msgspec.to_builtins(s)) for name, s in sorted(self.statuses.items())}
        return {"topics": topics, "status": status, "last_fault": self.last_fault}

    def render(self, lost: dict[str, int]) -> "Group":
        """Tables for people."""
        from rich.console import Group

        parts: list[Any] = [self._topics_table(lost)]
        for name in ("wrench/compensated", "wrench/raw"):
            if name in self.topics:
                parts.append(self._bars(name))
                break
        parts.append(self._status_table())
        if self.last_fault:
            parts.append(f"last fault  {self.last_fault}")
        return Group(*parts)

    def _topics_table(self, lost: dict[str, int]) -> "Table":
        from rich.table import Table

        now, now_ns = time.monotonic(), time.monotonic_ns()
        table = Table("topic", "source", "rate Hz", "age ms", "lost", "valid", box=None, pad_edge=False)
        for name, seen in sorted(self.topics.items()):
            age_ms = (now_ns - seen.message.t_ns) / 1e6
            valid = "yes" if seen.message.valid else "[red]no[/red]"
            missing = lost.get(name, 0)
            row = (f"{self.rate_hz(name, now):.1f}", f"{age_ms:.1f}", f"[red]{missing}[/red]" if missing else "0")
            table.add_row(name, seen.message.source, *row, valid)
        return table

    def _bars(self, name: str) -> "Table":
        import msgspec
        from rich.table import Table

        table = Table(name, "", "", box=None, pad_edge=False)
        content = msgspec.to_builtins(self.topics[name].message)
        for kind, unit in (("force", "N"), ("torque", "N m")):
            for axis, value in content[kind].items():
                table.add_row(f"{kind} {axis}", f"{value:9.3f} {unit}", bar(value, FULL_SCALE[kind]))
        return table

    def _status_table(self) -> "Table":
        from rich.table import Table

        table = Table("source", "state", "detail", box=None, pad_edge=False)
        colours = {"ready": "green", "fault": "red", "degraded": "yellow"}
        for name, status in sorted(self.statuses.items()):
            colour = colours.get(status.state, "default")
            table.add_row(name, f"[{colour}]{status.state}[/{colour}]", status.detail)
        return table


def bar(value: float, full_scale: float) -> str:
    """A bar from the middle: left negative, right positive; full at `full_scale`."""
    half = BAR_WIDTH // 2
    size = min(half, round(half * abs(value) / full_scale)) if math.isfinite(value) else 0
    left, right = ("█" * size, "") if value < 0 else ("", "█" * size)
    return f"{left:>{half}}│{right:<{half}}"


def _live(view: View, subscriber: "Subscriber") -> int:
    from rich.live import Live

    with Live(refresh_per_second=4, screen=sys.stdout.isatty()) as live:
        while True:
            view.listen(subscriber, 0.25)
            live.update(view.render(subscriber.lost))


def _print_once(view: View, subscriber: "Subscriber", *, as_json: bool) -> None:
    if as_json:
        print(json.dumps(view.as_json(subscriber.lost)))
        return
    from rich.console import Console

    Console().print(view.render(subscriber.lost))


def _finite(value: Any) -> Any:
    if isinstance(value, dict):
        return {k: _finite(v) for k, v in value.items()}
    if isinstance(value, list):
        return [_finite(v) for v in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value

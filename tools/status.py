"""`galen-hw status`: whether everything is well, in one look, for people, scripts and Prometheus."""

import argparse
import math
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from galen_hw.errors import EXIT_FOUND, EXIT_OK, GalenError, HardwareError, UsageError

if TYPE_CHECKING:
    from rich.console import Console

    from galen_hw.config.paths import Addresses
    from galen_hw.messages import Health

WAIT_S: Final = 3.0
"""Three times as long as from one `health` to the next."""
COLOURS: Final = {
    "good": "green",
    "ready": "green",
    "advice": "cyan",
    "starting": "cyan",
    "warning": "yellow",
    "degraded": "yellow",
    "stopped": "yellow",
}
SHOWN: Final = (
    # gauge, unit for people, factor, digits
    ("noise_n", "noise, N", 1.0, 4),
    ("calibration_noise_n", "noise when calibrated, N", 1.0, 4),
    ("rest_force_n", "wrench at rest, N", 1.0, 3),
    ("drift_n_per_s", "drift, N/min", 60.0, 3),
    ("calibration_age_days", "age of the calibration, days", 1.0, 1),
    ("daemon.core bus_load_share ft", "load of the CAN bus, %", 100.0, 0),
    ("daemon.core disk_free_bytes", "free on the disk, GB", 1e-9, 1),
    ("daemon.core machine_temperature_c", "computer, degrees C", 1.0, 0),
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of the command."""
    how = parser.add_mutually_exclusive_group()
    how.add_argument("--json", action="store_true", help="print JSON")
    how.add_argument("--metrics", action="store_true", help="print Prometheus text, e.g. for node_exporter's textfiles")
    how.add_argument(
        "--serve-metrics", metavar="PORT", type=int, help="serve Prometheus text on this port of 127.0.0.1 until Ctrl-C"
    )
    parser.add_argument("--dir", metavar="RUNTIME", type=Path, help="runtime directory of the daemon")
    parser.epilog = "examples: galen-hw status; galen-hw status --json; galen-hw status --serve-metrics 9873"


def run(args: argparse.Namespace) -> int:
    """Show; 0 if all is well or there is advice only, 1 if there is a warning or a fault."""
    from galen_hw.config.paths import Addresses, client_runtime_dir

    addresses = Addresses(args.dir or client_runtime_dir())
    if args.serve_metrics is not None:
        return _serve(addresses, args.serve_metrics)
    health, info = read_health(addresses)
    if args.metrics:
        from galen_hw.tools.metrics import metrics

        sys.stdout.write(metrics(health))
    elif args.json:
        from galen_hw.tools.answer import print_stamped

        print_stamped(as_json(health, info))
    else:
        from rich.console import Console

        console = Console()
        show(console if console.is_terminal else Console(width=120), health, info)
    return EXIT_FOUND if health.state in ("warning", "fault") else EXIT_OK


def read_health(addresses: "Addresses") -> "tuple[Health, dict[str, Any]]":
    """The next `health` of a daemon, and what it says of itself.

    Raises:
        HardwareError: no daemon runs, or it says nothing. UsageError: it runs without the health service.
    """
    from galen_hw.bus import CommandClient, Subscriber
    from galen_hw.messages import Health

    addresses.require_daemon()
    with Subscriber(addresses.bus, ("health",)) as subscriber, CommandClient(addresses.command) as client:
        info = client.call("daemon", "info", timeout_s=WAIT_S)
        if "health" not in info["services"]:
            todo = f"add [services.health] to {info['config']}, then restart"
            raise UsageError("this daemon runs without the health service", where=str(addresses.runtime), todo=todo)
        until = time.monotonic() + WAIT_S
        while (left := until - time.monotonic()) > 0:
            received = subscriber.receive(left)
            if received is not None and isinstance(received[1], Health):
                return received[1], info
    raise HardwareError(
        f"the health service says nothing for {WAIT_S:g} s", where=str(addresses.runtime), todo="see galen-hw monitor"
    )


def as_json(health: "Health", info: dict[str, Any]) -> dict[str, Any]:
    """Everything, for scripts; numbers that are not known become null."""
    import msgspec

    found = msgspec.json.decode(msgspec.json.encode(health))  # NaN becomes null
    return {**found, "ready": info["ready"], "processes": info["processes"], "config": info["config"]}


def show(console: "Console", health: "Health", info: dict[str, Any]) -> None:
    """Alarms first, then parts, then numbers."""
    from rich.markup import escape
    from rich.table import Table

    robot = f"{'virtual ' if health.virtual else ''}robot {health.robot}" + ("" if info["ready"] else ", not ready yet")
    colour = COLOURS.get(health.state, "red")
    console.print(f"[bold {colour}]{health.state}[/]  {escape(robot)}, version {health.versions.get('galen_hw', '?')}")
    for alarm in health.alarms:
        colour = COLOURS.get(alarm.level, "red")
        since = time.strftime("%H:%M:%S", time.localtime(alarm.since))
        todo = f"; {escape(alarm.todo)}" if alarm.todo else ""
        console.print(f"  [{colour}]{alarm.level} since {since}: {escape(alarm.what)}[/]{todo}")
    parts = Table(box=None, pad_edge=False, header_style="dim")
    for head in ("source", "state", "detail"):
        parts.add_column(head)
    for name, state in sorted(health.parts.items()):
        parts.add_row(name, f"[{COLOURS.get(state, 'red')}]{state}[/]", escape(health.details.get(name, "")))
    console.print(parts)
    topics = Table(box=None, pad_edge=False, header_style="dim")
    for i, head in enumerate(("topic", "rate Hz", "of", "lost %", "valid %", "p50 ms", "p99 ms")):
        topics.add_column(head, justify="right" if i else "left")
    for name, t in sorted(health.topics.items()):
        cells = (t.rate_hz, t.nominal_hz, 100 * t.lost_share, 100 * t.valid_share, 1e3 * t.p50_s, 1e3 * t.p99_s)
        digits = zip(cells, (1, 0, 2, 0, 2, 2), strict=True)
        topics.add_row(name, *("-" if math.isnan(x) else f"{x:.{d}f}" for x, d in digits))
    console.print(topics)
    known = [(text, factor * health.gauges[key], d) for key, text, factor, d in SHOWN if key in health.gauges]
    console.print("\n".join(f"{text}: {value:.{d}f}" for text, value, d in known), highlight=False)


def _serve(addresses: "Addresses", port: int) -> int:
    from galen_hw.tools.metrics import MetricsServer, metrics

    if not 0 <= port <= 65535:
        raise UsageError("must be 1 to 65535, or 0 for any free one", where="--serve-metrics")

    def text() -> str:
        try:
            return metrics(read_health(addresses)[0])
        except GalenError:
            return metrics(None)

    return serve_until_interrupt(MetricsServer(port, text))


def serve_until_interrupt(server: Any, say: Callable[[str], None] = print) -> int:
    """Serve and end with Ctrl-C, which is how it is meant to end."""
    say(f"Prometheus text at {server.url}")
    sys.stdout.flush()
    try:
        server.serve_forever()
    finally:
        server.server_close()
    return EXIT_OK

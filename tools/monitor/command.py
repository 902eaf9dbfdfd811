"""`galen-hw monitor`: what flows on the bus: rates, ages, losses, validity, the wrench, and how everything is doing."""

import argparse
import sys
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Final

from galen_hw.errors import EXIT_FOUND, EXIT_OK, GalenError, UsageError

if TYPE_CHECKING:
    from galen_hw.bus import Subscriber
    from galen_hw.config.paths import Addresses
    from galen_hw.tools.monitor.view import View

SECONDS: Final = 2.0
WIDTH: Final = 120
"""Columns where there is no terminal that says."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of the command."""
    parser.add_argument("--once", action="store_true", help="listen for --seconds, print, and end")
    parser.add_argument("--seconds", type=float, default=SECONDS, metavar="S", help="how long --once listens")
    parser.add_argument("--json", action="store_true", help="JSON, one object each time (with --once: one object)")
    parser.add_argument("--dir", metavar="RUNTIME", type=Path, help="runtime directory of the daemon")
    parser.epilog = "example: galen-hw monitor --once --json"


def run(args: argparse.Namespace) -> int:
    """Show until Ctrl-C, or once; with --once, 1 when nothing was heard."""
    from galen_hw.bus import Subscriber
    from galen_hw.config.paths import Addresses, client_runtime_dir
    from galen_hw.tools.monitor.view import View

    if not 0.0 < args.seconds <= 3600.0:
        raise UsageError("must be between 0 and 3600", where="--seconds", todo="e.g. --seconds 2")
    addresses = Addresses(args.dir or client_runtime_dir())
    addresses.require_daemon()
    with Subscriber(addresses.bus) as subscriber:
        view, daemon = View(), _Daemon(addresses, ask=not args.json)
        if args.once:
            view.listen(subscriber, args.seconds)
            if not view.topics and not args.json:
                bus, todo = addresses.bus.removeprefix("ipc://"), "galen-hw check names what is wrong"
                print(f"galen-hw monitor: {bus}: nothing heard for {args.seconds:g} s; {todo}", file=sys.stderr)
                return EXIT_FOUND
            _print_once(view, subscriber, daemon, as_json=args.json)
            return EXIT_OK if view.topics else EXIT_FOUND
        if args.json:
            while True:
                view.listen(subscriber, 1.0)
                _print_once(view, subscriber, daemon, as_json=True)
                sys.stdout.flush()
        return _live(view, subscriber, daemon)


class _Daemon:
    """The daemon that is looked at: which it is, and whether it still runs; another may take its place.

    Args:
        ask: have it say which it is.
    """

    def __init__(self, addresses: "Addresses", *, ask: bool) -> None:
        self._addresses, self._ask = addresses, ask
        self.gone = False
        self.about = self._about()

    def look(self) -> None:
        """See whether somebody listens at its socket."""
        try:
            self._addresses.require_daemon()
        except GalenError:
            self.gone = True
            return
        if self.gone:
            self.gone, self.about = False, self._about()

    def _about(self) -> str:
        """Which daemon this is, as far as it says so."""
        from galen_hw.bus import CommandClient

        words = [str(self._addresses.runtime)]
        if not self._ask:
            return words[0]
        with suppress(GalenError), CommandClient(self._addresses.command) as client:
            info = client.call("daemon", "info", timeout_s=1.0)
            robot = f"{'virtual ' if info['virtual'] else ''}robot {info['robot']}"
            words = [robot, f"version {info['version']}", *words]
        return ", ".join(words)


def _live(view: "View", subscriber: "Subscriber", daemon: _Daemon) -> int:
    from rich.console import Console, Group
    from rich.live import Live

    from galen_hw.tools.monitor.screen import screen

    console = Console()
    while not console.is_terminal:  # A pipe or a file keeps one screen after the other.
        view.listen(subscriber, SECONDS)
        _print_once(view, subscriber, daemon, as_json=False)
        sys.stdout.flush()
    with Live(console=console, auto_refresh=False, screen=True) as live:
        while True:
            view.listen(subscriber, 0.25)
            daemon.look()
            shown = screen(view, subscriber.lost, daemon.about, console.width, gone=daemon.gone)
            live.update(Group(shown, "[dim]Ctrl-C ends it[/]"), refresh=True)


def _print_once(view: "View", subscriber: "Subscriber", daemon: _Daemon, *, as_json: bool) -> None:
    daemon.look()
    if as_json:
        from galen_hw.tools.answer import print_stamped

        print_stamped(view.as_json(subscriber.lost) | {"daemon": not daemon.gone})
        return
    from rich.console import Console

    from galen_hw.tools.monitor.screen import screen

    console = Console()
    if not console.is_terminal:
        console = Console(width=WIDTH)
    console.print(screen(view, subscriber.lost, daemon.about, console.width, gone=daemon.gone))

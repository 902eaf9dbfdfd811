"""`galen-hw dashboard`: the robot live in a browser: wrench, arm, tools, tare, zero, calibration, stop, health, reports."""

import argparse
import os
from contextlib import ExitStack, suppress
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from galen_hw.errors import EXIT_OK, UsageError

if TYPE_CHECKING:
    from galen_hw.config.paths import Addresses

PORT: Final = 8765
HOST: Final = "127.0.0.1"
NICE: Final = 10
"""A page may wait; whoever acts on the wrench on the same cores may not."""
NEEDED: Final = ("starlette", "uvicorn", "websockets")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of the command."""
    parser.add_argument("--port", type=int, default=PORT, metavar="N", help=f"port (default {PORT}; 0: any free one)")
    parser.add_argument(
        "--host",
        default=HOST,
        metavar="ADDRESS",
        help=f"address (default {HOST}); from another machine one may only look",
    )
    parser.add_argument("--look-only", action="store_true", help="no page may command")
    parser.add_argument("--virtual", action="store_true", help="start a daemon on a virtual robot for it")
    parser.add_argument("--config", metavar="FILE", help="settings for --virtual")
    parser.add_argument("--poses", metavar="TILTSxROLLS", help="positions per swept axis of its calibrations, e.g. 7x8")
    parser.add_argument("--samples", type=int, metavar="N", help="samples averaged per pose of its calibrations")
    parser.add_argument("--no-check", action="store_true", help="no slow motion at the end of its calibrations")
    parser.add_argument("--dir", metavar="RUNTIME", type=Path, help="runtime directory of the daemon")
    parser.epilog = "examples: galen-hw dashboard; galen-hw dashboard --virtual --poses 4x5"


def run(args: argparse.Namespace) -> int:
    """Serve until Ctrl-C."""
    missing = [name for name in NEEDED if find_spec(name) is None]
    if missing:
        raise UsageError(f"needs {', '.join(missing)}", todo="pip install 'galen-hw[dashboard]'")
    from galen_hw.config.paths import Addresses, client_runtime_dir
    from galen_hw.daemon.session import own_daemon

    if not 0 <= args.port <= 65535:
        raise UsageError("must be 0 to 65535", where="--port", todo=f"e.g. --port {PORT}")
    overrides = _overrides(args)
    with ExitStack() as stack:
        if args.virtual:
            addresses = stack.enter_context(own_daemon(config=args.config, virtual=True, runtime=args.dir))
        else:
            addresses = Addresses(args.dir or client_runtime_dir())
        _serve(args, addresses, overrides)
    return EXIT_OK


def _overrides(args: argparse.Namespace) -> dict[str, Any]:
    """Arguments of the sweep that differ from its settings."""
    found: dict[str, Any] = {}
    if args.poses is not None:
        counts = args.poses.split("x")
        if not all(count.isdecimal() and len(count) <= 4 for count in counts):
            raise UsageError(f"{args.poses!r} is not TILTSxROLLS", where="--poses", todo="e.g. --poses 7x8")
        found["counts"] = [int(count) for count in counts]
    return found | ({} if args.samples is None else {"samples": args.samples})


def _serve(args: argparse.Namespace, addresses: "Addresses", overrides: dict[str, Any]) -> None:
    from galen_hw.tools.dashboard.access import Access, is_loopback
    from galen_hw.tools.dashboard.actions import Actions
    from galen_hw.tools.dashboard.calibration import Calibration
    from galen_hw.tools.dashboard.feed import Feed
    from galen_hw.tools.dashboard.server import Dashboard, listen, make_server

    with suppress(OSError):
        os.nice(NICE)
    access = Access(args.host, look_only=args.look_only)
    calibration = Calibration(addresses, overrides, check=not args.no_check)
    dashboard = Dashboard(Feed(addresses), Actions(addresses, calibration), calibration, access)

    listener, url = listen(args.host, args.port)
    # After the #: a browser sends it to nobody, and no log has it.
    print(f"dashboard: {url}{f'#token={access.token}' if access.token else ''}", flush=True)
    if not access.token:
        why = "" if is_loopback(args.host) else f"; to command from afar: ssh -L {PORT}:127.0.0.1:{PORT} USER@ROBOT"
        print(f"pages may only look{why}", flush=True)
    print(f"Ctrl-C ends it{'' if not args.virtual else ' and the virtual robot'}", flush=True)
    with listener:
        make_server(dashboard.app).run(sockets=[listener])

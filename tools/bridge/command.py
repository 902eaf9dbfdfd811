"""`galen-hw bridge`: pass the live bus on to Foxglove or to ROS 2, until Ctrl-C; nothing comes back in."""

import argparse
import importlib
import signal
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Final

from galen_hw.errors import EXIT_OK, UsageError

if TYPE_CHECKING:
    from galen_hw.messages import Message

BRIDGES: Final[dict[str, tuple[str, str]]] = {
    # name: (module with `add_arguments(parser)` and `opened(args)`, a context manager that gives a Sink and a line; what it is)
    "foxglove": ("galen_hw.tools.bridge.foxglove_server", "a WebSocket server for Foxglove: ws://HOST:PORT"),
    "ros2": ("galen_hw.tools.bridge.ros2_publisher", "topics of ROS 2: WrenchStamped, JointState, PoseStamped"),
}
Sink = Callable[[str, "Message"], None]
"""Takes a message of the bus, with its topic."""
POLL_S: Final = 0.25


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of the command."""
    kinds = parser.add_subparsers(dest="bridge", metavar="TO", required=True)
    for name, (module, text) in BRIDGES.items():
        one = kinds.add_parser(name, help=text, description=text[0].upper() + text[1:] + ".")
        one.add_argument(
            "--topics", nargs="+", default=[], metavar="TOPIC", help="names or beginnings of names; all if none"
        )
        one.add_argument("--seconds", type=float, metavar="S", help="end after so long")
        one.add_argument("--dir", metavar="RUNTIME", type=Path, help="runtime directory of the daemon")
        importlib.import_module(module).add_arguments(one)
    parser.epilog = "example: galen-hw bridge foxglove --port 8765"


def run(args: argparse.Namespace) -> int:
    """Pass on until Ctrl-C, SIGTERM or the time is over."""
    from galen_hw.bus import Subscriber
    from galen_hw.config.paths import Addresses, client_runtime_dir

    if args.seconds is not None and not 0.0 < args.seconds < float("inf"):
        raise UsageError("must be a number of seconds above 0", where="--seconds", todo="e.g. --seconds 60")
    addresses = Addresses(args.dir or client_runtime_dir())
    addresses.require_daemon()
    opened: Callable[[argparse.Namespace], AbstractContextManager[tuple[Sink, str]]]
    opened = importlib.import_module(BRIDGES[args.bridge][0]).opened
    with opened(args) as (sink, line), Subscriber(addresses.bus, args.topics) as bus, _ending() as over:
        print(line, flush=True)
        end = None if args.seconds is None else time.monotonic() + args.seconds
        passed = 0
        while not over() and (end is None or time.monotonic() < end):
            found = bus.receive(POLL_S)
            if found is not None:
                sink(*found)
                passed += 1
    lost = sum(bus.lost.values())
    print(f"{passed} messages passed on" + (f", {lost} lost: this end was too slow" if lost else ""))
    return EXIT_OK


@contextmanager
def _ending() -> Iterator[Callable[[], bool]]:
    """Return whether somebody has asked to end."""
    asked = []
    before = {
        number: signal.signal(number, lambda *_: asked.append(True)) for number in (signal.SIGINT, signal.SIGTERM)
    }
    try:
        yield lambda: bool(asked)
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)

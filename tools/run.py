"""`galen-hw run`: the daemon beside the robot."""

import argparse
from contextlib import ExitStack
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Final

from galen_hw.errors import UsageError

if TYPE_CHECKING:
    from galen_hw.daemon.fork_server import ForkServer
    from galen_hw.drivers.virtual.start import Starter


SLOWEST: Final = 0.1
FASTEST: Final = 100.0


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of the command."""
    parser.add_argument("--config", metavar="FILE", help="settings (default: /etc/galen-hw/galen.toml)")
    parser.add_argument("--virtual", action="store_true", help="start a virtual robot and use its wires")
    add_speed(parser)
    parser.add_argument("--dir", metavar="RUNTIME", type=Path, help="runtime directory for the sockets")
    parser.add_argument("--parent-pid", type=int, metavar="PID", help=argparse.SUPPRESS)
    parser.epilog = "example: galen-hw run --virtual"


def add_speed(parser: argparse.ArgumentParser) -> None:
    """The option of every command that starts a virtual robot of its own."""
    parser.add_argument(
        "--speed", type=_speed, default=1.0, metavar="N", help="with --virtual: at most N times as fast as the clock"
    )


def _speed(text: str) -> float:
    speed = float(text)
    if not SLOWEST <= speed <= FASTEST:
        raise argparse.ArgumentTypeError(f"{text} is not between {SLOWEST:g} and {FASTEST:g}")
    return speed


def require_virtual(args: argparse.Namespace) -> None:
    """Refuse a speed for what is real.

    Raises:
        UsageError: so it is.
    """
    if args.speed != 1.0 and not args.virtual:
        raise UsageError("real hardware has one speed", where="--speed", todo="add --virtual, or leave it out")


def run(args: argparse.Namespace) -> int:
    """Run until SIGTERM, SIGHUP or Ctrl-C, or until the parent ends."""
    from galen_hw.config.paths import make_runtime, runtime_dir, state_dir
    from galen_hw.daemon import logs
    from galen_hw.daemon.fork_server import ForkServer
    from galen_hw.daemon.machine import must_fit
    from galen_hw.daemon.supervisor import Supervisor, install_signals
    from galen_hw.daemon.tables import TABLES, read_setup
    from galen_hw.daemon.virtual import simulated_setup, virtual_setup

    require_virtual(args)
    logs.set_up()
    setup = read_setup(args.config)
    addresses = make_runtime(args.dir or runtime_dir())
    _load(virtual=args.virtual)
    with ExitStack() as stack:
        fork_server = stack.enter_context(ForkServer())
        if args.speed != 1.0:
            setup = stack.enter_context(simulated_setup(setup, TABLES, addresses.virtual, args.speed))
        elif args.virtual:
            setup = stack.enter_context(virtual_setup(setup, TABLES, addresses.virtual, _starter(fork_server)))
        must_fit(setup)
        supervisor = Supervisor(
            setup,
            TABLES,
            addresses,
            state_dir(),
            fork_server,
            on_ready=lambda text, viewers: _say_ready(text, addresses.bus, viewers),
            parent_pid=args.parent_pid,
        )
        install_signals(supervisor)
        return supervisor.run()


def _load(*, virtual: bool) -> None:
    """Load what the processes run, once for all of them; the settings have loaded the devices and services they name."""
    import_module("galen_hw.daemon.worker")
    if virtual:
        from galen_hw.drivers.table import VIRTUAL_DEVICES

        for module in ("galen_hw.tools.virtual", "galen_hw.daemon.simulated", *VIRTUAL_DEVICES.values()):
            import_module(module.partition(":")[0])


def _starter(fork_server: "ForkServer") -> "Starter":
    return lambda words, fds: fork_server.start("galen_hw.cli", words, fds, session=True)


def _say_ready(summary: str, bus: str, viewers: str) -> None:
    print(f"ready: {summary}; bus at {bus}{f', viewers at {viewers}' if viewers else ''}", flush=True)

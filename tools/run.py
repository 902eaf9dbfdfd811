"""`galen-hw run`: the daemon beside the robot."""

import argparse
from contextlib import ExitStack
from pathlib import Path


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of the command."""
    parser.add_argument("--config", metavar="FILE", help="settings (default: /etc/galen-hw/galen.toml)")
    parser.add_argument("--virtual", action="store_true", help="start a virtual robot and use its wires")
    parser.add_argument("--dir", metavar="RUNTIME", type=Path, help="runtime directory for the sockets")
    parser.add_argument("--parent-pid", type=int, metavar="PID", help=argparse.SUPPRESS)
    parser.epilog = "example: galen-hw run --virtual"


def run(args: argparse.Namespace) -> int:
    """Run until SIGTERM, SIGHUP or Ctrl-C, or until the parent ends."""
    from galen_hw.config.paths import make_runtime, runtime_dir, state_dir
    from galen_hw.daemon import logs
    from galen_hw.daemon.machine import must_fit
    from galen_hw.daemon.supervisor import Supervisor, install_signals
    from galen_hw.daemon.tables import TABLES, read_setup
    from galen_hw.daemon.virtual import virtual_setup

    logs.set_up()
    setup = read_setup(args.config)
    addresses = make_runtime(args.dir or runtime_dir())
    with ExitStack() as stack:
        if args.virtual:
            setup = stack.enter_context(virtual_setup(setup, TABLES, addresses.virtual))
        must_fit(setup)
        supervisor = Supervisor(
            setup,
            TABLES,
            addresses,
            state_dir(),
            on_ready=lambda text, viewers: _say_ready(text, addresses.bus, viewers),
            parent_pid=args.parent_pid,
        )
        install_signals(supervisor)
        return supervisor.run()


def _say_ready(summary: str, bus: str, viewers: str) -> None:
    print(f"ready: {summary}; bus at {bus}{f', viewers at {viewers}' if viewers else ''}", flush=True)

"""`galen-hw check`: every problem of the set-up at once, as a tree; or what is wrong with recordings."""

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from galen_hw.errors import GalenError, UsageError
from galen_hw.tools.robot_given import add_robot

if TYPE_CHECKING:
    from rich.tree import Tree

    from galen_hw.config.load import Setup
    from galen_hw.config.paths import Addresses
    from galen_hw.daemon.checks import Finding
    from galen_hw.daemon.probe import Seen

STYLE = {"ok": "[green]ok[/green]", "note": "[yellow]note[/yellow]", "problem": "[red]problem[/red]"}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of the command."""
    parser.add_argument(
        "recordings",
        nargs="*",
        metavar="RECORDING",
        help="check these recordings instead, or all of a folder: cells, clocks, units, frames, load",
    )
    add_robot(parser)
    parser.add_argument("--config", metavar="FILE", help="settings (default: /etc/galen-hw/galen.toml)")
    parser.add_argument("--virtual", action="store_true", help="check against a virtual robot's wires")
    parser.add_argument("--dir", metavar="RUNTIME", type=Path, help="runtime directory of a daemon")
    parser.add_argument("--json", action="store_true", help="the tree as JSON")
    parser.epilog = (
        "exit status: 0 no problem, 1 a problem, 2 wrong settings or files, 3 hardware; "
        "examples: galen-hw check --virtual; galen-hw check my-recording"
    )


def run(args: argparse.Namespace) -> int:
    """Look at everything, print the tree."""
    if args.recordings:
        from galen_hw.tools.check_recording import check_recordings

        return check_recordings(args)
    if args.robot or args.xacro_arg or args.sensor_link:
        where = "--robot" if args.robot or args.xacro_arg else "--sensor-link"
        raise UsageError("of which recording?", where=where, todo="the daemon's robot is in the settings: [robot]")
    from galen_hw.config.load import examine, read_document
    from galen_hw.config.paths import Addresses, client_runtime_dir, config_path, state_dir
    from galen_hw.daemon.checks import (
        Finding,
        check_device,
        check_machine,
        check_names,
        check_robot,
        check_settings,
        check_tools,
        exit_status,
    )
    from galen_hw.daemon.tables import TABLES

    path = config_path(args.config)
    document, places = read_document(path)
    setup, problems = examine(document, path, places, TABLES)
    looked_at, seen, source, found = _look(args, setup, Addresses(args.dir or client_runtime_dir()))
    devices = Finding("devices", source, below=[check_device(n, looked_at, seen[n]) for n in seen])
    devices.below += [*check_names(setup.devices), *found]
    serial = next((s.serial_number for s in seen.values() if s.serial_number), "")
    parts = [
        check_settings(path, problems),
        check_robot(document, setup),
        devices,
        check_tools(setup, state_dir(), serial),
    ]
    root = Finding("galen-hw check", below=[*parts, check_machine(setup, state_dir())])
    _print(root, as_json=args.json)
    return exit_status(root)


def _look(
    args: argparse.Namespace, setup: "Setup", addresses: "Addresses"
) -> "tuple[Setup, dict[str, Seen], str, list[Finding]]":
    """The set-up looked at and what was seen of it: through a running daemon, on its own wires, or on virtual ones."""
    import tempfile

    from galen_hw.daemon.checks import PROBLEM, Finding
    from galen_hw.daemon.probe import listen_to_daemon, probe_devices
    from galen_hw.daemon.tables import TABLES
    from galen_hw.daemon.virtual import virtual_setup

    try:
        if args.virtual:
            with (
                tempfile.TemporaryDirectory(prefix="galen-hw-") as folder,
                virtual_setup(setup, TABLES, Path(folder)) as s,
            ):
                return s, probe_devices(s), "virtual", []
        if (info := _running(addresses)) is not None:
            return setup, listen_to_daemon(addresses, info, setup), f"through the daemon in {addresses.runtime}", []
        return setup, probe_devices(setup), "opened one by one; no daemon runs", []
    except GalenError as error:
        return (
            setup,
            {},
            "",
            [Finding("virtual robot" if args.virtual else "daemon", str(error), PROBLEM, error.todo, error.exit_code)],
        )


def _running(addresses: "Addresses") -> dict[str, object] | None:
    """What the daemon of a runtime directory says of itself; None without one.

    Raises:
        UsageError: this user may not ask it; its wires are not to be opened beside it.
    """
    from galen_hw.bus import CommandClient
    from galen_hw.permission import require_permission

    require_permission(addresses.runtime / "command")
    if not (addresses.runtime / "command").exists():
        return None
    try:
        with CommandClient(addresses.command) as client:
            return client.call("daemon", "info", timeout_s=1.0)
    except GalenError:
        return None


def _print(root: "Finding", *, as_json: bool) -> None:
    if as_json:
        from galen_hw.tools.answer import print_stamped

        print_stamped(root.as_dict())
        return
    from rich.console import Console
    from rich.tree import Tree

    tree = Tree(root.name)
    _grow(tree, root)
    # A pipe has no width: lines stay whole there, and wrap in a terminal.
    Console(width=None if sys.stdout.isatty() else 400, highlight=False).print(tree)
    problems = sum(f.state == "problem" for f in root.all())
    print(f"{problems} problem{'s' if problems != 1 else ''}" if problems else "no problem")


def _grow(tree: "Tree", finding: "Finding") -> None:
    from rich.markup import escape

    for below in finding.below:
        mark = "" if below.below and below.state == "ok" else f"{STYLE[below.state]} "
        todo = f"; {below.todo}" if below.todo else ""
        _grow(tree.add(f"{mark}{escape(below.name)}: {escape(below.text)}{escape(todo)}"), below)

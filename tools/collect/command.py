"""`galen-hw collect`: guided collection of deflection data with the tracker."""

import argparse
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from galen_hw.errors import EXIT_OK, UsageError

if TYPE_CHECKING:
    from rich.console import Console, RenderableType

    from galen_hw.config.paths import Addresses
    from galen_hw.drivers.virtual.control import VirtualControl
    from galen_hw.kinematics import Robot
    from galen_hw.spatial import Array
    from galen_hw.tools.collect.session import CollectSession

VIRTUAL_TOOL: Final = "pointer"
LARGEST_N: Final = 30.0


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of the command."""
    parser.add_argument("what", choices=["deflection"], help="which data")
    parser.add_argument("-o", "--output", metavar="DIR", type=Path, help="session folder; a begun one is gone on with")
    parser.add_argument("--tool", metavar="NAME", help="tool in the holder (default: the selected one)")
    parser.add_argument("--configurations", type=int, default=4, metavar="N", help="places with two sets each (4)")
    parser.add_argument("--force", type=float, default=12.0, metavar="N", help="largest push, newtons (12)")
    parser.add_argument("--dwell", type=float, default=2.0, metavar="S", help="hold each push so long, for creep (2)")
    parser.add_argument("--config", metavar="FILE", help="settings for --virtual")
    parser.add_argument("--dir", metavar="RUNTIME", type=Path, help="runtime directory of the daemon")
    parser.add_argument("--virtual", action="store_true", help="on a virtual robot that gives; a virtual hand pushes")
    parser.epilog = "example: galen-hw collect deflection --virtual -o session"


def run(args: argparse.Namespace) -> int:
    """Collect what is left of the session."""
    from rich.console import Console

    from galen_hw.bus import CommandClient, Subscriber
    from galen_hw.config.paths import Addresses, client_runtime_dir
    from galen_hw.config.tool_store import ToolStore
    from galen_hw.daemon.session import own_daemon
    from galen_hw.tools.collect.rows import TOPICS
    from galen_hw.tools.collect.session import CollectSession

    if not 1.0 <= args.force <= LARGEST_N or not 0.2 <= args.dwell <= 60.0 or not 1 <= args.configurations <= 50:
        raise UsageError("out of range", where="--force, --dwell, --configurations", todo="1-30 N, 0.2-60 s, 1-50")
    console = Console()
    with ExitStack() as stack:
        if args.virtual:
            addresses = stack.enter_context(own_daemon(config=args.config, runtime=args.dir))
        else:
            addresses = Addresses(args.dir or client_runtime_dir())
            addresses.require_daemon()
        client = stack.enter_context(CommandClient(addresses.command))
        info = client.call("daemon", "info")
        store = ToolStore(Path(info["state_dir"]))
        name = args.tool or store.selected() or (VIRTUAL_TOOL if info["virtual"] else None)
        if name is None:
            raise UsageError("no tool is selected", where="--tool", todo=f"one of: {', '.join(store.names())}")
        robot, tool = _robot(info), store.load(name)
        plan = _plan(args, robot, name, console)
        hand = _hand(addresses, name, stack) if info["virtual"] else _Operator()
        subscriber = stack.enter_context(Subscriber(addresses.bus, TOPICS, queue=50_000))
        live = stack.enter_context(_live(console))
        session = CollectSession(
            plan,
            robot,
            tool,
            subscriber,
            client,
            hand,
            lambda line: console.print(line, markup=False),
            lambda now, text: live.update(_picture(now, text)),
        )
        session.run()
    left = len(plan.left)
    console.print(f"{len(plan.steps) - left} of {len(plan.steps)} sets in {plan.folder}", markup=False)
    if left:
        console.print(f"go on with: galen-hw collect deflection -o {plan.folder}", markup=False)
    else:
        console.print(f"next: galen-hw deflection fit {plan.folder} --report out.html", markup=False)
    return EXIT_OK


def _plan(args: argparse.Namespace, robot: "Robot", tool: str, console: "Console") -> Any:
    """A begun session's plan, or a new one."""
    from datetime import UTC, datetime

    from galen_hw.tools.collect.plan import Plan, make_steps

    now = datetime.now(UTC)
    folder = args.output or Path(f"deflection-{now:%Y%m%d-%H%M%S}")
    plan = Plan.load(folder)
    if plan is not None:
        if plan.tool != tool:
            raise UsageError(
                f"the session is of tool {plan.tool!r}, not {tool!r}", where=str(folder), todo="give a new folder"
            )
        console.print(f"going on: {len(plan.left)} of {len(plan.steps)} sets are left", markup=False)
        return plan
    plan = Plan(folder, robot.name, tool, f"{now:%Y-%m-%d}", make_steps(robot, args.configurations, args.force))
    plan.dwell_s = args.dwell
    plan.save()
    return plan


def _robot(info: dict[str, Any]) -> "Robot":
    """The robot of the daemon's settings."""
    from galen_hw.config.robot import build_robot
    from galen_hw.daemon.tables import read_setup

    return build_robot(read_setup(info["config"]).config)


class _Operator:
    """A person: the words are on the screen."""

    def push(self, force: "Array", rise_s: float, dwell_s: float) -> None:
        """Nothing to do here."""


class _VirtualHand:
    """The virtual robot's hand."""

    def __init__(self, control: "VirtualControl") -> None:
        self._control = control

    def push(self, force: "Array", rise_s: float, dwell_s: float) -> None:
        """At the tool's tip."""
        self._control.push(force=force.tolist(), seconds=dwell_s, rise_s=rise_s)


def _hand(addresses: "Addresses", tool: str, stack: ExitStack) -> _VirtualHand:
    """A virtual arm that gives, with the tool in its holder."""
    from galen_hw.drivers.virtual.control import VirtualControl

    control = stack.enter_context(VirtualControl(addresses.virtual))
    control.attach_tool(tool)
    rng = np.random.default_rng()
    joint = [*rng.uniform(1e-5, 5e-5, 3).tolist(), *rng.uniform(2e-3, 6e-3, 2).tolist()]
    control.compliance(joint=joint, structure=[0.0] * 6)
    return _VirtualHand(control)


def _live(console: "Console") -> Any:
    from rich.live import Live

    return Live(console=console, refresh_per_second=8, transient=True)


def _picture(session: "CollectSession", text: str) -> "RenderableType":
    """What to do now, the force as it is, and the coverage so far."""
    from rich.console import Group
    from rich.table import Table
    from rich.text import Text

    rows = session.rows
    force = " ".join(f"{a} {f:+6.1f}" for a, f in zip("xyz", rows.force_now, strict=True))
    table = Table(title="largest force, N", title_justify="left")
    for head in ("place", "+x", "+y", "+z", "-x", "-y", "-z"):
        table.add_column(head, justify="right")
    for place, peaks in session.peaks.items():
        table.add_row(place, *(f"{p:.0f}" for p in peaks))
    done = len(session.plan.steps) - len(session.plan.left)
    line = f"raw force, sensor axes, N: {force}   markers seen {rows.seen:4.0%}"
    line += f"   frames lost {rows.warnings['frames lost']}"
    line += f"   sets {done} of {len(session.plan.steps)}"
    return Group(Text(text, style="bold"), Text(line), table)

"""`galen-hw collect`: guided collection of deflection data with the tracker."""

import argparse
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from galen_hw.errors import EXIT_FOUND, EXIT_OK, UsageError
from galen_hw.tools.run import add_speed, require_virtual
from galen_hw.units import number_in

if TYPE_CHECKING:
    from rich.console import Console, RenderableType

    from galen_hw.config.paths import Addresses
    from galen_hw.drivers.virtual.control import VirtualControl
    from galen_hw.kinematics import Robot
    from galen_hw.spatial import Array
    from galen_hw.tools.collect.plan import Plan
    from galen_hw.tools.collect.session import CollectSession

VIRTUAL_TOOL: Final = "pointer"
LARGEST_N: Final = 30.0
DEFAULTS: Final[dict[str, float]] = {
    "configurations": 4,
    "force": 12.0,
    "dwell": 2.0,
    "rise": 1.0,
    "rest": 2.0,
    "rounds": 2,
    "places": 8,
    "still": 1.5,
}
"""Of a new session; what is given on the command line when a begun one is gone on with is said to be ignored."""
BESIDE: Final = ("compensation/state", "status", "fault")
"""What is recorded beside the topics that the rows are made of; poses and contact can be had from these again."""
BLOCKS: Final = " ▁▂▃▄▅▆▇█"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of the command."""
    parser.add_argument("what", choices=["deflection"], help="which data")
    parser.add_argument("-o", "--output", metavar="DIR", type=Path, help="session folder; a begun one is gone on with")
    parser.add_argument("--tool", metavar="NAME", help="tool in the holder (default: the selected one)")
    parser.add_argument("--configurations", type=int, metavar="N", help="places with two sets each (4)")
    parser.add_argument(
        "--max-force", dest="force", type=number_in("N"), metavar="N", help="largest push, newtons (12)"
    )
    parser.add_argument("--dwell", type=number_in("s"), metavar="S", help="hold each push so long, for creep (2)")
    parser.add_argument("--rise", type=number_in("s"), metavar="S", help="seconds for a push to rise and fall (1)")
    parser.add_argument("--rest", type=number_in("s"), metavar="S", help="rest before and after pushes (2)")
    parser.add_argument("--rounds", type=int, metavar="N", help="sets at each place (2)")
    parser.add_argument("--places", type=int, metavar="N", help="places of a calibration set (8)")
    parser.add_argument("--still", type=number_in("s"), metavar="S", help="time at each of them (1.5)")
    parser.add_argument("--config", metavar="FILE", help="settings for --virtual")
    parser.add_argument("--dir", metavar="RUNTIME", type=Path, help="runtime directory of the daemon")
    parser.add_argument("--virtual", action="store_true", help="on a virtual robot that gives; a virtual hand pushes")
    add_speed(parser)
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
    from galen_hw.tools.record import session_context

    given = _complete(args)
    _check(args)
    console, plan = Console(), None
    try:
        with ExitStack() as stack:
            if args.virtual:
                addresses = stack.enter_context(own_daemon(config=args.config, runtime=args.dir, speed=args.speed))
            else:
                addresses = Addresses(args.dir or client_runtime_dir())
                addresses.require_daemon()
            client = stack.enter_context(CommandClient(addresses.command))
            info = client.call("daemon", "info")
            store = ToolStore(Path(info["state_dir"]), virtual=info["virtual"])
            name = args.tool or store.selected() or (VIRTUAL_TOOL if info["virtual"] else None)
            if name is None:
                raise UsageError("no tool is selected", where="--tool", todo=f"one of: {', '.join(store.names())}")
            robot, tool = _robot(info), store.load(name)
            plan = _plan(args, robot, name, given)
            hand = _hand(addresses, name, robot, stack) if info["virtual"] else _Operator()
            subscriber = stack.enter_context(
                Subscriber(addresses.bus, [*TOPICS, *BESIDE], queue=50_000, as_published=True)
            )
            live = stack.enter_context(_live(console))
            CollectSession(
                plan,
                robot,
                tool,
                subscriber,
                client,
                hand,
                lambda line: console.print(line, markup=False, soft_wrap=True),
                lambda now, text: live.update(picture(now, text)),
                session_context(Path(info["config"])) | {"virtual": bool(info["virtual"])},
                simulated=info.get("speed", 1.0) != 1.0,
            ).run()
    finally:
        if plan is not None:
            _left(plan, virtual=args.virtual)
    return EXIT_FOUND if plan.left else EXIT_OK


def _complete(args: argparse.Namespace) -> dict[str, float]:
    """Fill in the numbers that were not given; those that were."""
    given = {name: value for name in DEFAULTS if (value := getattr(args, name)) is not None}
    vars(args).update(DEFAULTS | given)
    return given


def _option(name: str) -> str:
    """The option by which a number is given."""
    return "--max-force" if name == "force" else f"--{name}"


def _check(args: argparse.Namespace) -> None:
    """Numbers that make a session, and a folder that can hold it."""
    require_virtual(args)
    from galen_hw.config.paths import require_folder

    limits = {
        "force": (1.0, LARGEST_N),
        "dwell": (0.2, 60.0),
        "rise": (0.1, 10.0),
        "rest": (0.5, 60.0),
        "still": (0.5, 60.0),
        "configurations": (1, 50),
        "rounds": (1, 10),
        "places": (4, 50),
    }
    for name, (low, high) in limits.items():
        if not low <= getattr(args, name) <= high:
            raise UsageError("is out of range", where=_option(name), todo=f"{low:g} to {high:g}")
    if args.output is not None:
        require_folder(args.output, "-o")


def _left(plan: "Plan", *, virtual: bool = False) -> None:
    """How far the session is, and what comes next."""
    left = len(plan.left)
    print(f"{len(plan.steps) - left} of {len(plan.steps)} sets in {plan.folder}", flush=True)
    if left:
        print(f"go on with: galen-hw collect deflection{' --virtual' * virtual} -o {plan.folder}", flush=True)
    else:
        print(f"next: galen-hw deflection fit {plan.folder} --report out.html", flush=True)


def _plan(args: argparse.Namespace, robot: "Robot", tool: str, given: dict[str, float] | None = None) -> "Plan":
    """A begun session's plan, or a new one; of `given` numbers those that a begun session does not have are said."""
    from datetime import UTC, datetime

    from galen_hw.tools.collect.plan import Plan, make_steps

    now = datetime.now(UTC)
    folder = args.output or Path(f"deflection-{now:%Y%m%d-%H%M%S}")
    plan = Plan.load(folder)
    if plan is not None:
        for what, kept, here in (("tool", plan.tool, tool), ("robot", plan.robot, robot.name)):
            if kept != here:
                todo = "give a new folder"
                raise UsageError(f"the session is of {what} {kept!r}, not {here!r}", where=str(folder), todo=todo)
        print(f"going on: {len(plan.left)} of {len(plan.steps)} sets are left", flush=True)
        for name, value in (given or {}).items():
            had = plan.numbers.get(name)
            if had != value:
                begun = "" if had is None else f" with {had:g}"
                print(
                    f"{_option(name)} {value:g} is ignored: the session was begun{begun}; give a new folder", flush=True
                )
        return plan
    steps = make_steps(robot, args.configurations, args.force, rounds=args.rounds, places=args.places)
    plan = Plan(folder, robot.name, tool, f"{now:%Y-%m-%d}", steps)
    plan.dwell_s, plan.rise_s, plan.rest_s, plan.still_s = args.dwell, args.rise, args.rest, args.still
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


def _hand(addresses: "Addresses", tool: str, robot: "Robot", stack: ExitStack) -> _VirtualHand:
    """A virtual arm that gives, with the tool in its holder; the same arm again for the same seed of its world."""
    from galen_hw.drivers.virtual.control import VirtualControl

    control = stack.enter_context(VirtualControl(addresses.virtual))
    control.attach_tool(tool)
    middle = 0.5 * (robot.lower + robot.upper)
    turns = np.any(np.abs(robot.sensor_jacobian(middle)[0, 3:]) > 0.0, axis=0)
    rng = np.random.default_rng([control.state()["seed"], 4])
    # As the generated robots of the benchmark: 0.1 to 1 mm/N at the tip, a bearing or two that stick, creep and stiffen.
    ranges = np.where(turns, [[3.3e-3], [1.5e-2]], [[2e-5], [1e-4]])
    joint = np.exp(rng.uniform(*np.log(ranges)))
    control.compliance(
        joint=joint.tolist(),
        friction=np.where(turns, rng.uniform(0.05, 0.15), 0.0).tolist(),
        creep=np.where(turns, rng.uniform(0.05, 0.15), 0.0).tolist(),
        hardening=(np.where(turns, 3.0, 60.0) * joint).tolist(),
        slope=np.where(turns, 0.0, rng.uniform(-0.5, 0.5)).tolist(),
    )
    return _VirtualHand(control)


def _live(console: "Console") -> Any:
    from rich.live import Live

    return Live(console=console, refresh_per_second=8, transient=True)


def picture(session: "CollectSession", text: str) -> "RenderableType":
    """What to do now, how hard, the force's trace, and the coverage so far."""
    from rich.console import Group
    from rich.table import Table
    from rich.text import Text

    rows, trace = session.rows, np.array(session.trace).reshape(-1, 3)
    lines = [Text(text, style="bold")]
    size = float(np.linalg.norm(session.target))
    if size and len(trace):
        along = float(trace[-1] @ session.target) / size
        lines.append(Text(f"push {along:5.1f} of {size:.1f} N  {_bar(along / size)}"))
    for i, axis in enumerate("xyz"):
        now = f"{trace[-1, i]:+6.1f}" if len(trace) else "      "
        lines.append(Text(f"force {axis} {now} N  {sparkline(trace[:, i])}"))
    table = Table(title="largest force, N", title_justify="left")
    for head in ("place", "+x", "+y", "+z", "-x", "-y", "-z"):
        table.add_column(head, justify="right")
    for place, peaks in session.peaks.items():
        table.add_row(place, *(f"{p:.0f}" for p in peaks))
    done = len(session.plan.steps) - len(session.plan.left)
    line = f"markers seen {rows.seen:4.0%}   frames lost {rows.warnings['frames lost']}"
    lines.append(Text(f"{line}   sets {done} of {len(session.plan.steps)}"))
    return Group(*lines, table)


def sparkline(values: "Array", least: float = 2.0) -> str:
    """Values as one line of blocks, zero in the middle; the scale is their largest size, `least` at least."""
    scale = max(float(np.abs(values).max(initial=0.0)), least)
    steps = np.clip(np.round(4.0 + 4.0 * values / scale), 0, len(BLOCKS) - 1).astype(int)
    return "".join(BLOCKS[k] for k in steps)


def _bar(share: float) -> str:
    return "\N{FULL BLOCK}" * round(20 * min(max(share, 0.0), 1.2))

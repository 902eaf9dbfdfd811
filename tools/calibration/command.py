"""`galen-hw calibrate`: sweep, fit, verify, ask, and only then change what the live compensation uses."""

import argparse
import json
import shlex
import sys
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from galen_hw.errors import EXIT_FOUND, EXIT_OK, EXIT_REFUSED, GalenError, UsageError
from galen_hw.tools.robot_given import add_robot, keys_given, robot_given
from galen_hw.tools.run import add_speed, require_virtual

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from matplotlib.figure import Figure
    from rich.console import Console

    from galen_hw.config.paths import Addresses
    from galen_hw.config.tool_file import ToolFile
    from galen_hw.premises import Remark
    from galen_hw.tools.calibration.check import LiveCheck
    from galen_hw.tools.calibration.result import Result


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of the command."""
    parser.add_argument("--tool", metavar="NAME", help="the tool (galen-hw tool list); with --from its own name")
    parser.add_argument("--virtual", action="store_true", help="start a virtual robot and calibrate on it")
    add_speed(parser)
    parser.add_argument(
        "--from", dest="recording", metavar="RECORDING", type=Path, help="fit a recording, move nothing"
    )
    add_robot(parser)
    parser.add_argument("--yes", action="store_true", help="accept without asking (scripts)")
    parser.add_argument(
        "--no-repair", action="store_true", help="with --from: refuse what would be put right: units, axes, clocks"
    )
    parser.add_argument("--json", action="store_true", help="print the result as one JSON object")
    parser.add_argument(
        "--report", metavar="PAGE", type=Path, help="write a page with figures: a folder for report.html, or FILE.html"
    )
    parser.add_argument("--poses", metavar="TILTSxROLLS", help="positions per swept axis, e.g. 7x8; ranges stay")
    parser.add_argument("--samples", type=int, metavar="N", help="samples averaged per pose")
    parser.add_argument("--seed", type=int, metavar="N", help="of the order of the poses")
    parser.add_argument("--no-bare", action="store_true", help="no poses without the tool: trust the zeroing")
    parser.add_argument(
        "--no-check", action="store_true", help="no slow motion at the end that checks the compensation"
    )
    parser.add_argument("--config", metavar="FILE", help="settings for --virtual")
    parser.add_argument("--dir", metavar="RUNTIME", type=Path, help="runtime directory of the daemon")
    parser.epilog = "examples: galen-hw calibrate --tool retractor --virtual; galen-hw calibrate --from sweep/ --yes"


def run(args: argparse.Namespace) -> int:
    """Calibrate; 0 if it was accepted and checked, 1 if the check did not pass, 4 if it was not accepted."""
    from rich.console import Console

    console = Console(stderr=args.json)
    if not console.is_terminal:
        console = Console(stderr=args.json, width=128, soft_wrap=True)  # tables have a width, lines have none
    _check(args)
    if args.recording is not None:
        return _from_recording(args, console)
    if args.tool is None:
        raise UsageError("which tool?", where="--tool", todo="galen-hw tool list names them")
    from galen_hw.tools.calibration.asked import check_virtual, overrides

    overrides(args)
    if args.virtual:
        check_virtual(args)
    with ExitStack() as stack:
        return _live(args, console, _daemon(args, stack))


def _check(args: argparse.Namespace) -> None:
    """What is wrong with the words themselves, before anything is read, started or moved."""
    require_virtual(args)
    for option, given in (
        ("--robot", args.robot),
        ("--xacro-arg", args.xacro_arg),
        ("--sensor-link", args.sensor_link),
    ):
        if given and args.recording is None:
            raise UsageError("only of a recording", where=option, todo="add --from RECORDING")
    from galen_hw.config.tool_store import check_name
    from galen_hw.extras import need
    from galen_hw.tools.outputs import report_page

    if args.tool is not None:
        check_name(args.tool)
    if args.report is not None:
        need("reports", "--report")
        args.report = report_page(args.report)


def _from_recording(args: argparse.Namespace, console: "Console") -> int:
    """Everything but the robot."""
    from galen_hw.config.paths import state_dir
    from galen_hw.config.tool_store import ToolStore
    from galen_hw.formats import read
    from galen_hw.tools.calibration.recorded import calibrate_recording

    store = ToolStore(state_dir())
    recording = read(args.recording, robot=robot_given(args), info=keys_given(args))
    found = calibrate_recording(recording, store, args.tool, repair=not args.no_repair)
    return _conclude(_Session(args, console, store), found.result, found.tool, found.premises)


def _daemon(args: argparse.Namespace, stack: ExitStack) -> "Addresses":
    """The running daemon's addresses, or those of one of our own on a virtual robot."""
    from galen_hw.config.paths import Addresses, client_runtime_dir

    if args.virtual:
        from galen_hw.daemon.session import own_daemon

        return stack.enter_context(own_daemon(config=args.config, runtime=args.dir, speed=args.speed))
    addresses = Addresses(args.dir or client_runtime_dir())
    try:
        addresses.require_daemon()
    except GalenError as error:
        error.todo = "start one with galen-hw run, or add --virtual to calibrate on a virtual robot"
        raise
    return addresses


def _live(args: argparse.Namespace, console: "Console", addresses: "Addresses") -> int:
    """Sweep on the robot, then as from a recording, then the check."""
    from galen_hw.bus import CommandClient
    from galen_hw.config.tool_store import ToolStore
    from galen_hw.permission import require_writable
    from galen_hw.recording import read_recording
    from galen_hw.tools.calibration.asked import overrides
    from galen_hw.tools.calibration.poses import poses_of
    from galen_hw.tools.calibration.recorded import setting_of
    from galen_hw.tools.calibration.result import analyse, tool_file, with_terms
    from galen_hw.tools.calibration.sweep import by_hand, by_virtual_hand, run_sweep

    with CommandClient(addresses.command) as client:
        info = client.call("daemon", "info")
    virtual = bool(info["virtual"])
    store = ToolStore(Path(info["state_dir"]), virtual=virtual)
    nominal = store.load(args.tool)
    # Not at the end of a sweep: what was found would be kept there.
    require_writable(store.path(args.tool, 1).parent, f"galen-hw calibrate --tool {args.tool}")
    operator = (
        by_virtual_hand(console, args.tool, addresses.virtual)
        if virtual
        else by_hand(console, args.tool, addresses, ask=not args.yes)
    )
    console.print(f"[bold]calibrating {args.tool}[/]" + (" on a virtual robot" if virtual else ""))
    folder, stopped = run_sweep(addresses, args.tool, overrides(args), operator, console)
    if stopped:
        todo = (
            f"what was measured can be fitted: galen-hw calibrate --from {shlex.quote(str(folder))} --tool {args.tool}"
        )
        raise _StoppedError(stopped, where="sweep", todo=todo if _can_be_fitted(args.tool, folder) else "")
    recording = read_recording(folder)
    found = poses_of(recording)
    result = analyse(args.tool, found.poses, str(folder), found.notes)
    session = _Session(args, console, store, addresses)
    tool = tool_file(result, with_terms(nominal, found.terms), setting_of(recording))
    return _conclude(session, result, tool, found.premises)


def _can_be_fitted(tool: str, folder: Path) -> bool:
    """Return whether the poses of a sweep that was stopped are enough for a fit: asked of the fit itself."""
    from galen_hw.recording import read_recording
    from galen_hw.tools.calibration.poses import poses_of
    from galen_hw.tools.calibration.result import analyse

    if not (folder / "recording.csv").exists():
        return False
    try:
        analyse(tool, poses_of(read_recording(folder)).poses, str(folder))
    except GalenError:
        return False
    return True


class _StoppedError(GalenError):
    """The sweep did not come to its end."""

    exit_code = 3


@dataclass(frozen=True)
class _Session:
    """What the end of a calibration needs beside its result; `addresses` is None without a robot."""

    args: argparse.Namespace
    console: "Console"
    store: Any
    addresses: "Addresses | None" = None


def _conclude(session: _Session, result: "Result", tool: "ToolFile", premises: "Sequence[Remark]" = ()) -> int:
    """Show, ask, save, select, check, report."""
    from galen_hw.tools.calibration.screen import check_table, show_accepted, show_result

    args, console = session.args, session.console
    show_result(console, result)
    check = None
    accepted = args.yes or (_ask(console, tool.name) if not args.json else False)
    if accepted:
        tool = session.store.save(tool)
        assert tool.origin is not None
        path = session.store.path(tool.name, tool.origin.generation)
        show_accepted(console, tool, str(path))
        if session.addresses is not None:
            check = _select_and_check(session, tool, result)
            if check is not None:
                console.print(check_table(check.rms, check.rms_raw, check.noise))
    else:
        console.print("[yellow]not accepted: nothing has changed[/]" + _how_later(tool))
    # A script that wants figures says where; a person always gets them.
    wanted = (args.report is not None or not args.json) and _can_draw(console)
    page = _report(session, result, tool, check, accepted=accepted) if wanted else None
    if args.json:
        from galen_hw.tools.answer import stamped
        from galen_hw.tools.calibration.answer import answer_of

        answer = answer_of(result, tool, check, page, accepted=accepted)
        print(json.dumps(stamped(answer | {"premises": [remark.to_json() for remark in premises]}, seed=args.seed)))
    if not accepted:
        return EXIT_REFUSED
    passed = (check is None or check.passed) and (page is not None or not wanted)
    return EXIT_OK if passed else EXIT_FOUND


def _can_draw(console: "Console") -> bool:
    """Return whether there can be a page at all; a robot's computer may do without."""
    from galen_hw.extras import MissingExtraError, need

    try:
        need("reports", "no page")
    except MissingExtraError as error:
        console.print(str(error), markup=False)
        return False
    return True


def _how_later(tool: "ToolFile") -> str:
    sweep = tool.origin.sweep if tool.origin else ""
    return f"; the sweep is kept: galen-hw calibrate --tool {tool.name} --from {shlex.quote(sweep)}" if sweep else ""


def _ask(console: "Console", name: str) -> bool:
    if not sys.stdin.isatty():
        console.print("[yellow]nobody can be asked, the input is not a terminal: add --yes to accept[/]")
        return False
    console.print(f"Use this calibration for {name} from now on? \\[y/N] ", end="")
    return sys.stdin.readline().strip().lower() in ("y", "yes")


def _select_and_check(session: _Session, tool: "ToolFile", result: "Result") -> "LiveCheck | None":
    """Have the daemon take the tool up, then see every sample compensated."""
    from galen_hw.bus import CommandClient
    from galen_hw.tools.calibration.check import live_check

    addresses = session.addresses
    assert addresses is not None
    with CommandClient(addresses.command) as client:
        client.call("compensation", "select_tool", {"tool": tool.name})
        client.call("compensation", "set_enabled", {"enabled": True})
    if session.args.no_check:
        return None
    session.console.print("checking the live compensation in slow motion")
    return live_check(addresses, tool.name, tool.calibration_id, session.console, result.poses.noise)


def _report(
    session: _Session, result: "Result", tool: "ToolFile", check: "LiveCheck | None", *, accepted: bool
) -> Path | None:
    """Figures and page, beside the tool's calibrations unless told where; None if they cannot be written."""
    from galen_hw.tools.calibration.figures import write_report
    from galen_hw.tools.outputs import PAGE

    number = tool.origin.generation if tool.origin else 0
    leaf = f"{tool.name}-{number:04d}" if accepted else f"{tool.name}-not-accepted"
    target = session.args.report or session.store.state_dir / "reports" / leaf / PAGE
    state = f"accepted as {tool.calibration_id}" if accepted else "not accepted"
    more = _drift(session, tool) if check is not None else ()
    try:
        page = write_report(result, target, tool, check, state, more)
    except OSError as error:
        # What was accepted is in use whether there is a page or not: the calibration must not look as if it had failed.
        done = f"{tool.calibration_id} is active all the same" if accepted else "nothing has changed"
        problem = UsageError(
            f"the page cannot be written ({error.strerror})", where=str(target), todo=f"check space and rights; {done}"
        )
        print(f"galen-hw calibrate: {problem}", file=sys.stderr)
        return None
    session.console.print(f"figures and page: {page}")
    return page


def _drift(session: _Session, tool: "ToolFile") -> "tuple[tuple[str, Callable[[], Figure]], ...]":
    """On a virtual robot: what the compensation is for, shown with the calibration that was just found."""
    from galen_hw.drivers.virtual.truth import TOOLS

    if tool.origin is None or not tool.origin.virtual or tool.name not in TOOLS:
        return ()
    from galen_hw.tools.figure_drift import drift_figure, measure_drift

    session.console.print("turning the tool by hand and letting go, without and with the compensation")
    drift = measure_drift(tool, held=tool.name)
    text = f"  drifts {1e3 * drift.drift_off:.1f} mm in 3.5 s without, {1e3 * drift.drift_on:.1f} mm with it"
    session.console.print(text, style="bold", highlight=False)
    return (("hand_over_hand", lambda: drift_figure(drift)),)

"""`galen-hw calibrate`: sweep, fit, verify, ask, and only then change what the live compensation uses."""

import argparse
import json
import re
import sys
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from galen_hw.documents import load_json
from galen_hw.errors import EXIT_FOUND, EXIT_OK, GalenError, UsageError

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from matplotlib.figure import Figure
    from rich.console import Console

    from galen_hw.config.paths import Addresses
    from galen_hw.config.tool_file import ToolFile
    from galen_hw.premises import Remark
    from galen_hw.recording import Recording
    from galen_hw.tools.calibration.check import LiveCheck
    from galen_hw.tools.calibration.result import Result, Setting


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of the command."""
    parser.add_argument("--tool", metavar="NAME", help="the tool (galen-hw tool list); with --from its own name")
    parser.add_argument("--virtual", action="store_true", help="start a virtual robot and calibrate on it")
    parser.add_argument(
        "--from", dest="recording", metavar="RECORDING", type=Path, help="fit a recording, move nothing"
    )
    parser.add_argument("--yes", action="store_true", help="accept without asking (scripts)")
    parser.add_argument(
        "--no-repair", action="store_true", help="with --from: refuse what would be put right: units, axes, clocks"
    )
    parser.add_argument("--json", action="store_true", help="print the result as one JSON object")
    parser.add_argument("--report", metavar="DIR", type=Path, help="write figures and report.html there")
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
    """Calibrate; 0 if it was accepted, 1 if not."""
    from rich.console import Console

    console = Console(stderr=args.json)
    if not console.is_terminal:
        console = Console(stderr=args.json, width=128)
    _check(args)
    if args.recording is not None:
        return _from_recording(args, console)
    if args.tool is None:
        raise UsageError("which tool?", where="--tool", todo="galen-hw tool list names them")
    with ExitStack() as stack:
        return _live(args, console, _daemon(args, stack))


def _check(args: argparse.Namespace) -> None:
    """What is wrong with the words themselves, before anything is read, started or moved."""
    from galen_hw.config.paths import require_folder
    from galen_hw.config.tool_store import check_name

    if args.tool is not None:
        check_name(args.tool)
    if args.report is not None:
        require_folder(args.report, "--report")


def _from_recording(args: argparse.Namespace, console: "Console") -> int:
    """Everything but the robot."""
    from galen_hw.config.paths import state_dir
    from galen_hw.config.tool_file import ToolFile
    from galen_hw.config.tool_store import ToolStore
    from galen_hw.formats import read
    from galen_hw.identification.sense import contradictions
    from galen_hw.tools.calibration.poses import poses_of
    from galen_hw.tools.calibration.result import analyse, tool_file, with_terms

    recording = read(args.recording)
    store = ToolStore(state_dir())
    named = recording.info.tool
    name = args.tool or _slug(named.name if named else "") or _slug(args.recording.stem)
    if not name:
        raise UsageError("no tool's name can be made of it", where=str(args.recording), todo="give one with --tool")
    if name in store.names():
        nominal = store.nominal(name)
    else:
        nominal = ToolFile(name=name, tip=(named.tip if named and named.tip else None) or (0.0, 0.0, 0.0))
    found = poses_of(recording, repair=not args.no_repair)
    result = analyse(name, found.poses, str(args.recording), found.notes)
    if named is not None:
        more = tuple(contradictions(result.estimate, named.mass, named.com))
        result = replace(result, remarks=(*result.remarks, *more))
    tool = tool_file(result, with_terms(nominal, found.terms), setting_of(recording))
    return _conclude(_Session(args, console, store), result, tool, found.premises)


def setting_of(recording: "Recording") -> "Setting":
    """On what a recording was made, as far as it says."""
    from galen_hw.tools.calibration.result import Setting

    about = _about(recording.path)
    info = recording.info
    zeroed: Any = info.zeroed_at
    if isinstance(zeroed, tuple) and len(zeroed) != 4:
        zeroed = dict(zip(recording.joint_names, zeroed, strict=True))
    robot = str(about.get("robot") or info.robot or "")
    sweep = str(recording.path.resolve())
    return Setting(robot, info.sensor_serial, sweep, zeroed, about.get("date"), virtual=info.virtual)


def _about(folder: Path) -> dict[str, Any]:
    """`sweep.json` beside a sweep of our own."""
    try:
        found = load_json((folder / "sweep.json").read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}
    return found if isinstance(found, dict) else {}


def _daemon(args: argparse.Namespace, stack: ExitStack) -> "Addresses":
    """The running daemon's addresses, or those of one of our own on a virtual robot."""
    from galen_hw.config.paths import Addresses, client_runtime_dir

    if args.virtual:
        from galen_hw.daemon.session import own_daemon

        return stack.enter_context(own_daemon(config=args.config, virtual=True, runtime=args.dir))
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
    from galen_hw.tools.calibration.poses import poses_of
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
    folder, stopped = run_sweep(addresses, args.tool, _overrides(args), operator, console)
    if stopped:
        todo = f"what was measured can be fitted: galen-hw calibrate --from {folder} --tool {args.tool}"
        raise _StoppedError(stopped, where="sweep", todo=todo if _can_be_fitted(args.tool, folder) else "")
    recording = read_recording(folder)
    found = poses_of(recording)
    result = analyse(args.tool, found.poses, str(folder), found.notes)
    session = _Session(args, console, store, addresses)
    tool = tool_file(result, with_terms(nominal, found.terms), setting_of(recording))
    return _conclude(session, result, tool, found.premises)


def _can_be_fitted(tool: str, folder: Path) -> bool:
    """Whether the poses of a sweep that was stopped are enough for a fit: asked of the fit itself."""
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


def _overrides(args: argparse.Namespace) -> dict[str, Any]:
    """Arguments of the sweep that differ from its settings."""
    overrides: dict[str, Any] = {}
    if args.poses is not None:
        if not re.fullmatch(r"\d{1,4}(x\d{1,4})*", args.poses):
            raise UsageError(f"{args.poses!r} is not TILTSxROLLS", where="--poses", todo="e.g. --poses 7x8")
        # Only the counts: which joints are swept, and how far, is the daemon's to say.
        overrides["counts"] = [int(count) for count in args.poses.split("x")]
    overrides |= {key: getattr(args, key) for key in ("samples", "seed") if getattr(args, key) is not None}
    return overrides | ({"bare_poses": 0} if args.no_bare else {})


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
        console.print(show_accepted(tool, str(path)))
        if session.addresses is not None:
            check = _select_and_check(session, tool, result)
            if check is not None:
                console.print(check_table(check.rms, check.rms_raw, check.noise))
    else:
        console.print("[yellow]not accepted: nothing has changed[/]" + _how_later(tool))
    # A script that wants figures says where; a person always gets them.
    wanted = args.report is not None or not args.json
    page = _report(session, result, tool, check, accepted=accepted) if wanted else None
    if args.json:
        answer = _as_json(result, tool, check, page, accepted=accepted)
        print(json.dumps(answer | {"premises": [remark.to_json() for remark in premises]}))
    passed = accepted and (check is None or check.passed) and (page is not None or not wanted)
    return EXIT_OK if passed else EXIT_FOUND


def _how_later(tool: "ToolFile") -> str:
    sweep = tool.origin.sweep if tool.origin else ""
    return f"; the sweep is kept: galen-hw calibrate --tool {tool.name} --from {sweep}" if sweep else ""


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

    number = tool.origin.generation if tool.origin else 0
    leaf = f"{tool.name}-{number:04d}" if accepted else f"{tool.name}-not-accepted"
    folder = session.args.report or session.store.state_dir / "reports" / leaf
    state = f"accepted as {tool.calibration_id}" if accepted else "not accepted"
    more = _drift(session, tool) if check is not None else ()
    try:
        page = write_report(result, folder, tool, check, state, more)
    except OSError as error:
        # What was accepted is in use whether there is a page or not: the calibration must not look as if it had failed.
        done = f"{tool.calibration_id} is active all the same" if accepted else "nothing has changed"
        problem = UsageError(
            f"the page cannot be written ({error.strerror})", where=str(folder), todo=f"check space and rights; {done}"
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


def _as_json(
    result: "Result", tool: "ToolFile", check: "LiveCheck | None", page: Path | None, *, accepted: bool
) -> dict[str, Any]:
    """The result for machines; SI units."""
    data = tool.model_dump(by_alias=True, exclude_none=True, mode="json")
    candidates = [
        {
            "key": c.key,
            "title": c.title,
            "unknowns": c.unknowns,
            "mass": c.mass,
            "com": list(map(float, c.com)),
            "residual": c.rms.tolist(),
            "left_out": c.left_out_rms.tolist(),
            "bic": c.bic,
            "p_value": c.p_value if c.p_value == c.p_value else None,
        }
        for c in result.comparison.candidates
    ]
    live = None
    if check is not None:
        live = {
            "rms": check.rms.tolist(),
            "noise_floor": check.noise.tolist(),
            "ratio": check.ratios,
            "samples": check.samples,
            "left_out_braking": check.braked,
            "passed": check.passed,
        }
    return {
        "accepted": accepted,
        "tool": data,
        "recommended": result.comparison.recommended,
        "reason": result.comparison.reason,
        "interval95": (result.estimate.t95 * result.estimate.std[:4]).tolist(),
        "residual": result.best.rms.tolist(),
        "candidates": candidates,
        "remarks": list(result.remarks),
        "check": live,
        "report": None if page is None else str(page),
    }


def _slug(text: str) -> str:
    """A tool's name out of any text; empty if there is none in it."""
    return re.sub(r"[^a-z0-9_-]+", "-", text.lower()).strip("-_")[:40]

"""`galen-hw tool`: the tools, their calibrations and their history."""

import argparse
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from galen_hw.errors import EXIT_OK, GalenError, UsageError
from galen_hw.tools.answer import print_stamped

if TYPE_CHECKING:
    from galen_hw.config.tool_file import ToolFile
    from galen_hw.config.tool_store import Generation, ToolStore


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of the command and of its parts."""
    parts = parser.add_subparsers(dest="part", metavar="PART", required=True)
    for name, (_, text) in PARTS.items():
        part = parts.add_parser(name, help=text, description=text[0].upper() + text[1:] + ".")
        part.epilog = f"example: galen-hw tool {EXAMPLES[name]}"
        if name not in ("list", "import"):
            optional = "?" if name == "select" else None
            part.add_argument("name", metavar="NAME", nargs=optional, help="the tool")
        if name in ("show", "rollback", "export"):
            part.add_argument("--generation", type=int, metavar="N", help="of the history; default: see above")
        if name == "export":
            part.add_argument("file", metavar="FILE", nargs="?", type=Path, help="to write; default: NAME.json")
            part.add_argument("--overwrite", action="store_true", help="overwrite the file, make missing folders")
        if name == "import":
            part.add_argument("file", metavar="FILE", type=Path, help="a tool's file, as export writes it")
            part.add_argument("--foreign", action="store_true", help="take the calibration of another sensor or robot")
        if name == "select":
            part.add_argument("--none", action="store_true", help="no tool in hand")
        part.add_argument("--json", action="store_true", help="print JSON")
        part.add_argument("--dir", metavar="RUNTIME", type=Path, help="runtime directory of the daemon")
    parser.epilog = "examples: galen-hw tool show retractor --json; galen-hw tool rollback retractor"


def run(args: argparse.Namespace) -> int:
    """Carry out one part."""
    return PARTS[args.part][0](args, tool_store(args.dir))


def tool_store(runtime: Path | None) -> "ToolStore":
    """The tools of the daemon that runs in a runtime directory (None: the usual one), or the user's own."""
    from galen_hw.config.paths import state_dir
    from galen_hw.config.tool_store import ToolStore

    info = _ask_daemon(runtime, "daemon", "info", {})
    folder = info.get("state_dir")
    return ToolStore(Path(folder) if folder else state_dir(), virtual=info.get("virtual"))


def _ask_daemon(runtime: Path | None, target: str, name: str, arguments: dict[str, Any]) -> dict[str, Any]:
    """The daemon's answer, empty if none runs.

    Raises:
        GalenError: it refuses.
    """
    from galen_hw.bus import CommandClient
    from galen_hw.config.paths import Addresses, client_runtime_dir
    from galen_hw.errors import HardwareError
    from galen_hw.permission import require_permission

    addresses = Addresses(runtime or client_runtime_dir())
    require_permission(addresses.runtime / "command")
    if not (addresses.runtime / "command").exists():
        return {}
    with CommandClient(addresses.command) as client:
        try:
            return client.call(target, name, arguments, timeout_s=3.0)
        except HardwareError as error:
            if "no answer" in error.what:
                return {}
            raise


def _list(args: argparse.Namespace, store: "ToolStore") -> int:
    rows = [row for name in store.names() for row in _rows(store, name)]
    if args.json:
        print_stamped({"tools": rows})
        return EXIT_OK
    table = _table("", "tool", "mass g", "com mm", "calibration", "date", "robot", "sensor")
    for row in rows:
        table.add_row(">" if row["selected"] else "", row["name"], *_cells(row))
    _print(table)
    return EXIT_OK


def _rows(store: "ToolStore", name: str) -> list[dict[str, Any]]:
    """What is in use of a tool: on the real robot, on a virtual one, or neither."""
    rows = []
    for kind in (False, True):
        of_kind = replace(store, virtual=kind)
        row: dict[str, Any] = {"name": name, "selected": name == of_kind.selected(), "virtual": kind}
        try:
            row |= _summary(of_kind.load(name)) | {"virtual": kind}
        except GalenError as error:
            row["error"] = str(error)
        if not kind or row.get("calibrated") or "error" in row:
            rows.append(row)
    calibrated = [row for row in rows if row.get("calibrated") or "error" in row]
    return calibrated or rows


def _show(args: argparse.Namespace, store: "ToolStore") -> int:
    tool = store.load(args.name) if args.generation is None else store.generation(args.name, args.generation)
    if args.json:
        data = tool.model_dump(by_alias=True, mode="json")
        data |= {"calibrated": tool.calibrated, "calibration": tool.calibration_id}
        print_stamped(data)
        return EXIT_OK
    _print_tool(tool)
    return EXIT_OK


def _select(args: argparse.Namespace, store: "ToolStore") -> int:
    name = None if args.none else args.name
    if name is None and not args.none:
        raise UsageError("which tool?", where="tool select", todo="give its name, or --none")
    if name is not None:
        tool = store.load(name)
        if tool.origin is None:
            todo = f"galen-hw calibrate --tool {name}"
            raise UsageError(f"tool {name!r} was never calibrated", where="tool select", todo=todo)
        store = replace(store, virtual=tool.origin.virtual)
    live = _ask_daemon(args.dir, "compensation", "select_tool", {"tool": name})
    if not live:  # The daemon has kept it, where it may write and an operator perhaps not.
        store.select(name)
    daemon = "a virtual one" if store.virtual else "it"
    where = "the daemon uses it now" if live else f"no daemon runs: taken up when {daemon} starts"
    return _done(args, {"selected": name}, f"selected {name or 'no tool'}; {where}")


def _history(args: argparse.Namespace, store: "ToolStore") -> int:
    history = store.history(args.name)
    if args.json:
        print_stamped({"history": [_entry(g) for g in history]})
        return EXIT_OK
    if not history:
        print(f"{args.name} was never calibrated: galen-hw calibrate --tool {args.name}")
        return EXIT_OK
    table = _table("", "n", "mass g", "com mm", "calibration", "date", "robot", "sensor")
    for g in history:
        cells = _cells(_summary(g.tool)) if g.tool else _cells({"error": g.error})
        table.add_row(">" if g.active else "", str(g.number), *cells)
    _print(table)
    return EXIT_OK


def _rollback(args: argparse.Namespace, store: "ToolStore") -> int:
    before = store.active(args.name)
    tool = store.rollback(args.name, args.generation)
    of_kind = replace(store, virtual=bool(tool.origin and tool.origin.virtual))
    live = store.virtual == of_kind.virtual and of_kind.selected() == args.name
    live = live and bool(_ask_daemon(args.dir, "compensation", "reload", {}))
    text = f"{args.name}: generation {before} -> {store.active(args.name)}" + (
        "; the daemon uses it now" if live else ""
    )
    return _done(args, {"name": args.name, "calibration": tool.calibration_id}, text)


def _export(args: argparse.Namespace, store: "ToolStore") -> int:
    from galen_hw.config.tool_store import write_atomic

    tool = store.load(args.name) if args.generation is None else store.generation(args.name, args.generation)
    file = args.file or Path(f"{args.name}.json")
    if not args.overwrite and file.exists():
        raise UsageError("is there already", where=str(file), todo="give another name, or --overwrite")
    if not args.overwrite and not file.parent.is_dir():
        raise UsageError("there is no such folder", where=str(file.parent), todo="make it, or --overwrite")
    write_atomic(file, tool.to_json() + "\n")
    return _done(args, {"file": str(file)}, f"wrote {file}")


def _import(args: argparse.Namespace, store: "ToolStore") -> int:
    from galen_hw.config.paths import Addresses, client_runtime_dir
    from galen_hw.tools.tool_import import hardware_here, read_tool, refuse_foreign, refuse_unservable

    tool = read_tool(args.file)
    bus = Addresses(args.dir or client_runtime_dir()).bus
    here = hardware_here(_ask_daemon(args.dir, "daemon", "info", {}), store, bus)
    if not args.foreign:
        refuse_foreign(tool, here, args.file)
    refuse_unservable(tool, here.robot, args.file)
    saved = store.save(tool)
    of_kind = replace(store, virtual=bool(saved.origin and saved.origin.virtual))
    live = store.virtual == of_kind.virtual and of_kind.selected() == saved.name
    live = live and bool(_ask_daemon(args.dir, "compensation", "reload", {}))
    effects = ", ".join(dict.fromkeys(term.effect for term in saved.terms))
    text = f"imported {saved.calibration_id}" + (f" with {effects}" if effects else "")
    text += "; the daemon uses it now" if live else ""
    return _done(args, {"name": saved.name, "calibration": saved.calibration_id}, text)


def _summary(tool: "ToolFile") -> dict[str, Any]:
    origin = tool.origin
    return {
        "calibrated": tool.calibrated,
        "calibration": tool.calibration_id,
        "mass": tool.mass,
        "com": tool.com,
        "std": tool.std.model_dump(mode="json") if tool.std else None,
        "date": origin.date if origin else None,
        "sensor_serial": origin.sensor_serial if origin else None,
        "robot": origin.robot if origin else None,
        "virtual": origin.virtual if origin else False,
    }


def _entry(generation: "Generation") -> dict[str, Any]:
    row: dict[str, Any] = {"generation": generation.number, "active": generation.active, "file": str(generation.path)}
    return row | (_summary(generation.tool) if generation.tool else {"error": generation.error})


def _cells(row: dict[str, Any]) -> list[str]:
    if "error" in row:
        return ["", "", str(row["error"]), "", "", ""]
    if not row["calibrated"]:
        return ["-", "-", "never calibrated", "", "", ""]
    com = ", ".join(f"{1e3 * x:.2f}" for x in row["com"])
    robot = f"virtual {row['robot']}" if row["virtual"] else row["robot"] or "?"
    return [f"{1e3 * row['mass']:.2f}", com, row["calibration"], row["date"], robot, row["sensor_serial"] or "?"]


def _print_tool(tool: "ToolFile") -> None:
    from rich.console import Console

    console, mm = Console(highlight=False), "({:.2f}, {:.2f}, {:.2f}) mm"
    rows = [("tip", mm.format(*(1e3 * x for x in tool.tip)))]
    if tool.contact:
        rows.append(("contact", mm.format(*(1e3 * x for x in tool.contact))))
    if tool.mass is None or tool.com is None or tool.origin is None:
        rows.append(("calibration", f"never: galen-hw calibrate --tool {tool.name}"))
    else:
        std, wide = tool.std, 1e3 * tool.coverage_factor
        rows.append(("mass", f"{1e3 * tool.mass:.3f} g" + (f" +- {wide * std.mass:.3f} g (95 %)" if std else "")))
        spread = f" +- ({', '.join(f'{wide * x:.3f}' for x in std.com)}) mm" if std else ""
        rows.append(("centre of mass", mm.format(*(1e3 * x for x in tool.com)) + spread))
        if tool.bias_body:
            body = tool.bias_body
            rows.append(("bias body", f"{1e3 * body.mass:.3f} g at " + mm.format(*(1e3 * x for x in body.com))))
        origin = tool.origin
        sensor = origin.sensor_serial or "not known"
        rows += [
            ("calibration", f"{origin.id}, {origin.date}, {origin.software}"),
            ("made on", f"{'virtual ' if origin.virtual else ''}robot {origin.robot or 'not known'}, sensor {sensor}"),
            ("by", f"{origin.method}, {origin.fit_poses} poses and {origin.verify_poses} to verify with"),
            ("raw sweep", origin.sweep or "-"),
        ]
        rows += [("effect", f"{term.effect} ({term.source})") for term in tool.terms]
        rows += [("remark", line) for line in origin.remarks]
    console.print(f"[bold]{tool.name}[/]")
    for key, value in rows:
        console.print(f"  {key:<15} {value}", soft_wrap=True)


def _done(args: argparse.Namespace, data: dict[str, Any], text: str) -> int:
    if args.json:
        print_stamped(data)
    else:
        print(text)
    return EXIT_OK


def _table(*heads: str) -> Any:
    from rich import box
    from rich.table import Table

    table = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    for head in heads:
        table.add_column(head, no_wrap=True, justify="right" if head in ("n", "mass g", "com mm") else "left")
    return table


def _print(table: Any) -> None:
    from rich.console import Console

    console = Console()
    (console if console.is_terminal else Console(width=140)).print(table)


PARTS: dict[str, tuple[Callable[[argparse.Namespace, "ToolStore"], int], str]] = {
    "list": (_list, "all tools and the calibration that each uses"),
    "show": (_show, "mass, centre of mass, their uncertainty and where they came from"),
    "select": (_select, "the tool in hand, for the running daemon and after a restart"),
    "history": (_history, "all calibrations of a tool"),
    "rollback": (_rollback, "use an earlier calibration again"),
    "export": (_export, "write a tool's file"),
    "import": (_import, "add a tool's file as a new generation"),
}
EXAMPLES: dict[str, str] = {
    "list": "list --json",
    "show": "show retractor --generation 2",
    "select": "select retractor",
    "history": "history retractor",
    "rollback": "rollback retractor --generation 1",
    "export": "export retractor retractor.json",
    "import": "import retractor.json",
}

"""`galen-hw deflection`: fit and compare deflection models, and choose the one that serves."""

import argparse
import json
import math
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from galen_hw.errors import EXIT_OK, EXIT_REFUSED, UsageError
from galen_hw.tools.answer import print_stamped

if TYPE_CHECKING:
    from galen_hw.services.deflection.store import DeflectionFile, DeflectionStore
    from galen_hw.tools.deflection.fit import Comparison

RELOAD: Final = "the service takes it up with: galen-hw command deflection reload"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of the command."""
    parser.add_argument("--state", metavar="DIR", type=Path, help="state directory (default: the daemon's)")
    sub = parser.add_subparsers(dest="action", metavar="ACTION", required=True)
    fit = _part(
        sub, "fit", "fit all models, judge them on held-out sets, recommend one; saved if you say so", "fit session/"
    )
    fit.add_argument("data", nargs="+", type=Path, metavar="DATA", help="recordings, or folders of recordings")
    fit.add_argument(
        "--report", metavar="PAGE", type=Path, help="write a page with figures: FILE.html, or a folder for report.html"
    )
    fit.add_argument("--save", metavar="NAME", help="save under this name (default: the tool's)")
    fit.add_argument("--yes", action="store_true", help="save the recommended model without asking (scripts)")
    fit.add_argument("--no-save", action="store_true", help="save nothing, and do not ask")
    fit.add_argument("--holdout", nargs="+", default=[], metavar="SET", help="sets to judge on (default: chosen)")
    fit.add_argument("--models", nargs="+", metavar="MODEL", help="only these, by a part of their names")
    _part(sub, "list", "the saved models, and the one that serves (*)", "list --json")
    show = _part(sub, "show", "one saved model: the whole file, which is JSON", "show pointer")
    select = _part(sub, "select", "serve this model ('none': none)", "select pointer")
    for part in (show, select):
        part.add_argument("name", metavar="NAME", help="of the saved model")
    text = "take up a model's file, as galen-hw diagnose --save-model writes it"
    take = _part(sub, "import", text, "import arm.json")
    take.add_argument("file", type=Path, metavar="FILE", help="of a deflection model")
    back = _part(sub, "rollback", "go back to an earlier generation of a model", "rollback pointer 1")
    back.add_argument("name", metavar="NAME", help="of the saved model")
    back.add_argument("generation", nargs="?", type=int, metavar="N", help="default: the one before")
    parser.epilog = "example: galen-hw deflection fit session/ --report out.html"


def _part(sub: Any, name: str, text: str, example: str) -> argparse.ArgumentParser:
    part: argparse.ArgumentParser = sub.add_parser(name, help=text, description=text[0].upper() + text[1:] + ".")
    part.epilog = f"example: galen-hw deflection {example}"
    part.add_argument("--json", action="store_true", help="print JSON")
    return part


def run(args: argparse.Namespace) -> int:
    """Carry out one action."""
    from galen_hw.config.paths import state_dir
    from galen_hw.services.deflection.store import DeflectionStore

    store = DeflectionStore(args.state or state_dir())
    if args.action == "fit":
        return _fit(args, store)
    if args.action == "list":
        _list(store, as_json=args.json)
    elif args.action == "show":
        file = store.load(args.name)
        print(json.dumps(file.model_dump(mode="json", by_alias=True), indent=1))
    elif args.action == "import":
        saved = store.save(read_model(args.file))
        _done(args, {"model": saved.id}, f"imported {saved.id}; {RELOAD}")
    elif args.action == "select":
        name = None if args.name == "none" else args.name
        store.select(name)
        chosen = None if name is None else store.load(name).id
        _done(args, {"selected": name, "model": chosen}, f"selected {chosen or 'no model'}; {RELOAD}")
    else:
        found = store.rollback(args.name, args.generation)
        _done(args, {"model": found.id}, f"{found.id} is in use again; {RELOAD}")
    return EXIT_OK


def _done(args: argparse.Namespace, data: dict[str, Any], text: str) -> None:
    if args.json:
        print_stamped(data)
    else:
        print(text)


def _list(store: "DeflectionStore", *, as_json: bool) -> None:
    """All saved models, what they are of, and which one serves."""
    selected, files = store.selected(), [store.load(name) for name in store.names()]
    if as_json:
        shown = {"name", "model", "robot", "virtual", "tool", "tip", "date", "rmse_m", "reason"}
        rows = [f.model_dump(mode="json", include=shown) | {"id": f.id, "selected": f.name == selected} for f in files]
        print_stamped({"models": rows})
        return
    for file in files:
        mark = "*" if file.name == selected else " "
        print(f"{mark} {file.id:24s} {file.model:18s} tool {file.tool or '-':10s} {file.date}  {file.reason}")
    if not files:
        print(f"no deflection models in {store.folder}; fit one: galen-hw deflection fit DATA...")


def read_model(path: Path) -> "DeflectionFile":
    """A model's file, read and its numbers tried.

    Raises:
        UsageError: it cannot be read, or is no model.
    """
    from galen_hw.documents import DocumentError
    from galen_hw.identification.deflection.table import model_of
    from galen_hw.services.deflection.store import parse_deflection

    try:
        file = parse_deflection(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError) as error:
        raise UsageError(f"cannot be read ({error})", where=str(path), todo="give a deflection model's file") from None
    except DocumentError as error:
        text = f"is no deflection model ({error.what})"
        todo = "galen-hw deflection fit DATA... makes one"
        raise UsageError(text, where=error.within(str(path)), todo=todo) from None
    model_of(file.model, file.values)
    return file


def _fit(args: argparse.Namespace, store: "DeflectionStore") -> int:
    """Fit; 0 if the model was saved or was not to be, 4 if nothing can be fitted or nobody wanted it saved."""
    from galen_hw.extras import need
    from galen_hw.tools.answer import stamped
    from galen_hw.tools.deflection.data import recordings_in
    from galen_hw.tools.deflection.fit import summary
    from galen_hw.tools.deflection.recorded import fit_recordings
    from galen_hw.tools.outputs import report_page

    if args.report is not None:
        need("reports", "--report")
        args.report = report_page(args.report)
    fitted = fit_recordings(
        recordings_in(args.data),
        holdout=args.holdout,
        models=args.models or (),
        say=lambda name: print(f"fitting {name}", file=sys.stderr),
        warn=lambda line: print(f"galen-hw deflection: {line}", file=sys.stderr),
    )
    out = fitted.comparison
    if out is None:
        return EXIT_REFUSED
    if not args.json:
        _show(out)
    if args.report is not None:
        from galen_hw.tools.deflection.figures import write_report

        print(f"report: {write_report(out, args.report)}", file=sys.stderr)
    saved = None
    if not args.no_save and (args.yes or _ask(args.json)):
        saved = store.save(fitted.file(args.save))
        for line in next_steps(saved, store.state_dir):
            print(line, file=sys.stderr)
    if args.json:
        print(json.dumps(stamped(summary(out) | {"saved": None if saved is None else saved.id}), indent=1))
    return EXIT_REFUSED if saved is None and not args.no_save else EXIT_OK


def _ask(as_json: bool) -> bool:
    """Return whether a person wants the recommended model saved; who cannot be asked does not."""
    if as_json or not sys.stdin.isatty():
        print("not saved, nobody can be asked: add --yes to save, --no-save to be spared this line", file=sys.stderr)
        return False
    print("Save the recommended model, so that it can serve? [y/N] ", end="", file=sys.stderr, flush=True)
    return sys.stdin.readline().strip().lower() in ("y", "yes")


def next_steps(saved: "DeflectionFile", state_dir: Path) -> list[str]:
    """What is still to be typed until a saved model serves: the tool in hand must be the model's own.

    Raises:
        UsageError: the tools' store is damaged.
    """
    from galen_hw.config.tool_store import ToolStore
    from galen_hw.services.deflection.model import steps_to_hold

    store = ToolStore(state_dir, virtual=saved.virtual)
    steps = steps_to_hold(store, saved.tool) if saved.tool in store.names() else []
    where = " on a virtual robot" if saved.virtual else ""
    lines = [f"saved as {saved.id}; with the daemon running{where} it serves after:"]
    lines += [f"  {step}" for step in [*steps, "galen-hw command deflection reload"]]
    if saved.virtual:
        lines.append(
            "the arm of galen-hw run --virtual is rigid until galen-hw collect deflection -o DIR runs beside it"
        )
    return lines


def _told(figure: float, words: str) -> str:
    """The words for a figure; a dash where nothing was there to judge it by."""
    return "-" if math.isnan(figure) else words


def _show(out: "Comparison") -> None:
    from rich.console import Console
    from rich.table import Table

    table = Table(title=f"held-out error, mm rms (tracker noise {1e3 * out.noise_m:.3f} mm)", title_justify="left")
    for head in ("model", *out.held, "at rest after", "residual missed", "wrong side of wall", "fit s"):
        table.add_column(head, justify="left" if head == "model" else "right")
    for name, score in out.scores.items():
        errors = [f"{1e3 * score.rmse[kind]:.3f}" for kind in out.held]
        reported, corrected = out.walls[name]
        wall = _told(reported, f"{reported:.1%} -> {corrected:.1%}")
        late = _told(score.released, f"{1e3 * score.released:.3f}")
        missed = _told(score.residual, f"{score.residual:.0%}")
        seconds = f"{out.seconds[name]:.1f}"
        style = "bold" if name == out.best else ""
        table.add_row(name, *errors, late, missed, wall, seconds, style=style)
    piped = not sys.stdout.isatty()
    console = Console(width=130 if piped else None, soft_wrap=piped)
    console.print(table)
    for note in out.notes:
        console.print(f"note: {note}", markup=False)
    console.print(f"recommended: {out.best}: {out.reason}", markup=False)
    for line in out.doubts:
        console.print(line, markup=False, style="yellow")

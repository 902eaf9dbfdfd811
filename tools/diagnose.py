"""`galen-hw diagnose`: find what a model left out: locate, name, model, prove."""

import argparse
import json
from pathlib import Path

from rich.console import Console

from galen_hw.config.tool_store import write_atomic
from galen_hw.diagnosis.bench import Progress
from galen_hw.diagnosis.engine import Work
from galen_hw.diagnosis.result import Diagnosis
from galen_hw.errors import EXIT_FOUND, EXIT_OK, UsageError
from galen_hw.extras import need
from galen_hw.recording import Recording, read_recording
from galen_hw.tools.answer import stamped
from galen_hw.tools.diagnose_screen import counting, show, working
from galen_hw.tools.diagnose_tool import model_to_save, tool_named, with_tool
from galen_hw.tools.diagnose_work import Asked, diagnose_recordings
from galen_hw.tools.outputs import check_file, report_page


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The arguments of the command."""
    parser.add_argument(
        "recordings", nargs="+", metavar="RECORDING", help="MCAP file, table folder, or a folder of them"
    )
    parser.add_argument("--simulation", help="a table that someone else simulated")
    parser.add_argument(
        "--holdout",
        action="append",
        metavar="RECORDING",
        help="a second recording to be judged on (may be given several times), or the share of blocks to set aside (0.3)",
    )
    parser.add_argument(
        "--together", action="store_true", help="fit all recordings as one: the same machine, several runs"
    )
    parser.add_argument("--json", action="store_true", help="print the answer as JSON, the summary on stderr")
    parser.add_argument("-o", "--output", metavar="FILE", type=Path, help="write the answer as JSON to this file")
    parser.add_argument(
        "--report", metavar="PAGE", type=Path, help="write a page with figures: FILE.html, or a folder for report.html"
    )
    parser.add_argument(
        "--tool", metavar="NAME", help="the tool in hand, of the store or a tool's file (default: as recorded)"
    )
    parser.add_argument(
        "--save-model",
        metavar="OUT.json",
        help="write the tool's file with the terms found, for galen-hw tool import; without a tool the terms alone",
    )
    parser.add_argument(
        "--no-repair", action="store_true", help="refuse what would be put right in memory: units, axes, clocks"
    )
    parser.add_argument("--seed", type=int, default=0, help="of the blocks that are set aside")
    parser.add_argument("--dask", metavar="ADDRESS", help="scheduler of a Dask cluster, for many recordings")
    parser.epilog = "example: galen-hw diagnose run.mcap --report report.html --save-model retractor+cable.json"


def run(args: argparse.Namespace) -> int:
    """Diagnose; 0 all agree, 1 a mismatch was found.

    Raises:
        UsageError: wrong use or unreadable input.
    """
    _check_outputs(args)
    paths = [p for given in args.recordings for p in expanded(Path(given))]
    answers = _all(paths, args)
    show(Console(stderr=args.json), answers)
    if args.json or args.output:
        values = [stamped(answer.to_json(), seed=args.seed) for answer in answers]
        text = json.dumps(values if len(values) > 1 else values[0], indent=1, ensure_ascii=False, allow_nan=False)
        if args.output:
            write_atomic(args.output, text + "\n")
        if args.json:
            print(text)
    return EXIT_OK if all(a.verdict == "agrees" for a in answers) else EXIT_FOUND


def _check_outputs(args: argparse.Namespace) -> None:
    """What is to be written can be, before minutes of work are spent on it."""
    for option, given in (("-o", args.output), ("--save-model", args.save_model)):
        if given:
            check_file(Path(given), option)
    if args.report:
        need("reports", "--report")
        args.report = report_page(args.report)


def _all(paths: list[Path], args: argparse.Namespace) -> list[Diagnosis]:
    """One after the other, or in parallel on all cores (on a Dask cluster where its address is given)."""
    if len(paths) == 1 or args.together:
        with working(f"reading {paths[0].name}") as progress:
            return [_whole(paths, args, several=False, progress=progress)]
    from joblib import Parallel, delayed, parallel_config

    from galen_hw.tools.clusters import cluster

    out: dict[str, Diagnosis] = {}
    with counting("diagnosing", len(paths)) as done, cluster(args.dask) as backend, parallel_config(**backend):
        # Dask hands everything over at the end; the processes of this machine one by one.
        each = "list" if args.dask else "generator_unordered"
        for path, answer in Parallel(return_as=each)(delayed(_named_answer)(path, args) for path in paths):
            out[path] = answer
            done()
    return [out[str(path)] for path in paths]


def _named_answer(path: Path, args: argparse.Namespace) -> tuple[str, Diagnosis]:
    return str(path), _whole([path], args, several=True)


def _whole(
    paths: list[Path], args: argparse.Namespace, *, several: bool, progress: Progress | None = None
) -> Diagnosis:
    """Diagnose one recording (or some as one) and write what was asked for; with several, its name goes into the file's name."""
    (work, recording), path = one(paths, args, progress), paths[0]
    if args.report:
        from galen_hw.diagnosis.draw import traces_of
        from galen_hw.diagnosis.page import write_page

        page = _named(args.report, path, several=several)
        page.parent.mkdir(parents=True, exist_ok=True)
        write_page(page, work.diagnosis, traces_of(work))
    if args.save_model:
        target = _named(args.save_model, path, several=several)
        saved = model_to_save(work, recording, target)
        if saved.text:
            write_atomic(target, saved.text)
        work.diagnosis.notes += saved.lines
    return work.diagnosis


def _named(given: str | Path, path: Path, *, several: bool) -> Path:
    target = Path(given)
    return target.with_stem(f"{target.stem}-{path.stem}") if several else target


def expanded(path: Path) -> list[Path]:
    """The recordings of a folder of recordings; else the path itself."""
    if path.is_dir() and not any((path / f"recording.{kind}").exists() for kind in ("csv", "parquet", "json")):
        inside = sorted(p for p in path.iterdir() if (p / "recording.json").exists() or p.suffix == ".mcap")
        return inside or [path]
    return [path]


def one(paths: list[Path], args: argparse.Namespace, progress: Progress | None = None) -> tuple[Work, Recording]:
    """Diagnose one recording, or several recordings of one machine as one; and the (first) recording itself."""
    share, judges = _holdout(args.holdout or ["0.3"])
    tool = tool_named(args.tool) if args.tool else None

    def read(path: Path, simulation: str | None = None) -> Recording:
        recording = read_recording(path, simulation=simulation)
        return recording if tool is None else with_tool(recording, tool)

    recordings = [read(path, args.simulation) for path in paths]
    others = [read(path) for path in judges]
    asked = Asked(share=share, seed=args.seed, repair=not args.no_repair)
    return diagnose_recordings(recordings, others, asked, progress), recordings[0]


def _holdout(given: list[str]) -> tuple[float, list[Path]]:
    """The share of blocks to set aside, or the recordings to be judged on."""
    try:
        share = float(given[-1])
    except ValueError:
        return 0.3, [path for one in given for path in expanded(Path(one))]
    if len(given) > 1 or not 0.0 <= share < 0.9:
        where = f"--holdout {' '.join(given)}"
        raise UsageError("not a share", where=where, todo="give a number from 0 to 0.9, or recordings")
    return share, []

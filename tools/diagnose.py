"""`galen-hw diagnose`: find what a model left out: locate, name, model, prove."""

import argparse
import json
from dataclasses import replace
from pathlib import Path
from typing import Final

from rich.console import Console

from galen_hw.config.tool_store import write_atomic
from galen_hw.diagnosis.bench import Progress
from galen_hw.diagnosis.engine import Work, diagnose
from galen_hw.diagnosis.result import Diagnosis
from galen_hw.errors import EXIT_FOUND, EXIT_OK, UsageError
from galen_hw.formats import read as read_recording
from galen_hw.formats.own import is_own
from galen_hw.physics.observations import Observations
from galen_hw.physics.table import scene_of
from galen_hw.physics.together import joined
from galen_hw.recording import Recording
from galen_hw.tools.diagnose_input import named_in, observations_of
from galen_hw.tools.diagnose_screen import counting, show, working
from galen_hw.tools.diagnose_tool import model_to_save, tool_named, with_tool
from galen_hw.tools.recorded_robot import model_notes

STDOUT: Final = "-"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The arguments of the command."""
    parser.add_argument(
        "recordings",
        nargs="+",
        metavar="RECORDING",
        help="MCAP file, table folder, a file of another program (docs/import.md), or a folder of them",
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
    parser.add_argument(
        "--json", metavar="OUT", help="write the answer as JSON; -: to the standard output, the summary to the other"
    )
    parser.add_argument("--report", metavar="OUT.html", help="write a page with figures")
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
    show(Console(stderr=args.json == STDOUT), answers)
    if args.json:
        values = [answer.to_json() for answer in answers]
        text = json.dumps(values if len(values) > 1 else values[0], indent=1, ensure_ascii=False, allow_nan=False)
        if args.json == STDOUT:
            print(text)
        else:
            write_atomic(Path(args.json), text + "\n")
    return EXIT_OK if all(a.verdict == "agrees" for a in answers) else EXIT_FOUND


def _check_outputs(args: argparse.Namespace) -> None:
    """What is to be written can be, before minutes of work are spent on it."""
    for option, given in (("--json", args.json), ("--report", args.report), ("--save-model", args.save_model)):
        if given and Path(given).is_dir():
            raise UsageError("is a folder", where=f"{option} {given}", todo="name a file in it")
        if given and not Path(given).parent.is_dir():
            raise UsageError("there is no such folder", where=f"{option} {given}", todo=f"mkdir {Path(given).parent}")


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

        write_page(_named(args.report, path, several=several), work.diagnosis, traces_of(work))
    if args.save_model:
        target = _named(args.save_model, path, several=several)
        saved = model_to_save(work, recording, target)
        if saved.text:
            write_atomic(target, saved.text)
        work.diagnosis.notes += saved.lines
    return work.diagnosis


def _named(given: str, path: Path, *, several: bool) -> Path:
    target = Path(given)
    return target.with_stem(f"{target.stem}-{path.stem}") if several else target


def expanded(path: Path) -> list[Path]:
    """The recordings of a folder of recordings; else the path itself."""
    if (
        path.is_dir()
        and is_own(path)
        and not any((path / f"recording.{kind}").exists() for kind in ("csv", "parquet", "json"))
    ):
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
    observations, notes = _joined(recordings, paths)
    holdout = None
    if judges:
        others = [read(path) for path in judges]
        other = _joined(others, judges)[0]
        with named_in(others[0]):
            order = {k: other.columns[k] for k in observations.columns if k in other.columns}
            holdout = scene_of(replace(other, columns=order | dict(other.columns)))
    with named_in(recordings[0]):
        scene = scene_of(observations)
    if holdout is not None and holdout.channels != scene.channels:
        todo = "judge on a recording that compares the same channels"
        raise UsageError(f"does not compare the channels of {paths[0]}", where=f"--holdout {judges[0]}", todo=todo)
    name = ", ".join(map(str, paths))
    with named_in(recordings[0]):
        work = diagnose(
            scene, name=name, holdout=holdout, share=share, seed=args.seed, progress=progress, repair=not args.no_repair
        )
    work.diagnosis.units = dict(zip(scene.channels, scene.units, strict=True))
    concerned = [name for remark in work.diagnosis.premises for name in remark["columns"]]
    work.diagnosis.notes[:0] = [line for line in notes if not _said_better(line, concerned)]
    if holdout is not None:
        work.diagnosis.holdout = ", ".join(map(str, judges))
    return work, recordings[0]


def _said_better(line: str, columns: list[str]) -> bool:
    """Whether a line of the reader is about cells of which a premise has said what they are."""
    name = line.partition(":")[0].partition(",")[0].strip()
    return any(column.startswith(name) for column in columns)


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


def _joined(recordings: list[Recording], paths: list[Path]) -> tuple[Observations, list[str]]:
    """The recordings as one, and what is odd about each."""
    _same_machine(recordings, paths)
    names = [str(path) for path in paths]
    each = [observations_of(recording) for recording in recordings]
    odd = [
        [*r.warnings, *model_notes(r, one.belief.robot, r.info.predict)]
        for r, one in zip(recordings, each, strict=True)
    ]
    observations, begins = joined(each, names)
    if len(paths) == 1:
        return observations, odd[0]
    notes = [f"{name}: {line}" for name, lines in zip(names, odd, strict=True) for line in lines]
    clock = "at {:.2f} s" if observations.time is not None else "with row {:.0f}"
    return observations, [*notes, *(f"{n} begins {clock.format(b)}" for n, b in zip(names, begins, strict=True))]


def _same_machine(recordings: list[Recording], paths: list[Path]) -> None:
    """That all recordings are of one machine and one model, so that one set of parameters can stand for all."""
    first = recordings[0]
    for recording in recordings[1:]:
        for key in ("robot", "tool", "predict", "model", "distal_bodies"):
            if getattr(recording.info, key) != getattr(first.info, key):
                todo = f"make {key} agree, or diagnose them one by one"
                raise UsageError(f"{key} is not that of {paths[0]}", where=recording.about, todo=todo)

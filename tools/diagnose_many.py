"""Diagnose what the command line names: one recording, several, or several as one."""

import argparse
import math
import sys
from functools import partial
from pathlib import Path

from galen_hw.config.tool_store import write_atomic
from galen_hw.diagnosis.pipeline import Progress
from galen_hw.diagnosis.recordings import diagnose_recordings
from galen_hw.diagnosis.result import Diagnosis
from galen_hw.diagnosis.work import Work
from galen_hw.errors import UsageError
from galen_hw.formats import read as read_recording
from galen_hw.formats.remote import Place, Remote, at_hand, place, recordings_in
from galen_hw.recording import Recording
from galen_hw.tools.diagnose_tool import model_to_save, tool_named, with_tool
from galen_hw.tools.progress import counting, working
from galen_hw.tools.robot_given import keys_given, robot_given


def answers_to(paths: list[Place], args: argparse.Namespace) -> list[Diagnosis]:
    """One after the other, or in parallel on all cores (on a Dask cluster where its address is given)."""
    if args.time_limit < 0.0:
        where = f"--time-limit {args.time_limit:g}"
        raise UsageError("not a time", where=where, todo="give seconds, or 0 for as long as it takes")
    if len(paths) == 1 or args.together:
        if args.dask:
            print("galen-hw diagnose: --dask is for many recordings; one is diagnosed on this machine", file=sys.stderr)
        with working(f"reading {paths[0].name}") as progress:
            return [_whole(paths, args, several=False, progress=progress)]
    from galen_hw.tools.clusters import on_cluster, on_this_machine

    do, out = partial(_named_answer, args=args), dict[str, Diagnosis]()
    with counting("diagnosing", len(paths)) as done:
        for path, answer in on_cluster(args.dask, do, paths) if args.dask else on_this_machine(do, paths):
            out[path] = answer
            done()
    return [out[str(path)] for path in paths]


def _named_answer(path: Place, args: argparse.Namespace) -> tuple[str, Diagnosis]:
    return str(path), _whole([path], args, several=True)


def _whole(
    paths: list[Place], args: argparse.Namespace, *, several: bool, progress: Progress | None = None
) -> Diagnosis:
    """Diagnose one recording (or some as one) and write what was asked for; with several, its name goes into the file's name."""
    share, judges = _holdout(args.holdout or ["0.3"])
    extra = [place(args.simulation)] if args.simulation else []
    with at_hand([*paths, *judges, *extra]) as local:
        (work, recording), path = _one(paths, judges, local, share, args, progress), paths[0]
        if args.report:
            from galen_hw.diagnosis.report.collect import traces_of
            from galen_hw.diagnosis.report.page import write_page

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


def _named(given: str | Path, path: Place, *, several: bool) -> Path:
    target = Path(given)
    return target.with_stem(f"{target.stem}-{path.stem}") if several else target


def _one(
    places: list[Place],
    judges: list[Place],
    local: list[Path],
    share: float,
    args: argparse.Namespace,
    progress: Progress | None,
) -> tuple[Work, Recording]:
    """Diagnose one recording, or several recordings of one machine as one; and the (first) recording itself.

    Args:
        places: of the recordings; judges: of those to be judged on.
        local: where all of them can be read, and the simulation behind them.
        share: of the blocks to set aside.
        args: the other options.
        progress: told how far the work is.
    """
    tool = tool_named(args.tool) if args.tool else None
    robot = robot_given(args)

    def read(path: Path, simulation: Path | None = None) -> Recording:
        recording = read_recording(path, simulation=simulation, robot=robot, info=keys_given(args))
        return recording if tool is None else with_tool(recording, tool)

    simulation = local[-1] if args.simulation else None
    recordings = [read(path, simulation) for path in local[: len(places)]]
    others = [read(path) for path in local[len(places) : len(places) + len(judges)]]
    work = diagnose_recordings(
        recordings,
        holdout=others,
        share=share,
        seed=args.seed,
        repair=not args.no_repair,
        progress=progress,
        time_limit=args.time_limit or math.inf,
        names=_urls(places),
        holdout_names=_urls(judges),
    )
    return work, recordings[0]


def _urls(places: list[Place]) -> list[str]:
    """What recordings are called in the answer where some were fetched; nothing where their paths will do."""
    return [str(one) for one in places] if any(isinstance(one, Remote) for one in places) else []


def _holdout(given: list[str]) -> tuple[float, list[Place]]:
    """The share of blocks to set aside, or the recordings to be judged on."""
    try:
        share = float(given[-1])
    except ValueError:
        return 0.3, [path for one in given for path in recordings_in(place(one))]
    if len(given) > 1 or not 0.0 <= share < 0.9:
        where = f"--holdout {' '.join(given)}"
        raise UsageError("not a share", where=where, todo="give a number from 0 to 0.9, or recordings")
    return share, []

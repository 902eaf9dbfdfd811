"""`galen-hw diagnose`: find what a model left out: locate, name, model, prove."""

import argparse
import json
from pathlib import Path

import numpy as np

from galen_hw.diagnosis.engine import Work, diagnose
from galen_hw.diagnosis.result import Diagnosis
from galen_hw.diagnosis.summary import summary
from galen_hw.errors import EXIT_FOUND, EXIT_OK, UsageError
from galen_hw.kinematics import GalenRobot, Robot, UrdfRobot
from galen_hw.physics.observations import Belief, Observations
from galen_hw.physics.rigid import Body
from galen_hw.physics.table import scene_of
from galen_hw.recording import Recording, read_recording
from galen_hw.spatial import Array, rotation_from_quaternion


def observations_of(recording: Recording) -> Observations:
    """What the effects read, from a recording and its own notes.

    Raises:
        UsageError: the recording does not say what is compared.
    """
    info = recording.info
    if info.predict is None:
        where = f"{recording.path}/recording.json: predict"
        raise UsageError("nothing is named to compare", where=where, todo='e.g. "predict": "wrench"')
    columns, simulation = dict(recording.columns), recording.simulation
    simulated = None if simulation is None else _matched(recording, simulation)
    return Observations(info.predict, columns, simulated, _belief(recording))


def _matched(recording: Recording, simulation: Recording) -> dict[str, Array]:
    """The simulation's columns at the recording's rows: by time, or row by row; NaN outside."""
    ours, theirs = recording.time, simulation.time
    if ours is None or theirs is None:
        if len(simulation) != len(recording):
            raise UsageError(
                f"the simulation has {len(simulation)} rows beside {len(recording)} and no common clock",
                where=str(simulation.path),
                todo="give both a time column, or as many rows",
            )
        return dict(simulation.columns)
    same = len(ours) == len(theirs) and np.allclose(ours, theirs, rtol=0.0, atol=1e-9)
    if same:
        return dict(simulation.columns)
    order = np.argsort(theirs, kind="stable")
    return {k: np.interp(ours, theirs[order], v[order], np.nan, np.nan) for k, v in simulation.columns.items()}


def _belief(recording: Recording) -> Belief:
    info = recording.info
    robot = _robot(recording)
    tool, bias = info.tool, info.bias_body
    return Belief(
        robot=robot,
        tool=Body() if tool is None else _body(tool.mass, tool.com, tool.inertia),
        tip=np.zeros(3) if tool is None or tool.tip is None else np.array(tool.tip),
        bias_body=None if bias is None else _body(bias.mass, bias.com, bias.inertia),
        zeroed_rotation=_zeroed(recording, robot),
        gravity=np.array(info.gravity),
        bias_free=info.model.bias == "free",
        dynamic=info.model.dynamics == "rigid",
        compliance={} if info.model.compliance is None else dict(info.model.compliance.joint),
        distal_bodies=info.distal_bodies or (),
        ranges=dict(info.ranges),
    )


def _body(mass: float | None, com: tuple[float, ...] | None, inertia: tuple[tuple[float, ...], ...] | None) -> Body:
    return Body(
        mass or 0.0,
        np.zeros(3) if com is None else np.array(com),
        np.zeros((3, 3)) if inertia is None else np.array(inertia),
    )


def _robot(recording: Recording) -> Robot | None:
    info = recording.info
    if info.robot is None:
        return None
    if info.robot == "galen":
        return GalenRobot(gravity=np.array(info.gravity))
    folder = recording.path if recording.path.is_dir() else recording.path.parent
    file = Path(folder) / info.robot
    if not file.is_file():
        raise UsageError("the robot's file is not there", where=str(file), todo="put the URDF beside the recording")
    sensor = info.sensor_link or info.tip_link
    return UrdfRobot(file, sensor_link=sensor, base_link=info.base_link, gravity=np.array(info.gravity))


def _zeroed(recording: Recording, robot: Robot | None) -> Array | None:
    names = () if robot is None else tuple(robot.joint_names)
    quaternion = recording.info.zeroed_quaternion(names)
    if quaternion is not None:
        return rotation_from_quaternion(quaternion)
    joints = recording.info.zeroed_joints(names) if robot is not None else None
    return None if joints is None or robot is None else np.asarray(robot.sensor_pose(np.array(joints))[0, :3, :3])


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The arguments of the command."""
    parser.add_argument(
        "recordings", nargs="+", metavar="RECORDING", help="MCAP file, table folder, or a folder of them"
    )
    parser.add_argument("--simulation", help="a table that someone else simulated")
    parser.add_argument("--holdout", default="0.3", help="a second recording, or the share of blocks to set aside")
    parser.add_argument("--json", metavar="OUT", help="write the answer as JSON")
    parser.add_argument("--report", metavar="OUT.html", help="write a page with figures")
    parser.add_argument("--save-model", metavar="OUT.json", help="write the terms found, for the live services")
    parser.add_argument("--seed", type=int, default=0, help="of the blocks that are set aside")
    parser.add_argument("--dask", metavar="ADDRESS", help="scheduler of a Dask cluster, for many recordings")
    parser.epilog = "example: galen-hw diagnose run.mcap --report report.html --save-model retractor+cable.json"


def run(args: argparse.Namespace) -> int:
    """Diagnose; 0 all agree, 1 a mismatch was found.

    Raises:
        UsageError: wrong use or unreadable input.
    """
    paths = [p for given in args.recordings for p in expanded(Path(given))]
    answers = _all(paths, args)
    for answer in answers:
        print(summary(answer))
    if len(answers) > 1:
        _table(answers)
    if args.json:
        values = [answer.to_json() for answer in answers]
        text = json.dumps(values if len(values) > 1 else values[0], indent=1, ensure_ascii=False)
        Path(args.json).write_text(text + "\n", encoding="utf-8")
    return EXIT_OK if all(a.verdict == "agrees" for a in answers) else EXIT_FOUND


def _all(paths: list[Path], args: argparse.Namespace) -> list[Diagnosis]:
    """One after the other, or in parallel on all cores (on a Dask cluster where its address is given)."""
    if len(paths) == 1:
        return [_whole(paths[0], args, several=False)]
    from joblib import Parallel, delayed, parallel_config

    from galen_hw.tools.clusters import cluster

    with cluster(args.dask) as backend, parallel_config(**backend):
        found = Parallel()(delayed(_whole)(path, args, several=True) for path in paths)
    return list(found)


def _whole(path: Path, args: argparse.Namespace, *, several: bool) -> Diagnosis:
    """Diagnose one recording and write what was asked for; with several, its name goes into the file's name."""
    work = one(path, args)
    if args.report:
        from galen_hw.diagnosis.draw import traces_of
        from galen_hw.diagnosis.page import write_page

        write_page(_named(args.report, path, several=several), work.diagnosis.to_json(), traces_of(work))
    if args.save_model:
        terms = {"schema": 1, "recording": str(path), "terms": work.diagnosis.terms}
        target = _named(args.save_model, path, several=several)
        target.write_text(json.dumps(terms, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
    return work.diagnosis


def _named(given: str, path: Path, *, several: bool) -> Path:
    target = Path(given)
    return target.with_stem(f"{target.stem}-{path.stem}") if several else target


def _table(answers: list[Diagnosis]) -> None:
    """One row a recording."""
    from rich.console import Console
    from rich.table import Table

    table = Table("recording", "verdict", "findings", "held-out error / floor", box=None)
    for answer in answers:
        floor, after = answer.fit["noise_floor"], answer.fit["rmse_after"]
        worst = max((after[c] / floor[c] for c in after if floor[c] > 0.0), default=float("nan"))
        table.add_row(answer.recording, answer.verdict, ", ".join(f.effect for f in answer.findings), f"{worst:.2f}")
    Console().print(table)


def expanded(path: Path) -> list[Path]:
    """The recordings of a folder of recordings; else the path itself."""
    if path.is_dir() and not any((path / f"recording.{kind}").exists() for kind in ("csv", "parquet", "json")):
        inside = sorted(p for p in path.iterdir() if (p / "recording.json").exists() or p.suffix == ".mcap")
        return inside or [path]
    return [path]


def one(path: Path, args: argparse.Namespace) -> Work:
    """Diagnose one recording."""
    recording = read_recording(path, simulation=args.simulation)
    holdout, share = None, 0.3
    try:
        share = float(args.holdout)
    except ValueError:
        holdout = scene_of(observations_of(read_recording(args.holdout)))
    if not 0.0 <= share < 0.9:
        raise UsageError(
            "not a share", where=f"--holdout {args.holdout}", todo="give a number from 0 to 0.9, or a recording"
        )
    work = diagnose(scene_of(observations_of(recording)), name=str(path), holdout=holdout, share=share, seed=args.seed)
    work.diagnosis.notes[:0] = recording.warnings
    if holdout is not None:
        work.diagnosis.holdout = str(args.holdout)
    return work

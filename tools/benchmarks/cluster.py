"""A folder of many recordings on a Dask cluster of processes, one of which is killed: the same answers, and how much sooner.

    python -m galen_hw.tools.benchmarks.cluster [--recordings 200] [--workers 2] [--write docs/benchmarks.md]

All is asked thrice by `galen-hw diagnose FOLDER --dask`: of one worker, of several, and of several of which one is killed
(SIGKILL) at work, a third of the way through. The recordings' formulas are written here anew. On a shared machine the times
are those of what others leave: how many cores others took meanwhile stands beside them.
"""

import argparse
import json
import os
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np

from galen_hw.errors import EXIT_FOUND, EXIT_OK
from galen_hw.recording import RecordingInfo, write_table
from galen_hw.recording.recording import SENSOR_ORIENTATION, WRENCH, Recording
from galen_hw.spatial import Array, rotation_about
from galen_hw.tools.benchmarks.row import Row

ROWS: Final = 100
STEP_S: Final = 0.12
NOISE: Final = np.array([0.05] * 3 + [0.0025] * 3)
COM_M: Final = np.array([0.01, 0.0, 0.06])
LONGEST_S: Final = 3600.0
"""Waited for a third of the recordings."""


def recording(seed: int) -> Recording:
    """A sensor that is turned about: with a tool that nobody told of, with a drift, or with neither; by turns."""
    rng = np.random.default_rng(seed)
    t = np.arange(ROWS) * STEP_S
    a, b = 0.9 * np.sin(0.7 * t + rng.uniform(0, 6)), 0.8 * np.sin(1.1 * t + rng.uniform(0, 6))
    R = rotation_about(0, a) @ rotation_about(1, b)
    mass = rng.uniform(0.2, 0.6) if seed % 3 == 0 else 0.0
    force = mass * np.einsum("nji,j->ni", R, [0.0, 0.0, -9.80665])
    wrench = np.hstack([force, np.cross(COM_M, force)]) + NOISE * rng.normal(size=(ROWS, 6))
    if seed % 3 == 1:
        wrench[:, 2] += rng.uniform(0.5, 1.0) * t / t[-1]
    half = np.stack([np.sin(a / 2), np.cos(a / 2), np.sin(b / 2), np.cos(b / 2)])
    turn = np.stack([half[0] * half[3], half[1] * half[2], half[0] * half[2], half[1] * half[3]], axis=-1)
    columns: dict[str, Array] = dict(zip(("time", *WRENCH, *SENSOR_ORIENTATION), np.c_[t, wrench, turn].T, strict=True))
    info = RecordingInfo.model_validate({"robot": None, "predict": "wrench", "model": {"bias": "free"}})
    return Recording(columns, info)


class Pass(NamedTuple):
    """One diagnosis of the folder.

    Args:
        took: seconds.
        others: cores that other programs took meanwhile, on average.
        answers: without their dates.
    """

    took: float
    others: float
    answers: list[dict[str, Any]]


def spent() -> tuple[float, float]:
    """Processor seconds of the whole machine, and of this process and those of its children that have ended."""
    user, nice, system, _, _, irq, soft, *_ = map(int, Path("/proc/stat").read_text().split(maxsplit=9)[1:9])
    return (user + nice + system + irq + soft) / os.sysconf("SC_CLK_TCK"), sum(os.times()[:4])


def asked(folder: Path, workers: int, meanwhile: Callable[[Any], None] | None = None) -> Pass:
    """Diagnose a folder on a cluster of so many processes.

    Args:
        folder: of recordings.
        workers: processes of one thread.
        meanwhile: done beside it, with the cluster.
    """
    from distributed import LocalCluster

    made: Any = LocalCluster  # its signature carries no types
    start, before = time.perf_counter(), spent()
    with (
        tempfile.TemporaryDirectory() as out,
        made(n_workers=workers, threads_per_worker=1, processes=True, dashboard_address=None) as cluster,
    ):
        beside = threading.Thread(target=meanwhile or (lambda _: None), args=(cluster,))
        beside.start()
        begun = time.perf_counter()
        words = ["diagnose", str(folder), "--dask", cluster.scheduler_address, "-o", f"{out}/answers.json"]
        status = subprocess.run([sys.executable, "-m", "galen_hw.cli", *words], check=False).returncode
        took = time.perf_counter() - begun
        beside.join()
        if status not in (EXIT_OK, EXIT_FOUND):
            raise RuntimeError(f"galen-hw diagnose ended with {status}")
        answers = json.loads(Path(out, "answers.json").read_text())
    whole, own = np.subtract(spent(), before)
    others = max(0.0, float(whole - own)) / (time.perf_counter() - start)
    return Pass(took, others, [{key: value for key, value in answer.items() if key != "date"} for answer in answers])


def done(cluster: Any) -> int:
    """Return how many tasks the cluster has done so far, those that are forgotten by now included."""
    return sum(prefix.state_counts["memory"] for prefix in list(cluster.scheduler.task_prefixes.values()))


def killed_after(recordings: int, killed: list[int]) -> Callable[[Any], None]:
    """Return what kills a worker at work when so many recordings are done; its process is noted.

    Not after a time: what an earlier pass took says little on a machine whose other programs come and go.
    """
    from distributed import Client

    connect: Any = Client

    def kill(cluster: Any) -> None:
        until = time.monotonic() + LONGEST_S
        while done(cluster) < recordings and time.monotonic() < until:
            time.sleep(0.05)
        with connect(cluster.scheduler_address) as client:
            until = time.monotonic() + 60.0
            while not killed and time.monotonic() < until:
                pids = client.run(os.getpid)
                for address in [a for a, tasks in client.call_stack().items() if tasks and a in pids][:1]:
                    os.kill(pids[address], signal.SIGKILL)
                    killed.append(pids[address])

    return kill


def row(count: int, workers: int) -> Row:
    """The figure: all answers those of one worker, each recording answered, and the time over that of one worker."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for seed in range(count):
            write_table(recording(seed), folder / f"run{seed:04d}")
        alone = asked(folder, 1)
        several = asked(folder, workers)
        killed: list[int] = []
        wounded = asked(folder, workers, killed_after(count // 3, killed))
    truth = alone.answers
    differ = {
        one["recording"]
        for found in (several.answers, wounded.answers)
        for one, true in zip(found, truth, strict=True)
        if one != true
    }
    whole = len(truth) == len(wounded.answers) == count and not differ and len(killed) == 1
    busy = ", ".join(f"{each.others:.1f}" for each in (alone, several, wounded))
    text = (
        f"{len(wounded.answers)} answers, {len(differ)} other than with one process, {len(killed)} killed; "
        f"{alone.took:.0f} s with one process, {several.took:.0f} s with {workers} ({alone.took / several.took:.2f} x), "
        f"{wounded.took:.0f} s with the killed one ({alone.took / wounded.took:.2f} x); of {os.cpu_count()} cores other "
        f"programs took {busy}"
    )
    what = f"{count} recordings on a Dask cluster, a process of it killed at work"
    return Row(what, "nothing lost, same answers", text, whole, "bench_cluster")


def main(argv: list[str] | None = None) -> int:
    """Measure, and put the line into the page of the benchmarks; exit status 1 if an answer was lost or differs."""
    parser = argparse.ArgumentParser(prog="bench_cluster", description=__doc__)
    parser.add_argument("--recordings", type=int, default=200)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--write", type=Path, help="page whose line of this is replaced")
    args = parser.parse_args(argv)
    found = row(args.recordings, args.workers)
    print(found.line)
    if args.write:
        lines = args.write.read_text(encoding="utf-8").splitlines()
        kept = [line for line in lines if "| bench_cluster |" not in line]
        args.write.write_text("\n".join([*kept, found.line, ""]), encoding="utf-8")
    return 0 if found.good else 1


if __name__ == "__main__":
    sys.exit(main())

"""How long a diagnosis takes, and that its time grows with the rows: a machine of many joints, all effects asked.

    python -m galen_hw.tools.benchmarks.diagnosis [--joints 12] [--rows 25000 50000 100000] [--json]

The recording is a servo arm against its commands: a delay, a joint that friction holds back, noise. Its formulas are
written here anew.
"""

import argparse
import json
import sys
import time
from typing import TYPE_CHECKING, Any

import numpy as np

from galen_hw.diagnosis.pipeline import diagnose
from galen_hw.physics.effects.registry import scene_of
from galen_hw.physics.observations import Observations

if TYPE_CHECKING:
    from galen_hw.spatial import Array

RATE_HZ = 500.0
NOISE = 2e-4
DELAY_S = 0.004


def recording(joints: int, rows: int, seed: int = 0) -> Observations:
    """Commands and positions (rows,) of so many joints."""
    rng = np.random.default_rng(seed)
    t = np.arange(rows) / RATE_HZ
    columns: dict[str, Array] = {"time": t}
    for j in range(joints):
        hz, phase = rng.uniform(0.05, 0.6, 5), rng.uniform(0.0, 2.0 * np.pi, 5)
        part = rng.uniform(0.1, 0.4, 5)
        command = np.sin(2.0 * np.pi * np.outer(t, hz) + phase) @ part
        late = np.sin(2.0 * np.pi * np.outer(t - DELAY_S, hz) + phase) @ part
        if j == 1:
            late = late - 8e-4 * np.sign(np.gradient(late))
        columns[f"joint.j{j}.command"] = command
        columns[f"joint.j{j}.position"] = late + NOISE * rng.normal(size=rows)
    return Observations("position", columns)


def measured(joints: int, rows: int) -> dict[str, Any]:
    """Wall time of one whole diagnosis, adequacy, look-alikes and advice included."""
    scene = scene_of(recording(joints, rows))
    start, spent = time.perf_counter(), time.process_time()
    work = diagnose(scene)
    return {
        "joints": joints,
        "rows": rows,
        "seconds": time.perf_counter() - start,
        "cpu_seconds": time.process_time() - spent,
        "hypotheses": len(work.selection.scorer.library),
        "verdict": work.diagnosis.verdict,
        "found": [f.effect for f in work.diagnosis.findings],
    }


def main(argv: list[str] | None = None) -> int:
    """Measure and print; exit status 1 if the longest took more than a minute."""
    parser = argparse.ArgumentParser(prog="bench_diagnosis", description=__doc__)
    parser.add_argument("--joints", type=int, default=12, help="channels (default 12)")
    parser.add_argument("--rows", type=int, nargs="+", default=[25_000, 50_000, 100_000])
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    args = parser.parse_args(argv)
    results = [measured(args.joints, rows) for rows in args.rows]
    if args.json:
        print(json.dumps({"results": results}))
    else:
        for r in results:
            print(
                f"{r['rows']} rows x {r['joints']} channels: {r['seconds']:.1f} s, {r['hypotheses']} hypotheses, {r['found']}"
            )
    return 0 if results[-1]["seconds"] <= 60.0 else 1


if __name__ == "__main__":
    sys.exit(main())

"""`make ablation`: each rule and move of the diagnosis switched off in turn, on sealed cases of three seeds and real recordings.

python -m galen_hw.tools.blind_proof.ablation [--cases 8] [--seeds 3] [--only NAME,...] [--keep DIR] [--write docs/ablation.md]

What is right without a rule as often as with it, at every seed, is worth nothing there. With `--keep` a run that was cut off
goes on.
"""

import argparse
import json
import os
import re
import sys
import tempfile
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from pathlib import Path
from typing import Any, NamedTuple

from rich.progress import track

from galen_hw.tools.blind_proof import judge, real, seal
from galen_hw.tools.blind_proof.generator.build import build
from galen_hw.tools.blind_proof.generator.plan import plan
from galen_hw.tools.blind_proof.score import Scored, score
from galen_hw.tools.blind_proof.switches import SWITCHES

REAL = (
    "emps",
    "kr300-dual-encoder",
    "real-2/axia_first",
    "real-2/kuka_run1",
    "real-2/sts3215_one",
    "real-2/ur10e_push",
)
"""Recordings whose first cause is known and that are answered within a minute."""
CAUSES = {
    "emps": {"friction"},
    "kr300-dual-encoder": {"time_delay", "lag"},
    "real-2/axia_first": {"drift"},
    "real-2/kuka_run1": {"inertial"},
    "real-2/sts3215_one": {"compliance", "backlash", "friction", "hysteresis"},
    "real-2/ur10e_push": {"contact"},
}


class Task(NamedTuple):
    """One recording with one rule off ("" for none)."""

    switch: str
    name: str
    train: Path
    test: Path | None


class Row(NamedTuple):
    """Says what one switch is worth: cases right by seed, real recordings right, effects named too many or wrongly, seconds."""

    switch: str
    right: list[int]
    real: int
    wrong_names: int
    seconds: float


def main() -> int:
    """Generate, seal, ask with each rule off, unseal, score, write the table."""
    args = _arguments()
    switches = ["", *(args.only.split(",") if args.only else SWITCHES)]
    seed, commit = seal.seed_of_commit()
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(args.keep or scratch)
        sets = {f"seed-{k}": plan(seed + k, args.cases) for k in range(args.seeds)}
        jobs = [(case, folder / key / case.name) for key, planned in sets.items() for case in planned]
        with ProcessPoolExecutor(args.workers) as pool:
            built = list(track(pool.map(build, *zip(*jobs, strict=True)), total=len(jobs), description="generating"))
        cases = {key: built[k * args.cases : (k + 1) * args.cases] for k, key in enumerate(sets)}
        sealed = {key: seal.seal(of, folder / key) for key, of in cases.items()}
        tasks = [task for switch in switches for task in _tasks(switch, folder, cases)]
        with ThreadPoolExecutor(args.workers) as threads:
            answers = list(
                track(threads.map(lambda t: _asked(t, folder), tasks), total=len(tasks), description="asking")
            )
        told = {(t.switch, t.name): answer for t, answer in zip(tasks, answers, strict=True)}
        truth = {key: json.loads(text) for key, text in sealed.items()}
    rows = [_row(switch, truth, told) for switch in switches]
    text = _table(rows, args.cases, sum(("", name) in told for name in REAL), commit)
    Path(args.write).write_text(text) if args.write else print(text)
    return 0


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="ablation", description=__doc__)
    parser.add_argument("--cases", type=int, default=8, help="recordings of each seed (default 8)")
    parser.add_argument("--seeds", type=int, default=3, help="how many seeds, from the commit's hash on (default 3)")
    parser.add_argument("--only", help="switches, separated by commas (default: all)")
    parser.add_argument("--keep", help="folder for data and answers (a temporary one)")
    parser.add_argument("--write", help="the page that is written (default: the screen)")
    parser.add_argument("--workers", type=int, default=os.cpu_count() or 1)
    return parser.parse_args()


def _tasks(switch: str, folder: Path, cases: dict[str, list[Any]]) -> Iterator[Task]:
    for key, of in cases.items():
        for case in of:
            place = folder / key / case.name
            test = place / "test" if judge.second_run(case) else None
            yield Task(switch, f"{key}/{case.name}", place / "train", test)
    data = real.data_folder()
    for name in REAL if data is not None else ():
        place = data / name  # type: ignore[operator]
        two = (place / "train").is_dir()
        yield Task(switch, name, place / "train" if two else place, place / "test" if two else None)


def _asked(task: Task, folder: Path) -> dict[str, Any]:
    """The answer, as `judge` keeps it; one that is there stays."""
    kept = folder / "answers" / (task.switch or "all") / f"{task.name.replace('/', '_')}.json"
    if kept.exists():
        return dict(json.loads(kept.read_text()))
    kept.parent.mkdir(parents=True, exist_ok=True)
    told = kept.with_suffix(".told")
    command = ["galen_hw.tools.blind_proof.switches", task.switch, str(task.train), "-o", str(told)]
    answer = judge.asked([*command, "--holdout", str(task.test)] if task.test is not None else command, told)
    answer["seconds"] = _cpu(answer["said"])
    part = kept.with_suffix(".part")
    part.write_text(json.dumps(answer))
    part.replace(kept)
    return answer


def _cpu(said: str) -> float:
    """Seconds of CPU that the process says it took."""
    found = re.findall(r"^cpu_s ([0-9.]+)$", said, re.MULTILINE)
    return float(found[-1]) if found else judge.PATIENCE_S


def _row(switch: str, truth: dict[str, list[dict[str, Any]]], told: dict[tuple[str, str], dict[str, Any]]) -> Row:
    right, wrong, seconds = [], 0, 0.0
    for key, of in truth.items():
        scored = [score(case, told[switch, f"{key}/{case['name']}"]) for case in of]
        right.append(sum(one.right for one in scored))
        wrong += sum(_wrong_names(one) for one in scored)
        seconds += sum(one.seconds for one in scored)
    causes = sum(_first(told[switch, name]) in CAUSES[name] for name in REAL if (switch, name) in told)
    return Row(switch, right, causes, wrong, seconds)


def _wrong_names(one: Scored) -> int:
    """Findings with a name that nobody concealed."""
    return len({name for name in one.found if name != "unknown"} - set(one.wanted) - {"bias"})


def _first(answer: dict[str, Any]) -> str:
    findings = (answer["json"] or {}).get("findings", [])
    return str(findings[0]["effect"]) if findings else ""


def _table(rows: list[Row], cases: int, recordings: int, commit: str) -> str:
    whole = rows[0]
    sets = " | ".join(f"set {k + 1}" for k in range(len(whole.right)))
    out = [
        "# Ablation of the diagnosis",
        "",
        f"Written by `make ablation` at {commit[:7]}; nothing here is edited by hand. Each row is the diagnosis without one",
        f"rule or move, on {len(whole.right)} sets of {cases} sealed recordings whose seeds follow the commit's, and on",
        f"{recordings} real ones (first cause right). Wrong names: findings of things that nobody concealed. CPU: over that of",
        "the first row. A row as good as the first is a rule that is worth nothing here; it takes more recordings to say so",
        "than to say the contrary.",
        "",
        f"| without | {sets} | real | wrong names | CPU | what it does |",
        f"| --- |{' --- |' * (len(whole.right) + 4)}",
    ]
    for row in rows:
        sets = " | ".join(f"{n} of {cases}" for n in row.right)
        what = SWITCHES[row.switch].what if row.switch else ""
        share = row.seconds / max(whole.seconds, 1e-9)
        out.append(
            f"| {row.switch or 'nothing'} | {sets} | {row.real} of {recordings} | {row.wrong_names} | {share:.2f} | {what} |"
        )
    return "\n".join(out) + "\n"


if __name__ == "__main__":
    sys.exit(main())

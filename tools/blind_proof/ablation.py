"""`make ablation`: each rule and move of the diagnosis switched off in turn, on sealed cases of three seeds and real recordings.

python -m galen_hw.tools.blind_proof.ablation [--cases 8] [--seeds 3] [--only NAME,...] [--keep DIR] [--write docs/ablation.md]

What is right without a rule as often as with it, at every seed, is worth nothing there. A rule that said nothing in a recording
changes nothing there: such a recording is not asked again. With `--keep` a run that was cut off goes on.
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

import numpy as np
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
    "brfd-backlash",
)
"""Recordings whose first cause is known and that are answered within a minute."""
CAUSES = {
    "brfd-backlash": {"hysteresis", "backlash", "friction"},
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
    """Says what one switch is worth: cases right by seed, real recordings right, effects named too many or wrongly, seconds.

    error: held-out error over that with all rules, geometric mean over all recordings; spoke: recordings in which the rule spoke.
    """

    switch: str
    right: list[int]
    real: int
    wrong_names: int
    seconds: float
    error: float
    spoke: int


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
        whole = list(_tasks("", folder, cases))
        told = _answers(whole, folder, args.workers, "asking with all rules")
        rules = {task.name: _rules(told["", task.name]["said"]) for task in whole}
        tasks = [
            task for s in switches[1:] for task in _tasks(s, folder, cases) if rules[task.name].get(s, (1, 0.0))[0]
        ]
        told |= _answers(tasks, folder, args.workers, "asking without each")
        truth = {key: json.loads(text) for key, text in sealed.items()}
    rows = [_row(switch, truth, told, rules) for switch in switches]
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


def _answers(tasks: list[Task], folder: Path, workers: int, what: str) -> dict[tuple[str, str], dict[str, Any]]:
    """Answers by switch and name."""
    with ThreadPoolExecutor(workers) as threads:
        answers = list(track(threads.map(lambda t: _asked(t, folder), tasks), total=len(tasks), description=what))
    return {(t.switch, t.name): answer for t, answer in zip(tasks, answers, strict=True)}


def _rules(said: str) -> dict[str, tuple[int, float]]:
    """By switch, how often the rule spoke and the CPU seconds that it took, as `switches.watch` has printed; empty: cut off."""
    found = re.findall(r"^rule (.+): spoke ([0-9]+), cpu_s ([0-9.]+)$", said, re.MULTILINE)
    return {name: (int(spoke), float(seconds)) for name, spoke, seconds in found}


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


def _row(
    switch: str,
    truth: dict[str, list[dict[str, Any]]],
    told: dict[tuple[str, str], dict[str, Any]],
    rules: dict[str, dict[str, tuple[int, float]]],
) -> Row:
    """What one switch is worth; where its rule said nothing the answer is that with all rules, less the time that it took."""

    def of(name: str) -> dict[str, Any]:
        if (switch, name) in told:
            return told[switch, name]
        whole = told["", name]
        return whole | {"seconds": max(whole["seconds"] - rules[name][switch][1], 0.0)}

    right, wrong = [], 0
    for key, planned in truth.items():
        scored = [score(case, of(f"{key}/{case['name']}")) for case in planned]
        right.append(sum(one.right for one in scored))
        wrong += sum(_wrong_names(one) for one in scored)
    names = [name for whole, name in told if not whole]
    causes = sum(_first(of(name)) in CAUSES[name] for name in REAL if name in names)
    ratios = [_error(of(name)) / _error(told["", name]) for name in names]
    spoke = sum((switch, name) in told for name in names)
    error = float(np.exp(np.nanmean(np.log(ratios))))
    return Row(switch, right, causes, wrong, sum(of(name)["seconds"] for name in names), error, spoke)


def _error(answer: dict[str, Any]) -> float:
    """Held-out error over the noise, rms over the channels; nan without an answer."""
    fit = (answer["json"] or {}).get("fit") or {}
    after, noise = (np.array(list((fit.get(key) or {}).values()), dtype=float) for key in ("rmse_after", "noise_floor"))
    read = noise > 0.0
    return float(np.sqrt(np.mean((after[read] / noise[read]) ** 2))) if read.any() else float("nan")


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
        f"{recordings} real ones (first cause right). Wrong names: findings of things that nobody concealed. Error: the held-out",
        "error over that of the first row, geometric mean over all recordings. CPU: over that of the first row. Spoke:",
        "recordings in which the rule said anything; the others were not asked again. A row as good as the first is a rule that",
        "is worth nothing here; it takes more recordings to say so than to say the contrary.",
        "",
        f"| without | {sets} | real | wrong names | error | CPU | spoke | what it does |",
        f"| --- |{' --- |' * (len(whole.right) + 6)}",
    ]
    for row in rows:
        sets = " | ".join(f"{n} of {cases}" for n in row.right)
        what = SWITCHES[row.switch].what if row.switch else ""
        share = row.seconds / max(whole.seconds, 1e-9)
        out.append(
            f"| {row.switch or 'nothing'} | {sets} | {row.real} of {recordings} | {row.wrong_names} "
            f"| {row.error:.3f} | {share:.2f} | {row.spoke} | {what} |"
        )
    return "\n".join(out) + "\n"


if __name__ == "__main__":
    sys.exit(main())

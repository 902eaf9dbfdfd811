"""Real recordings, where they are present: the tool's answers with its defaults, beside what was published."""

import json
import os
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from galen_hw.tools.blind_proof.score import by_names


@dataclass(frozen=True)
class RealSet:
    """One set: its runs to learn from, its runs to be judged on (none: on blocks set aside), and what others found in it.

    The mean gain is over all channels, and over the `arm`'s joints by themselves where a gripper was recorded with them.
    """

    name: str
    train: tuple[str, ...]
    test: tuple[str, ...]
    known: str
    arm: tuple[str, ...] = ()

    @property
    def title(self) -> str:
        """The set and the runs that it is judged on."""
        return f"{self.name}, {', '.join(self.test or self.train)}"


SETS = (
    RealSet(
        "emps",
        ("train",),
        ("test",),
        "friction, unequal by direction; 2.16 N held out below 20 Hz (a test asks 1.1 times that of ours), 4.1-6.0 % published",
    ),
    RealSet(
        "kr300-dual-encoder",
        ("train",),
        ("test",),
        "a delay of about 3 ms, and very little else; 52 and 97 urad after it",
    ),
    # The simulation beside each run is a spring and a damper fitted to that run: one run's correction is not the other's.
    RealSet(
        "brfd-backlash",
        ("train",),
        (),
        "hysteresis with play; 1070 N held out with a stop operator and its cube, 4070 N before",
    ),
    RealSet(
        "brfd-backlash",
        ("test",),
        (),
        "hysteresis with play; 1480 N held out with a stop operator and its cube, 3870 N before",
    ),
    RealSet(
        "panda-excite",
        ("train",),
        ("test",),
        "joint friction; published law 0.258 0.683 0.240 0.316 0.152 0.105 0.064 N m held out, an open rest in joint 2",
    ),
    RealSet(
        "so101",
        ("backlash_detection", "friction_gravity", "step_response", "frequency_sweep", "large_amplitude"),
        ("multisine", "reach_and_return", "random_waypoints"),
        "delay, play or friction, lag, sag, contact with the table; 4.8 5.1 5.8 3.2 6.9 11.6 mrad without contact",
        arm=("Rotation", "Pitch", "Elbow", "Wrist_Pitch", "Wrist_Roll"),
    ),
)


LEFT_OUT = ["## Real recordings\n", "Left out of this run.\n"]


def data_folder() -> Path | None:
    """Where the real recordings are: GALEN_HW_DATA, or shared/data beside the checkout; None when absent."""
    beside = Path(__file__).resolve().parents[2].parent / "shared" / "data"
    chosen = Path(os.environ.get("GALEN_HW_DATA", beside))
    return chosen if chosen.is_dir() else None


def recordings(out: Path, workers: int, commit: str, engine: str) -> list[str]:
    """The section of the report, line by line; answers that an engine of another commit has given are said to be so.

    Args:
        out: folder in which answers are kept; workers: at once; commit: of the report; engine: the commit that is asked now.
    """
    data = data_folder()
    if data is None:
        return ["## Real recordings\n", "Not present on this machine.\n"]
    out.mkdir(parents=True, exist_ok=True)
    with ThreadPoolExecutor(workers) as pool:
        # The last takes longest: it begins first.
        answers = list(pool.map(lambda real_set: _ask(data, real_set, out, engine), SETS[::-1]))[::-1]
    lines = ["## Real recordings\n", "All with the tool's defaults; nothing was set for any of them.\n"]
    lines += [
        "| set, held out | verdict | findings, first to last | held-out rms before to after | known |",
        "| --- " * 5 + "|",
    ]
    lines += [_row(real_set, answer) for real_set, answer in zip(SETS, answers, strict=True)]
    return [*lines, "", *_made_before(out, commit)]


def _made_before(out: Path, commit: str) -> list[str]:
    """A line for every commit but the report's whose engine has given answers."""
    by: dict[str, list[str]] = {}
    for real_set in SETS:
        note = _note(out, real_set)
        made = note.read_text() if note.exists() else "unknown"
        if _path(out, real_set).exists() and made != commit:
            by.setdefault(made, []).append(real_set.title)
    return [f"Answered by the engine of commit {made}: {'; '.join(titles)}." for made, titles in by.items()]


def _path(out: Path, real_set: RealSet) -> Path:
    return out / f"{real_set.name}-{real_set.train[0]}.json"


def _note(out: Path, real_set: RealSet) -> Path:
    return _path(out, real_set).with_suffix(".commit")


def _ask(data: Path, real_set: RealSet, out: Path, engine: str) -> dict[str, Any] | str:
    """The tool's answer, or its one line of refusal; an answer that a run before has kept stays."""
    path = _path(out, real_set)
    if path.exists():
        kept: dict[str, Any] = json.loads(path.read_text())
        return kept
    folder = data / real_set.name
    command = [sys.executable, "-m", "galen_hw.cli", "diagnose", *[str(folder / t) for t in real_set.train]]
    for test in real_set.test:
        command += ["--holdout", str(folder / test)]
    command += ["--json", str(path)]
    if len(real_set.train) > 1:
        command.append("--together")
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if not path.exists():
        return (done.stderr.strip().splitlines() or ["no answer"])[-1]
    answer: dict[str, Any] = json.loads(path.read_text())
    _note(out, real_set).write_text(engine)
    return answer


def _row(real_set: RealSet, answer: dict[str, Any] | str) -> str:
    if isinstance(answer, str):
        return f"| {real_set.title} | refused | {answer} | | {real_set.known} |"
    found = "; ".join(_finding(f) for f in answer["findings"]) or "none"
    before, after = answer["fit"]["rmse_before"], answer["fit"]["rmse_after"]
    pairs = ", ".join(f"{c.split('.')[-2] if '.' in c else c} {before[c]:.3g} to {after[c]:.3g}" for c in before)
    gains = {c: before[c] / after[c] for c in before}
    named = by_names(answer)
    alone = np.mean([before[c] / named[c] for c in before])
    gain = f"mean {np.mean(list(gains.values())):.1f} x"
    if real_set.arm:
        gain += f", {np.mean([gains[f'joint.{joint}.position'] for joint in real_set.arm]):.1f} x without the gripper"
    gain += f", {alone:.1f} x by named physics alone" if named != after else ""
    return f"| {real_set.title} | {answer['verdict']} | {found} | {pairs} ({gain}) | {real_set.known} |"


def _finding(finding: dict[str, Any]) -> str:
    joints = f" ({', '.join(finding['joints'])})" if finding["joints"] else ""
    others = [c["effect"] for c in finding["confounded_with"]]
    rivals = ", ".join("elsewhere" if other == finding["effect"] else other for other in others)
    return f"**{finding['effect']}**{joints}" + (f", or {rivals}" if rivals else "")

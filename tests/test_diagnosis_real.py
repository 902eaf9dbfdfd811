"""Real recordings with the tool's defaults: what is known is named first, and no name stands that its evidence does not carry.

What was published of each is in the README beside it; `make proof` sets it beside these answers and the two long sets.
"""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.signal import butter, filtfilt

from galen_hw import read_recording
from galen_hw.cli import main
from galen_hw.diagnosis.recordings import diagnose_recordings, observed
from galen_hw.diagnosis.validation.other_recording import apply
from galen_hw.physics.effects.registry import scene_of

DATA = Path(__file__).resolve().parents[2] / "shared" / "data"
EXIT_DIFFERS = 1
"""Of the command where simulation and recording differ."""
DOUBT = 0.01
"""False-alarm probability from which a name is a guess."""


def asked(out: Path, name: str, run: str, *, other: bool = True) -> dict[str, Any]:
    """The answer about one run, judged on the other or on blocks of its own."""
    folder = DATA / name
    if not folder.is_dir():
        pytest.skip(f"the real recordings of {name} are not beside the checkout")
    held = ["--holdout", str(folder / "test")] if other else []
    assert main(["diagnose", str(folder / run), *held, "-o", str(out / "answer.json")]) == EXIT_DIFFERS
    return json.loads((out / "answer.json").read_text())


def judged(answer: dict[str, Any]) -> tuple[list[str], float]:
    """Names in their order, none of them a guess, and by how much the error falls in the channel that was worst."""
    for finding in answer["findings"]:
        if finding["effect"] != "unknown":
            assert finding["evidence"]["false_alarm_probability"] < DOUBT, finding["says"]
    before, after = answer["fit"]["rmse_before"], answer["fit"]["rmse_after"]
    worst = max(before, key=lambda channel: before[channel])
    return [finding["effect"] for finding in answer["findings"]], before[worst] / after[worst]


def test_friction_of_a_linear_axis() -> None:
    """EMPS: dry friction, unequal by direction, and below 20 Hz an error as small as the reference fit's, which ends there."""
    folder = DATA / "emps"
    if not folder.is_dir():
        pytest.skip("the real recordings of emps are not beside the checkout")
    train, test = (read_recording(folder / run) for run in ("train", "test"))
    work = diagnose_recordings([train], holdout=[test])
    names = [finding.effect for finding in work.diagnosis.findings]
    assert (work.diagnosis.verdict, names) == ("explained", ["friction"])
    better = np.sqrt(work.judged.before / work.judged.after)
    assert better[0] > 11.0, "by plain least squares: weighed ones take what is missed for slow noise"
    other = scene_of(observed(test))
    time = work.model.bench.rows.of(other.segments).average(other.time)
    low = butter(4, 20.0, fs=1.0 / np.median(np.diff(time)))
    residual = filtfilt(*low, apply(work.model, other, work.judged.good)[:, 0])[(time > 0.3) & (time < time[-1] - 0.3)]
    assert np.sqrt(np.mean(residual**2)) < 1.1 * 2.16


def test_delay_of_an_industrial_arm(tmp_path: Path) -> None:
    """KR300: 3 ms between the encoders of the motor and of the joint."""
    answer = asked(tmp_path, "kr300-dual-encoder", "train")
    names, better = judged(answer)
    assert names[0] == "time_delay"
    assert answer["findings"][0]["parameters"]["delay"]["value"] == pytest.approx(3e-3, abs=3e-4)
    assert better > 5.0


@pytest.mark.parametrize(("run", "least"), [("train", 3.8), ("test", 1.25 * 2.6)])
def test_hysteresis_of_a_damper(tmp_path: Path, run: str, least: float) -> None:
    """BRFD: stick and slip with play; a stop operator with its cube takes 3.8 and 2.6 times off the error, ours more."""
    names, better = judged(asked(tmp_path, "brfd-backlash", run, other=False))
    assert names[0] == "hysteresis"
    assert "contact" not in names
    assert better > least

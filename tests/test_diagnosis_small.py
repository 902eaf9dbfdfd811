"""Few rows: seventeen static poses, whatever hangs on the sensor and whichever way its forces are counted."""

import csv
import json
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from galen_hw.cli import main
from galen_hw.diagnosis.stats.sampling import folds
from galen_hw.errors import EXIT_FOUND, EXIT_INTERNAL, EXIT_OK, EXIT_USAGE

POSES = 17
TOOLS = {
    "none": None,
    "right": (0.5, [0.02, 0.0, 0.06]),
    "heavy": (1.0, [0.02, 0.0, 0.06]),
    "light": (0.2, [0.0, 0.0, 0.03]),
}


def poses(folder: Path, tool: str, sign: int) -> Path:
    """A tool of 0.5 kg in 17 orientations, read by a sensor that is not straight; the recording may name another tool."""
    turns = Rotation.random(POSES, random_state=3)
    force = turns.inv().apply([0.0, 0.0, -0.5 * 9.80665])
    rng = np.random.default_rng(3)
    torque = sign * np.cross([0.02, 0.0, 0.06], force) + [0.1, -0.2, 0.05] + 0.002 * rng.normal(size=(POSES, 3))
    force = sign * force + [1.0, 2.0, -3.0] + 0.02 * rng.normal(size=(POSES, 3))
    force += 0.05 * force**2
    folder.mkdir()
    with (folder / "recording.csv").open("w", newline="") as file:
        table = csv.writer(file)
        table.writerow(
            [f"sensor.orientation.{a}" for a in "xyzw"]
            + [f"wrench.{k}.{a}" for k in ("force", "torque") for a in "xyz"]
        )
        table.writerows(np.column_stack([turns.as_quat(), force, torque]).tolist())
    named = TOOLS[tool]
    info = {"schema": 1, "predict": "wrench", "model": {"bias": "free", "dynamics": "static"}}
    info |= {"tool": {"name": "t", "mass": named[0], "com": named[1]}} if named else {}
    (folder / "recording.json").write_text(json.dumps(info))
    return folder


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize("tool", list(TOOLS))
def test_few_poses_have_an_answer(tool: str, sign: int, tmp_path: Path) -> None:
    """An answer, its status and no finding that takes nothing: trees were once asked to learn from a fold without rows."""
    out = tmp_path / "answer.json"
    status = main(["diagnose", str(poses(tmp_path / "r", tool, sign)), "-o", str(out)])
    answer = json.loads(out.read_text())
    assert status == (EXIT_OK if answer["verdict"] == "agrees" else EXIT_FOUND)
    named = [f for f in answer["findings"] if f["effect"] != "unknown"]
    assert all(f["evidence"]["heldout_gain"] > 0.0 for f in named)
    assert all(f["channels"] for f in named)
    if tool != "right" and sign == 1:
        assert named[0]["effect"] == "payload"


@pytest.mark.parametrize("blocks", [1, 2, 3, 5, 12])
def test_no_fold_is_empty(blocks: int) -> None:
    """Each has rows to be judged on, and leaves rows to be learnt from."""
    block = np.repeat(np.arange(blocks) * 3, 2)
    fold = folds(block)
    counts = np.bincount(fold)
    assert counts.all()
    assert len(counts) >= 2
    assert len(counts) == min(max(blocks, 2), 5)


def test_a_fault_of_the_program_is_no_finding(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """One line that says where, and a status that neither `found` nor `agrees` has."""
    monkeypatch.delenv("GALEN_HW_TRACEBACK", raising=False)

    def broken(*_: object, **__: object) -> None:
        raise ValueError("two\nlines")

    monkeypatch.setattr("galen_hw.diagnosis.recordings.diagnose", broken)
    assert main(["diagnose", str(poses(tmp_path / "r", "none", 1))]) == EXIT_INTERNAL
    (line,) = capsys.readouterr().err.strip().splitlines()
    assert line.startswith("galen-hw diagnose: internal error: ValueError two lines (test_diagnosis_small.py:")
    assert "GALEN_HW_TRACEBACK" in line


def test_numbers_that_have_no_square_are_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """One line with column and row, where numpy's warnings of overflow had been on the screen."""
    folder = poses(tmp_path / "r", "heavy", 1)
    table = (folder / "recording.csv").read_text().splitlines()
    cells = table[3].split(",")
    table[3] = ",".join([*cells[:4], "1e200", *cells[5:]])
    (folder / "recording.csv").write_text("\n".join(table) + "\n")
    assert main(["diagnose", str(folder)]) == EXIT_USAGE
    (line,) = capsys.readouterr().err.strip().splitlines()
    assert "wrench.force.x is 1e+200 in row 3" in line

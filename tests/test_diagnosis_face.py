"""The face of the diagnosis: a recording in, a Diagnosis out, and nothing heavy loaded before it is asked for."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

from galen_hw.cli import main
from galen_hw.diagnosis import Diagnosis, diagnose
from galen_hw.errors import UsageError
from galen_hw.recording import read_recording
from tests import diagnosis_parts as parts


def test_a_path_a_recording_and_the_command_give_the_same_answer(tmp_path: Path) -> None:
    folder = parts.write_table(parts.poses(), tmp_path / "run")
    found = diagnose(folder)
    assert isinstance(found, Diagnosis)
    assert [finding.effect for finding in found.findings] == ["payload"]
    assert main(["diagnose", str(folder), "--json", str(tmp_path / "out.json")]) == 1
    told = json.loads((tmp_path / "out.json").read_text())
    stamp = {key: told.pop(key) for key in ("software", "date", "seed")}  # of the command, not of the answer
    assert stamp["seed"] == 0
    for answer in (found, diagnose(read_recording(folder), holdout=0.3)):
        assert json.loads(json.dumps(answer.to_json())) == told


def test_what_is_no_recording_is_said_in_one_line(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="no such recording"):
        diagnose(tmp_path / "nowhere")


def test_the_face_loads_no_fitting_code() -> None:
    """Whoever names a type of it pays for nothing else."""
    code = "import sys, galen_hw.diagnosis; print(*(m for m in ('scipy', 'galen_hw.diagnosis.pipeline') if m in sys.modules))"
    out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert out.stdout.strip() == ""

"""The notebooks run from top to bottom in a fresh interpreter, as a reader would run them."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

FOLDER = Path(__file__).parents[1] / "docs" / "notebooks"
LIVE = {"live_wrench"}


def code_of(name):
    """The code cells of a notebook, in order; it is kept without outputs."""
    cells = json.loads((FOLDER / f"{name}.ipynb").read_text(encoding="utf-8"))["cells"]
    code = [cell for cell in cells if cell["cell_type"] == "code"]
    assert not any(cell["outputs"] or cell["execution_count"] for cell in code), "clear the outputs"
    return "\n\n".join("".join(cell["source"]) for cell in code)


@pytest.mark.parametrize(
    "name",
    [
        pytest.param(path.stem, marks=[pytest.mark.live, pytest.mark.timeout(400)] if path.stem in LIVE else [])
        for path in sorted(FOLDER.glob("*.ipynb"))
    ],
)
def test_a_notebook_runs_from_top_to_bottom(name, tmp_path):
    """Every cell, in order, with its own assertions; no state of the user's is read or written."""
    environ = os.environ | {
        "GALEN_HW_STATE": str(tmp_path / "state"),
        "GALEN_HW_RUNTIME": str(tmp_path / "run"),
        "MPLBACKEND": "Agg",
        "TMPDIR": str(tmp_path),
    }
    done = subprocess.run(
        [sys.executable, "-c", code_of(name)], capture_output=True, text=True, check=False, cwd=tmp_path, env=environ
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout


def test_there_are_three():
    """The pages that name them are true."""
    assert {path.stem for path in FOLDER.glob("*.ipynb")} == {"first_calibration", "first_diagnosis", "live_wrench"}

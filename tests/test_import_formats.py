"""Every format: file in, diagnosis out, in one command; and the numbers are those that were written."""

import json
from pathlib import Path

import numpy as np
import pytest

from galen_hw.cli import main
from galen_hw.formats import read
from galen_hw.recording import Recording
from galen_hw.recording.recording import SENSOR_ORIENTATION, WRENCH
from tests.import_files import ARMS, MASS, OFFSET, WRENCHES, N, table

COUNTS = {"candump -L, Robotous": (0.011, 2.6e-4), "candump -L, IIT": (0.0062, 1.6e-4)}
"""Formats that bring whole counts of the sensor: half a count of force and torque."""


def held(recording: Recording, name: str) -> None:
    """The columns are those that were written."""
    force, torque = COUNTS.get(name, (5e-3, 3e-4) if name.startswith(("CAN", "candump")) else (1e-9, 1e-9))
    assert len(recording) == N
    time = recording.time
    assert time is not None
    np.testing.assert_allclose(time - time[0], table()["time"], atol=2e-6)
    for column in WRENCH:
        bound = force if "force" in column else torque
        np.testing.assert_allclose(recording.columns[column], table()[column], atol=bound, err_msg=column)
    signs = np.sign(np.sum([recording.columns[c] * table()[c] for c in SENSOR_ORIENTATION], axis=0))
    for column in SENSOR_ORIENTATION:
        np.testing.assert_allclose(signs * recording.columns[column], table()[column], atol=1e-4, err_msg=column)


@pytest.mark.parametrize("name", list(WRENCHES))
def test_the_numbers_are_those_that_were_written(name: str, tmp_path: Path) -> None:
    """By the real writers, read back by content."""
    held(read(WRENCHES[name](tmp_path)), name)


@pytest.mark.parametrize("name", [*WRENCHES, *(pytest.param(name, marks=pytest.mark.slow) for name in ARMS)])
def test_a_file_in_and_a_diagnosis_out_in_one_command(name: str, tmp_path: Path) -> None:
    """`galen-hw diagnose FILE` names what nobody told of: the tool, the load, the joint's zero."""
    path = (WRENCHES | ARMS)[name](tmp_path)
    assert main(["diagnose", str(path), "--json", str(tmp_path / "answer.json")]) == 1
    first = json.loads((tmp_path / "answer.json").read_text())["findings"][0]
    if name.startswith("NDI"):
        assert first["effect"] == "joint_offset"
        value = next(v["value"] for k, v in first["parameters"].items() if "offset" in k)
        assert abs(abs(value) - OFFSET) < 0.004
    else:
        assert first["effect"] == "payload"
        assert abs(first["parameters"]["mass"]["value"] - MASS) < 0.03


def test_the_table_in_the_docs_lists_what_is_tested() -> None:
    """Every format of the tests has its line in docs/import.md, and every line is tested."""
    lines = (Path(__file__).parents[1] / "docs" / "import.md").read_text(encoding="utf-8").splitlines()
    rows = [line.split("|")[1].strip() for line in lines if "`galen-hw diagnose" in line and line.startswith("|")]
    assert rows == [*WRENCHES, *ARMS]

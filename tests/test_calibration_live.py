"""`galen-hw calibrate --virtual` end to end: virtual wires, drivers, daemon, sweep, fit, acceptance."""

import json
import os
import signal
import subprocess
import sys
import time
from importlib import resources

import pytest

from galen_hw.config.tool_store import ToolStore
from galen_hw.drivers.virtual.truth import TOOLS
from galen_hw.recording import read_recording

QUICK = ("--poses", "3x4", "--samples", "80", "--no-check")


@pytest.fixture
def command(tmp_path):
    """Words that calibrate the pointer on a virtual robot in directories of their own."""
    text = (resources.files("galen_hw.config") / "galen.toml").read_text(encoding="utf-8")
    config = tmp_path / "galen.toml"
    # No copy of the bus for viewers: its port may be in use on the machine that tests.
    text = text.replace("[bus]\n", '[bus]\nviewers = ""\n')
    # Nor is a stall of the machine that tests what these tests are about.
    config.write_text(text.replace("[daemon]\n", "[daemon]\nblind_after_s = 2.0\n"), encoding="utf-8")
    words = [sys.executable, "-m", "galen_hw.cli", "calibrate", "--tool", "pointer", "--virtual", "--yes"]
    return [*words, "--config", str(config), *QUICK]


@pytest.fixture
def environ(tmp_path):
    return os.environ | {"GALEN_HW_STATE": str(tmp_path / "state")}


@pytest.mark.slow
@pytest.mark.timeout(300)
def test_a_virtual_calibration_finds_and_saves_the_tool(command, environ, tmp_path):
    """Over slcan and serial ptys: mass and centre of mass within their intervals, saved, bound to the sensor."""
    done = subprocess.run([*command, "--json"], env=environ, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    saved = ToolStore(tmp_path / "state").load("pointer")

    true = TOOLS["pointer"]
    values = (saved.mass, *saved.com)
    for value, expected, half in zip(values, (true.mass, *true.com), found["interval95"], strict=True):
        assert abs(value - expected) < 3.0 * half
    assert found["accepted"]
    assert saved.calibration_id == found["tool"]["origin"]["id"]
    assert saved.origin.sensor_serial
    assert saved.origin.robot == "galen"
    assert saved.origin.virtual
    assert not ToolStore(tmp_path / "state", virtual=False).load("pointer").calibrated
    assert len(read_recording(saved.origin.sweep)) == saved.origin.fit_poses + saved.origin.verify_poses


@pytest.mark.slow
@pytest.mark.timeout(300)
def test_ctrl_c_stops_the_robot_and_keeps_the_poses(command, environ, tmp_path):
    """SIGINT in the middle: exit 130, nothing accepted, the poses so far are a recording that says it was stopped."""
    process = subprocess.Popen(command, env=environ, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    sweeps = tmp_path / "state" / "sweeps"
    until = time.monotonic() + 120.0
    while time.monotonic() < until and not list(sweeps.glob("*/recording.csv")):
        select_nothing(0.1)
    process.send_signal(signal.SIGINT)
    process.communicate(timeout=60.0)

    (folder,) = sweeps.iterdir()
    about = json.loads((folder / "sweep.json").read_text())
    assert process.returncode == 130
    assert about["state"] == "stopped"
    assert about["poses"] == len(read_recording(folder)) >= 1
    assert not ToolStore(tmp_path / "state").load("pointer").calibrated


def select_nothing(seconds):
    """Let another process go on."""
    signal.sigtimedwait([], seconds)

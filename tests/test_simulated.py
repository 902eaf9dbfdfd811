"""Simulated time: the whole daemon on a virtual robot, faster than the clock, and never late."""

import logging
import os
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from galen_hw.bus import CommandClient, Subscriber
from galen_hw.cli import main
from galen_hw.config.paths import Addresses
from galen_hw.config.tool_store import ToolStore
from galen_hw.daemon.session import own_daemon
from galen_hw.daemon.simulated import JUDGED_NS, SimulatedTime
from galen_hw.drivers.virtual.control import VirtualControl
from galen_hw.drivers.virtual.truth import TOOLS
from tests.daemon_tree import alive, within

CONFIG = """
[devices.ft]
driver = "ati_netcanoem"
transport = { interface = "slcan", channel = "CAN0", bitrate = 1000000 }
settings = { rate_hz = 200 }
[devices.motors]
driver = "galil_dmc"
transport = { url = "/dev/serial/by-id/motors" }
[services.compensation]
[services.calibration]
[bus]
viewers = ""
"""
MS = 1_000_000


class Machine:
    """A machine's clock that goes on by itself whenever it is looked at."""

    def __init__(self, step_ns: int) -> None:
        self.now_ns, self.step_ns = 10**12, step_ns

    def __call__(self) -> int:
        self.now_ns += self.step_ns
        return self.now_ns


@pytest.fixture
def config(tmp_path: Path) -> Path:
    path = tmp_path / "galen.toml"
    path.write_text(CONFIG)
    return path


def test_time_passes_from_event_to_event_and_at_most_so_fast() -> None:
    """A second in steps of a millisecond, on an idle machine: exactly those steps, in a tenth of a second and not less."""
    import time

    passing = SimulatedTime(10.0)
    begun, first = time.monotonic(), passing.now_ns
    seen = []
    for n in range(1, 1001):
        assert passing.pass_until(first + n * MS, []) == []
        seen.append(passing.now_ns)
    assert np.diff(seen).tolist() == [MS] * 999
    assert time.monotonic() - begun > 0.1 - 0.003
    passing.pass_until(first, [])
    assert passing.now_ns == seen[-1]


def test_a_busy_machine_is_said_in_one_line(caplog: pytest.LogCaptureFixture) -> None:
    """Half the speed asked for, for a minute: one line; then fast enough, then slow again: one more."""
    machine = Machine(200_000)  # a step of a millisecond takes 0.2 ms at least, which is a speed of 5
    passing = SimulatedTime(10.0, machine)

    def live(seconds: float) -> None:
        for _ in range(round(seconds * 1000)):
            passing.pass_until(passing.now_ns + MS, [])

    with caplog.at_level(logging.WARNING, "galen-hw"):
        live(300.0)
        assert [r.getMessage() for r in caplog.records] == [
            "this machine is too busy: the virtual robot runs 5 times as fast as the clock, not 10"
        ]
        machine.step_ns = 100_000
        live(10.0 * 3e-9 * JUDGED_NS)
        machine.step_ns = 500_000
        live(2.0 * 3e-9 * JUDGED_NS)
    assert len(caplog.records) == 2
    assert "runs 2 times" in caplog.records[1].getMessage()


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["run", "--speed", "10"], "--speed: real hardware has one speed; add --virtual, or leave it out"),
        (["calibrate", "--tool", "pointer", "--speed", "10"], "--speed: real hardware has one speed"),
        (["collect", "deflection", "--speed", "10"], "--speed: real hardware has one speed"),
        (["run", "--virtual", "--speed", "0"], "--speed: 0 is not between 0.1 and 100"),
        (["run", "--virtual", "--speed", "nan"], "--speed: nan is not between 0.1 and 100"),
    ],
)
def test_real_hardware_refuses_a_speed(words: list[str], said: str, capsys: pytest.CaptureFixture[str]) -> None:
    """One line, status 2."""
    try:
        status = main(words)
    except SystemExit as error:
        status = int(error.code or 0)
    assert status == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert said in line


def test_nothing_is_late_on_the_busiest_machine(config: Path, tmp_path: Path) -> None:
    """One process; each sample exactly one period after the other; a push is felt, a move is made; time runs ahead."""
    with own_daemon(config=str(config), state=tmp_path / "state", speed=50.0) as addresses:
        with (
            CommandClient(addresses.command) as client,
            VirtualControl(addresses.virtual) as world,
            Subscriber(addresses.bus, ("wrench/raw", "joints/state"), queue=50_000) as bus,
        ):
            info = client.call("daemon", "info")
            assert info["processes"].keys() == {"core"}
            assert (info["speed"], info["virtual"]) == (50.0, True)
            world.push(force=[0, 0, -5], seconds=1e6)
            client.call("motors", "enable")
            client.call("motors", "move_jp", {"position": {"roll": 0.3}})
            stamps, numbers, force, roll = [], [], 0.0, 0.0
            while len(stamps) < 400 or abs(roll - 0.3) > 1e-3:
                received = bus.receive(20.0)
                assert received is not None
                if received[0] == "wrench/raw":
                    stamps.append(received[1].t_ns)
                    numbers.append(received[1].seq)
                    force = received[1].force.z
                else:
                    roll = received[1].position["roll"]
        assert np.diff(numbers).tolist() == [1] * (len(numbers) - 1)
        assert np.diff(stamps).tolist() == [5 * MS] * (len(stamps) - 1)
        assert force != 0.0


def test_the_end_of_the_process_is_the_end_of_its_world(config: Path, tmp_path: Path) -> None:
    """The virtual robot has died with it: nothing is started again in its place."""
    command = [sys.executable, "-m", "galen_hw.cli", "run", "--virtual", "--speed", "5", "--config", str(config)]
    environ = os.environ | {"GALEN_HW_STATE": str(tmp_path / "state"), "GALEN_HW_RUNTIME": str(tmp_path / "run")}
    with subprocess.Popen(command, env=environ, text=True, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as process:
        assert process.stdout is not None
        assert process.stdout.readline().startswith("ready: ft ready, motors ready")
        with CommandClient(Addresses(tmp_path / "run").command) as client:
            pid = client.call("daemon", "info")["processes"]["core"]
        os.kill(pid, signal.SIGKILL)
        _, said = process.communicate(timeout=30)
    assert process.returncode == 1
    assert "core: ended with status -9; giving up" in said
    assert within(5.0, lambda: not alive(pid))


@pytest.mark.slow
@pytest.mark.timeout(300)  # half a minute of the robot's time: seconds, unless the machine is busy
def test_a_whole_calibration_in_simulated_time(
    config: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """The very command, its sweep and its fit: the tool's true mass and centre of mass are found."""
    monkeypatch.setenv("GALEN_HW_STATE", str(tmp_path / "state"))
    words = ["--tool", "retractor", "--virtual", "--speed", "100", "--yes", "--poses", "3x4", "--samples", "40"]
    assert main(["calibrate", *words, "--no-check", "--config", str(config), "--dir", str(tmp_path / "run")]) == 0
    capsys.readouterr()
    found = ToolStore(tmp_path / "state", virtual=True).load("retractor")
    truth = TOOLS["retractor"]
    assert found.mass == pytest.approx(truth.mass, abs=5e-4)
    np.testing.assert_allclose(found.com, truth.com, atol=2e-4)

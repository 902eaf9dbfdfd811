"""`galen-hw run --virtual` as a user starts it: the default settings, the virtual robot, a subscriber."""

import json
import os
import signal
import subprocess
import sys
import time
from itertools import pairwise
from pathlib import Path

import pytest

from galen_hw.bus import CommandClient, Subscriber
from galen_hw.config.paths import DEFAULT_CONFIG, Addresses
from galen_hw.messages import JointsState, Message, Status, WrenchRaw
from tests.daemon_tree import alive, within

ROBOTOUS = """
[devices.ft]
driver = "robotous_rft"
transport = { interface = "slcan", channel = "CAN0", bitrate = 1000000 }
[services.compensation]
[bus]
viewers = ""
[daemon]
start_timeout_s = 4.0
realtime_priority = 0
"""


def environ(folder: Path) -> dict[str, str]:
    return os.environ | {"GALEN_HW_STATE": str(folder / "state"), "GALEN_HW_RUNTIME": str(folder / "run")}


def galen(folder: Path, *words: str) -> "subprocess.Popen[str]":
    command = [sys.executable, "-m", "galen_hw.cli", *words]
    return subprocess.Popen(command, env=environ(folder), text=True, stdout=subprocess.PIPE, stderr=subprocess.PIPE)


def virtual_pids(folder: Path) -> list[int]:
    """The process of the virtual robot in this folder, as its lock names it."""
    lock = folder / "run" / "virtual" / "lock"
    pid = int(lock.read_text() or 0) if lock.exists() else 0
    return [pid] if pid and alive(pid) else []


def test_run_virtual_end_to_end(tmp_path: Path) -> None:
    """Ready in one command: wrench, joints and pose flow, a move is carried out and seen, SIGTERM ends all of it."""
    config = tmp_path / "galen.toml"
    config.write_text(DEFAULT_CONFIG.read_text().replace('# viewers = "tcp://127.0.0.1:9872"', 'viewers = ""'))
    process = galen(tmp_path, "run", "--virtual", "--config", str(config))
    addresses = Addresses(tmp_path / "run")
    try:
        assert process.stdout is not None
        line = process.stdout.readline()
        assert line.startswith("ready: ft ready, motors ready, tracker ready"), line
        assert virtual_pids(tmp_path)
        seen: dict[str, Message] = {}
        with Subscriber(addresses.bus) as bus, CommandClient(addresses.command) as client:
            wanted = {"wrench/raw", "wrench/compensated", "wrench/contact", "joints/state", "pose/reported", "status"}
            wanted |= {"tracker/tool", "tracker/reference"}

            def heard() -> bool:
                for _ in range(2000):
                    if (received := bus.receive(0.1)) is None:
                        break
                    seen[received[0]] = received[1]
                return wanted <= seen.keys()

            assert within(15.0, heard), wanted - seen.keys()
            client.call("motors", "enable")
            client.call("motors", "move_jp", {"position": {"roll": 0.2}})
            assert within(15.0, lambda: heard() and _roll(seen) == pytest.approx(0.2, abs=1e-3))
            pids = client.call("daemon", "info")["processes"].values()
        process.send_signal(signal.SIGTERM)
        assert process.wait(timeout=30) == 0
        assert not any(alive(pid) for pid in pids)
        assert within(5.0, lambda: not virtual_pids(tmp_path))
    finally:
        process.kill()
        process.communicate()


@pytest.mark.parametrize(("driver", "serial"), [("robotous_rft", "HA01-2041"), ("iit_strain", "SN042")])
def test_run_virtual_with_a_sensor_that_streams(tmp_path: Path, driver: str, serial: str) -> None:
    """`driver` alone chooses the sensor on the virtual wire: ready, valid samples at its pace, zeroed on request."""
    config = tmp_path / "galen.toml"
    config.write_text(ROBOTOUS.replace("robotous_rft", driver))
    process = galen(tmp_path, "run", "--virtual", "--config", str(config))
    addresses = Addresses(tmp_path / "run")
    try:
        assert process.stdout is not None
        line = process.stdout.readline()
        assert line.startswith("ready: ft ready"), line
        samples: list[WrenchRaw] = []
        published = Subscriber(addresses.bus, ["wrench/raw"], as_published=True)
        with published as bus, CommandClient(addresses.command) as client:

            def heard(zeroings: int) -> bool:
                while (received := bus.receive(0.0)) is not None:
                    assert isinstance(received[1], WrenchRaw)
                    samples.append(received[1])
                return sum(sample.zeroings == zeroings for sample in samples) >= 100

            assert within(15.0, lambda: heard(0))
            assert client.call("ft", "zero", {"samples": 50})["samples"] == 50
            assert within(15.0, lambda: heard(1))
    finally:
        process.terminate()
        process.communicate(timeout=30)
    assert process.returncode == 0
    assert [sample for sample in samples if not (sample.valid and sample.virtual)] == []
    assert {(sample.source, sample.serial_number) for sample in samples} == {("ft", serial)}
    assert [b.seq - a.seq for a, b in pairwise(samples)] == [1] * (len(samples) - 1)
    assert abs(samples[0].force.z) > 5.0, "the sensor's own offset"
    last = samples[-50:]
    assert abs(sum(sample.force.z for sample in last) / len(last)) < 0.2


def _roll(seen: dict[str, Message]) -> float:
    state = seen["joints/state"]
    assert isinstance(state, JointsState)
    return state.position["roll"]


def test_core_that_is_killed_comes_back_with_the_sensors_zero(tmp_path: Path) -> None:
    """Zeroed, then SIGKILL: the new core's samples bear the same zero from the first on, and the sensor says so."""
    config = tmp_path / "galen.toml"
    config.write_text(ROBOTOUS.replace("robotous_rft", "ati_netcanoem"))
    process = galen(tmp_path, "run", "--virtual", "--config", str(config))
    addresses = Addresses(tmp_path / "run")
    try:
        assert process.stdout is not None
        assert process.stdout.readline().startswith("ready")
        with Subscriber(addresses.bus, ["wrench/raw"]) as bus, CommandClient(addresses.command) as client:
            client.call("ft", "zero", {"samples": 50})
            kept = tmp_path / "state" / "devices" / "ft-virtual.json"
            assert within(10.0, lambda: kept.exists() and b'"zeroings": 1' in kept.read_bytes())
            core = client.call("daemon", "info")["processes"]["core"]
            os.kill(core, signal.SIGKILL)
            assert within(20.0, lambda: client.call("daemon", "info")["processes"]["core"] not in (0, core))
            begun = time.monotonic_ns()
            after: list[WrenchRaw] = []

            def heard() -> bool:
                received = bus.receive(1.0)
                if received and isinstance(received[1], WrenchRaw) and received[1].t_ns > begun:
                    after.append(received[1])
                return len(after) > 200

            assert within(20.0, heard)
        with Subscriber(addresses.bus, ["status"]) as bus:
            details: dict[str, str] = {}

            def told() -> bool:
                if (received := bus.receive(1.0)) and isinstance(received[1], Status):
                    details[received[1].source] = received[1].detail
                return "restored after a restart" in details.get("ft", "")

            assert within(10.0, told), details
    finally:
        process.terminate()
        process.communicate(timeout=30)
    assert {sample.zeroings for sample in after} == {1}
    mean = sum(sample.force.z for sample in after) / len(after)
    assert abs(mean) < 0.1, "the sensor's own offset is tens of newtons"


def test_wrong_device_and_busy_port_are_one_line_each(tmp_path: Path) -> None:
    """An ATI board where the settings say Robotous; then the same port while another program holds it."""
    virtual = galen(tmp_path, "virtual", "--json", "--dir", str(tmp_path / "v"))
    try:
        assert virtual.stdout is not None
        channel = json.loads(virtual.stdout.readline())["addresses"]["can0"]["channel"]
        config = tmp_path / "galen.toml"
        config.write_text(ROBOTOUS.replace("CAN0", channel))
        wrong = galen(tmp_path, "run", "--config", str(config))
        _, said = wrong.communicate(timeout=60)
        assert wrong.returncode == 3
        lines = [line for line in said.splitlines() if not line.startswith("waiting for ")]
        assert len(lines) == 1
        assert "ft" in lines[0]

        config.write_text(ROBOTOUS.replace("CAN0", channel).replace("robotous_rft", "ati_netcanoem"))
        first = galen(tmp_path, "run", "--config", str(config))
        try:
            assert first.stdout is not None
            assert first.stdout.readline().startswith("ready")
            second = galen(tmp_path, "run", "--config", str(config), "--dir", str(tmp_path / "other"))
            _, said = second.communicate(timeout=60)
            assert second.returncode == 3
            assert [channel in line for line in said.splitlines() if line.startswith("galen-hw run")] == [True]
        finally:
            first.terminate()
            first.communicate(timeout=30)
        assert first.returncode == 0
    finally:
        virtual.terminate()
        virtual.communicate(timeout=30)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_signal_to_the_whole_group_ends_cleanly(tmp_path: Path, number: signal.Signals) -> None:
    """As a terminal sends Ctrl-C and `timeout` sends SIGTERM: the order of the end stays, status 0, nothing is said."""
    config = tmp_path / "galen.toml"
    config.write_text(ROBOTOUS.replace("robotous_rft", "ati_netcanoem"))
    command = [sys.executable, "-m", "galen_hw.cli", "run", "--virtual", "--config", str(config)]
    process = subprocess.Popen(
        command,
        env=environ(tmp_path),
        text=True,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        start_new_session=True,
    )
    assert process.stdout is not None
    assert process.stdout.readline().startswith("ready")
    os.killpg(process.pid, number)
    _, said = process.communicate(timeout=30)

    assert process.returncode == 0
    assert all(line.startswith("waiting for ") for line in said.splitlines())


OWN = """
import sys
from pathlib import Path
from galen_hw.cli import main
from galen_hw.daemon.session import own_daemon
import galen_hw.tools.record as record

def run(args):
    with own_daemon(config=sys.argv[1], runtime=Path(sys.argv[2])) as addresses:
        print("up", flush=True)
        sys.stdin.readline()
    return 0

record.run = run
sys.exit(main(["record"]))
"""
"""A command that waits within a daemon of its own."""


@pytest.mark.parametrize(
    ("number", "status"), [(signal.SIGTERM, 130), (signal.SIGHUP, 130), (signal.SIGKILL, -signal.SIGKILL)]
)
def test_a_command_that_is_ended_takes_its_daemon_along(tmp_path: Path, number: signal.Signals, status: int) -> None:
    """SIGTERM and SIGHUP are a Ctrl-C; after SIGKILL the daemon and its virtual robot end by themselves."""
    config = tmp_path / "galen.toml"
    config.write_text(ROBOTOUS.replace("robotous_rft", "ati_netcanoem"))
    process = subprocess.Popen(
        [sys.executable, "-c", OWN, str(config), str(tmp_path / "run")],
        env=environ(tmp_path),
        text=True,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
    )
    assert process.stdout is not None
    assert process.stdout.readline() == "up\n"
    with CommandClient(Addresses(tmp_path / "run").command) as client:
        pids = [*client.call("daemon", "info")["processes"].values(), *virtual_pids(tmp_path)]
    assert len(pids) >= 2
    process.send_signal(number)
    process.communicate(timeout=30)

    assert process.returncode == status
    assert within(15.0, lambda: not any(alive(pid) for pid in pids))
    assert within(5.0, lambda: not (tmp_path / "run" / "command").exists())

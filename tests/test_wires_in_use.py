"""A wire that somebody uses: a check leaves it alone, and a channel that is closed behind our back is opened again."""

import json
import os
import subprocess
import sys
import time
from contextlib import contextmanager

import pytest

from galen_hw.bus import CommandClient, Subscriber
from galen_hw.config.paths import Addresses
from galen_hw.drivers.can_transport import CanTransport
from galen_hw.drivers.serial_transport import SerialTransport
from galen_hw.drivers.virtual.start import virtual_robot
from galen_hw.drivers.wire_claim import Claim, users
from galen_hw.errors import HardwareError

SETTINGS = """
[devices.ft]
driver = "{sensor}"
transport = {{ interface = "slcan", channel = "{channel}", bitrate = 1000000 }}
[services.compensation]
[bus]
viewers = ""
[daemon]
realtime_priority = 0
"""


@contextmanager
def daemon_on(robot, folder, sensor):
    """`galen-hw run` on a virtual sensor's wire, as on a real one; its addresses and its environment."""
    config = folder / "galen.toml"
    config.write_text(SETTINGS.format(sensor=sensor, channel=robot.addresses["can0"]["channel"]))
    environ = os.environ | {"GALEN_HW_STATE": str(folder / "state"), "GALEN_HW_RUNTIME": str(folder / "run")}
    command = [sys.executable, "-m", "galen_hw.cli", "run", "--config", str(config)]
    process = subprocess.Popen(command, env=environ, text=True, stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    try:
        assert process.stdout.readline().startswith("ready: ft ready")
        yield Addresses(folder / "run"), environ
    finally:
        process.terminate()
        process.communicate(timeout=30)


def longest_silence(bus, seconds, until=lambda: False):
    """The longest time between two samples, s, while listening."""
    begun = last = time.monotonic()
    longest = 0.0
    while time.monotonic() - begun < seconds and not until():
        received = bus.receive(0.1)
        now = time.monotonic()
        longest = max(longest, now - last)
        last = now if received is not None else last
    return longest


@pytest.mark.parametrize("sensor", ["ati_netcanoem", "robotous_rft", "iit_strain"])
def test_a_check_of_another_folder_leaves_the_wire_alone(tmp_path, sensor):
    """`check` with the same wires and another --dir: it says who has the wire, and the samples flow on."""
    with virtual_robot(sensor=sensor) as robot, daemon_on(robot, tmp_path, sensor) as (addresses, environ):
        command = [sys.executable, "-m", "galen_hw.cli", "check", "--json", "--config", str(tmp_path / "galen.toml")]
        with Subscriber(addresses.bus, ["wrench/raw"]) as bus:
            assert bus.receive(5.0) is not None
            check = subprocess.Popen(
                [*command, "--dir", str(tmp_path / "other")], env=environ, text=True, stdout=subprocess.PIPE
            )
            silence = longest_silence(bus, 30.0, until=lambda: check.poll() is not None)
            assert silence < 1.0
            assert longest_silence(bus, 1.0) < 1.0
        tree = json.loads(check.communicate()[0])
        (devices,) = [f for f in tree["below"] if f["name"] == "devices"]
        (port,) = [f for f in devices["below"][0]["below"] if f["name"] == "port"]
        assert port["state"] == "problem"
        assert "in use by process" in port["text"]
        assert check.returncode == 3
        assert robot.control.state()["counters"]["can0"]["refused"] == 0


@pytest.mark.parametrize("sensor", ["ati_netcanoem", "robotous_rft", "iit_strain"])
def test_a_channel_that_is_closed_behind_our_back_is_opened_again(tmp_path, sensor):
    """Another program writes `C`, three times: samples again within 2 s, and the sensor's zero is kept."""
    with virtual_robot(sensor=sensor) as robot, daemon_on(robot, tmp_path, sensor) as (addresses, _):
        with CommandClient(addresses.command) as client:
            client.call("ft", "zero", {"samples": 50}, timeout_s=20.0)
        with Subscriber(addresses.bus, ["wrench/raw"]) as bus:
            for _ in range(3):
                assert bus.receive(5.0) is not None
                intruder = os.open(robot.addresses["can0"]["channel"], os.O_RDWR | os.O_NOCTTY)
                os.write(intruder, b"C\r")
                os.close(intruder)
                assert 0.2 < longest_silence(bus, 2.0) < 2.0, "it was cut, and mended"
                bus.receive(0.0)
            assert bus.receive(2.0)[1].zeroings == 1


@pytest.mark.parametrize("make", [SerialTransport, CanTransport])
def test_a_port_has_one_user_by_any_name(tmp_path, make):
    """A second opening by another name of the port is refused before a byte is written, and says who has it."""
    with virtual_robot() as robot:
        path, other = robot.addresses["can0"]["channel"], tmp_path / "by-id"
        other.symlink_to(os.path.realpath(path))
        first = CanTransport(CanTransport.Settings(interface="slcan", channel=path))
        first.open()
        keys = {"url": str(other)} if make is SerialTransport else {"interface": "slcan", "channel": str(other)}
        second = make(make.Settings(**keys))
        with pytest.raises(HardwareError, match=f"in use by process {os.getpid()}"):
            second.open()
        first.close()
        second.open()
        second.close()
        assert robot.control.state()["counters"]["can0"]["refused"] == 0


def test_claims_are_shared_or_not_and_end_with_their_process():
    """Sharers go together; who wants it alone is refused while anybody is there; a killed process leaves nothing."""
    key = f"test:{os.getpid()}:{'x' * 80}"
    with Claim(key, "can0", shared=True), Claim(key, "can0", shared=True):
        assert users(key) == [os.getpid()]
        with pytest.raises(HardwareError, match="can0: in use by process"):
            Claim(key, "can0", shared=True, alone=True)
    code = (
        "import sys; from galen_hw.drivers.wire_claim import Claim\n"
        "claim = Claim(sys.argv[1], 'can0'); print('have it', flush=True); sys.stdin.read()"
    )
    other = subprocess.Popen(
        [sys.executable, "-c", code, key], text=True, stdin=subprocess.PIPE, stdout=subprocess.PIPE
    )
    assert other.stdout.readline() == "have it\n"
    with pytest.raises(HardwareError, match=rf"in use by process {other.pid} \(.*python"):
        Claim(key, "can0")
    other.kill()
    other.communicate()
    with Claim(key, "can0"):
        assert users(key) == [os.getpid()]
    assert users(key) == []

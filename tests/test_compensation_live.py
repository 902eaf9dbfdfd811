"""End to end, over ptys and ZeroMQ: the virtual robot is led by hand, recorded, and the recording is repeated."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from galen_hw.bus import CommandClient, Subscriber
from galen_hw.cli import main
from galen_hw.config.tool_store import ToolStore
from galen_hw.daemon.session import own_daemon
from galen_hw.drivers.virtual.control import VirtualControl
from galen_hw.recording import read_recording
from galen_hw.recording.mcap_reader import McapFile
from tests.test_admittance import calibrated

# Paces and patience with which a machine that is starved of processor time still loses nothing.
CONFIG = """
[devices.ft]
driver = "ati_netcanoem"
transport = { interface = "socketcan", channel = "can0", bitrate = 1000000 }
settings = { rate_hz = 250.0, reply_timeout_s = 0.2 }
[devices.motors]
driver = "galil_dmc"
transport = { url = "/dev/serial/by-id/usb-FTDI_FT232R_USB_UART_A1B2C3D4-if00-port0", baud_rate = 115200 }
settings = { rate_hz = 50.0, reply_timeout_s = 2.0, servo_timeout_s = 1.0 }
[services.compensation]
max_extrapolation_s = 0.5
tare_timeout_s = 8.0
[services.admittance]
[bus]
viewers = ""
[daemon]
blind_after_s = 2.0
"""


pytestmark = pytest.mark.live


def listen(subscriber: Subscriber, seconds: float) -> list[tuple[str, object]]:
    """What is published until the sensor's own clock has gone on by so long."""
    found: list[tuple[str, object]] = []
    begin = None
    while received := subscriber.receive(5.0):
        found.append(received)
        begin = begin or received[1].t_ns
        if received[1].t_ns - begin > seconds * 1e9:
            return found
    raise AssertionError("the bus fell silent")


@pytest.mark.slow
def test_led_by_hand_recorded_and_repeated(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Without compensation the tool drifts by a centimetre or more after it is let go, with it by nothing; and the recording of
    all that, ended by SIGKILL, gives the same compensated wrench bit for bit."""
    (tmp_path / "galen.toml").write_text(CONFIG)
    ToolStore(tmp_path / "state").save(calibrated().on_virtual())
    config, file = str(tmp_path / "galen.toml"), tmp_path / "run.mcap"
    moved = {}
    with own_daemon(config=config, state=tmp_path / "state") as addresses:
        words = ["record", "-o", str(file), "--dir", str(addresses.runtime), "--config", config]
        recorder = subprocess.Popen([sys.executable, "-m", "galen_hw.cli", *words])
        try:
            with (
                CommandClient(addresses.command) as client,
                Subscriber(addresses.bus, ["wrench/raw"]) as wire,
                VirtualControl(addresses.virtual) as world,
            ):
                client.call("ft", "zero", {"samples": 100}, timeout_s=30.0)
                world.attach_tool("retractor")
                client.call("motors", "enable")
                client.call("compensation", "select_tool", {"tool": "retractor"})
                for enabled in (True, False):
                    client.call("compensation", "set_enabled", {"enabled": enabled})
                    client.call("compensation", "tare")
                    listen(wire, 0.5)
                    client.call("admittance", "set_enabled", {"enabled": True})
                    world.guide(turn=(0.7, 0.45, 0.0), move_s=1.5, seconds=2.5)
                    listen(wire, 4.5)
                    before = np.array(world.call("state")["tip_pose"])
                    listen(wire, 2.0)
                    moved[enabled] = np.linalg.norm((np.array(world.call("state")["tip_pose"]) - before)[:3, 3])
                    client.call("admittance", "set_enabled", {"enabled": False})
                    if enabled:
                        client.call("motors", "move_jp", {"position": {"roll": 0.0, "tilt": 0.0}})
                        listen(wire, 4.0)
        finally:
            recorder.kill()
            recorder.wait()
    faults = [item.message for item in McapFile(file, frozenset({"fault"}))]
    assert moved[True] < 5e-4
    assert moved[False] > 0.01, faults  # a limit may stop it on a busy machine, where it goes on for longer
    assert main(["replay", str(file), "--verify"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[-1].endswith("samples are equal, bit for bit")
    assert int(lines[-1].split()[0]) > 1000
    recording = read_recording(file)
    assert recording.info.tool is not None
    assert recording.info.tool.name == "retractor"
    assert recording.info.virtual
    assert recording.info.sensor_serial
    assert np.nanmax(recording.columns["joint.roll.position"]) > 0.5

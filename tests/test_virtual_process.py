"""The virtual robot as a process, end to end: real ptys, real ZeroMQ, python-can's own slcan bus as the client."""

import importlib.util
import os
import signal
import struct
import subprocess
import sys
import time
from pathlib import Path

import can
import msgspec
import numpy as np
import pytest
import serial
import zmq

from galen_hw.drivers.table import VIRTUAL_DEVICES
from galen_hw.drivers.virtual.ati_netcanoem import AtiSettings, VirtualAtiNetcanoem
from galen_hw.drivers.virtual.commands import Commands
from galen_hw.drivers.virtual.control import VirtualControl
from galen_hw.drivers.virtual.iit_strain import VirtualIitStrain
from galen_hw.drivers.virtual.robotous_rft import VirtualRobotousRft
from galen_hw.drivers.virtual.start import start_virtual, virtual_robot
from galen_hw.drivers.virtual.world import World
from galen_hw.errors import HardwareError, UsageError
from tests.virtual_client import ask, open_bus


@pytest.fixture(scope="module")
def robot():
    with virtual_robot(tool="retractor", seed=3) as running:
        yield running


def until(condition, seconds=5.0):
    deadline = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < deadline, "it did not happen in time"
    return True


def weight_along_z(bus):
    """Fz in N of one sample, gauge offsets included, decoded from manual table 4.2 and chapter 10."""
    row = struct.unpack(">6f", b"".join(d for _, d in ask(bus, 0x202, b"\x02", 3)))
    total = 0.0
    for _ in range(20):
        (_, a), (_, b) = ask(bus, 0x200, replies=2)
        _, g0, g2, g4 = struct.unpack(">Hhhh", a)
        g1, g3, g5 = struct.unpack(">hhh", b)
        total += float(np.dot(row, (g0, g1, g2, g3, g4, g5))) / 1e6
    return total / 20


def test_python_cans_own_slcan_bus_reads_a_sample(robot):
    """Open the adapter, read the firmware, and weigh the tool: taking it off changes Fz by 0.287 kg x g."""
    with open_bus(robot) as bus:
        assert ask(bus, 0x20F) == [(0x20F, bytes.fromhex("0308000C"))]
        loaded = weight_along_z(bus)
        robot.control.attach_tool(None)
        empty = weight_along_z(bus)
    robot.control.attach_tool("retractor")
    assert loaded - empty == pytest.approx(-0.287 * 9.80665, abs=0.03)


def test_a_client_may_close_and_come_back(robot):
    """Three clients one after the other on the same link."""
    for _ in range(3):
        with open_bus(robot) as bus:
            assert ask(bus, 0x205) == [(0x205, b"FT28417\x00")]


def test_the_wrong_bit_rate_hears_nothing(robot):
    """At 500 kbit/s on a bus of 1 Mbit/s there is no answer."""
    address = {**robot.addresses["can0"], "bitrate": 500_000}
    with can.Bus(**address, sleep_after_open=0) as bus:
        bus.send(can.Message(arbitration_id=0x205, is_extended_id=False))
        assert bus.recv(0.1) is None


@pytest.mark.parametrize(
    "frames", [[b"\x81\xa2do\xa1\xff"], [b"\x91" * 1000 + b"\xc0"], [b"\xc1"], [b"", b"", b"x"], [b""]]
)
def test_no_frame_ends_the_virtual_robot(robot, frames):
    """Text that is not UTF-8, deep nesting, nonsense, several frames: refused in words, and the next request is answered."""
    with zmq.Context.instance().socket(zmq.REQ) as client:
        client.setsockopt(zmq.LINGER, 0)
        client.connect(f"ipc://{robot.folder / 'control'}")
        client.send_multipart(frames)
        assert client.poll(10_000)
        assert b"error" in client.recv()
    assert robot.control.state()["load"]


def test_the_control_socket_changes_the_world(robot):
    """Push, guide, drift, cable, thermal, compliance, noise, fault, estop, contact, power cycle; state tells."""
    control = robot.control
    rest = np.array(control.state()["load"])
    control.push(force=[0, 0, -5.0], seconds=60.0)
    assert np.array(control.state()["load"])[2] - rest[2] == pytest.approx(-5.0, abs=1e-6)
    control.release()
    assert np.array(control.state()["load"]) == pytest.approx(rest)
    control.guide(by=[0.0, 0.0, 0.01], move_s=0.01, seconds=30.0)
    assert until(lambda: control.state()["load"][2] - rest[2] > 2.9)
    control.release()
    control.contact([0, 0, -0.1])
    control.contact(None)
    control.drift(rate=[0.1] * 6)
    control.drift()
    control.cable(anchor=[0, 0, 1.0], attached=[0, 0, 0], stiffness=5.0)
    assert control.state()["load"][2] > rest[2]
    control.cable()
    control.thermal(start_c=30.0)
    assert control.state()["temperature"] == 30.0
    control.thermal()
    control.compliance(structure=[1e-5] * 6)
    assert control.state()["tip_pose"][2][3] < -0.06
    control.compliance()
    control.noise(scale=0.0)
    control.noise()
    control.fault("ft.sticky_can_error")
    control.estop()
    control.fault("motors.blocked.roll")
    assert control.state()["faults"] == ["elo", "ft.sticky_can_error", "motors.blocked.roll"]
    control.fault("motors.blocked.roll", on=False)
    control.fault("ft.sticky_can_error", on=False)
    control.estop(on=False)
    control.power_cycle("can0")
    assert np.array(control.state()["load"]) == pytest.approx(rest)


@pytest.mark.parametrize(
    "request_",
    [
        {"do": "dance"}, {"do": "attach_tool", "tool": "scalpel"}, {"do": "attach_tool"}, 17, None, [],
        {"do": "push", "force": [1, 2]}, {"do": "push", "force": ["a", "b", "c"]}, {"do": "push", "colour": 1},
        {"do": "guide", "weight": 3.0}, {"do": "drift", "rate": [float("nan")] * 6}, {"do": "cable", "stiffness": 1.0},
        {"do": "drift", "speed": [0.0] * 6}, {"do": "compliance", "joint": [0.0]}, {"do": "noise", "scale": "loud"},
        {"do": "fault", "name": "ft.nonsense"}, {"do": "power_cycle", "device": "kettle"},
    ],
)  # fmt: skip
def test_a_wrong_request_is_one_line_and_changes_nothing(request_):
    """Every refusal names what is wrong; the world is as it was."""
    world = World()
    device = VirtualAtiNetcanoem(AtiSettings(), world)
    commands = Commands(world, {"can0": device}, {}, lambda: 5)
    before = (world.tool, world.drift, world.cable, world.compliance, set(world.faults), world.hand.idle)
    reply = commands.carry_out(request_)
    assert set(reply) == {"error"}
    assert "\n" not in reply["error"]
    assert (world.tool, world.drift, world.cable, world.compliance, set(world.faults), world.hand.idle) == before


def test_garbage_on_the_control_socket_is_answered(robot):
    """Bytes that are no msgpack get an error, and the process lives on."""
    with zmq.Context() as context, context.socket(zmq.REQ) as socket:
        socket.connect(robot.addresses["control"]["url"])
        socket.send(b"\xc1garbage")
        assert socket.poll(2000)
        assert "error" in msgspec.msgpack.decode(socket.recv())
    assert robot.control.state()["seed"] == 3


def test_a_second_one_in_the_same_folder_is_refused_in_one_line(robot):
    """It names the process that runs and says what to do; the first one is not disturbed."""
    with pytest.raises(HardwareError, match=f"runs here already \\(process {robot.pid}\\)"):
        start_virtual(robot.folder)
    assert robot.control.state()["tool"] == "retractor"


def run_cli(*words):
    command = [sys.executable, "-m", "galen_hw.cli", "virtual", *words]
    return subprocess.run(command, capture_output=True, text=True, check=False)


@pytest.mark.parametrize(
    ("words", "status", "says"),
    [
        (["--sensor", "scales"], 2, "no virtual sensor 'scales'; one of: ati_netcanoem, robotous_rft, iit_strain\n"),
        (["--sensor", "galil_dmc"], 2, "no virtual sensor 'galil_dmc'"),
        (["--can", "pigeon"], 2, "one of: slcan"),
        (["--settings", "{"], 2, "not JSON"),
        (["--settings", '{"ati_netcanoem": {"base_id": 300}}'], 2, "base_id"),
        (["--tool", "scalpel"], 2, "pointer"),
        (["--can", "socketcan", "--channel", "nonesuch0"], 3, "vcan0"),
        (["--can", "socketcand", "--channel", "localhost:99999"], 3, "another port"),
    ],
)
def test_wrong_options_end_in_one_line(tmp_path, words, status, says):
    """What, where and what to do; exit status 2 for wrong use, 3 for hardware; nothing is left in the folder."""
    done = run_cli("--dir", str(tmp_path), *words)
    assert done.returncode == status, done.stderr
    assert says in done.stderr
    assert done.stderr.count("\n") == 1
    assert {p.name for p in tmp_path.iterdir()} <= {"lock"}


def test_a_path_too_long_for_a_socket_is_said(tmp_path):
    """Unix sockets end at 107 bytes."""
    done = run_cli("--dir", str(tmp_path / ("x" * 110)))
    assert done.returncode == 2
    assert "too long for a socket" in done.stderr


def test_a_talkative_one_is_not_blocked_by_a_full_pipe(monkeypatch):
    """The interpreter's own log of imports fills any pipe (64 KiB) before it is ready; it starts, serves, and is heard."""
    monkeypatch.setenv("PYTHONVERBOSE", "1")
    with virtual_robot() as robot:
        with open_bus(robot) as bus:
            assert ask(bus, 0x205) == [(0x205, b"FT28417\x00")]
        assert len(robot.said) > 65536


def test_sigterm_cleans_up_and_a_crash_does_not_block_the_next_start(tmp_path):
    """After SIGTERM only the lock file stays; after SIGKILL the links are stale, and a new start replaces them."""
    robot = start_virtual(tmp_path)
    os.kill(robot.pid, signal.SIGKILL)
    assert until(lambda: not robot.alive)
    robot.close()
    assert (tmp_path / "can0").is_symlink()
    again = start_virtual(tmp_path)
    with open_bus(again) as bus:
        assert ask(bus, 0x205) == [(0x205, b"FT28417\x00")]
    again.close()
    assert [p.name for p in tmp_path.iterdir()] == ["lock"]
    with pytest.raises(HardwareError, match="no answer"):
        VirtualControl(tmp_path, timeout_s=0.1).state()


def test_it_ends_with_its_parent(tmp_path):
    """A parent that is killed cannot say goodbye; the virtual robot notices by itself and cleans up."""
    script = "import sys, time; from galen_hw.drivers.virtual.start import start_virtual as s; "
    script += "print(s(sys.argv[1]).pid, flush=True); time.sleep(60)"
    parent = subprocess.Popen([sys.executable, "-c", script, str(tmp_path)], stdout=subprocess.PIPE, text=True)
    assert parent.stdout is not None
    assert int(parent.stdout.readline())
    parent.kill()
    parent.wait()
    parent.stdout.close()
    assert until(lambda: [p.name for p in tmp_path.iterdir()] == ["lock"])


def test_settings_reach_the_device():
    """A base identifier of 0x7F from the command line's JSON."""
    with virtual_robot(settings={"ati_netcanoem": {"base_id": 0x7F}}) as robot, open_bus(robot) as bus:
        assert ask(bus, 0x7F5) == [(0x7F5, b"FT28417\x00")]


def test_it_has_a_wire_for_every_virtual_device_there_is(robot):
    """Sensor, motors and tracker, each behind its link; the motors answer ^R^V with their model."""
    built = {row for row, path in VIRTUAL_DEVICES.items() if importlib.util.find_spec(path.partition(":")[0])}
    wires = {"can0"} | {w for w, row in {"motors": "galil_dmc", "tracker": "ndi_tracker"}.items() if row in built}
    assert set(robot.addresses) == wires | {"control"}
    with serial.Serial(robot.addresses["motors"]["url"], 115200, timeout=2.0, exclusive=True) as motors:
        motors.write(b"\x12\x16")
        assert b"DMC4153" in motors.read_until(b":")


def test_bad_control_answers_are_usage_errors(robot):
    """The client raises what the server refused."""
    with pytest.raises(UsageError, match="scalpel"):
        robot.control.attach_tool("scalpel")


def test_the_manual_names_every_fault_and_every_word():
    """docs/virtual.md has a row for each fault of each device and each word of the control socket."""
    text = (Path(__file__).parents[1] / "docs" / "virtual.md").read_text()
    sensors = (VirtualAtiNetcanoem, VirtualRobotousRft, VirtualIitStrain)
    known = {*(fault for sensor in sensors for fault in sensor.FAULTS), *Commands(World(), {}, {}, int).known_faults()}
    words = {f"| `{word}` |" for word in Commands(World(), {}, {}, int)._words}
    assert {name for name in known if name not in text} == set()
    assert {word for word in words if word not in text} == set()

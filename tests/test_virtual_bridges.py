"""The other ways to the virtual sensor: streaming, socketcand, multicast, and python-can's `virtual` in one process."""

import can
import pytest

from galen_hw.drivers.virtual.ati_netcanoem import AtiSettings, VirtualAtiNetcanoem
from galen_hw.drivers.virtual.library_bus import InProcessCan
from galen_hw.drivers.virtual.start import virtual_robot
from galen_hw.drivers.virtual.world import World
from tests.virtual_client import ask, open_bus


def test_the_robotous_sensor_streams_over_the_adapter():
    """Start the output at 1 kHz: pairs of frames flow, about a thousand in a second, in order."""
    with virtual_robot(sensor="robotous_rft") as robot, open_bus(robot) as bus:
        assert ask(bus, 0x64, b"\x0f\x08" + bytes(6), 2)[0] == (0x01, bytes.fromhex("0F01000000000000"))
        ask(bus, 0x64, b"\x0b" + bytes(7), 0)
        frames = [bus.recv(1.0) for _ in range(400)]
        ask(bus, 0x64, b"\x0c" + bytes(7), 0)
    assert [f.arbitration_id for f in frames] == [0x01, 0x02] * 200
    assert {f.data[0] for f in frames[::2]} == {0x0B}
    assert frames[-1].timestamp - frames[0].timestamp < 1.0


def test_a_socketcand_client_reads_a_sample():
    """python-can's own socketcand bus, as over a network."""
    with virtual_robot(can="socketcand") as robot, can.Bus(**robot.addresses["can0"]) as bus:
        assert [i for i, _ in ask(bus, 0x200, replies=2)] == [0x200, 0x201]
        assert ask(bus, 0x20D, b"\x20") == [(0x20D, b"")], "a frame without data must not be lost"
        assert robot.control.state()["counters"]["can0"]["refused"] == 0


def test_a_multicast_node_does_not_answer_itself():
    """A sender hears its own frames there; an echoed index of opcode 6 must not become a request."""
    try:
        with can.Bus(interface="udp_multicast", channel="239.74.163.2") as probe:
            probe.send(can.Message(arbitration_id=1, is_extended_id=False))
            heard = probe.recv(0.5)
    except (can.CanError, OSError):
        heard = None
    if heard is None:
        pytest.skip("no multicast here")
    with virtual_robot(can="udp_multicast") as robot, can.Bus(interface="udp_multicast", channel="239.74.163.2") as bus:
        for _ in range(3):
            assert ask(bus, 0x206, b"\x01", 2) == [(0x206, b"\x01")] * 2, "our own frame, and one answer"
        assert robot.control.state()["counters"]["can0"]["requests"] == 3


def test_the_virtual_interface_serves_one_process():
    """A thread of this process is the node; no pty, no second process."""
    device = VirtualAtiNetcanoem(AtiSettings(), World())
    with (
        InProcessCan(device, "test_virtual_process"),
        can.Bus(interface="virtual", channel="test_virtual_process") as bus,
    ):
        assert [i for i, _ in ask(bus, 0x200, replies=2)] == [0x200, 0x201]

"""The real tracker driver against the virtual tracker, byte for byte at line speed, in simulated time."""

import numpy as np
import pytest

from galen_hw.drivers.ndi_tracker import NdiTracker
from galen_hw.drivers.virtual.ndi_tracker import VirtualNdiTracker
from galen_hw.drivers.virtual.ndi_tracker.scene import REFERENCE, TOOL
from galen_hw.drivers.virtual.world import World
from tests.pty_peer import rom
from tests.serial_pair import TIME_BASE, Pair

MARKERS = {role: {"rom_file": rom(role)} for role in ("tool", "reference")}


def place(message):
    p = message.position
    return np.array([p.x, p.y, p.z])


@pytest.fixture(params=["BX", "TX"])
def pair(request):
    world = World()
    driver = NdiTracker("tracker", NdiTracker.Settings(reply=request.param, markers=MARKERS), TIME_BASE)
    pair = Pair(driver, VirtualNdiTracker(VirtualNdiTracker.Settings(), world))
    pair.world = world
    assert pair.run(15.0, lambda: driver.ready), pair.said
    pair.ready_ns = pair.now_ns
    return pair


def test_it_connects_and_every_frame_arrives(pair):
    """From power-up to 60 frames a second of both markers, where the scene has them."""
    pair.run(0.5)
    before = len(pair.of("tracker/tool"))
    pair.run(2.0)
    frames = [m.frame for m in pair.of("tracker/tool")[before:]]

    assert 118 <= len(frames) <= 122
    assert set(np.diff(frames)) == {1}
    for topic, marker in (("tracker/tool", TOOL), ("tracker/reference", REFERENCE)):
        got = np.mean([place(m) for m in pair.of(topic)[before:]], axis=0)
        expected = pair.device.session.scene._pose(marker, 0)[:3, 3]
        np.testing.assert_allclose(got, expected, atol=4e-5)
    assert not [fault for fault in pair.of("fault") if fault.t_ns > pair.ready_ns]


def test_what_goes_missing_is_said(pair):
    """A hidden marker is missing with its handle, and is back when it is seen again."""
    pair.world.faults.add("tracker.missing")
    pair.run(0.3)
    assert pair.of("tracker/tool")[-1].missing
    assert not pair.of("tracker/reference")[-1].missing
    pair.world.faults.discard("tracker.missing")
    pair.run(0.3)
    assert not pair.of("tracker/tool")[-1].missing


def test_it_comes_back_after_a_restart_of_the_tracker(pair):
    """RESET in the middle of tracking: the driver sets it up again by itself."""
    pair.world.faults.add("tracker.restart")
    pair.run(0.3)
    count = len(pair.of("tracker/tool"))
    assert pair.run(30.0, lambda: len(pair.of("tracker/tool")) > count + 30)


def test_without_a_definition_it_refuses_as_a_real_tracker_does():
    """A passive body has no memory of its own: one fault says which body and what to set, and nothing is tracked."""
    driver = NdiTracker("tracker", NdiTracker.Settings(markers={"tool": MARKERS["tool"], "reference": {}}), TIME_BASE)
    pair = Pair(driver, VirtualNdiTracker(VirtualNdiTracker.Settings(), World()))
    assert not pair.run(10.0, lambda: driver.ready)
    fault = pair.of("fault")[-1]
    assert fault.what == "reference: a wireless marker body needs its tool definition (.rom)"
    assert "rom_file" in fault.todo
    assert not pair.of("tracker/tool")


def test_a_damaged_definition_is_refused_by_the_tracker(tmp_path):
    """One bit of the geometry flipped: PINIT fails, and the fault names the body."""
    damaged = bytearray(rom("tool").read_bytes())
    damaged[84] ^= 0x10
    (tmp_path / "bad.rom").write_bytes(damaged)
    markers = {"tool": {"rom_file": tmp_path / "bad.rom"}}
    driver = NdiTracker("tracker", NdiTracker.Settings(markers=markers), TIME_BASE)
    pair = Pair(driver, VirtualNdiTracker(VirtualNdiTracker.Settings(), World()))
    assert not pair.run(10.0, lambda: driver.ready)
    assert pair.of("fault")[-1].what == "tool: PINIT refused with error 13: port could not be initialised"

"""The virtual STRAIN board against the maker's frames: decoded here by hand."""

import json
import struct
import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parent))

from conformance.peer import virtual_run
from paired_peer import ask as ask_driver
from paired_peer import force, wrenches

from galen_hw.clock import NS_PER_S
from galen_hw.drivers.device import CanFrame
from galen_hw.drivers.iit_strain import IitStrain
from galen_hw.drivers.virtual.iit_strain import NEVER_NS, StrainSettings, VirtualIitStrain
from galen_hw.drivers.virtual.world import World

T0 = NS_PER_S
MS = 1_000_000
VECTORS = json.loads((Path(__file__).parent / "vectors" / "iit_strain.json").read_text())["frames"]
SCALES = np.array(StrainSettings().full_scales) / 0x8000


def sensor(**settings):
    world = World(seed=1)
    world.noise_scale = 0.0
    world.attach("retractor")
    return VirtualIitStrain(StrainSettings(**settings), world), world


def ask(device, *data, t=T0):
    device.feed(CanFrame(0x201, bytes(data)), t)
    return device.poll(t)


def wrench(frames):
    return (np.concatenate([struct.unpack("<3H", frame.data[:6]) for frame in frames]) - 0x8000) * SCALES


def test_a_sample_is_the_load_and_the_offset_in_parts_of_the_full_scale():
    """Force, then torque, to half a count; six bytes each."""
    device, world = sensor()
    frames = ask(device, 0x07, 0)
    assert [(f.arbitration_id, len(f.data)) for f in frames] == [(0x31A, 6), (0x31B, 6)]
    error = wrench(frames) - world.load(T0) - StrainSettings().offset
    assert (np.abs(error) <= 0.5001 * SCALES).all()


def test_every_command_of_the_vector_table_is_understood():
    """Those with an answer are answered, by their own number, and the rest in silence."""
    for vector in (v for v in VECTORS if v["to"] == "device"):
        device, _ = sensor()
        data = bytes.fromhex(vector["frames"][0]["data"])
        replies = ask(device, *data)
        if vector["command"].startswith("GET"):
            assert [(f.arbitration_id, f.data[0]) for f in replies] == [(0x210, data[0])]
        assert (device.counters["commands"], device.counters["ignored"]) == (1, 0)


def test_answers_of_the_vector_table_are_what_it_sends():
    """Full scales, serial number and firmware, byte for byte; protocol 2.0 is not the 1.0 that was asked for."""
    device, _ = sensor()
    table = {v["what"]: v["frames"][0]["data"] for v in VECTORS if v["to"] == "host"}
    assert ask(device, 0x18, 0)[0].data.hex().upper() == table["full scale of channel 0: 1500 N"]
    assert ask(device, 0x18, 5)[0].data.hex().upper() == table["full scale of channel 5: 25 N m"]
    assert ask(device, 0x1A)[0].data.hex().upper() == table["serial number of five characters"]
    firmware = table["STRAIN2, firmware 2.0.7, protocol 2.0"]
    assert ask(device, 0x1C, 2, 0)[0].data.hex().upper() == firmware
    assert ask(device, 0x1C, 1, 0)[0].data.hex().upper() == firmware[:-2] + "00"


@pytest.mark.parametrize("period_ms", [1, 2, 10, 100, 255])
def test_the_stream_has_the_period_it_was_given(period_ms):
    """A second of output, the first sample at once; then stop, which answers nothing."""
    device, _ = sensor()
    assert ask(device, 0x08, period_ms) == []
    ask(device, 0x07, 0)
    times = [T0]
    while (t := device.wakeup_ns) < T0 + NS_PER_S:
        assert len(device.poll(t)) == 2
        times.append(t)
    assert set(np.diff(times)) <= {period_ms * MS}
    assert ask(device, 0x07, 1, t=T0 + NS_PER_S - 1) == []
    assert device.wakeup_ns == NEVER_NS


def test_the_boards_own_tare_is_lost_with_the_power_and_so_are_stream_and_period():
    """Tared it reads nought; after a power cycle it is idle, at its own period, and reads all again."""
    device, _ = sensor()
    whole = wrench(ask(device, 0x07, 0))
    ask(device, 0x15, 1, t=T0 + 1)
    assert (np.abs(wrench(device.poll(device.wakeup_ns))) <= SCALES).all()
    device.power_cycle(T0 + NS_PER_S)
    assert device.poll(T0 + 2 * NS_PER_S) == []
    np.testing.assert_allclose(wrench(ask(device, 0x07, 0, t=T0 + 2 * NS_PER_S)), whole, atol=1e-9)


def test_a_limited_channel_repeats_the_last_good_sample_and_says_so():
    """Seven bytes in both frames; two bits a channel, 2 is high."""
    device, world = sensor()
    good = ask(device, 0x07, 0)
    world.faults.add("ft.saturated.4")
    world.attach(None)
    frames = device.poll(device.wakeup_ns)
    assert [f.data[:6] for f in frames] == [f.data for f in good]
    assert [f.data[6] for f in frames] == [0b1, 0b100001]


def test_the_hosts_zero_outlives_the_boards_power():
    """The virtual board off and on: the driver starts it anew, and its samples bear the same zero."""
    device, world = sensor()
    run = virtual_run(IitStrain, device, world).seconds(1.0)
    ask_driver(run, "zero", samples=20)
    run.seconds(0.5)
    assert run.replies[-1].error is None
    device.power_cycle(run.now_ns)
    run.seconds(3.0)
    assert run.device.ready
    assert wrenches(run)[-1].zeroings == 1
    assert (np.abs(force(wrenches(run)[-1])) <= 2 * SCALES).all()

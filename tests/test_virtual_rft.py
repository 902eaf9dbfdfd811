"""The virtual Robotous sensor against the RFT manual 1.7, chapter 3: decoded here by hand."""

import json
import struct
from pathlib import Path

import numpy as np
import pytest

from galen_hw.clock import NS_PER_S
from galen_hw.drivers.device import CanFrame
from galen_hw.drivers.virtual.robotous_rft import NEVER_NS, RftSettings, VirtualRobotousRft
from galen_hw.drivers.virtual.world import World

T0 = NS_PER_S
MS = 1_000_000
VECTORS = json.loads((Path(__file__).parent / "vectors" / "robotous_rft.json").read_text())["frames"]
OFFSET = np.array(RftSettings().offset)


def sensor(**settings):
    world = World(seed=1)
    world.noise_scale = 0.0
    world.attach("retractor")
    return VirtualRobotousRft(RftSettings(**settings), world), world


def ask(device, *data, t=T0, receiver=0x64):
    device.feed(CanFrame(receiver, bytes(data).ljust(8, b"\x00")), t)
    return device.poll(t)


def answer(device, *data, t=T0):
    """R1..R15 of a response: two frames on the two transmitters, the command's id first."""
    first, second = ask(device, *data, t=t)
    assert (first.arbitration_id, second.arbitration_id) == (0x01, 0x02)
    assert len(first.data) == len(second.data) == 8
    assert first.data[0] == data[0]
    return first.data[1:] + second.data


def wrench(parameters):
    return np.array(struct.unpack(">6h", parameters[:12])) / np.repeat([50.0, 2000.0], 3)


def test_a_single_reading_is_the_load_and_the_sensors_offset_in_counts():
    """Force / 50 N, torque / 2000 N m, to half a count."""
    device, world = sensor()
    measured = wrench(answer(device, 0x0A))
    assert (np.abs(measured - world.load(T0) - OFFSET) <= 0.5001 / np.repeat([50.0, 2000.0], 3)).all()


def test_bias_is_kept_in_the_device_and_answers_nothing():
    """After bias a reading is zero, after a change of tool the difference, after un-bias the whole again."""
    device, world = sensor()
    whole = answer(device, 0x0A)
    assert ask(device, 0x11, 1) == []
    assert not wrench(answer(device, 0x0A)).any()
    loaded = world.load(T0)
    world.attach(None)
    np.testing.assert_allclose(wrench(answer(device, 0x0A)), world.load(T0) - loaded, atol=0.011)
    world.attach("retractor")
    ask(device, 0x11, 0)
    assert answer(device, 0x0A) == whole


@pytest.mark.parametrize(("code", "rate"), list(enumerate([200, 10, 20, 50, 100, 200, 333, 500, 1000])))
def test_the_stream_has_the_rate_of_its_code(code, rate):
    """One second of output at each code, the first sample at once; then stop, which answers nothing."""
    device, _ = sensor()
    assert answer(device, 0x0F, code)[:2] == b"\x01\x00"
    assert answer(device, 0x10)[0] == code
    ask(device, 0x0B)
    t, times = T0, [T0]
    while (t := device.wakeup_ns) < T0 + NS_PER_S:
        frames = device.poll(t)
        assert [f.data[0] for f in frames[:1]] == [0x0B]
        times.append(t)
    assert abs(len(times) - rate) <= 1
    assert ask(device, 0x0C, t=t - 1) == []
    assert device.wakeup_ns == NEVER_NS


def test_only_stop_and_bias_work_while_it_streams():
    """Every other command is ignored without an answer until the stream is stopped."""
    device, _ = sensor()
    ask(device, 0x0B)
    for command in (*range(0x01, 0x0B), 0x0F, 0x10, 0x12, 0x55):
        assert ask(device, command, 1, 2, 3, t=T0 + 1) == []
    ask(device, 0x11, 1, t=T0 + 2)
    frames = device.poll(device.wakeup_ns)
    assert not wrench(frames[0].data[1:] + frames[1].data).any()
    ask(device, 0x0C, t=T0 + 6 * MS)
    assert answer(device, 0x01)[:10] == b"RFT60-HA01"


def test_every_command_of_the_vector_table_is_understood():
    """All but start, stop and bias are answered, by their own id."""
    for vector in (v for v in VECTORS if v["to"] == "device"):
        device, _ = sensor()
        frame = vector["frames"][0]
        device.feed(CanFrame(int(frame["id"], 16), bytes.fromhex(frame["data"])), T0)
        replies = device.poll(T0)
        assert len(replies) == (0 if vector["command"] in {"STOP_OUTPUT", "SET_BIAS"} else 2), vector["what"]
        assert device.counters["commands"] == 1


def test_responses_of_the_vector_table_are_what_it_sends():
    """Model name, a stored setting, a refusal, a failure and an unsupported command, byte for byte."""
    device, world = sensor(max_rate_hz=200)
    table = {v["what"]: [(int(f["id"], 16), f["data"]) for f in v["frames"]] for v in VECTORS if v["to"] == "host"}

    def sent(*data):
        return [(f.arbitration_id, f.data.hex().upper()) for f in ask(device, *data)]

    assert sent(0x01) == table["model name"]
    assert sent(0x0F, 5) == table["setting accepted"]
    assert sent(0x0F, 8) == table["setting refused"], "an RFT40 does not stream faster than 200 Hz"
    world.faults.add("ft.set_fails")
    assert sent(0x08, 1, 3) == table["setting failed"]
    unsupported = [(i, "0D" + d[2:] if i == 1 else d) for i, d in table["unsupported command"]]
    assert sent(0x0D) == unsupported


def test_settings_out_of_range_are_refused_and_change_nothing():
    """Filter, rate, baud rate and identifiers each answer 0 and error 2."""
    device, _ = sensor()
    for bad in ((0x08, 2, 0), (0x08, 1, 15), (0x0F, 9), (0x06, 5), (0x04, 0, 1, 2), (0x04, 5, 5, 6)):
        assert answer(device, *bad)[:2] == b"\x00\x02"
    assert answer(device, 0x05)[:6] == bytes([0x64, 1, 2, 0x64, 1, 2])


def test_identifiers_change_at_the_next_power_up_and_stream_and_bias_are_lost():
    """Set, still on the old ones, shown as pending; after the power cycle on the new ones, unbiased and idle."""
    device, _ = sensor()
    assert answer(device, 0x04, 0x30, 0x31, 0x32)[:2] == b"\x01\x00"
    assert answer(device, 0x05)[:6] == bytes([0x64, 1, 2, 0x30, 0x31, 0x32])
    answer(device, 0x0F, 7)
    ask(device, 0x11, 1)
    ask(device, 0x0B)
    device.power_cycle(T0)
    assert device.poll(T0 + NS_PER_S) == []
    assert ask(device, 0x01) == []
    replies = ask(device, 0x0A, receiver=0x30)
    assert [f.arbitration_id for f in replies] == [0x31, 0x32]
    assert wrench(replies[0].data[1:] + replies[1].data)[2] == pytest.approx(OFFSET[2] - 3.65, abs=0.02)
    assert ask(device, 0x10, receiver=0x30)[0].data[1] == 7, "the output rate survives"


def test_overload_is_flagged_by_axis_and_counted():
    """Above 1.2 of the rating: bit 5 is Fx, bit 0 Tz; the counters stop at 255 and count each onset once."""
    device, world = sensor(rating=(10.0, 10.0, 10.0, 5.0, 0.5, 5.0))
    assert answer(device, 0x0A)[12] == 0
    world.advance(T0)
    world.push([20.0, 0, 0], seconds=0.01)
    assert answer(device, 0x0A)[12] == 0b100010
    assert answer(device, 0x0A)[12] == 0b100010
    assert list(answer(device, 0x12)[:6]) == [1, 0, 0, 0, 1, 0]
    for k in range(300):
        world.faults = {"ft.saturated.2"} if k % 2 else set()
        answer(device, 0x0A, t=T0 + NS_PER_S)
    assert answer(device, 0x12)[2] == 150
    assert np.max(np.abs(wrench(answer(device, 0x0A)))) <= 32768 / 50


def test_the_filter_slows_a_step():
    """A first-order low-pass at 10 Hz has 63 % of a step after 1 / (2 pi 10) s."""
    device, world = sensor(rate_code=8)
    answer(device, 0x08, 1, 10)
    assert answer(device, 0x09)[:2] == bytes([1, 10])
    before = wrench(answer(device, 0x0A))[0]
    world.advance(T0)
    world.push([10.0, 0, 0], seconds=10.0)
    for k in range(1, 17):
        last = wrench(answer(device, 0x0A, t=T0 + k * MS))[0]
    assert last - before == pytest.approx(10.0 * (1 - np.exp(-2 * np.pi * 10 * 0.016)), abs=0.05)

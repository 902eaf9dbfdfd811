"""The Robotous RFT driver and codec: vectors, start, stream, pairing, overload, zero."""

import json
import sys
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import ValidationError

sys.path.insert(0, str(Path(__file__).parent))

from paired_peer import MS, ask, force, wrenches
from rft_sensor import Sensor, run_of

from galen_hw.drivers.device import CanFrame
from galen_hw.drivers.robotous_rft import RobotousRft, codec
from galen_hw.drivers.robotous_rft.codec import Command

VECTORS = json.loads((Path(__file__).parent / "vectors/robotous_rft.json").read_text())["frames"]
counts = st.integers(-32768, 32767)


def vectors(key):
    return [
        pytest.param(vector, id=f"{vector['what']} {vector.get('args', '')}") for vector in VECTORS if key in vector
    ]


def frames(vector):
    return [CanFrame(int(frame["id"], 16), bytes.fromhex(frame["data"])) for frame in vector["frames"]]


def response(vector):
    return b"".join(frame.data for frame in frames(vector))


@pytest.mark.parametrize("vector", vectors("command"))
def test_commands_are_the_manuals_frames(vector):
    """Each command is encoded to the frame of the table."""
    assert [codec.command(0x64, Command[vector["command"]], *vector["args"])] == frames(vector)


@pytest.mark.parametrize("vector", vectors("axes"))
def test_data_responses_decode_and_encode(vector):
    """Two frames give axes and overloads of the table (Tx straddles them), and come back from them."""
    assert codec.decode_data(response(vector)) == (tuple(vector["axes"]), vector["overload"])
    assert codec.overloaded_axes(vector["overload"]) == vector["overloaded"]
    assert codec.encode_data(tuple(vector["axes"]), vector["overload"]) == tuple(f.data for f in frames(vector))


def test_other_responses_decode():
    """Texts and results of settings mean what the table says."""
    assert sum("text" in v or "result" in v for v in VECTORS) == 6
    for vector in VECTORS:
        if "text" in vector:
            assert codec.decode_text(response(vector)) == vector["text"]
        if "result" in vector:
            assert codec.decode_result(response(vector)) == vector["result"]


@given(axes=st.tuples(*[counts] * 6), overload=st.integers(0, 255))
def test_data_survive_the_round_trip(axes, overload):
    """Any counts and flags: decode undoes encode, in two frames of eight bytes that begin with 0x0B."""
    first, second = codec.encode_data(axes, overload)
    assert (len(first), len(second), first[0]) == (8, 8, 0x0B)
    assert codec.decode_data(first + second) == (axes, overload)


@given(st.binary(min_size=16, max_size=16))
def test_any_response_has_a_text_and_a_result(data):
    """Whatever the bytes, texts are printable and errors have words."""
    assert codec.decode_text(data).isprintable()
    assert isinstance(codec.decode_result(data), str)


def test_start_stops_asks_sets_and_streams():
    """Stop twice, then names, the rate if it differs, overload counts, un-bias, start; then samples at the sensor's
    rate."""
    sensor = Sensor()
    run = run_of(sensor, rate_hz=500, filter_hz=100).seconds(1.0)
    assert [wire.data[0] for wire in sensor.seen] == [0x0C, 0x0C, 1, 2, 3, 0x10, 0x0F, 9, 8, 0x12, 0x11, 0x0B]
    assert (sensor.rate_code, sensor.filter) == (7, (1, 5))
    assert run.device.ready
    samples = wrenches(run)
    assert len(samples) > 400
    assert all(sample.valid and sample.serial_number == "S-0001" for sample in samples)
    assert np.all(np.diff([sample.t_ns for sample in samples]) == 2 * MS)
    assert "overloads in its life: Fz 3" in run.messages("status")[-1].detail
    again = Sensor(rate_code=7, filter=(1, 5))
    run_of(again, rate_hz=500, filter_hz=100).seconds(1.0)
    assert not {0x0F, 0x08} & {wire.data[0] for wire in again.seen}


@pytest.mark.parametrize(
    ("model", "dt"), [("RFT40-SA01", 2000), ("RFT76-HA01", 2000), ("RFT82-HA02", 1000), ("RFT80-6A01", 1000)]
)
def test_scaling_follows_the_model(model, dt):
    """Force is counts / 50; torque counts / 2000 or / 1000 by the model that answers."""
    sensor = Sensor(model=model.encode(), axes=(50, -100, 25, dt, -dt, dt // 2))
    run = run_of(sensor).seconds(0.5)
    np.testing.assert_allclose(force(wrenches(run)[-1]), (1, -2, 0.5, 1, -1, 0.5))


@pytest.mark.parametrize(
    ("sensor", "keys", "what", "todo"),
    [
        (Sensor(deaf=True), {}, "no answer to the model name", "1 Mbit/s"),
        (Sensor(model=b"RFT99"), {}, "unknown model 'RFT99'", "counts_per_newton"),
        (Sensor(model=b"RFT40-SA01"), {"rate_hz": 1000}, "200 Hz at most", "rate_hz"),
        (Sensor(refuses={0x0F: 2}), {"rate_hz": 1000}, "refuses rate_hz: parameter out of range", "rate_hz"),
        (Sensor(refuses={0x08: 3}), {"filter_hz": 50}, "refuses filter_hz: setting failed", "filter_hz"),
        (Sensor(), {"serial_number": "other"}, "sensor S-0001 answers", "serial_number"),
    ],
)
def test_start_that_cannot_succeed_is_a_fault(sensor, keys, what, todo):
    """Silent, unknown, too slow, refusing or the wrong one: never ready, and a fault that says what to do."""
    run = run_of(sensor, **keys).seconds(5.0)
    assert not run.device.ready
    assert wrenches(run) == []
    fault = run.messages("fault")[0]
    assert what in fault.what
    assert todo in fault.todo


def test_configured_model_and_scaling_win():
    """A model or counts in the settings replace what the sensor says."""
    run = run_of(Sensor(model=b"RFT99", axes=(100, 0, 0, 10, 0, 0)), counts_per_newton=100, counts_per_newton_metre=10)
    run.seconds(0.5)
    assert force(wrenches(run)[-1])[::3] == (1.0, 1.0)


def test_overload_flags_make_samples_invalid():
    """Flags in bits 0 to 5 are saturation and name the axes; the reserved bits 6 and 7 mean nothing."""
    sensor = Sensor(overload=0xC0)
    run = run_of(sensor).seconds(0.5)
    assert all(sample.valid for sample in wrenches(run))
    sensor.overload = 0x21
    run.seconds(0.1)
    sample = wrenches(run)[-1]
    assert (sample.valid, sample.saturated, sample.status) == (False, True, 0x21)
    assert "overload in Fx, Tz" in run.messages("fault")[0].what


def test_zero_is_the_sensors_own_and_must_show():
    """`zero` sends 0x11 1 and answers once N samples are near zero; `unzero` sends 0x11 0."""
    sensor = Sensor(axes=(500, -300, 20, 100, 10, -70))
    run = run_of(sensor).seconds(0.5)
    assert force(wrenches(run)[-1])[0] == 10.0
    ask(run, "zero", samples=20)
    run.seconds(0.5)
    (reply,) = run.replies
    assert reply.error is None
    assert reply.result["samples"] == 20
    assert force(wrenches(run)[-1]) == (0.0,) * 6
    run.seconds(1.0)
    assert run.messages("status")[-1].detail.endswith(", zeroed")
    ask(run, "unzero")
    run.seconds(0.2)
    assert force(wrenches(run)[-1])[0] == 10.0
    assert [w.zeroings for w in wrenches(run)][:: len(wrenches(run)) - 1] == [0, 0]
    assert {w.zeroings for w in wrenches(run)} == {0, 1}
    assert [wire.data[:2] for wire in sensor.seen if wire.data[0] == 0x11] == [b"\x11\0", b"\x11\1", b"\x11\0"]


def test_zero_that_does_not_take_is_an_error():
    """A sensor that does not obey is asked again, then the reply says what remains; an overload ends it at once."""
    sensor = Sensor(axes=(500, 0, 0, 0, 0, 0), obeys_bias=False)
    run = run_of(sensor).seconds(0.5)
    ask(run, "zero", samples=10)
    run.seconds(2.0)
    assert "10.00 N" in run.replies[0].error.what
    assert sum(wire.data[:2] == b"\x11\1" for wire in sensor.seen) == 3
    ask(run, "zero", samples=10)
    sensor.overload = 1
    run.seconds(0.5)
    assert "overloaded" in run.replies[1].error.what


def test_a_lost_bias_command_is_sent_again():
    """One lost 0x11 is noticed by the samples and repeated."""
    sensor = Sensor(axes=(500, 0, 0, 0, 0, 0), obeys_bias=False)
    run = run_of(sensor).seconds(0.5)
    ask(run, "zero", samples=10)
    run.seconds(0.05)
    sensor.obeys_bias = True
    run.seconds(0.5)
    assert run.replies[0].error is None


def test_a_stream_that_ends_is_started_again_without_its_zero():
    """The sensor loses its power: a fault, then samples again, and a fault that the zero is lost."""
    sensor = Sensor(axes=(500, 0, 0, 0, 0, 0))
    run = run_of(sensor).seconds(0.5)
    ask(run, "zero", samples=10)
    run.seconds(0.5)
    sensor.streaming, sensor.bias = False, (0,) * 6
    run.seconds(3.0)
    assert run.device.ready
    whats = [fault.what for fault in run.messages("fault")]
    assert "no samples come" in whats
    assert "the sensor's zero is lost" in whats
    assert force(wrenches(run)[-1])[0] == 10.0


def test_other_identifiers_work_and_the_old_ones_are_foreign():
    """Receiver and transmitters as configured; the factory's ids are then somebody else's."""
    sensor = Sensor(ids=(0x10, 0x20, 0x21))
    run = run_of(sensor, receiver_id=0x10, transmitter1_id=0x20, transmitter2_id=0x21).seconds(0.5)
    assert run.device.ready
    before = run.device.counters["foreign"]
    run.feed(CanFrame(1, bytes(8)))
    assert run.device.counters["foreign"] == before + 1


def test_settings_refuse_what_cannot_be():
    """Rates and filters that have no code, equal identifiers, unknown models and keys."""
    for wrong in (
        {"rate_hz": 250},
        {"filter_hz": 60},
        {"transmitter1_id": 2},
        {"receiver_id": 0},
        {"model": "X"},
        {"x": 1},
    ):
        with pytest.raises(ValidationError):
            RobotousRft.Settings(**wrong)

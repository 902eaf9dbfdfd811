"""Bota Systems sensors: lines, status bits, zero, restart; without the vendor's package."""

import json
import sys
from pathlib import Path

import numpy as np
import pytest
from pydantic import ValidationError

sys.path.insert(0, str(Path(__file__).parent))

from bota_parts import SENSOR, Process, run_of, wrenches
from conformance.peer import VECTORS, Run, wire_of

from galen_hw.clock import NS_PER_S, TimeBase
from galen_hw.drivers.bota import codec
from galen_hw.drivers.bota.codec import INVALID, OVERRANGE, RAW, THROTTLED, Frame, Sensor, decode, encode
from galen_hw.drivers.bota.device import Bota
from galen_hw.drivers.bota_transport import BotaTransport, BotaWireSettings
from galen_hw.errors import CommandRejectedError, HardwareError
from galen_hw.messages import Reply, Request

TABLE = json.loads((VECTORS / "bota.json").read_text())


def ask(run: Run, name: str, **args) -> None:
    run.outputs += run.device.request(Request(id=name, target="ft", name=name, args=args), run.now_ns)


def said(run: Run) -> list[str]:
    return [fault.what for fault in run.messages("fault")]


def last_status(run: Run):
    return run.seconds(1.0).messages("status")[-1]


# ------------------------------------------------------------ lines


@pytest.mark.parametrize("row", TABLE["frames"], ids=lambda row: row["what"])
def test_each_line_means_what_the_table_says_and_is_written_so(row):
    """Both directions, the float of the package to its last digit."""
    fields = {k: tuple(v) if isinstance(v, list) else v for k, v in row.get("sensor", row.get("frame")).items()}
    message = Sensor(**fields) if "sensor" in row else Frame(**fields)
    assert decode(wire_of(row).rstrip(b"\n")) == message
    assert encode(message) == wire_of(row)


@pytest.mark.parametrize("row", TABLE["refused"], ids=lambda row: row["what"])
def test_what_is_no_line_is_refused(row):
    """It says nothing, and is counted by the device."""
    assert decode(wire_of(row)) is None
    run = run_of(Process()).seconds(0.1)
    before = len(wrenches(run))
    run.feed(wire_of(row) + b"\n")
    assert run.device.counters["malformed"] == 1
    assert len(wrenches(run)) == before


def test_a_force_that_is_no_number_leaves_no_line_for_a_sample():
    """NaN and infinity of the package are `null` on the way, and then no frame."""
    for bad in (float("nan"), float("inf")):
        assert decode(encode(Frame(1, 0, (bad, 0.0, 0.0), (0.0, 0.0, 0.0), 25.0)).rstrip()) is None
    found = decode(encode(Frame(1, 0, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), float("nan"))).rstrip())
    assert found is not None
    assert found.celsius is None


def test_a_line_without_an_end_is_not_kept_for_ever():
    """A megabyte of it is one malformed line in the end, and the sample after it is heard."""
    run = run_of(Process()).seconds(0.1)
    for _ in range(1024):
        run.feed(b"7" * 1024)
    assert len(run.device._line) <= codec.LONGEST + 1
    run.feed(b"\n")
    assert run.device.counters["malformed"] == 1
    assert run.seconds(0.01).device.ready


# ------------------------------------------------------------ samples


def test_samples_bear_our_time_and_the_sensors_number():
    """N and N m as the package gives them, stamped when they were fed, the serial number with each, kelvin in the status."""
    run = run_of(Process()).seconds(1.0)
    samples = wrenches(run)
    assert len(samples) > 890
    assert {sample.t_ns for sample in samples} <= {t_ns for t_ns, _ in run.fed}
    assert (samples[0].force.y, samples[0].torque.z, samples[0].valid, samples[0].zeroings) == (2.0, 0.3, True, 0)
    assert {sample.serial_number for sample in samples} == {"SN000853"}
    status = last_status(run)
    assert status.state == "ready"
    assert status.gauges["temperature_k"] == 298.15
    assert 990.0 < status.gauges["rate_hz"] < 1010.0
    assert "BFT-ROKS-SER-M8, sensor SN000853, firmware 1.2.3; not zeroed" in status.detail


@pytest.mark.parametrize(
    ("word", "valid", "saturated", "state", "words"),
    [
        (THROTTLED, True, False, "degraded", "fewer samples"),
        (OVERRANGE, False, True, "fault", "beyond the sensor's range"),
        (INVALID, False, False, "fault", "calls its measurement invalid"),
        (RAW, False, False, "fault", "raw measurements"),
        (THROTTLED | INVALID, False, False, "fault", "calls its measurement invalid"),
        (0x40, False, False, "fault", "status bits 0x40"),
    ],
)
def test_each_status_bit_decides_for_itself(word, valid, saturated, state, words):
    """What speaks against the measurement makes it not valid and is told; fewer samples are right ones; then all is well."""
    process = Process()
    run = run_of(process).seconds(0.2)
    process.status = word
    run.seconds(0.5)
    sample = wrenches(run)[-1]
    assert (sample.valid, sample.saturated, sample.status) == (valid, saturated, word)
    assert any(words in what for what in said(run)) is not valid
    status = last_status(run)
    assert status.state == state
    assert words in status.detail
    assert bool(status.todo) == (state != "ready")
    for bit, name in ((THROTTLED, "throttled"), (OVERRANGE, "saturated")):
        assert (status.counters[name] > 0) == bool(word & bit)
    assert (status.counters["unusable"] > 0) is not valid
    process.status = 0
    assert wrenches(run.seconds(0.1))[-1].valid
    assert last_status(run).state == "ready"


# ------------------------------------------------------------ start, restart, silence


def test_restart_asks_anew_and_is_answered_by_the_first_sample():
    """Stop, ask, start; the zero stays, for it is the host's and the sensor is the same."""
    run = run_of(Process()).seconds(0.2)
    ask(run, "zero", samples=50)
    run.seconds(0.2)
    run.peer.heard.clear()
    ask(run, "restart")
    with pytest.raises(CommandRejectedError):
        ask(run, "restart")
    run.seconds(0.3)
    assert run.peer.heard == [b"stop\n", b"identify\n", b"start\n"]
    assert Reply(id="restart", result={"serial_number": "SN000853"}) in run.replies
    assert wrenches(run)[-1].zeroings == 1
    assert run.device.counters["restarts"] == 1
    assert said(run) == []


def test_a_stream_that_falls_silent_is_told_and_started_anew():
    """Within half a second; what was asked meanwhile is answered; it comes back by itself."""
    process = Process()
    run = run_of(process).seconds(0.3)
    ask(run, "zero", samples=10_000)
    process.silent = True
    run.seconds(0.6)
    assert not run.device.ready
    assert said(run) == ["no samples come"]
    assert run.replies[-1].error.kind == "fault"
    process.silent = False
    run.seconds(4.0)
    assert run.device.ready


def test_stop_leaves_it_at_rest():
    """One word, and nothing flows; what was still on its way is counted as late."""
    run = run_of(Process()).seconds(0.2)
    wires = run.device.stop(run.now_ns)
    assert wires == [b"stop\n"]
    before = len(wrenches(run))
    run.feed(run.peer.frame(1, run.now_ns))
    assert len(wrenches(run)) == before
    assert not run.device.ready


def test_another_rate_or_sensor_than_configured_is_refused():
    """Said with what to write; nothing is started."""
    for process, settings, words in (
        (
            Process(Sensor("m", "SN1", "f", 10_000)),
            {"rate_hz": 1000.0},
            "the sensor streams at 100 Hz, but rate_hz is 1000",
        ),
        (Process(), {"serial_number": "SN9"}, "sensor SN000853 answers, but sensor SN9 is configured"),
    ):
        run = run_of(process, **settings).seconds(0.5)
        assert said(run) == [words]
        assert run.messages("fault")[0].todo
        assert b"start\n" not in process.heard


def test_a_sensor_that_does_not_say_who_it_is_has_the_configured_number():
    """As over CAN: taken on trust, and the status says so."""
    run = run_of(Process(Sensor("", "", "", 1000)), serial_number="SN7").seconds(0.2)
    assert wrenches(run)[-1].serial_number == "SN7"
    assert "model unknown, sensor SN7 (as configured, it does not say)" in last_status(run).detail


# ------------------------------------------------------------ zero


def test_zero_subtracts_the_mean_and_tells_it():
    """From the answer on; `unzero` takes it back."""
    run = run_of(Process()).seconds(0.2)
    ask(run, "zero", samples=100)
    run.seconds(0.2)
    reply = run.replies[-1]
    assert reply.result["samples"] == 100
    np.testing.assert_allclose(reply.result["bias_force_n"][1:], [2.0, 3.0])
    np.testing.assert_allclose(reply.result["bias_torque_nm"], [0.1, 0.2, 0.3])
    sample = wrenches(run)[-1]
    assert (sample.zeroings, sample.force.z) == (1, 0.0)
    ask(run, "unzero")
    sample = wrenches(run.seconds(0.1))[-1]
    assert (sample.zeroings, sample.force.z) == (0, 3.0)


def test_no_zero_of_samples_that_are_not_valid():
    """It is given up at once, with why; the old one stays."""
    process = Process()
    run = run_of(process).seconds(0.2)
    process.status = OVERRANGE
    run.seconds(0.1)
    ask(run, "zero", samples=100)
    run.seconds(0.1)
    assert "beyond the sensor's range" in run.replies[-1].error.what
    assert wrenches(run)[-1].zeroings == 0


def test_another_sensor_loses_the_zero():
    """And says so."""
    process = Process()
    run = run_of(process).seconds(0.2)
    ask(run, "zero", samples=50)
    run.seconds(0.2)
    process.sensor = Sensor("BFT-ROKS-SER-M8", "SN000999", "1.2.3", 1000)
    ask(run, "restart")
    run.seconds(0.2)
    assert wrenches(run)[-1].zeroings == 0
    assert said(run) == ["another sensor (SN000999) answers: the zero is lost"]


def test_the_zero_outlives_the_daemon_for_the_same_sensor_only():
    """Taken up from the first sample on, as an ATI sensor's; never for a sensor that has no number."""
    run = run_of(Process()).seconds(0.2)
    ask(run, "zero", samples=50)
    state = run.seconds(0.2).device.snapshot(run.now_ns)
    for sensor, zeroings in ((SENSOR, 1), (Sensor("m", "SN1", "f", 1000), 0)):
        again = Run(Bota("ft", Bota.Settings(), TimeBase()), Process(sensor), now_ns=run.now_ns + NS_PER_S)
        again.device.restore(state, "")
        assert {sample.zeroings for sample in wrenches(again.start().seconds(0.2))} == {zeroings}
    nameless = run_of(Process(Sensor("", "", "", 1000))).seconds(0.2)
    ask(nameless, "zero", samples=50)
    assert nameless.seconds(0.2).device.snapshot(nameless.now_ns) == {}


# ------------------------------------------------------------ the wire, without the package


def test_a_missing_package_is_said_in_a_line(monkeypatch):
    """What, where, what to type; before any process is started."""
    monkeypatch.setitem(sys.modules, "bota_driver", None)
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    wire = BotaTransport(BotaWireSettings(interface="Bota_Dummy"))
    with pytest.raises(HardwareError) as caught:
        wire.open()
    assert str(caught.value) == "Bota_Dummy: bota-driver is not installed; pip install 'galen-hw[bota]'"
    assert wire.fileno() is None


@pytest.mark.parametrize(
    ("keys", "words"),
    [
        ({"interface": "Bota_Binary"}, "Bota_Binary needs an address"),
        ({"interface": "Bota_CAN_Robot", "address": "can0", "device_id": 21}, "must be 1 to 20"),
        ({"interface": "Bota_Dumy"}, "Bota_Dummy"),
    ],
)
def test_wrong_settings_of_the_wire_are_named(keys, words):
    """By the key, before anything is opened."""
    with pytest.raises(ValidationError, match=words):
        BotaWireSettings(**keys)

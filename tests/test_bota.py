"""Bota Systems sensors: lines, status bits, which frame is a sample, zero, restart; without the vendor's package."""

import json
import sys
from pathlib import Path

import numpy as np
import pytest
from pydantic import ValidationError

sys.path.insert(0, str(Path(__file__).parent))

from bota_parts import SENSOR, Process, rounded
from conformance.peer import VECTORS, Run, wire_of

from galen_hw.clock import NS_PER_S, TimeBase
from galen_hw.drivers.bota import codec
from galen_hw.drivers.bota.codec import INVALID, OVERRANGE, RAW, THROTTLED, Frame, Sensor, decode, encode
from galen_hw.drivers.bota.device import Bota
from galen_hw.drivers.bota.stream import Sieve, missing
from galen_hw.drivers.bota_transport import BotaTransport, BotaWireSettings
from galen_hw.errors import CommandRejectedError, HardwareError
from galen_hw.messages import Reply, Request

TABLE = json.loads((VECTORS / "bota.json").read_text())
COUNTED = ("late", "lost", "doubled")


def run_of(process: Process, **settings) -> Run:
    device = Bota("ft", Bota.Settings(**{"rate_hz": 1e6 / process.sensor.period_us} | settings), TimeBase())
    return Run(device, process).start()


def ask(run: Run, name: str, **args) -> None:
    run.outputs += run.device.request(Request(id=name, target="ft", name=name, args=args), run.now_ns)


def wrenches(run: Run) -> list:
    return run.messages("wrench/raw")


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
    for bit, name in ((THROTTLED, "throttled"), (OVERRANGE, "saturated")):
        assert (status.counters[name] > 0) == bool(word & bit)
    assert (status.counters["unusable"] > 0) is not valid
    process.status = 0
    assert wrenches(run.seconds(0.1))[-1].valid
    assert last_status(run).state == "ready"


def fed(sieve, ages_ms, begin_ms=0.0):
    """Which frames of a stream at 1 kHz, each read so many ms after it was measured, are samples."""
    found, t_ms = [], 0.0
    for number, age_ms in enumerate(ages_ms):
        t_ms = max(t_ms, begin_ms + number + age_ms)
        frame = Frame(rounded(round(1000 * (begin_ms + number))), 0, (float(number), 2.0, 3.0), (0.1, 0.2, 0.3))
        found.append(sieve.take(frame, round(1e6 * t_ms)))
    return found


@pytest.mark.parametrize("pause", [0, 1, 15, 25, 90, 200])
def test_what_had_piled_up_in_the_package_is_no_sample(pause):
    """Half a second's frames that are read in one go at the start, or in two with a pause between: none passes for prompt."""
    backlog = [500 - n for n in range(200)] + [500 + pause - n for n in range(200, 500 + pause)]
    counters = dict.fromkeys(COUNTED, 0)
    found = fed(Sieve(1_000_000, 20_000_000, counters), backlog + [0] * 300)
    assert not any(found[: len(backlog)])
    assert all(found[-150:])
    assert counters["late"] == found.count(False)


def test_a_stall_costs_only_what_had_waited():
    """Of what piled up in 200 ms the last 20 are young enough; all before and after are samples."""
    ages = [0] * 500 + [200 - n for n in range(200)] + [0] * 500
    found = fed(Sieve(1_000_000, 20_000_000, dict.fromkeys(COUNTED, 0)), ages, begin_ms=4_000_000.0)
    assert all(found[110:500])
    assert not any(found[500:675])
    assert all(found[685:])


def test_frames_in_bunches_are_samples():
    """An adapter that gives 16 frames at once every 16 ms: none waited longer than it may."""
    found = fed(Sieve(1_000_000, 20_000_000, dict.fromkeys(COUNTED, 0)), [15 - n % 16 for n in range(1000)])
    assert all(found[150:])


def test_a_sensor_whose_clock_is_half_a_percent_slow_or_fast_goes_on():
    """The least difference of the clocks follows."""
    for pace_ns in (995_000, 1_005_000):
        counters = dict.fromkeys(COUNTED, 0)
        sieve = Sieve(1_000_000, 20_000_000, counters)
        for number in range(20_000):
            sieve.take(Frame(rounded(1000 * number), 0, (float(number), 0.0, 0.0), (0.0, 0.0, 0.0)), number * pace_ns)
        assert counters["late"] < 120
        assert counters["lost"] == 0


def test_an_interface_without_a_stamp_gives_samples():
    """Late only at the start and after a silence."""
    counters = dict.fromkeys(COUNTED, 0)
    sieve = Sieve(1_000_000, 20_000_000, counters)
    found = [sieve.take(Frame(0, 0, (float(n), 0.0, 0.0), (0.0, 0.0, 0.0)), n * 1_000_000) for n in range(500)]
    assert all(found[101:])
    assert not sieve.take(Frame(0, 0, (-1.0, 0.0, 0.0), (0.0, 0.0, 0.0)), 600_000_000)


@pytest.mark.parametrize("seed", range(20))
def test_no_sample_is_at_a_wrong_time_or_twice_whatever_happens(seed):
    """Loss, doubling and a reader that stands still: each published sample is one that was measured, at its time, once."""
    process = Process(lose=0.02, double=0.05, stall=0.005, seed=seed)
    run = run_of(process).seconds(4.0)
    samples = wrenches(run)
    assert len(samples) > 500
    numbers = [int(sample.force.x) for sample in samples]
    assert numbers == sorted(set(numbers))
    # 20 ms is what `stall_s` lets pass; 1 % of the longest stall comes on top.
    assert all(0 <= sample.t_ns - process.measured_ns[int(sample.force.x)] <= 21_200_000 for sample in samples)
    assert [sample.t_ns for sample in samples] == sorted(sample.t_ns for sample in samples)
    counters = run.device.counters
    assert counters["doubled"] > 0
    assert counters["late"] > 0
    assert abs(counters["lost"] - process.lost) <= 2  # at either end of the run none follows that would show it


@pytest.mark.parametrize(
    ("begin_s", "period_us"), [(1, 1000), (17, 500), (2200, 1000), (4200, 1000), (4293, 1000), (4200, 520)]
)
def test_losses_are_counted_exactly_where_the_rounded_stamp_allows(begin_s, period_us):
    """From the first seconds to the last before 2^32 us, and over the turn: one in fifty is lost, each is counted."""
    sensor = Sensor("", "", "", period_us)
    process = Process(sensor, begin_us=begin_s * 1_000_000, lose=0.02, seed=3)
    run = run_of(process).seconds(4.0)
    assert process.lost > 50
    assert abs(run.device.counters["lost"] - process.lost) <= 2


@pytest.mark.parametrize("period_us", [250, 333])
def test_where_the_stamp_is_too_coarse_no_loss_is_made_up(period_us):
    """At 3 and 4 kHz after 70 minutes equal stamps are no doubled frames, and nothing counts as lost that was not."""
    process = Process(Sensor("", "", "", period_us), begin_us=4200 * 1_000_000)
    run = run_of(process).seconds(1.0)
    assert {run.device.counters[name] for name in ("lost", "doubled")} == {0}
    assert run.device.counters["samples"] > 870_000 / period_us


@pytest.mark.parametrize(
    ("before", "after", "lost"),
    [
        (1000, 2000, 0),
        (1000, 4000, 2),
        (4000, 1000, 0),  # backwards
        ((1 << 32) - 1024, 1976, 2),  # over the turn
        (rounded(3_000_000_000), rounded(3_000_002_000), 1),
        (rounded(3_000_000_000), rounded(3_000_001_000), 0),
    ],
)
def test_missing_frames_between_two_stamps(before, after, lost):
    """At 1 kHz."""
    assert missing(before, after, 1000.0) == lost


def test_a_clock_that_was_set_is_no_loss():
    """A leap of the stamp of ten minutes within a second of ours has no room for that many frames."""
    counters = dict.fromkeys(COUNTED, 0)
    sieve = Sieve(1_000_000, 20_000_000, counters)
    for number in range(1000):
        stamp = 1000 * number + (600_000_000 if number > 500 else 0)
        sieve.take(Frame(stamp, 0, (1.0, 2.0, 3.0), (0.1, 0.2, 0.3)), 1_000_000 * number)
    assert counters == {"late": 200, "lost": 0, "doubled": 0}  # 100 ms after each beginning


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

"""The ATI NETCANOEM driver: start, schedule, status, saturation, zero."""

import sys
from pathlib import Path

import numpy as np
import pytest
from pydantic import ValidationError

sys.path.insert(0, str(Path(__file__).parent))

from ati_board import MS, Board, ask, force, run_of, wrenches

from galen_hw.drivers.ati_netcanoem import AtiNetcanoem
from galen_hw.drivers.device import CanFrame
from galen_hw.errors import CommandRejectedError

MATRIX = np.random.default_rng(5).normal(0.0, 500.0, (6, 6)).astype(np.float32).astype(float)


def test_start_asks_in_the_manuals_order_and_then_samples():
    """Firmware, serial number, slot, six rows (twice), counts, units; then samples at the rate, stamped at their
    second frame."""
    board = Board()
    run = run_of(board, calibration_slot=3, rate_hz=500.0).seconds(0.5)
    opcodes = [wire.arbitration_id & 0xF for wire in board.seen]
    assert opcodes[:18] == [0xF, 5, 6, *[2] * 12, 7, 8, 0]
    assert [wire.data[0] for wire in board.seen if wire.arbitration_id == 0x202] == [0, 1, 2, 3, 4, 5] * 2
    assert board.slot == 3
    assert run.device.ready
    samples = wrenches(run)
    asked = [t_ns for t_ns, wire in run.sent if wire == CanFrame(0x200)]
    assert np.all(np.diff(asked) == 2 * MS)
    assert [sample.t_ns for sample in samples] == [t_ns + board.latency_ns for t_ns in asked[: len(samples)]]
    assert all(sample.valid and sample.serial_number == "FT01234" for sample in samples)


def test_reset_is_sent_only_when_configured_and_given_time():
    """With reset_at_start the first frame is a reset, and nothing follows for reset_wait_s."""
    run = run_of(reset_at_start=True, reset_wait_s=0.25).seconds(0.5)
    assert run.sent[0][1] == CanFrame(0x20C)
    assert run.sent[1][0] - run.sent[0][0] == 250 * MS
    assert CanFrame(0x20C) not in run_of().seconds(0.5).peer.seen


@pytest.mark.parametrize(
    ("units", "force_si", "torque_si"), [(b"\x02\x03", 1.0, 1.0), (b"\x01\x01", 4.4482216152605, 0.1129848290276167)]
)
def test_wrench_is_matrix_times_counts_in_si(units, force_si, torque_si):
    """Force and torque are the matrix times the gauges, over counts per unit, in N and N m."""
    gauges = (18, 1274, -454, -1389, -6488, 323)
    run = run_of(Board(matrix=MATRIX, gauges=gauges, counts=(1_000_000, 50_000), units=units)).seconds(0.2)
    expected = MATRIX @ gauges / np.repeat([1e6 / force_si, 5e4 / torque_si], 3)
    np.testing.assert_allclose(force(wrenches(run)[-1]), expected, rtol=1e-6)


def test_old_firmware_is_not_asked_for_counts():
    """Before 3.7 the board does not know opcodes 7 and 8: 1 000 000 counts, N and N m, unless configured."""
    board = Board(firmware=b"\x03\x06\x00\x00", gauges=(1000, 0, 0, 1000, 0, 0))
    run = run_of(board).seconds(0.2)
    assert not {7, 8} & {wire.arbitration_id & 0xF for wire in board.seen}
    np.testing.assert_allclose(force(wrenches(run)[-1]), [1e-3, 0, 0, 1e-3, 0, 0])
    board = Board(firmware=b"\x03\x06\x00\x00", gauges=(1000, 0, 0, 1000, 0, 0))
    run = run_of(board, counts_per_force=100, counts_per_torque=1000, torque_unit="N-mm").seconds(0.2)
    np.testing.assert_allclose(force(wrenches(run)[-1]), [10, 0, 0, 1e-3, 0, 0])


@pytest.mark.parametrize(
    ("board", "settings", "what", "todo"),
    [
        (Board(deaf=True), {}, "no answer to the firmware version", "base id and bit rate"),
        (Board(matrix=np.zeros((6, 6))), {}, "matrix of calibration slot 0", "calibration_slot"),
        (Board(matrix=np.full((6, 6), np.nan)), {}, "matrix of calibration slot 0", "calibration_slot"),
        (Board(counts=(0, 1)), {}, "0 counts per unit", "counts_per_force"),
        (Board(units=b"\x09\x03"), {}, "unknown unit code", "force_unit"),
        (Board(), {"serial_number": "FT99999"}, "sensor FT01234 answers, but sensor FT99999", "serial_number"),
    ],
)
def test_start_that_cannot_succeed_is_a_fault(board, settings, what, todo):
    """A board that is silent, empty, without units or the wrong one: never ready, no sample, and a fault that says
    why."""
    run = run_of(board, **settings).seconds(6.0)
    assert not run.device.ready
    assert wrenches(run) == []
    fault = run.messages("fault")[0]
    assert what in fault.what
    assert todo in fault.todo
    assert "ft (ATI NETCANOEM, CAN ids 0x200 to 0x20F)" in fault.where
    assert run.messages("status")[-1].state in ("fault", "starting")
    assert todo in run.messages("status")[-1].todo


def test_wrong_echo_of_the_slot_is_a_fault():
    """A board that selects another slot than asked is not used."""
    board = Board()
    honest = board.frames
    board.frames = lambda wire: [CanFrame(0x206, b"\x00")] if wire.arbitration_id == 0x206 else honest(wire)
    run = run_of(board, calibration_slot=2).seconds(1.0)
    assert not run.device.ready
    assert "slot 2 was asked for, slot 0 was selected" in run.messages("fault")[0].what


def test_schedule_never_bursts():
    """After the loop stalls for 50 periods one sample is asked for at once, 49 are missed, and the grid is kept."""
    run = run_of(rate_hz=1000.0).seconds(0.5)
    missed = run.device.counters["missed"]
    run.now_ns += 50 * MS
    run.seconds(0.1)
    asked = [t_ns for t_ns, wire in run.sent if wire == CanFrame(0x200)]
    assert run.device.counters["missed"] - missed in (49, 50)
    assert np.sum(np.diff(asked) < MS) == 1
    assert len({t_ns % MS for t_ns in asked[-50:]}) == 1


@pytest.mark.parametrize("latency_us", [20, 330, 900, 2500])
def test_one_request_at_a_time(latency_us):
    """However slow the wire, there is never a second request before the first is answered."""
    board = Board(latency_ns=latency_us * 1000)
    run = run_of(board, rate_hz=3000.0).seconds(0.5)
    asked = [t_ns for t_ns, wire in run.sent if wire == CanFrame(0x200)]
    assert np.diff(asked).min() >= latency_us * 1000
    assert run.device.counters["lost"] == 0
    rate = len(wrenches(run)) / 0.5
    assert rate == pytest.approx(min(3000.0, 1e6 / latency_us), rel=0.25)


def test_3000_a_second_with_300_us_exchanges():
    """At 3 kHz with replies after 300 us nothing is lost and nothing missed."""
    run = run_of(Board(latency_ns=300_000), rate_hz=3000.0).seconds(1.0)
    assert len(wrenches(run)) > 2980
    assert run.device.counters["missed"] == run.device.counters["lost"] == 0


def test_published_quirk_stays_valid_and_resets_nothing():
    """Status 0x4000 in every sample, as real boards send: valid for ever, no reset, reported as degraded after a
    second."""
    board = Board(status=0x4000)
    run = run_of(board).seconds(5.0)
    assert all(sample.valid and sample.status == 0x4000 for sample in wrenches(run))
    assert len(wrenches(run)) > 4900
    assert CanFrame(0x20C) not in board.seen
    assert run.device.counters["restarts"] == 0
    assert [status.state for status in run.messages("status")][-3:] == ["degraded"] * 3
    assert run.messages("status")[-1].todo == "check cable and termination of the CAN bus"
    board.status = 0
    run.seconds(2.1)
    assert (run.messages("status")[-1].state, run.messages("status")[-1].todo) == ("ready", "")


def test_flicker_of_bit_14_is_not_reported():
    """Bit 14 in single samples does not degrade the device."""
    board = Board(status=0x4000)
    run = run_of(board)
    for number in range(60):
        board.status = 0x4000 if number % 5 == 0 else 0
        run.seconds(0.05)
    assert {status.state for status in run.messages("status")} <= {"starting", "ready"}


@pytest.mark.parametrize("bit", range(16))
def test_each_status_bit_decides_for_itself(bit):
    """Critical bits of table 4.3 make samples invalid and raise a fault; the others, reserved ones and bit 15 alone
    do not."""
    board = Board()
    run = run_of(board).seconds(0.2)
    board.status = 1 << bit
    done = len(wrenches(run)) + 1
    run.seconds(0.01)
    critical = bit in (1, 2, 3, 4, 5, 6, 7, 11, 12)
    after = wrenches(run)[done:]
    assert after or bit == 0
    assert all(sample.valid is not critical and sample.status == 1 << bit for sample in after)
    assert bool(run.messages("fault")) is (critical or bit in (0, 8))


def test_watchdog_reset_selects_the_calibration_again():
    """When bit 0 appears the slot is selected again before the next valid sample; while it stays set, not once more."""
    board = Board()
    run = run_of(board, calibration_slot=4).seconds(0.3)
    board.slot, board.status = 0, 1
    before = len(wrenches(run)) + 1
    run.seconds(3.0)
    assert board.slot == 4
    assert run.device.counters["restarts"] == 1
    samples = wrenches(run)[before - 1 :]
    assert [sample.valid for sample in samples if sample.status == 1][:2] == [False, True]
    assert run.device.ready


@pytest.mark.parametrize(
    ("counts", "saturated"), [(32767, True), (-32768, True), (-32767, True), (32766, False), (-32766, False)]
)
@pytest.mark.parametrize("gauge", range(6))
def test_saturation_is_seen_in_the_gauges(gauge, counts, saturated):
    """A gauge at its limit makes the sample invalid, whatever the status says."""
    board = Board(gauges=tuple(counts if number == gauge else 7 for number in range(6)))
    run = run_of(board).seconds(0.05)
    sample = wrenches(run)[-1]
    assert (sample.saturated, sample.valid) == (saturated, not saturated)
    assert bool(run.device.counters["saturated"]) is saturated


def test_zero_averages_counts_and_unzero_takes_it_back():
    """`zero` subtracts the mean counts of N samples before the matrix; the reply has bias and scatter; `unzero`
    undoes it."""
    board = Board(matrix=MATRIX, gauges=(100, -200, 3000, 4, 5, -6))
    run = run_of(board).seconds(0.2)
    unzeroed = force(wrenches(run)[-1])
    assert ask(run, "zero", samples=50) == []
    run.seconds(0.3)
    (reply,) = run.replies
    assert reply.error is None
    assert reply.result["samples"] == 50
    assert reply.result["bias_counts"] == [100, -200, 3000, 4, 5, -6]
    assert reply.result["quiet"]
    np.testing.assert_allclose(force(wrenches(run)[-1]), 0.0, atol=1e-9)
    ask(run, "unzero")
    run.seconds(0.1)
    np.testing.assert_allclose(force(wrenches(run)[-1]), unzeroed)
    ask(run, "zero", samples=5)
    run.seconds(0.1)
    told = {(w.zeroings, bool(np.allclose(force(w), 0.0, atol=1e-9))) for w in wrenches(run)}
    assert told == {(0, False), (1, True), (2, True)}, "every sample says which zero is in it"


def test_zero_is_the_mean_of_moving_gauges():
    """With gauges that count up the bias is their mean, and samples after it are the difference."""
    board = Board()
    run = run_of(board).seconds(0.1)
    ask(run, "zero", samples=11)
    run.seconds(0.2)
    (reply,) = run.replies
    mean = reply.result["bias_counts"][0]
    assert reply.result["peak_to_peak_counts"] == [10.0] * 6
    last = wrenches(run)[-1]
    assert last.force.x == pytest.approx(board.asked - mean)


def test_zero_keeps_its_bias_when_it_fails():
    """A gauge that saturates, a board that falls silent, a stop: an error in the reply, and the old zero stays."""
    board = Board(gauges=(10, 20, 30, 40, 50, 60))
    run = run_of(board).seconds(0.1)
    ask(run, "zero", samples=10)
    run.seconds(0.1)
    ask(run, "zero", samples=100)
    board.gauges = (10, 20, 30, 40, 50, 32767)
    run.seconds(0.2)
    assert run.replies[-1].error.kind == "fault"
    ask(run, "zero", samples=100)
    board.deaf = True
    run.seconds(3.0)
    assert run.replies[-1].error.kind == "fault"
    board.deaf, board.gauges = False, (11, 20, 30, 40, 50, 60)
    run.seconds(3.0)
    np.testing.assert_allclose(force(wrenches(run)[-1]), [1, 0, 0, 0, 0, 0])
    ask(run, "zero", samples=100)
    run.device.stop(run.now_ns)
    run.poll()
    assert run.replies[-1].error.what == "not zeroed: the sensor was stopped"


def test_wrong_requests_are_rejected():
    """Wrong arguments, twice at once, or before samples flow: rejected, and nothing changes."""
    run = run_of()
    with pytest.raises(CommandRejectedError, match="not ready"):
        ask(run, "zero")
    run.seconds(0.1)
    for args in ({"samples": 0}, {"samples": 1.5}, {"samples": True}, {"samples": "9"}, {"sample": 5}):
        with pytest.raises(CommandRejectedError, match="wrong arguments"):
            ask(run, "zero", **args)
    ask(run, "zero", samples=1000)
    with pytest.raises(CommandRejectedError, match="being zeroed"):
        ask(run, "zero")
    with pytest.raises(CommandRejectedError, match="being zeroed"):
        ask(run, "unzero")


def test_restart_answers_when_samples_flow_again():
    """`restart` identifies the board anew; its reply names the sensor and comes with the first sample."""
    board = Board()
    run = run_of(board).seconds(0.2)
    ask(run, "restart")
    assert not run.device.ready
    run.seconds(0.1)
    assert run.replies[0].result == {"serial_number": "FT01234"}
    assert sum(wire == CanFrame(0x20F) for wire in board.seen) == 2
    ask(run, "restart")
    board.deaf = True
    run.seconds(1.0)
    assert "no answer" in run.replies[1].error.what


def test_another_sensor_loses_the_zero_and_says_so():
    """The bias belongs to the sensor: after an exchange it is gone, with a fault; after a mere interruption it
    stays."""
    board = Board(gauges=(100, 0, 0, 0, 0, 0))
    run = run_of(board).seconds(0.1)
    ask(run, "zero", samples=10)
    run.seconds(0.1)
    run.start().seconds(0.1)
    assert force(wrenches(run)[-1])[0] == 0
    board.serial_number = b"FT77777\0"
    run.start().seconds(0.1)
    assert force(wrenches(run)[-1])[0] == 100
    assert "FT77777" in run.messages("fault")[-1].what


def test_settings_refuse_what_cannot_be():
    """Rates above the wire's ceiling, base ids of eight bits, unknown units and keys."""
    for wrong in (
        {"rate_hz": 5000},
        {"rate_hz": 0},
        {"base_id": 128},
        {"calibration_slot": 16},
        {"force_unit": "oz"},
        {"x": 1},
    ):
        with pytest.raises(ValidationError):
            AtiNetcanoem.Settings(**wrong)

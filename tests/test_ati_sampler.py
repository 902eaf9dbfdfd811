"""No frame that is lost, late, doubled, short or foreign makes a wrong sample of the ATI board."""

import random
import sys
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

sys.path.insert(0, str(Path(__file__).parent))

from ati_board import MS, Board, force, run_of, wrenches

from galen_hw.drivers.device import CanFrame

ASK = CanFrame(0x200)
FAULTS = ("drop", "double", "double_pair", "short", "foreign", "delay")


def check_every_sample_answers_the_last_request(run, board):
    """Feed on, looking at each sample as it comes: all six gauges must bear the number of the newest request."""
    feed = run.feed

    def watched(wire):
        outputs = feed(wire)
        for output in outputs:
            if isinstance(output, tuple) and output[0] == "wrench/raw":
                assert force(output[1]) == (board.asked,) * 6
                last = next(t_ns for t_ns, sent in reversed(run.sent) if sent == ASK)
                assert last <= output[1].t_ns <= last + 20 * MS
        return outputs

    run.feed = watched


@settings(max_examples=50)
@given(
    seed=st.integers(0, 2**32),
    rates=st.dictionaries(st.sampled_from(FAULTS), st.sampled_from([0.005, 0.05, 0.3]), min_size=1),
    delay_ms=st.sampled_from([1, 25, 300]),
    rate_hz=st.sampled_from([200.0, 1000.0, 3000.0]),
)
def test_no_wrong_sample_whatever_happens_on_the_wire(seed, rates, delay_ms, rate_hz):
    """Any mixture of faults on a wire that keeps the order: each sample is the answer to the newest request, or
    none."""
    board = Board(rng=random.Random(seed), delay_ns=delay_ms * MS)
    run = run_of(board, rate_hz=rate_hz).seconds(0.05)
    assert run.device.ready
    board.rates = rates
    check_every_sample_answers_the_last_request(run, board)
    run.seconds(0.3)
    board.rates = {}
    run.seconds(1.7)
    assert run.device.ready
    seqs = [wrench.seq for wrench in wrenches(run)]
    assert seqs == list(range(len(seqs)))


@settings(max_examples=40)
@given(seed=st.integers(0, 2**32), fault=st.sampled_from(FAULTS), rate=st.sampled_from([0.05, 0.2]))
def test_start_amid_faults_never_takes_a_wrong_matrix(seed, fault, rate):
    """Whatever happens while the matrix is read: if the device becomes ready, its wrench is that of the true matrix."""
    matrix = np.random.default_rng(2).normal(0.0, 3.0, (6, 6)).round(2)
    gauges = (18, 1274, -454, -1389, -6488, 323)
    board = Board(matrix=matrix, gauges=gauges, rng=random.Random(seed), rates={fault: rate})
    run = run_of(board, rate_hz=100.0).seconds(2.0)
    for wrench in wrenches(run):
        np.testing.assert_allclose(force(wrench), matrix @ gauges, rtol=1e-5, atol=1e-2)


@pytest.mark.parametrize(
    ("fault", "counter"),
    [
        ("drop", "lost"),
        ("double", "doubled"),
        ("double_pair", "doubled"),
        ("short", "short"),
        ("foreign", "foreign"),
        ("delay", "late"),
    ],
)
def test_each_fault_is_counted(fault, counter):
    """Each kind of fault shows in its counter, and the samples go on."""
    board = Board()
    run = run_of(board).seconds(0.1)
    before = run.device.counters
    board.rates, board.delay_ns = {fault: 0.05}, 30 * MS
    run.seconds(2.0)
    after = run.device.counters
    assert after[counter] > before[counter]
    assert after["samples"] - before["samples"] > 300
    assert run.messages("status")[-1].counters[counter] > 0
    others = {"lost", "doubled", "short", "foreign", "late"} - {counter, "lost" if fault != "foreign" else "", "late"}
    assert all(after[name] == before[name] for name in others)


def test_a_late_pair_is_never_paired_with_the_next_request():
    """A reply held back for 100 ms, while the driver gives up, comes amid later ones: it is counted as late, not
    used."""
    board = Board()
    run = run_of(board).seconds(0.1)
    check_every_sample_answers_the_last_request(run, board)
    board.rates, board.delay_ns = {"delay": 1.0}, 100 * MS
    run.seconds(0.003)
    board.rates = {}
    run.seconds(0.5)
    counters = run.device.counters
    assert counters["late"] >= 2
    assert counters["lost"] == 1
    assert counters["samples"] > 400


def test_a_lost_first_half_costs_no_time_out():
    """An opcode-1 frame alone tells at once that its first half is missing: the next sample is 2 periods later at
    most."""
    board = Board()
    run = run_of(board).seconds(0.1)
    run.spoil = lambda wire: [] if wire.arbitration_id == 0x200 else [wire]
    run.seconds(0.0009)
    run.spoil = lambda wire: [wire]
    run.seconds(0.1)
    gaps = np.diff([wrench.t_ns for wrench in wrenches(run)])
    assert run.device.counters["timeouts"] == 0
    assert gaps.max() <= 2.5 * MS


def test_steady_gauges_are_published_each_time():
    """Equal samples are examined and then published: a quiet board is not mistaken for doubled frames."""
    board = Board(gauges=(1, 2, 3, 4, 5, 6))
    run = run_of(board).seconds(1.0)
    assert len(wrenches(run)) > 980
    assert run.device.counters["doubled"] == run.device.counters["lost"] == 0
    assert run.device.counters["repeated"] > 980
    off = run_of(Board(gauges=(1, 2, 3, 4, 5, 6)), verify_repeats=False).seconds(1.0)
    assert off.device.counters["repeated"] == 0


def test_own_requests_shown_by_the_wire_are_ignored():
    """On a wire that loops our frames back (udp_multicast) the device starts, selects its slot and samples as ever."""
    board = Board(loops_back=True)
    run = run_of(board, calibration_slot=7).seconds(1.0)
    check_every_sample_answers_the_last_request(run, board)
    run.seconds(0.5)
    assert board.slot == 7
    assert run.device.counters["echoes"] > 1000
    assert run.device.counters["lost"] == run.device.counters["doubled"] == 0
    assert len(wrenches(run)) > 1400


def test_a_looped_back_selection_is_not_its_echo():
    """A board that does not answer the selection is noticed although the wire shows the request itself."""
    board = Board(loops_back=True)
    honest = board.frames
    board.frames = lambda wire: [] if wire.arbitration_id == 0x206 else honest(wire)
    run = run_of(board).seconds(1.0)
    assert not run.device.ready
    assert "selection of a calibration" in run.messages("fault")[0].what


def test_a_silent_board_is_a_fault_and_comes_back():
    """Unplugged: a fault after `silent_s` and not before, tried again; plugged in again: samples within 3 s."""
    board = Board()
    run = run_of(board, silent_s=0.6).seconds(0.2)
    board.deaf = True
    run.seconds(0.5)
    assert run.device.ready
    assert not run.messages("fault")
    run.seconds(0.2)
    assert not run.device.ready
    assert "does not answer any more" in run.messages("fault")[0].what
    board.deaf = False
    run.seconds(3.0)
    assert run.device.ready


def test_a_board_that_is_slow_for_less_than_silent_s_is_not_gone():
    """On a busy machine the answers of 0.9 s come late and all at once: lost samples, no fault, no new start."""
    board = Board()
    run = run_of(board).seconds(0.2)
    held: list[CanFrame] = []
    run.spoil = lambda wire: held.append(wire) or []
    run.seconds(0.9)
    run.spoil = lambda wire: [wire]
    for frame in held:
        run.feed(frame)
    run.seconds(0.1)
    assert run.device.ready
    assert not run.messages("fault")
    assert run.device.counters["restarts"] == 0


def test_a_program_that_was_held_up_takes_no_board_for_gone():
    """The loop itself stands still for a minute, again and again: what the board had no chance to answer is no
    silence of the board's."""
    board = Board()
    run = run_of(board).seconds(0.2)
    for _ in range(5):
        run.now_ns += 60_000 * MS
        run.poll()
        run.seconds(0.01)
    run.seconds(0.1)
    assert run.device.ready
    assert not run.messages("fault")


def test_a_board_that_was_exchanged_while_running_is_identified_anew():
    """The answer to a fence is compared: another serial number makes the device start again."""
    board = Board()
    run = run_of(board).seconds(0.2)
    board.serial_number = b"FT55555\0"
    board.rates = {"drop": 0.2}
    run.seconds(0.5)
    board.rates = {}
    run.seconds(3.0)
    assert wrenches(run)[-1].serial_number == "FT55555"
    assert any("another board" in fault.what for fault in run.messages("fault"))


@given(st.lists(st.tuples(st.integers(0x1F0, 0x21F), st.binary(max_size=8), st.integers(0, 3 * MS)), max_size=200))
@settings(max_examples=50)
def test_any_frames_at_any_time_raise_nothing(frames):
    """Arbitrary frames on and around the board's identifiers, amid its own, are no exception."""
    run = run_of().seconds(0.02)
    for identifier, data, wait_ns in frames:
        run.until(run.now_ns + wait_ns)
        run.feed(CanFrame(identifier, data))
    run.seconds(0.1)


def test_a_reply_read_after_its_deadline_is_late_even_if_nobody_polled():
    """When the loop itself stalled past the deadline, the reply it then reads has lost its time: late, not
    published."""
    run = run_of().seconds(0.1)
    run.until(next(t_ns for t_ns, sent in reversed(run.sent) if sent == ASK) + MS)
    before = run.device.counters
    run.peer.take(run.poll(), run.now_ns)
    run.now_ns += 30 * MS
    for frame in run.peer.frames(ASK):
        assert run.feed(frame) == []
    assert run.device.counters["late"] > before["late"]
    assert run.device.counters["samples"] == before["samples"]

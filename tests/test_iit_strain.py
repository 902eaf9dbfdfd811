"""The driver and codec of IIT's STRAIN boards: vectors, start, stream, pairing, limits, zero."""

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
from strain_sensor import FULL_SCALES, Board, run_of

from galen_hw.drivers.device import CanFrame
from galen_hw.drivers.iit_strain import IitStrain, codec
from galen_hw.drivers.iit_strain.codec import Command, Stream

VECTORS = json.loads((Path(__file__).parent / "vectors/iit_strain.json").read_text())["frames"]
SCALE = np.array(FULL_SCALES) / 0x8000
counts = st.integers(-0x8000, 0x7FFF)


def vectors(key):
    return [pytest.param(vector, id=vector["what"]) for vector in VECTORS if key in vector]


def frames(vector):
    return [CanFrame(int(frame["id"], 16), bytes.fromhex(frame["data"])) for frame in vector["frames"]]


@pytest.mark.parametrize("vector", vectors("command"))
def test_commands_are_the_tables_frames(vector):
    """Each command is encoded to the frame of the table."""
    assert [codec.command(1, Command[vector["command"]], *vector["args"])] == frames(vector)


@pytest.mark.parametrize("vector", vectors("counts"))
def test_samples_decode_and_encode(vector):
    """Force and torque of the table, and back; a seventh byte only where a channel is at its limit."""
    sent = frames(vector)
    found = [codec.decode_vector(frame.data) for frame in sent]
    assert [*found[0][0], *found[1][0]] == vector["counts"]
    assert [limits for _, limits in found] == vector["limits"]
    assert [codec.limited(limits) for _, limits in found] == vector.get("limited", [[], []])
    kinds = (Stream.FORCE, Stream.TORQUE)
    again = [
        CanFrame(codec.stream_id(1, kind), codec.encode_vector(*part)) for kind, part in zip(kinds, found, strict=True)
    ]
    assert again == sent


def test_other_answers_decode():
    """Full scales, the serial number and the firmware mean what the table says; all come from the board's identifier."""
    seen = 0
    for vector in VECTORS:
        if vector["to"] == "device" or "counts" in vector:
            continue
        (frame,) = frames(vector)
        assert frame.arbitration_id == codec.answer_id(1)
        found = {
            "full_scale": codec.decode_full_scale,
            "text": codec.decode_text,
            "firmware": lambda data: list(codec.decode_firmware(data)),
        }
        for key, decode in found.items():
            if key in vector:
                assert decode(frame.data) == vector[key]
                seen += 1
    assert seen == 4


@given(vector=st.tuples(counts, counts, counts), limits=st.integers(0, 255))
def test_vectors_survive_the_round_trip(vector, limits):
    """Any counts and limits: decode undoes encode, in six bytes or seven."""
    data = codec.encode_vector(vector, limits)
    assert len(data) == (7 if limits else 6)
    assert codec.decode_vector(data) == (vector, limits)


@given(st.binary(min_size=6, max_size=7))
def test_bytes_survive_the_round_trip(data):
    """Any frame of the stream: encode undoes decode, but for a seventh byte of nought."""
    assert codec.encode_vector(*codec.decode_vector(data)) == (data if data[6:] != b"\0" else data[:6])


@given(address=st.integers(1, 14), kind=st.sampled_from(Stream))
def test_identifiers_of_boards_never_meet(address, kind):
    """Commands, answers and streams of any two boards have identifiers of their own."""
    others = [a for a in range(1, 15) if a != address]
    mine = {codec.command_id(address), codec.answer_id(address), *(codec.stream_id(address, k) for k in Stream)}
    theirs = {i for a in others for i in (codec.command_id(a), codec.answer_id(a), codec.stream_id(a, kind))}
    assert len(mine) == 4
    assert not mine & theirs


@given(st.binary(min_size=8, max_size=8))
def test_any_answer_has_a_text(data):
    """Whatever the bytes, the text is printable and the version is read."""
    assert codec.decode_text(data).isprintable() or not codec.decode_text(data)
    assert len(codec.decode_firmware(data)) == 3


@pytest.mark.parametrize(
    "bad", [{"rate_hz": 300}, {"rate_hz": 3.0}, {"address": 0}, {"address": 15}, {"rate_hz": 2000}]
)
def test_settings_that_cannot_be_are_refused(bad):
    """A rate whose period is no whole number of ms up to 255, and the addresses of the host and of everybody."""
    with pytest.raises(ValidationError):
        IitStrain.Settings(**bad)


def test_start_stops_asks_sets_and_streams():
    """Stop twice, firmware, serial number, six full scales, no tare, the period, start; then samples at that period."""
    board = Board()
    run = run_of(board, rate_hz=500).seconds(1.0)
    assert [wire.data[0] for wire in board.seen] == [7, 7, 0x1C, 0x1A, *[0x18] * 6, 0x15, 8, 7]
    assert board.seen[-1].data == b"\x07\x00"
    assert run.device.ready
    samples = wrenches(run)
    assert len(samples) > 400
    assert all(sample.valid and sample.serial_number == "SN042" for sample in samples)
    assert np.all(np.diff([sample.t_ns for sample in samples]) == 2 * MS)
    assert "STRAIN2" in run.messages("status")[-1].detail


def test_counts_are_parts_of_the_full_scale():
    """Of 0x8000 counts a full scale, which the board tells; N and N m."""
    board = Board(counts=(0x4000, -0x8000, 1, 0x4000, -1, 0x7FFF), full_scales=(1000, 500, 2000, 20, 35, 25))
    run = run_of(board).seconds(0.5)
    expected = np.array(board.counts) * np.array(board.full_scales) / 0x8000
    np.testing.assert_allclose(force(wrenches(run)[-1]), expected)


@pytest.mark.parametrize(
    ("board", "keys", "what", "todo"),
    [
        (Board(deaf=True), {}, "no answer to the firmware version", "1 Mbit/s"),
        (Board(board=5), {}, "type 5", "another address than 1"),
        (Board(full_scales=(1500, 1500, 0, 35, 35, 25)), {}, "the full scale of Fz is 0", "calibration"),
        (Board(), {"serial_number": "other"}, "sensor SN042 answers", "serial_number"),
    ],
)
def test_start_that_cannot_succeed_is_a_fault(board, keys, what, todo):
    """Silent, no force/torque sensor, without a calibration or the wrong one: never ready, and a fault that says what to do."""
    run = run_of(board, **keys).seconds(5.0)
    assert not run.device.ready
    assert wrenches(run) == []
    fault = run.messages("fault")[0]
    assert what in fault.what
    assert todo in fault.todo


def test_a_channel_at_its_limit_makes_samples_invalid():
    """The numbers are old then: not valid, saturated, and the fault names the converter's channels."""
    board = Board()
    run = run_of(board).seconds(0.5)
    board.limits = (0x05, 0x81)
    run.seconds(0.1)
    sample = wrenches(run)[-1]
    assert (sample.valid, sample.saturated, sample.status) == (False, True, 0x8105)
    assert "channel 0 low, 5 high" in run.messages("fault")[0].what
    board.limits = (0, 0)
    run.seconds(0.1)
    assert wrenches(run)[-1].valid


def test_zero_is_the_hosts_and_outlives_a_restart_of_the_board():
    """The mean is subtracted from then on, and still is after the board was off for a while."""
    board = Board(counts=(100, -200, 300, 40, 50, -60))
    run = run_of(board).seconds(0.5)
    ask(run, "zero", samples=20)
    run.seconds(0.5)
    assert run.replies[-1].result["mean_force_n"] == pytest.approx((np.array(board.counts) * SCALE)[:3].tolist())
    np.testing.assert_allclose(force(wrenches(run)[-1]), 0.0, atol=1e-9)
    board.streaming = False
    run.seconds(3.0)
    assert run.device.ready
    assert wrenches(run)[-1].zeroings == 1
    np.testing.assert_allclose(force(wrenches(run)[-1]), 0.0, atol=1e-9)
    ask(run, "unzero")
    run.seconds(0.1)
    np.testing.assert_allclose(force(wrenches(run)[-1]), np.array(board.counts) * SCALE)


def test_zero_at_the_limit_fails_in_words():
    """Old numbers are no mean."""
    board = Board(limits=(1, 1))
    run = run_of(board).seconds(0.5)
    ask(run, "zero")
    run.seconds(0.2)
    assert "at its limit" in run.replies[-1].error.what

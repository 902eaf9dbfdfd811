"""Galil wire format against the table of vectors, and the line's parser under arbitrary chunking and noise."""

import json
import struct
import sys
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

sys.path.insert(0, str(Path(__file__).parent))

from galil_parts import record

from galen_hw.drivers.galil_dmc.codec import (
    LINE_LENGTH,
    axes_of_model,
    error_code,
    lines,
    numbers,
    parse_record,
    per_axis,
    record_size,
)
from galen_hw.drivers.galil_dmc.link import Exchange, GalilLink

VECTORS = json.loads((Path(__file__).parent / "vectors" / "galil_dmc.json").read_text())


def link_after(exchange, data, sizes=()):
    """A link that has been asked and fed, and its answers."""
    link = GalilLink(300_000_000, 50_000_000)
    link.send(exchange, 0)
    answers, start = [], 0
    for size in [*sizes, len(data)]:
        answers += link.feed(data[start : start + size], 1)
        start += size
    return link, answers


@pytest.mark.parametrize("vector", VECTORS["commands"], ids=lambda v: v["what"])
def test_commands_as_in_the_vectors(vector):
    """Values go to their axis's slot, and no command is longer than a line may be."""
    found = per_axis(vector["command"], vector["values"])
    assert found == vector["lines"]
    assert all(len(line) <= 80 for line in found)


@pytest.mark.parametrize("vector", VECTORS["records"], ids=lambda v: v["what"])
def test_records_as_in_the_vectors(vector):
    """A record's size is known from its header, and each field has the value of the vector."""
    data = bytes.fromhex(vector["hex"])
    assert record_size(data[:4]) == len(data)
    found = parse_record(data)
    assert [found.sample_counter, found.error_code, found.amplifier_status] == [
        vector[key] for key in ("sample_counter", "error_code", "amplifier_status")
    ]
    assert set(vector["axes"]) <= set(found.axes)
    for letter, fields in vector["axes"].items():
        assert {key: getattr(found.axes[letter], key) for key in fields} == fields


@pytest.mark.parametrize("vector", VECTORS["answers"], ids=lambda v: v["line"])
def test_answers_as_in_the_vectors(vector):
    """One terminator a command, echoes dropped, data read with or without leading zeros."""
    _, (answer,) = link_after(Exchange(vector["line"]), vector["text"].encode())
    assert list(answer.parts) == vector["parts"]
    assert list(answer.refused) == vector["refused"]
    if "numbers" in vector:
        assert [numbers(part) for part in answer.parts] == vector["numbers"]


@pytest.mark.parametrize(("text", "axes"), VECTORS["models"])
def test_model_tells_the_number_of_axes(text, axes):
    """The digit at index 5, or 6 for the longer names; anything else is no DMC."""
    assert axes_of_model(text) == axes


@given(st.lists(st.text("ABCDEFGH ,0123456789", min_size=1, max_size=LINE_LENGTH), min_size=1, max_size=12))
def test_lines_keep_all_commands_in_order(commands):
    """Packing loses, adds and reorders nothing, and no line is longer than 80 characters."""
    packed = lines(commands)
    assert ";".join(packed).split(";") == commands
    assert all(len(line) <= LINE_LENGTH for line in packed)


COUNTS = st.integers(-(2**31), 2**31 - 1)
BLOCK = st.fixed_dictionaries(
    {
        "status": st.integers(0, 0xFFFF),
        "switches": st.integers(0, 255),
        "stop_code": st.integers(0, 255),
        "position": COUNTS,
        "velocity_64": COUNTS,
        "torque": COUNTS,
    }
)
SIDE_TALK = st.text("ABC 019.", max_size=8).map(lambda t: bytes(c | 0x80 for c in t.encode() + b"\r\n"))


@given(
    st.fixed_dictionaries(dict.fromkeys("ABCDE", BLOCK)),
    st.booleans(),
    SIDE_TALK,
    SIDE_TALK,
    st.lists(st.integers(1, 60), max_size=12),
)
def test_a_record_is_read_by_length_in_any_chunks(axes, general, before, after, sizes):
    """Whatever bytes it holds, ':' and '?' too, and whatever is said around it, a record comes out whole."""
    data = record(axes, general=general)
    exchange = Exchange("QR ABCDE", record="ABCDE")
    _, (answer,) = link_after(exchange, before + data + after + b":", sizes)
    assert answer.record == parse_record(data)
    for letter, values in axes.items():
        assert {key: getattr(answer.record.axes[letter], key) for key in values} == values


@given(
    st.fixed_dictionaries(dict.fromkeys("ABCDE", BLOCK)), st.integers(0, 184), st.lists(st.integers(1, 60), max_size=12)
)
def test_a_record_with_a_lost_byte_is_never_a_sample(axes, place, sizes):
    """With any one byte lost there is no record, unless what is left is the same record; the line then times out."""
    whole = record(axes) + b":"
    link, answers = link_after(Exchange("QR ABCDE", record="ABCDE"), whole[:place] + whole[place + 1 :], sizes)
    assert [answer.record for answer in answers if answer.record is not None] == []
    assert link.expired(300_000_000)


@given(st.binary(max_size=400), st.lists(st.integers(1, 30), max_size=20), st.booleans())
def test_noise_in_any_chunks_gives_the_same(noise, sizes, binary):
    """Any bytes in any chunks: no exception, the same answers, side talk and counts."""
    exchange = Exchange("QR ABCDE", record="ABCDE") if binary else Exchange("TP;TV")
    one, other = link_after(exchange, noise), link_after(exchange, noise, sizes)
    assert one[1] == other[1]
    assert (one[0].said(), one[0].counters) == (other[0].said(), other[0].counters)


def test_unsolicited_text_is_kept_apart_from_answers():
    """Bytes with the MSB set are side talk, amid an answer and between answers."""
    marked = bytes(c | 0x80 for c in b"CMDERR 5\r\n")
    link, (answer,) = link_after(Exchange("TP"), b" 1, " + marked + b"2\r\n:" + marked)
    assert answer.parts == ("1, 2",)
    assert link.said() == ["CMDERR 5", "CMDERR 5"]


def test_a_record_refused():
    """A '?' instead of a record is an answer without one."""
    _, (answer,) = link_after(Exchange("QR ABCDE", record="ABCDE"), b"?")
    assert answer.refused == (True,)
    assert answer.record is None


def test_a_stray_terminator_before_a_record_is_foreign():
    """A late ':' from an exchange given up does not shift the answers: records begin with their header."""
    data = record({letter: {} for letter in "ABCDE"})
    link, (answer,) = link_after(Exchange("QR ABCDE", record="ABCDE"), b":\r\n:" + data + b":")
    assert answer.record is not None
    assert link.counters["foreign"] == 2


def test_drain_waits_for_quiet_and_then_counts_anew():
    """What arrives in a drain is thrown away and prolongs it; a line that never rests is given up in the end."""
    link = GalilLink(300, 50)
    link.send(Exchange("TP"), 0)
    assert link.expired(300)
    assert link.drain(300) == b"\r"
    assert link.feed(b"1, 2\r\n::", 340) == []
    assert not link.settled(380)
    assert link.settled(390)
    assert link.idle
    link.drain(1000)
    for t in range(1000, 1960, 40):
        link.feed(b"x", t)
        assert not link.settled(t)
    assert link.settled(2000)


@pytest.mark.parametrize("flags", [0x00, 0x07, 0x88, 0xFF])
def test_header_must_be_one(flags):
    """Bit 7 set, bits 3 to 6 clear, a size that fits the blocks."""
    assert record_size(struct.pack("<BBH", flags, 0x1F, 184)) is None
    assert record_size(struct.pack("<BBH", 0x80, 0x1F, 183)) is None
    assert record_size(struct.pack("<BBH", 0x80, 0x1F, 184)) == 184


@pytest.mark.parametrize("word", ["1e999", "-1e999", "nan", "inf", "1_0", "+", ".", "9" * 1000, "0x10", "\u0661"])
def test_what_is_no_number_of_a_controller_is_an_error(word):
    """`float` takes most of these; none is what a controller prints, and none may become an infinite count."""
    with pytest.raises(ValueError, match="no numbers"):
        numbers(f"5, {word}, 26")


def test_numbers_as_controllers_print_them():
    """With leading zeros, signs, points and either separator."""
    assert numbers(" 5, 0000000052.0000,-26 +.5") == [5.0, 52.0, -26.0, 0.5]


def test_reason_of_a_refusal():
    """The code of TC 1 is three digits at most; anything else is words."""
    assert error_code("6 Number out of range") == (6, "Number out of range")
    assert error_code("9" * 4000 + " x")[0] == -1
    assert error_code("") == (-1, "")

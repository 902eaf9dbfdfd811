"""Combined API wire format against the table of vectors, under arbitrary chunking and noise."""

import json
import math
import sys
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

sys.path.insert(0, str(Path(__file__).parent))

from ndi_parts import binary, line

from galen_hw.drivers.ndi_tracker.clock import FrameClock
from galen_hw.drivers.ndi_tracker.codec import (
    BadReplyError,
    binary_body,
    binary_size,
    command,
    crc16,
    handles,
    parse_bx,
    parse_tx,
    reply_text,
    rom_writes,
)
from galen_hw.drivers.ndi_tracker.device import _code
from galen_hw.drivers.ndi_tracker.link import NdiLink

VECTORS = json.loads((Path(__file__).parent / "vectors" / "ndi_tracker.json").read_text())
QUIET = 50


@pytest.mark.parametrize(("text", "crc"), VECTORS["crc"])
def test_published_check_values(text, crc):
    """The CRC of the published texts, in commands and in replies."""
    assert f"{crc16(text.encode()):04X}" == crc
    assert command(text) == f"{text}{crc}\r".encode()
    assert reply_text(f"{text}{crc}".encode()) == text


@pytest.mark.parametrize("vector", [*VECTORS["tx"], *VECTORS["bx"]], ids=lambda v: v["what"])
def test_tracking_replies_as_in_the_vectors(vector):
    """Handles, states, quaternions, millimetres, status and frame, from text and from bytes alike."""
    if "text" in vector:
        found = parse_tx(vector["text"])
    else:
        data = bytes.fromhex(vector["hex"])
        assert binary_size(data[:6]) == len(data)
        found = parse_bx(binary_body(data))
    assert found.system_status == vector["system_status"]
    for transform, wanted in zip(found.transforms, vector["transforms"], strict=True):
        for key, value in wanted.items():
            got = getattr(transform, key)
            assert (list(got) if isinstance(got, tuple) else got) == value
        if transform.state != "ok":
            assert math.isnan(transform.position_mm[0])


@given(st.integers(0, 200), st.integers(0, 7))
def test_one_wrong_bit_is_noticed(place, bit):
    """Any single bit of a binary or text reply: an error, never another reply."""
    for whole in (bytes.fromhex(VECTORS["bx"][0]["hex"]), line(VECTORS["tx"][0]["text"])[:-1]):
        data = bytearray(whole)
        data[place % len(data)] ^= 1 << bit
        link = NdiLink()
        link.listen(0, 100)
        replies = link.feed(bytes(data) + b"\r", 1, QUIET)
        assert all(reply.error for reply in replies)


@given(st.binary(max_size=300), st.lists(st.integers(1, 40), max_size=20))
def test_noise_in_any_chunks_gives_the_same(noise, sizes):
    """Any bytes in any chunks: no exception, the same replies and counts; a bad one begins a drain."""
    one, other = NdiLink(), NdiLink()
    for link in (one, other):
        link.listen(0, 100)
    whole = one.feed(noise, 1, QUIET)
    parts, start = [], 0
    for size in [*sizes, len(noise)]:
        parts += other.feed(noise[start : start + size], 1, QUIET)
        start += size
    assert whole == parts
    assert one.counters == other.counters
    assert all(one.draining for reply in whole if reply.error)


@given(st.binary(max_size=120), st.lists(st.integers(1, 40), max_size=20))
def test_binary_reply_of_any_body_in_any_chunks(body, sizes):
    """Read by length: bodies may hold CR and the start word."""
    data, start, replies = binary(body), 0, []
    link = NdiLink()
    link.listen(0, 100)
    for size in [*sizes, len(data)]:
        replies += link.feed(data[start : start + size], 1, QUIET)
        start += size
    assert [reply.body for reply in replies] == [body]


@pytest.mark.parametrize(
    "text",
    ["", "01", "0101", "0101+0500", "0101MISSING0000", "0101MISSING00000031000004D2\n000", "00 12", "0G0000", "00+001"],
)
def test_texts_that_are_no_tracking_reply(text):
    """Cut off, too long or not hexadecimal: an error."""
    with pytest.raises(BadReplyError):
        parse_tx(text)


@pytest.mark.parametrize("body", [b"", b"\x01", b"\x01\x01\x02\x00", b"\x01\x01\x08" + bytes(40), b"\x00\x00\x00\x00"])
def test_bodies_that_are_no_tracking_reply(body):
    """Cut off, too long or of an unknown state: an error."""
    with pytest.raises(BadReplyError):
        parse_bx(body)


def test_lists_of_handles():
    """Count, then handle and status."""
    assert handles("0201031" + "0A001") == {"01": 0x31, "0A": 0x01}
    assert handles("00") == {}
    with pytest.raises(BadReplyError):
        handles("02010")


def test_definition_is_written_in_whole_chunks():
    """64 bytes a command, the last filled up, addresses in hexadecimal."""
    writes = list(rom_writes("0A", bytes(range(100))))
    assert [write[:11] for write in writes] == ["PVWR:0A0000", "PVWR:0A0040"]
    assert all(len(write) == 11 + 128 for write in writes)
    assert writes[1].endswith("00" * 28)
    assert len(list(rom_writes("0A", bytes(1024)))) == 16


@given(st.lists(st.integers(0, 40_000_000), min_size=30, max_size=200), st.integers(0, 2**31))
def test_frame_clock_is_the_least_delayed_reply(delays, first):
    """Times are frame by frame one period apart from the least delayed, whatever the delays; never later than read."""
    clock = FrameClock(1e9 / 60)
    for number, delay in enumerate(delays):
        frame = first + number
        read_ns = 10**15 + round(frame * 1e9 / 60) + delay
        assert clock.take(frame, read_ns) == ""
        least = min(delays[: number + 1])
        assert abs(clock.time_of(frame) - (10**15 + round(frame * 1e9 / 60) + least)) <= 4
        assert clock.time_of(frame) <= read_ns + 4


def test_frame_clock_follows_a_drift():
    """At 100 ppm difference the window keeps the time within 2 ms for ever."""
    clock = FrameClock(1e9 / 60)
    worst = 0
    for frame in range(40_000):
        true_ns = round(frame * 1e9 / 60 * 1.0001)
        assert clock.take(frame, true_ns + 1_000_000 * (frame % 7)) == ""
        worst = max(worst, abs(clock.time_of(frame) - true_ns))
    assert worst < 2_000_000


def test_frame_clock_notices_restart_and_jump():
    """A smaller number is a restart; a leap ahead of the host is a jump; a host that hangs once is neither."""
    clock = FrameClock(1e9 / 60)
    read = [round(n * 1e9 / 60) for n in range(2000)]
    assert [clock.take(n, read[n]) for n in range(100)] == [""] * 100
    assert clock.take(100, read[100] + 900_000_000) == ""
    assert clock.take(101, read[101]) == ""
    assert clock.take(5, read[102]) == "restart"
    assert clock.take(6, read[103]) == ""
    assert clock.take(60, read[104]) == "jump"
    assert clock.take(61, read[105]) == ""
    events = [clock.take(62 + n, read[200 + n]) for n in range(20)]
    assert events.count("jump") == 1


@pytest.mark.parametrize("word", ["x1", "nan", "9" * 400, "+1", "1_0", " 7", ""])
def test_an_error_reply_without_a_code_has_none(word):
    """Two hexadecimal digits are a code; what `int` alone would also take is not."""
    assert _code(f"ERROR{word}") == (0x99 if word.startswith("9") else 0)
    assert _code("ERROR0C") == 0x0C

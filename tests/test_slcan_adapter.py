"""The virtual LAWICEL adapter, byte for byte, and its pty."""

import os
import time
from functools import partial

import pytest
from hypothesis import given
from hypothesis import strategies as st

from galen_hw.drivers.device import CanFrame
from galen_hw.drivers.virtual.ptys import Pty
from galen_hw.drivers.virtual.slcan import SlcanAdapter


def opened(rate=1_000_000):
    adapter = SlcanAdapter(lambda: rate)
    adapter.feed(b"S8\rO\r")
    return adapter


def test_the_opening_of_python_can_is_accepted():
    """C, Sn, a bare CR, O and O again: five times OK."""
    assert SlcanAdapter(lambda: 1_000_000).feed(b"C\rS8\r\rO\rO\r") == (b"\r" * 5, [])


def test_a_frame_goes_to_the_bus_and_is_acknowledged():
    """`tIIILDD..` with upper or lower case digits."""
    adapter = opened()
    assert adapter.feed(b"t2000\r") == (b"z\r", [CanFrame(0x200)])
    assert adapter.feed(b"t7fF3A1b2C3\r") == (b"z\r", [CanFrame(0x7FF, b"\xa1\xb2\xc3")])


def test_frames_from_the_bus_read_as_the_host_expects():
    """Upper-case hex, one CR each, several in one go."""
    frames = [CanFrame(0x200, bytes.fromhex("40000012FE3AE6A8")), CanFrame(0x001, b"\x0a"), CanFrame(0x7F0)]
    assert opened().encode(frames, 0) == b"t200840000012FE3AE6A8\rt00110A\rt7F00\r"


@pytest.mark.parametrize(
    "line",
    [b"t200", b"t8000", b"t2009" + b"00" * 9, b"t200100FF", b"t2001", b"t20010", b"t2g00", b"t2001zz", b"q", b"S8",
     b"Y2", b"Z1", b"t2001\xff\xfe", b"t200/", b"t+201FF", b"t 201FF", b"t2_0100", b"t2002 0A0", b"t2001+A"],
)  # fmt: skip
def test_what_is_malformed_or_not_now_rings_the_bell(line):
    """BELL, nothing on the bus, and the next good line works."""
    adapter = opened()
    assert adapter.feed(line + b"\r") == (b"\x07", [])
    assert adapter.feed(b"t2000\r") == (b"z\r", [CanFrame(0x200)])


@pytest.mark.parametrize("line", [b"S", b"SA", b"S10", b"s", b"s00", b"sXXYY", b"s0 14", b"Z3", b"M00", b"t2000", b"F"])
def test_what_is_wrong_while_closed_rings_the_bell(line):
    """Settings with wrong arguments, and traffic on a closed channel."""
    assert SlcanAdapter(lambda: 1_000_000).feed(line + b"\r")[0] == b"\x07"


def test_at_another_bit_rate_nothing_passes():
    """The adapter takes the frame, the bus never sees it, and nothing comes from the bus."""
    adapter = SlcanAdapter(lambda: 1_000_000)
    adapter.feed(b"S6\rO\r")
    assert adapter.feed(b"t2000\r") == (b"z\r", [])
    assert adapter.encode([CanFrame(0x200)], 0) == b""
    assert adapter.counters["wrong_bit_rate"] == 1


@pytest.mark.parametrize(
    ("line", "rate"), [(b"S5", 250_000), (b"S6", 500_000), (b"S4", 125_000), (b"s0014", 1_000_000)]
)
def test_bit_rates_by_code_and_by_register(line, rate):
    """Sn of the standard, sxxyy as BTR0 and BTR1 of an SJA1000 at 8 MHz (0x00, 0x14: 1 Mbit/s)."""
    adapter = SlcanAdapter(lambda: rate)
    adapter.feed(line + b"\rO\r")
    assert adapter.feed(b"t2000\r")[1] == [CanFrame(0x200)]


def test_closed_and_listening_adapters_send_nothing():
    """After C nothing passes; after L the bus is heard and not spoken to."""
    adapter = opened()
    adapter.feed(b"C\r")
    assert adapter.encode([CanFrame(1)], 0) == b""
    adapter.feed(b"L\r")
    assert adapter.feed(b"t2000\r") == (b"\x07", [])
    assert adapter.encode([CanFrame(1)], 0) == b"t0010\r"


def test_identity_flags_and_time_stamps():
    """V, N, F answer; with Z1 each frame bears milliseconds below one minute in four hex digits."""
    adapter = SlcanAdapter(lambda: 1_000_000)
    assert adapter.feed(b"V\rN\rZ1\rS8\rO\rF\rM00000000\r")[0] == b"V1013\rNGALN\r\r\r\rF00\r\x07"
    assert adapter.encode([CanFrame(0x123)], 61_500_000_000) == b"t123005DC\r"
    adapter.feed(b"C\rZ2\rO\r")
    assert adapter.encode([CanFrame(0x123)], 61_500_000_000) == b"t123003AA6A60\r"


def test_extended_and_remote_frames_are_acknowledged_and_meet_no_node():
    """No node of this bus uses them."""
    assert opened().feed(b"T000002000\rr2000\rR000002000\r") == (b"Z\rz\rZ\r", [])


@given(st.lists(st.tuples(st.integers(0, 0x7FF), st.binary(max_size=8)), max_size=8), st.data())
def test_any_chunking_gives_the_same_frames(frames, data):
    """Frames encoded by one adapter and fed to another in arbitrary pieces come out as they were."""
    wires = [CanFrame(i, d) for i, d in frames]
    line = opened().encode(wires, 0)
    adapter, out, answers = opened(), [], b""
    while line:
        cut = data.draw(st.integers(1, len(line)))
        answer, got = adapter.feed(line[:cut])
        line, out, answers = line[cut:], out + got, answers + answer
    assert out == wires
    assert answers == b"z\r" * len(wires)


@given(st.binary(max_size=200))
def test_no_bytes_upset_the_adapter(garbage):
    """Any bytes: no exception, a bounded buffer, and a good frame after a CR."""
    adapter = opened()
    adapter.feed(garbage)
    assert len(adapter._buffer) <= 32
    adapter.feed(b"\rC\rS8\rO\r")
    assert adapter.feed(b"t2000\r") == (b"z\r", [CanFrame(0x200)])


@pytest.fixture
def pty(tmp_path):
    line = Pty(tmp_path / "line")
    yield line
    line.close()


def whole(read, size):
    """`size` bytes in as many reads as it takes: a terminal may hand over a part."""
    data = b""
    end = time.monotonic() + 5.0
    while len(data) < size and time.monotonic() < end:
        data += read()
    return data


def test_clients_of_a_pty_may_come_and_go(pty):
    """Bytes pass unchanged both ways; a second client works after the first has left."""
    raw = bytes(range(256))
    for _ in range(2):
        client = os.open(pty.link, os.O_RDWR | os.O_NOCTTY)
        os.write(client, raw)
        assert whole(pty.read, len(raw)) == raw
        pty.write(raw)
        assert whole(partial(os.read, client, 1000), len(raw)) == raw
        os.close(client)
        assert pty.read() == b""


def test_a_line_that_nobody_reads_loses_whole_pieces_and_recovers(pty):
    """The buffer fills, later pieces are lost and counted; what a late client reads has no torn piece."""
    piece = b"t2008" + b"AB" * 8 + b"\r"
    for _ in range(5000):
        pty.write(piece)
    assert pty.counters["overrun_bytes"] > 0
    client = os.open(pty.link, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
    read = b""
    for _ in range(100):
        try:
            read += os.read(client, 65536)
        except BlockingIOError:
            break
        pty.write(b"")
    os.close(client)
    assert read.replace(piece, b"") == b""


def test_closing_takes_the_link_away_but_not_another_ones(tmp_path):
    """A link that someone else has put there since stays."""
    first = Pty(tmp_path / "line")
    second = Pty(tmp_path / "line")
    first.close()
    assert second.link.is_symlink()
    second.close()
    assert not second.link.is_symlink()

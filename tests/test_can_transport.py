"""CanTransport over a pty (slcan), python-can's virtual bus, socketcand and udp multicast; and MemoryTransport."""

import os
import select
import socket
import threading
import time
import tty
import uuid

import can
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import ValidationError

from galen_hw.clock import SimulatedClock
from galen_hw.drivers.can_errors import explain
from galen_hw.drivers.can_transport import CanTransport
from galen_hw.drivers.device import CanFrame
from galen_hw.drivers.memory_transport import MemoryTransport
from galen_hw.drivers.slcan_wire import SlcanWire, parse_line
from galen_hw.errors import HardwareError

FRAME = CanFrame(0x200, bytes.fromhex("400000120FFEE6A8"))


def transport(interface, channel, **options):
    return CanTransport(CanTransport.Settings(interface=interface, channel=channel, options=options))


class Adapter:
    """The far end of an slcan port: a pty whose master the test holds."""

    def __init__(self):
        self.master, self.slave = os.openpty()
        tty.setraw(self.slave)
        self.path = os.ttyname(self.slave)

    def read(self, size, seconds=2.0):
        text = b""
        while len(text) < size and select.select([self.master], [], [], seconds)[0]:
            text += os.read(self.master, 4096)
        return text

    def write(self, text):
        os.write(self.master, text)

    def close(self):
        for fd in (self.master, self.slave):
            os.close(fd)


@pytest.fixture
def adapter():
    adapter = Adapter()
    yield adapter
    adapter.close()


@pytest.fixture
def slcan(adapter):
    wire = transport("slcan", adapter.path)
    wire.open()
    adapter.read(7)
    yield wire
    wire.close()


def receive(wire, count, seconds=2.0):
    frames, end = [], time.monotonic() + seconds
    while len(frames) < count and time.monotonic() < end:
        frames += wire.receive(0.1)
    return frames


def test_slcan_opens_without_a_pause_on_a_pty(adapter):
    """Close, bit rate, open, without the two seconds for an adapter that boots."""
    begun = time.monotonic()
    wire = transport("slcan", adapter.path)
    wire.open()
    assert time.monotonic() - begun < 1.0
    assert adapter.read(7) == b"C\rS8\rO\r"
    wire.close()
    assert adapter.read(2) == b"C\r"
    wire.close()


def test_slcan_writes_and_reads_standard_lines(slcan, adapter):
    """Frames become lines and lines frames, with and without data, stamped with CLOCK_MONOTONIC when they were read."""
    slcan.send([CanFrame(0x200), FRAME])
    assert adapter.read(27) == b"t2000\rt2008400000120FFEE6A8\r"
    before = time.monotonic_ns()
    adapter.write(b"z\rt2000\rt7FF10a\rt2008400000120FFEE6A8\r")
    frames = receive(slcan, 3)
    assert [frame for frame, _ in frames] == [CanFrame(0x200), CanFrame(0x7FF, b"\n"), FRAME]
    assert all(before <= t_ns <= time.monotonic_ns() for _, t_ns in frames)
    assert (slcan.counters["sent"], slcan.counters["received"]) == (2, 3)


def test_slcan_counts_what_is_no_data_frame(slcan, adapter):
    """Bells, extended and remote frames, garbage and wrong lengths are counted and not passed on."""
    adapter.write(b"\x07T0000020010A\rr2000\rt20G0\rt2003AA\rt20\r" + b"#" * 200 + b"\rt20010A\r")
    assert [frame for frame, _ in receive(slcan, 1)] == [CanFrame(0x200, b"\n")]
    counters = slcan.counters
    assert counters["rejected"] == 1
    assert counters["not_data"] == 2
    assert counters["malformed"] == 4


@pytest.mark.parametrize("stamp", ["", "EA5F", "ea5f", "03AA6AE0"])
@pytest.mark.parametrize("frame", [CanFrame(0x200), CanFrame(0x7FF, b"\x0a"), FRAME])
def test_slcan_accepts_adapters_that_add_a_time_stamp(slcan, adapter, frame, stamp):
    """Milliseconds in 16 bits, microseconds in 32, or none: the stamp is left out, and nothing is malformed."""
    adapter.write(f"t{frame.arbitration_id:03X}{len(frame.data)}{frame.data.hex()}{stamp}\r".encode())
    assert receive(slcan, 1)[0][0] == frame
    assert (slcan.counters["malformed"], slcan.counters["not_data"]) == (0, 0)


NO_FRAMES = [
    b"t2_0100", b"t+201FF", b"t 201FF", b"t-201FF", b"t0x1100", b"t2009" + b"00" * 9, b"t200A" + b"00" * 10, b"t8000",
    b"tFFF0", b"t2001F F", b"t2001+F", b"t2001_F", b"t2002 0A0", b"t200", b"t20", b"t", b"t2001", b"t2001F", b"t2000F",
    b"t2000FFF", b"t2000FFFFF", b"t20001234567", b"t2000123456789", b"t2001FF\n", b"\nt2001FF", b"t2001\xd9\xa1",
    b"t2001FFt2001FF", b"T2000000", b"T0000020G1FF", b"hello",
]  # fmt: skip


@pytest.mark.parametrize("line", NO_FRAMES)
def test_slcan_takes_nothing_for_a_frame_that_is_none(slcan, adapter, line):
    """Signs, spaces, underscores, prefixes, nine bytes, identifiers beyond 7FF, wrong lengths: malformed, and counted."""
    adapter.write(line + b"\rt2010\r")
    assert [frame for frame, _ in receive(slcan, 1)] == [CanFrame(0x201)]
    assert slcan.counters["malformed"] == 1


STAMPS = st.sampled_from(["", "%04X", "%08x"])


@settings(max_examples=300)
@given(st.integers(0, 0x7FF), st.binary(max_size=8), STAMPS, st.integers(0, 0xFFFF), st.booleans())
def test_slcan_round_trip(identifier, data, stamp, number, upper):
    """What is written reads back as it was, with every kind of stamp and in either case of letters."""
    frame = CanFrame(identifier, data)
    line = SlcanWire.encode(SlcanWire.__new__(SlcanWire), [frame]).removesuffix(b"\r")
    line += (stamp % number if stamp else "").encode()
    assert parse_line(line if upper else b"t" + line[1:].lower()) == frame


@settings(max_examples=500)
@given(st.from_regex(rb"t[0-9A-Fa-f_+ \-xX]{0,30}", fullmatch=True))
def test_slcan_frames_are_what_their_digits_say(line):
    """Any line like a frame: one of hexadecimal digits whose length fits, or an error."""
    try:
        frame = parse_line(line)
    except ValueError:
        return
    assert frame.arbitration_id <= 0x7FF
    assert len(frame.data) <= 8
    text = b"%03x%d%s" % (frame.arbitration_id, len(frame.data), frame.data.hex().encode())
    assert line[1:].lower().startswith(text)
    assert len(line) - 1 - len(text) in (0, 4, 8)


def test_a_closed_channel_is_opened_again(slcan, adapter):
    """Nothing heard for 0.4 s: the opening sequence is sent again, then once a second; frames put it off."""
    begun_ns = slcan.wakeup_ns - 400_000_000
    slcan.tend(slcan.wakeup_ns - 1)
    adapter.write(b"t2010\r")
    assert receive(slcan, 1)
    due_ns = slcan.wakeup_ns
    assert due_ns > begun_ns + 400_000_000
    slcan.tend(due_ns)
    assert adapter.read(7) == b"C\rS8\rO\r"
    assert slcan.wakeup_ns == due_ns + 1_000_000_000
    adapter.write(b"\a\a\rt2010\r")
    slcan.tend(slcan.wakeup_ns)
    assert slcan.counters["reopened"] == 1, "what has arrived and was not read yet is not silence"
    assert receive(slcan, 1)


def test_slcan_notices_that_the_adapter_is_gone(adapter):
    """Unplugged: receive and send raise HardwareError, close does not, and opening again says no such port."""
    other = Adapter()
    wire = transport("slcan", other.path)
    wire.open()
    other.close()
    with pytest.raises(HardwareError, match="the wire is gone"):
        receive(wire, 1)
    with pytest.raises(HardwareError, match="the wire is gone"):
        wire.send([FRAME])
    wire.close()
    with pytest.raises(HardwareError, match="not open"):
        wire.receive(0.0)


def test_slcan_waits_for_parts_of_a_millisecond(slcan):
    """A time-out of 0.2 ms is not rounded up to whole milliseconds (at 3 kHz that would lose slots)."""
    quickest = 1.0
    for _ in range(100):
        begun = time.monotonic()
        assert slcan.receive(0.0002) == []
        quickest = min(quickest, time.monotonic() - begun)
    assert quickest < 0.0009


def test_a_busy_port_is_refused(slcan, adapter):
    """Two programs on one adapter: the second is told that it is busy."""
    with pytest.raises(HardwareError, match="in use by process"):
        transport("slcan", adapter.path).open()
    slcan.send([FRAME])
    assert adapter.read(22) == b"t2008400000120FFEE6A8\r", "the one that was refused has written nothing"


def parser():
    """A wire's parser alone."""
    wire = SlcanWire.__new__(SlcanWire)
    wire.counters, wire._rest = dict.fromkeys(("rejected", "malformed", "not_data"), 0), b""
    return wire


@settings(max_examples=100)
@given(
    frames=st.lists(st.builds(CanFrame, st.integers(0, 0x7FF), st.binary(max_size=8)), max_size=20),
    cuts=st.lists(st.integers(1, 30), max_size=60),
)
def test_slcan_parses_any_chunking(frames, cuts):
    """However the text is cut, the same frames come out; so do they from lower-case adapters."""
    text = b"".join(b"t%03X%d%s\r" % (f.arbitration_id, len(f.data), f.data.hex().encode()) for f in frames)
    wire, found = parser(), []
    for cut in cuts:
        found += wire.parse(text[:cut])
        text = text[cut:]
    found += wire.parse(text)
    assert found == frames
    assert wire.counters["malformed"] == 0


@settings(max_examples=100)
@given(st.lists(st.binary(max_size=60), max_size=20))
def test_slcan_survives_any_noise(chunks):
    """Arbitrary bytes are no exception, and what remains buffered is bounded."""
    wire = parser()
    for chunk in chunks:
        for frame in wire.parse(chunk):
            assert len(frame.data) <= 8
        assert len(wire._rest) <= 160


@pytest.fixture
def virtual():
    channel = uuid.uuid4().hex
    wire = transport("virtual", channel)
    wire.open()
    with can.Bus(channel, "virtual", ignore_config=True) as far:
        yield wire, far
    wire.close()


def test_virtual_carries_frames_both_ways(virtual):
    """Frames in and out of python-can's in-process bus, without a descriptor to wait on."""
    wire, far = virtual
    wire.send([FRAME, CanFrame(0x201)])
    got = far.recv(1.0)
    assert (got.arbitration_id, bytes(got.data), got.is_extended_id) == (0x200, FRAME.data, False)
    far.recv(1.0)
    far.send(can.Message(arbitration_id=0x205, data=b"FT", is_extended_id=False))
    assert receive(wire, 1)[0][0] == CanFrame(0x205, b"FT")
    assert wire.fileno() is None
    assert wire.receive(0.0) == []


def test_error_frames_are_counted_and_not_passed_on(virtual):
    """Error frames by their class (bus-off, error-passive, overrun, no acknowledge, restarted); other kinds of frames
    too."""
    wire, far = virtual
    for kinds, data in ((0x40, b""), (0x04, b"\0\x10"), (0x04, b"\0\x01"), (0x20, b""), (0x100, b"")):
        far.send(can.Message(arbitration_id=kinds, is_error_frame=True, data=data.ljust(8, b"\0")))
    far.send(can.Message(arbitration_id=0x200, is_extended_id=True, data=b"\0"))
    far.send(can.Message(arbitration_id=0x200, is_extended_id=False, is_remote_frame=True))
    assert wire.receive(0.1) == []
    names = ("error_frames", "bus_off", "error_passive", "overruns", "no_acknowledge", "restarted", "not_data")
    assert [wire.counters[name] for name in names] == [5, 1, 1, 1, 1, 1, 2]


def test_socketcand_carries_frames_and_a_closed_connection_is_noticed():
    """Over TCP: frames both ways, and a server that went away is noticed."""
    server = socket.create_server(("127.0.0.1", 0))
    lines, connections = [], []

    def serve():
        connection, _ = server.accept()
        connection.sendall(b"< hi >")
        connection.recv(100)
        connections.append(connection)
        connection.sendall(b"< ok >")
        connection.recv(100)
        connection.sendall(b"< ok >")
        lines.append(connection.recv(100))
        connection.sendall(b"< frame 200 1.5 0A0B >< frame 201 1.5  >")

    thread = threading.Thread(target=serve)
    thread.start()
    host, port = server.getsockname()
    wire = transport("socketcand", "can0", host=host, port=port)
    wire.open()
    wire.send([CanFrame(0x7FF, b"\x0a")])
    assert [frame for frame, _ in receive(wire, 2)] == [CanFrame(0x200, b"\x0a\x0b"), CanFrame(0x201)]
    thread.join()
    assert lines == [b"< send 7FF 1 0A >"]
    assert wire.fileno() is not None
    connections[0].close()
    with pytest.raises(HardwareError, match="its far end was closed"):
        receive(wire, 1)
    wire.close()
    server.close()
    with pytest.raises(HardwareError, match="nobody listens there"):
        wire.open()


def test_udp_multicast_carries_frames_and_shows_our_own():
    """Opt-in interface; a sender receives its own frames, and a stray datagram is counted."""
    wire = transport("udp_multicast", "239.74.163.99", port=43999)
    try:
        wire.open()
    except HardwareError as error:
        pytest.skip(f"no multicast here: {error}")
    try:
        wire.send([FRAME])
        received = receive(wire, 1, 0.5)
        if not received:
            pytest.skip("multicast does not loop here")
        assert received[0][0] == FRAME
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stray:
            stray.sendto(b"\x01not msgpack", ("239.74.163.99", 43999))
        assert receive(wire, 1, 0.3) == []
        assert wire.counters["malformed"] == 1
    finally:
        wire.close()


@pytest.mark.parametrize(
    ("interface", "channel", "words"),
    [
        ("slcan", "/dev/ttyNOSUCH9", "slcan:/dev/ttyNOSUCH9: no such port; check that"),
        ("slcan", "/dev/null", "slcan:/dev/null: this is not a serial port; give the port"),
        ("udp_multicast", "nonsense.invalid", "udp_multicast:nonsense.invalid: "),
        ("socketcan", "can99", "socketcan:can99: "),
    ],
)
def test_what_cannot_be_opened_is_one_clear_line(interface, channel, words, capfd):
    """No such port or interface: one line with what, where and what to do, and nothing else on the terminal."""
    with pytest.raises(HardwareError) as raised:
        transport(interface, channel).open()
    assert words in str(raised.value)
    assert "\n" not in str(raised.value)
    assert raised.value.todo
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize(
    ("interface", "number", "words"),
    [
        ("socketcan", 97, "no SocketCAN"),
        ("socketcan", 19, "no such CAN interface"),
        ("socketcan", 100, "ip link set can0 up"),
        ("socketcan", 1, "no permission"),
        ("slcan", 13, "dialout"),
        ("slcan", 16, "another program has it open"),
        ("slcan", 11, "another program has it open"),
        ("socketcand", 111, "nobody listens there"),
        ("socketcand", 113, "no way to that host"),
    ],
)
def test_the_systems_reasons_are_put_into_words(interface, number, words):
    """Error numbers, also behind exceptions of python-can, become what and what to do."""
    wrapped = can.CanInitializationError("could not")
    wrapped.__cause__ = OSError(number, "x")
    for error in (OSError(number, "x"), wrapped):
        assert words in str(explain(interface, "can0", error))


def test_settings_refuse_what_cannot_be():
    """Unknown interfaces and keys, bit rates an slcan adapter has no code for, socketcand without a server."""
    for wrong in (
        {"interface": "pcan9"},
        {"bit_rate": 5},
        {"interface": "slcan", "channel": "/dev/ttyACM0", "bitrate": 300_000},
        {"interface": "socketcand", "channel": "can0"},
        {"interface": "slcan", "channel": "/dev/ttyACM0", "options": {"bootrate": 1}},
        {"interface": "slcan", "channel": "/dev/ttyACM0", "options": {"tty_baudrate": "fast"}},
        {"interface": "socketcand", "channel": "can0", "options": {"host": "x", "port": 1.5}},
        {"channel": ""},
    ):
        with pytest.raises(ValidationError):
            CanTransport.Settings(**wrong)


def test_memory_transport_is_a_wire():
    """In order, stamped by the clock, nothing through a closed or broken wire, and waiting turns the simulated
    clock."""
    clock = SimulatedClock(5)
    left, right = MemoryTransport[CanFrame].pair(clock)
    with pytest.raises(HardwareError, match="not open"):
        left.send([FRAME])
    left.open()
    right.open()
    left.send([FRAME, CanFrame(1)])
    assert right.receive(1.0) == [(FRAME, 5), (CanFrame(1), 5)]
    assert right.receive(1.0) == []
    assert clock.now_ns == 1_000_000_005
    left.break_wire()
    for end in (left, right):
        with pytest.raises(HardwareError, match="broken"):
            end.receive(0.0)
    with pytest.raises(HardwareError, match="broken"):
        right.open()
    left.break_wire(broken=False)
    right.send([FRAME])
    assert [frame for frame, _ in left.receive(0.0)] == [FRAME]
    assert left.counters == {"received": 1, "sent": 2}
    left.close()
    left.close()

"""Serial transport over real pseudo terminals and sockets of this machine."""

import contextlib
import os
import pty
import socket
import sys
import termios
import time
import tty
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent))

from galen_hw.drivers.serial_line import LineChange, LineControl
from galen_hw.drivers.serial_transport import SerialTransport
from galen_hw.errors import HardwareError


@pytest.fixture
def ends():
    """The master's descriptor and the slave's path of a pseudo terminal; both are closed at the end."""
    master, slave = pty.openpty()
    tty.setraw(slave)
    yield master, os.ttyname(slave)
    for fd in (master, slave):
        with contextlib.suppress(OSError):
            os.close(fd)


@pytest.fixture
def transport(ends):
    """An open transport on the slave."""
    opened = SerialTransport(SerialTransport.Settings(url=ends[1]))
    opened.open()
    yield opened
    opened.close()


def read_all(transport, count):
    """Read until `count` bytes have come."""
    found = []
    while sum(len(data) for data, _ in found) < count:
        part = transport.receive(1.0)
        assert part, "nothing came"
        found += part
    return found


def heard(fd, count):
    """`count` bytes from a descriptor, in as many reads as it takes: a terminal may hand over a part."""
    data = b""
    while len(data) < count:
        data += os.read(fd, count - len(data))
    return data


def test_bytes_both_ways_are_stamped_and_counted(ends, transport):
    """All bytes arrive in order, also those that terminals like to change; times are those of the reads."""
    everything = bytes(range(256)) * 4
    before = time.monotonic_ns()
    os.write(ends[0], everything)
    found = read_all(transport, len(everything))
    assert b"".join(data for data, _ in found) == everything
    assert all(before < t_ns <= time.monotonic_ns() for _, t_ns in found)
    transport.send([b"TP\r", b"\x00\x11\x13\xff"])
    sent = b"TP\r\x00\x11\x13\xff"
    assert heard(ends[0], len(sent)) == sent
    assert transport.counters["bytes_in"] == len(everything)
    assert transport.counters["bytes_out"] == 7


def test_nothing_to_read_returns_at_the_time_out(transport):
    """receive(0) does not wait; a descriptor tells when there is something."""
    assert transport.receive(0.0) == []
    assert transport.fileno() is not None


def test_line_control_changes_the_baud_rate_in_its_turn(ends, transport):
    """What was sent before goes at the old rate; the slave's settings are visible from the master."""
    transport.send([b"COMM:50000", LineControl(LineChange(baud_rate=9600)), b"next"])
    assert termios.tcgetattr(ends[0])[4] == termios.B9600
    assert heard(ends[0], 14) == b"COMM:50000next"
    transport.send([LineControl(LineChange(break_on=True)), LineControl(LineChange(break_on=False))])
    assert transport.counters["line_changes"] == 3


def test_second_opening_is_refused(ends, transport):
    """A port belongs to one program."""
    assert transport.fileno() is not None
    with pytest.raises(HardwareError, match="in use by process"):
        SerialTransport(SerialTransport.Settings(url=ends[1])).open()


@pytest.mark.parametrize(
    ("url", "words"),
    [
        ("/dev/no-such-port", "no such port"),
        ("/etc/hostname", "not a serial port"),
        ("/tmp", "a folder, not a serial port"),
        ("fax://there", "not a port and not a URL"),
    ],
)
def test_failures_to_open_are_one_clear_line(url, words):
    """What, where and what to do."""
    with pytest.raises(HardwareError, match=words) as caught:
        SerialTransport(SerialTransport.Settings(url=url)).open()
    assert "\n" not in str(caught.value)
    assert caught.value.where == url
    assert caught.value.todo


@pytest.mark.skipif(os.geteuid() == 0, reason="the superuser may open everything")
def test_no_permission(ends):
    """The group to join is named."""
    Path(ends[1]).chmod(0)
    with pytest.raises(HardwareError, match="no permission"):
        SerialTransport(SerialTransport.Settings(url=ends[1])).open()


def test_device_that_goes_away(ends, transport):
    """A closed master (an unplugged adapter) is a hardware error for readers and writers, and closing twice is fine."""
    os.close(ends[0])
    with pytest.raises(HardwareError, match="the device is gone"):
        transport.receive(1.0)
    with pytest.raises(HardwareError, match="gone"):
        transport.send([b"x"])
    transport.close()
    transport.close()
    with pytest.raises(HardwareError, match="not open"):
        transport.receive(0.0)


def test_a_peer_that_takes_nothing(ends, transport):
    """A full line ends in an error after the time-out, not in a hang."""
    slow = SerialTransport(SerialTransport.Settings(url=ends[1], write_timeout_s=0.05))
    transport.close()
    slow.open()
    with pytest.raises(HardwareError, match="takes no bytes"):
        slow.send([bytes(200_000)])
    slow.close()


def test_the_same_over_a_socket():
    """socket:// reads in chunks, has a descriptor, ignores changes of the line, and notices the end."""
    with socket.create_server(("127.0.0.1", 0)) as server:
        url = f"socket://127.0.0.1:{server.getsockname()[1]}"
        transport = SerialTransport(SerialTransport.Settings(url=url))
        transport.open()
        peer, _ = server.accept()
        with peer:
            peer.sendall(bytes(500))
            assert sum(len(data) for data, _ in read_all(transport, 500)) == 500
            assert transport.counters["reads"] <= 3
            assert transport.fileno() is not None
            transport.send([LineControl(LineChange(baud_rate=9600, break_on=True)), b"QR\r"])
            assert peer.recv(10) == b"QR\r"
        with pytest.raises(HardwareError, match="gone"):
            transport.receive(1.0)
        transport.close()
    with pytest.raises(HardwareError, match="nothing listens"):
        SerialTransport(SerialTransport.Settings(url=url)).open()


def test_loop_has_no_descriptor_and_still_reads():
    """A URL without a descriptor is read by time-out, for a thread of the shell."""
    transport = SerialTransport(SerialTransport.Settings(url="loop://"))
    transport.open()
    assert transport.fileno() is None
    transport.send([b"abc"])
    assert b"".join(data for data, _ in read_all(transport, 3)) == b"abc"
    assert transport.receive(0.0) == []
    transport.close()

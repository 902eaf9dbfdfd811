"""Socketcand servers as they are: a stream that is cut anywhere, one that is busy already, one that refuses."""

import contextlib
import socket
import threading
import time

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from galen_hw.drivers.can_errors import ERROR_COUNTERS
from galen_hw.drivers.can_transport import CanTransport
from galen_hw.drivers.device import CanFrame
from galen_hw.drivers.socketcand_wire import SocketcandWire
from galen_hw.drivers.virtual.start import virtual_robot
from galen_hw.errors import HardwareError

FRAMES = b"< frame 001 1.000000 0B00010002000300 >< frame 002 1.000000 0400050006000000 >"

EARLY = [CanFrame(1, bytes.fromhex("0B00010002000300")), CanFrame(2, bytes.fromhex("0400050006000000"))]


class Server:
    """Answers each connection with `answers`, one for what it hears each time; cut into `pieces` bytes."""

    def __init__(self, *answers, pieces=1 << 16):
        self.heard = []
        self._answers, self._pieces = answers, pieces
        self._server = socket.create_server(("127.0.0.1", 0))
        self.port = self._server.getsockname()[1]
        self._thread = threading.Thread(target=self._serve, daemon=True)
        self._thread.start()

    def _serve(self):
        connection, _ = self._server.accept()
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        with connection, contextlib.suppress(OSError):  # the client may leave at any time
            for answer in self._answers:
                for start in range(0, len(answer), self._pieces):
                    connection.sendall(answer[start : start + self._pieces])
                data = connection.recv(4096)
                self.heard.append(data)
                if not data:
                    return

    def transport(self):
        options = {"host": "127.0.0.1", "port": self.port}
        return CanTransport(CanTransport.Settings(interface="socketcand", channel="can0", options=options))

    def __enter__(self):
        return self

    def __exit__(self, *_):
        with socket.socket() as last:
            last.connect_ex(("127.0.0.1", self.port))
        self._server.close()
        self._thread.join(5.0)


def received(wire, count):
    frames, end = [], time.monotonic() + 2.0
    while len(frames) < count and time.monotonic() < end:
        frames += [frame for frame, _ in wire.receive(0.1)]
    return frames


@pytest.mark.parametrize("pieces", [1, 7, 1 << 16])
@pytest.mark.parametrize(
    ("hi", "opened", "raw"),
    [
        (b"< hi >", b"< ok >", b"< ok >" + FRAMES),
        (b"< hi >", b"< ok >" + FRAMES, b"< ok >" + FRAMES),
        (b"< hi >", FRAMES + b"< ok >", FRAMES + b"< ok >" + FRAMES),
        (b"< hi >\n", b"< ok >\n", b"< ok >\n" + FRAMES),
    ],
)
def test_a_server_that_already_streams_can_be_opened(hi, opened, raw, pieces):
    """Frames before, behind and in one segment with `< ok >`, in any pieces: it opens, and what follows is read."""
    with Server(hi, opened, raw, b"< frame 7FF 2.0 0A >", pieces=pieces) as server:
        wire = server.transport()
        wire.open()
        wire.send([CanFrame(0x123, b"\1\2")])
        last, frames = CanFrame(0x7FF, b"\n"), []
        while last not in frames and (more := received(wire, 1)):
            frames += more
        assert frames[-1] == last
        assert set(frames) <= {last, *EARLY}
        assert wire.counters["malformed"] == 0
        wire.close()
    assert server.heard[:3] == [b"< open can0 >", b"< rawmode >", b"< send 123 2 01 02 >"]


@pytest.mark.parametrize(
    ("answers", "words"),
    [
        ((b"< hi >", b"< error could not open bus >"), "'< error could not open bus >' to '< open can0 >'; does the"),
        ((b"< hi >", b"< ok >", b"< error unknown >"), "to '< rawmode >'"),
        ((b"SSH-2.0-OpenSSH_9.6\r\n",), "no socketcand server; check host and port"),
        ((b"<html><body>",), "'<html>' to the connection"),
        ((b"< hi >", b""), "no answer to '< open can0 >' within 2 s"),
        ((b"< hi >",), "closed the connection without an answer to '< open can0 >'"),
        ((b"x" * 1000,), "no socketcand server"),
    ],
)
def test_what_the_server_says_is_the_reason(answers, words):
    """A refusal, another kind of server, silence, a closed connection: the line names that, and not the settings."""
    with Server(*answers) as server:
        begun = time.monotonic()
        with pytest.raises(HardwareError) as raised:
            server.transport().open()
        assert words in str(raised.value)
        assert "127.0.0.1" in str(raised.value)
        assert time.monotonic() - begun < 10.0


def test_a_streaming_virtual_sensor_is_opened_every_time():
    """The Robotous sensor streams at 1 kHz while the connection is made anew, twenty times."""
    with virtual_robot(sensor="robotous_rft", can="socketcand") as robot:
        address = robot.addresses["can0"]
        options = {key: address[key] for key in ("host", "port")}
        wire = CanTransport(CanTransport.Settings(interface="socketcand", channel="can0", options=options))
        wire.open()
        for command in ("0F08", "0B"):
            wire.send([CanFrame(0x64, bytes.fromhex(command).ljust(8, b"\0"))])
        assert received(wire, 20)
        for _ in range(20):
            wire.open()
            assert len(received(wire, 10)) >= 10
        assert wire.counters["malformed"] == 0
        wire.close()


def parser():
    wire = SocketcandWire.__new__(SocketcandWire)
    wire.counters, wire._rest = dict.fromkeys(("malformed", "not_data", *ERROR_COUNTERS), 0), b""
    return wire


@settings(max_examples=200)
@given(
    frames=st.lists(st.builds(CanFrame, st.integers(0, 0x7FF), st.binary(max_size=8)), max_size=20),
    cuts=st.lists(st.integers(1, 60), max_size=60),
    separator=st.sampled_from(["", " "]),
)
def test_frames_read_back_in_any_chunks(frames, cuts, separator):
    """Data in one word, as the server writes them, or byte by byte, as its manual says; cut anywhere."""
    text = "".join(
        f"< frame {f.arbitration_id:03X} 23.424242 {f.data.hex(separator) if separator else f.data.hex()} >"
        for f in frames
    ).encode()
    wire, found = parser(), []
    for cut in cuts:
        found += wire.parse(text[:cut])
        text = text[cut:]
    assert found + wire.parse(text) == frames
    assert wire.counters["malformed"] == 0


@pytest.mark.parametrize(
    ("text", "counter"),
    [
        ("< frame 00000123 1.0 0A >", "not_data"),
        ("< frame 1FFFFFFF 1.0 >", "not_data"),
        ("< error 040 1.000000 >", "bus_off"),
        ("< frame 800 1.0 0A >", "malformed"),
        ("< frame +20 1.0 0A >", "malformed"),
        ("< frame 2_0 1.0 0A >", "malformed"),
        ("< frame 200 1e999 0A >", "malformed"),
        ("< frame 200 1.0 A >", "malformed"),
        ("< frame 200 1.0 +A >", "malformed"),
        ("< frame 200 1.0 " + "00" * 9 + " >", "malformed"),
        ("< frobnicate >", "malformed"),
        ("garbage >", "malformed"),
        ("<" * 1000, "malformed"),
    ],
)
def test_all_else_is_counted(text, counter):
    """Extended frames, error frames by their class, and what is no frame; the next frame is read."""
    wire = parser()
    assert wire.parse(text.encode()) == []
    assert wire.counters[counter] == 1
    assert wire.parse(b"< frame 201 1.0 0A >") == [CanFrame(0x201, b"\x0a")]

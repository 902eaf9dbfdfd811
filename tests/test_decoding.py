"""What comes in on a socket is what it should be or one typed error, whatever the bytes."""

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import msgpack
import pytest
import zmq
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from galen_hw.bus import CommandClient
from galen_hw.config.paths import Addresses
from galen_hw.daemon.broker import Broker
from galen_hw.daemon.links import Beat
from galen_hw.decoding import (
    DEEPEST,
    LARGEST_REQUEST,
    LONGEST_NAME,
    Reader,
    UnreadableError,
    decode_batch,
    decode_message,
    decode_reply,
    decode_request,
    id_of,
)
from galen_hw.errors import UsageError
from galen_hw.messages import TOPICS, CommandError, Message, Reply, Request, encode

HEAD = b"\x84\xa2id\xa11\xa6target\xa1a\xa4name\xa1b\xa4args\x81\xa1a"
NOT_UTF8 = HEAD + b"\xa1\xff"
NESTED = HEAD + b"\x91" * 1000 + b"\xc0"
SERVICE = "compensation"


def request_of(args: dict[str, Any]) -> bytes:
    return msgpack.packb({"id": "1", "target": "a", "name": "b", "args": args})


def nested(depth: int) -> dict[str, Any]:
    inside: dict[str, Any] = {}
    for _ in range(depth - 1):
        inside = {"a": inside}
    return inside


_leaves = st.none() | st.booleans() | st.integers(-(2**63), 2**64 - 1) | st.floats() | st.text() | st.binary(max_size=9)
_values = st.recursive(
    _leaves,
    lambda inner: (
        st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=3) | st.integers(0, 9), inner, max_size=3)
    ),
    max_leaves=6,
)
_maps = st.dictionaries(
    st.sampled_from(["id", "target", "name", "args", "version", "result", "error", "t_ns", "force", "devices"]), _values
).map(msgpack.packb)


@st.composite
def frames(draw: st.DrawFn) -> bytes:
    """Any bytes; packed maps with the right keys, some cut or with a byte changed; deep nesting; text that is none."""
    raw = draw(
        st.binary(max_size=200)
        | _maps
        | st.sampled_from([NOT_UTF8, NESTED, encode(Request(id="1", target="a", name="b"))])
    )
    if raw and draw(st.booleans()):
        at = draw(st.integers(0, len(raw) - 1))
        raw = raw[:at] + draw(st.binary(max_size=2)) + raw[at + draw(st.integers(0, 2)) :]
    return raw


def take(decoder: Callable[[], Any]) -> Any:
    """What a decoder gives, or its one error."""
    try:
        return decoder()
    except UnreadableError as error:
        return error


@given(frames(), st.sampled_from(sorted(TOPICS)).map(str.encode) | st.binary(max_size=20))
@settings(max_examples=150)
def test_any_bytes_are_what_the_socket_takes_or_the_typed_error(frame: bytes, topic: bytes) -> None:
    """Command, control (heartbeat, reply) and bus: no decoder raises anything else, and what it gives can be sent on."""
    request = decode_request(frame)
    assert isinstance(request, Request | CommandError)
    encode(request)
    assert isinstance(id_of(frame), str)
    assert isinstance(take(lambda: decode_reply(frame)), Reply | UnreadableError)
    assert isinstance(take(lambda: Reader(Beat)(frame)), Beat | UnreadableError)
    assert isinstance(take(lambda: decode_batch(frame)), list | UnreadableError)
    message = take(lambda: decode_message(topic, frame))
    assert isinstance(message, UnreadableError) or isinstance(message[1], Message)


@pytest.mark.parametrize(
    ("frame", "what"),
    [
        (NOT_UTF8, "text that is not UTF-8"),
        (NESTED, "nested too deep"),
        (request_of(nested(DEEPEST + 1)), "nested deeper than 16"),
        (request_of({"a": "x" * LARGEST_REQUEST}), "bytes are more than 65536"),
        (request_of({"a": b"x"}), "bytes where numbers, text, lists and maps are taken"),
        (request_of({"a": {1: 2}}), "dict where"),
        (HEAD + b"\xdd\xff\xff\xff\xff", "truncated"),
        (msgpack.packb({"id": "1", "target": "a" * (LONGEST_NAME + 1), "name": "b"}), "longer than 64 letters"),
        (b"", "truncated"),
    ],
)
def test_what_is_no_request_says_why(frame: bytes, what: str) -> None:
    """Each bound has its own words; the limits themselves are still taken."""
    error = decode_request(frame)

    assert isinstance(error, CommandError)
    assert error.kind == "invalid"
    assert what in error.what
    assert isinstance(decode_request(request_of(nested(DEEPEST))), Request)


def test_the_sender_of_an_unreadable_request_is_told_under_its_own_id() -> None:
    """Arguments that cannot be read do not hide who asked: else the client would wait for an answer that it has."""
    assert id_of(NOT_UTF8) == "1"
    assert id_of(b"\xc1") == ""


@pytest.mark.parametrize("args", [{"a": 10**30}, {"a": "\ud800"}, {"a": "x" * LARGEST_REQUEST}, {"a": object()}])
def test_what_cannot_be_sent_is_one_line(tmp_path: Path, args: dict[str, Any]) -> None:
    """Numbers beyond 64 bits, half a surrogate, and too much of it are refused where they are typed."""
    with CommandClient(f"ipc://{tmp_path}/command") as client, pytest.raises(UsageError, match="motors move_jp: "):
        client.call("motors", "move_jp", args, timeout_s=0.1)


class Wires:
    """A broker with two foreign peers: one on `command`, one on `control` that calls itself a process, one without a name."""

    def __init__(self, folder: Path) -> None:
        addresses = Addresses(folder)
        self.broker = Broker(addresses, {"compensation": "core"}, ["core"], 30.0, lambda: {"ready": True})
        self.peers = []
        for address, identity in ((addresses.command, b""), (addresses.control, b""), (addresses.control, b"core")):
            peer: zmq.Socket[Any] = zmq.Context.instance().socket(zmq.DEALER)
            peer.setsockopt(zmq.LINGER, 0)
            if identity:
                peer.setsockopt(zmq.IDENTITY, identity)
            peer.connect(address)
            self.peers.append(peer)

    def close(self) -> None:
        for peer in self.peers:
            peer.close()
        self.broker.close()


@pytest.fixture(scope="module")
def wires(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Wires]:
    own = Wires(tmp_path_factory.mktemp("w"))
    yield own
    own.close()


@given(
    st.lists(frames() | st.sampled_from([b"", b"beat", b"reply", b"request"]), min_size=1, max_size=12),
    st.integers(0, 2),
)
@settings(max_examples=60, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_no_message_ends_the_broker(wires: Wires, message: list[bytes], who: int) -> None:
    """Over real sockets: any number of any frames from any peer is taken, and a client's is answered."""
    wires.peers[who].send_multipart(message)
    own = wires.broker.sockets[min(who, 1)]
    assert own.poll(10_000)
    wires.broker.step()
    if who == 0:
        assert wires.peers[0].poll(10_000)
        assert isinstance(decode_reply(wires.peers[0].recv_multipart()[-1]), Reply)


def test_frames_of_strangers_are_counted_and_their_names_are_not_taken(wires: Wires) -> None:
    """A peer of `control` that is no process of this daemon cannot beat for one."""
    before, beats = wires.broker.unreadable, dict(wires.broker.beats)
    wires.peers[1].send_multipart([b"beat", encode(Beat(progress=5))])
    assert wires.broker.sockets[1].poll(10_000)
    wires.broker.step()

    assert wires.broker.unreadable == before + 1
    assert wires.broker.beats == beats

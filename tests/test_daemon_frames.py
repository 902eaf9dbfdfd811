"""Foreign frames on every socket of a running daemon: answered or counted, and nothing ends."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import msgspec
import pytest
import zmq

from galen_hw.decoding import decode_reply
from galen_hw.messages import Reply
from tests.daemon_tree import Tree, daemon_tree, within
from tests.test_decoding import NESTED, NOT_UTF8, request_of


@pytest.fixture(scope="module")
def running(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Tree]:
    with daemon_tree(tmp_path_factory.mktemp("d")) as tree:
        tree.write_config()
        tree.start_ready()
        yield tree


def dealer(address: str, identity: bytes = b"") -> "zmq.Socket[Any]":
    socket: zmq.Socket[Any] = zmq.Context.instance().socket(zmq.DEALER)
    socket.setsockopt(zmq.LINGER, 1000)
    if identity:
        socket.setsockopt(zmq.IDENTITY, identity)
    socket.connect(address)
    return socket


def ask(address: str, frame: bytes) -> Reply:
    with dealer(address) as client:
        client.send_multipart([b"", frame])
        assert client.poll(10_000), "no answer"
        return decode_reply(client.recv_multipart()[-1])


def alive_as_before(tree: Tree, pids: dict[str, int]) -> bool:
    with tree.subscriber("wrench/compensated") as subscriber:
        return tree.call("daemon", "info")["processes"] == pids and subscriber.receive(10.0) is not None


@pytest.mark.parametrize("frame", [NOT_UTF8, NESTED, request_of({"a": "x" * 70_000})])
def test_an_unreadable_request_is_answered_and_ends_nothing(running: Tree, frame: bytes) -> None:
    """Text that is not UTF-8, a thousand nested lists, and more bytes than a request may have: `invalid`, counted."""
    info = running.call("daemon", "info")
    reply = ask(running.addresses.command, frame)

    assert reply.error is not None
    assert reply.error.kind == "invalid"
    assert reply.id in ("1", "")
    assert alive_as_before(running, info["processes"])
    assert running.call("daemon", "info")["unreadable_frames"] == info["unreadable_frames"] + 1


@pytest.mark.parametrize(
    "message", [[b"beat", b"\xff"], [b"x"], [b"reply", NOT_UTF8], [b"", b"", b"", b""], [b"request", NESTED]]
)
def test_a_stranger_on_control_ends_nothing(running: Tree, message: list[bytes]) -> None:
    """A DEALER without an identity gets random bytes for a name: it is no process, so that its frames are counted."""
    info = running.call("daemon", "info")
    with dealer(running.addresses.control) as stranger:
        stranger.send_multipart(message)
        counted = within(10.0, lambda: running.call("daemon", "info")["unreadable_frames"] > info["unreadable_frames"])

    assert counted
    assert alive_as_before(running, info["processes"])


def test_foreign_frames_between_the_processes_end_none_of_them(running: Tree) -> None:
    """What is pushed inward is no topic, or a topic with a payload that is none: `core` counts it and goes on."""
    info = running.call("daemon", "info")
    with running.subscriber("status") as subscriber, zmq.Context.instance().socket(zmq.PUSH) as push:
        push.setsockopt(zmq.LINGER, 1000)
        push.connect(running.addresses.inward)
        for frames in ([b"x"], [b"\xff\xfe", b""], [b"joints/state", NOT_UTF8], [b"joints/state", NESTED], [b""] * 3):
            push.send_multipart(frames)

        def counted() -> bool:
            received = subscriber.receive(2.0)
            return received is not None and getattr(received[1], "counters", {}).get("unreadable", 0) >= 5

        assert within(10.0, counted)
    assert alive_as_before(running, info["processes"])


def test_every_message_says_which_robot_and_whether_it_is_virtual(running: Tree) -> None:
    """In the header of each message of each process; this test's devices are on real wires."""
    heard: dict[str, tuple[str, bool]] = {}
    with running.subscriber() as subscriber:
        for _ in range(300):
            if received := subscriber.receive(5.0):
                heard[received[0]] = (received[1].robot, received[1].virtual)

    assert {"wrench/raw", "wrench/compensated", "joints/state", "status"} <= heard.keys()
    assert set(heard.values()) == {("galen", False)}


def test_info_takes_no_arguments(running: Tree) -> None:
    """An unknown key of a request is refused everywhere, also by the daemon itself."""
    reply = ask(
        running.addresses.command,
        msgspec.msgpack.encode({"id": "7", "target": "daemon", "name": "info", "args": {"x": 1}}),
    )

    assert reply.id == "7"
    assert reply.error is not None
    assert "info takes no x" in reply.error.what


def test_sockets_of_the_processes_are_the_owners_alone(running: Tree) -> None:
    """The directory of this test is the owner's (0700), and so are all its sockets."""
    modes = {
        name: (running.addresses.runtime / name).stat().st_mode & 0o777
        for name in ("bus.pub", "batches", "command", "inward", "control")
    }

    assert modes == dict.fromkeys(modes, 0o700)
    assert Path(running.addresses.runtime).stat().st_mode & 0o777 == 0o700

"""The bus over real ZeroMQ sockets: what is sent arrives as it is, a slow subscriber costs nobody but itself."""

import itertools
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import msgspec
import pytest
import zmq
from hypothesis import given
from hypothesis import strategies as st

from galen_hw.bus import (
    BATCH_TOPIC,
    LARGEST_BATCH,
    MOST_ASKED,
    Batcher,
    CommandClient,
    HeedingPublisher,
    Publisher,
    Subscriber,
    command_error,
    command_exception,
)
from galen_hw.decoding import decode_batch, decode_message, decode_request
from galen_hw.errors import CommandRejectedError, GalenError, HardwareError, UsageError
from galen_hw.messages import STREAMS, TOPICS, CommandError, Reply, Request, Vector3, WrenchRaw, encode


def wrench(seq: int, source: str = "ft") -> WrenchRaw:
    force = Vector3(x=1.0, y=2.0, z=float(seq))
    return WrenchRaw(timestamp=1.5e9, t_ns=seq, seq=seq, valid=True, source=source, force=force, torque=Vector3())


@pytest.fixture
def bus(tmp_path: Path) -> str:
    return f"ipc://{tmp_path}/bus.pub"


def publish_until_heard(publisher: Publisher, subscriber: Subscriber) -> None:
    """A subscription takes effect some time after it is made."""
    for _ in range(1000):
        publisher.publish("wrench/raw", wrench(0, "settling"))
        if subscriber.receive(0.01) is not None:
            break
    while subscriber.receive(0.05) is not None:
        pass


@pytest.fixture
def pair(bus: str) -> Iterator[tuple[Publisher, Subscriber]]:
    with Publisher(bus) as publisher, Subscriber(bus, ["wrench/raw"], as_published=True) as subscriber:
        publish_until_heard(publisher, subscriber)
        yield publisher, subscriber


def test_message_arrives_as_it_was_sent(pair: tuple[Publisher, Subscriber]) -> None:
    """Topic and message are equal on both ends."""
    publisher, subscriber = pair
    publisher.publish("wrench/raw", wrench(1))

    assert ("wrench/raw", wrench(1)) == subscriber.receive(1.0)


def test_gaps_in_seq_are_counted_per_source_and_restarts_are_not(pair: tuple[Publisher, Subscriber]) -> None:
    """Two sources interleave; one loses three, the other starts again from zero."""
    publisher, subscriber = pair
    for message in (wrench(1), wrench(7, "b"), wrench(2), wrench(6), wrench(0, "b"), wrench(1, "b")):
        publisher.publish("wrench/raw", message)
    for _ in range(6):
        assert subscriber.receive(1.0) is not None

    assert subscriber.lost == {"wrench/raw": 3}


def test_what_is_no_message_is_counted_and_passed_over(pair: tuple[Publisher, Subscriber]) -> None:
    """Foreign topics, cut and random payloads never end a subscriber."""
    publisher, subscriber = pair
    publisher.publish_bytes(b"wrench/raw2", b"x")
    publisher.publish_bytes(b"wrench/raw", b"\xc1")
    publisher.publish_bytes(b"wrench/raw", encode(wrench(1))[:-3])
    publisher.publish("wrench/raw", wrench(5))
    received = subscriber.receive(1.0)

    assert received is not None
    assert received[1] == wrench(5)
    assert subscriber.unreadable == 3


def look_until(publisher: HeedingPublisher, unasked: frozenset[str]) -> bool:
    """Return whether what nobody asks for becomes this: a subscription takes effect some time after it is made."""
    until = time.monotonic() + 10.0
    while time.monotonic() < until:
        publisher.look()
        if publisher.unasked == unasked:
            return True
        time.sleep(0.005)
    return False


def test_what_nobody_asks_for_is_known(bus: str) -> None:
    """Streams only; by beginnings of names, as ZeroMQ has it; until the last subscriber has gone. Junk asks for nothing."""
    wrenches = {"wrench/raw", "wrench/compensated", "wrench/contact"}
    with HeedingPublisher(bus) as publisher:
        assert not publisher.unasked
        publisher.look()
        assert publisher.unasked == STREAMS
        with Subscriber(bus, ["wrench/", "nothing/of/this", "wrench/rawer"]), Subscriber(bus, ["wrench/raw"]):
            assert look_until(publisher, STREAMS - wrenches)
            with Subscriber(bus):
                assert look_until(publisher, frozenset())
            assert look_until(publisher, STREAMS - wrenches)
        assert look_until(publisher, STREAMS)


def test_a_crowd_of_subscriptions_hides_no_subscriber(bus: str) -> None:
    """While more is asked than is looked at in one go, everything counts as asked for; afterwards what is asked for does."""
    with HeedingPublisher(bus) as publisher, Subscriber(bus, ["joints/state"]) as crowd:
        assert look_until(publisher, STREAMS - {"joints/state"})
        for n in range(3 * MOST_ASKED):
            crowd.socket.setsockopt(zmq.SUBSCRIBE, b"junk/%d" % n)
        time.sleep(0.5)
        publisher.look()
        assert publisher.unasked == frozenset()
        assert look_until(publisher, STREAMS - {"joints/state"})


def test_slow_subscriber_slows_nobody(bus: str) -> None:
    """With one subscriber that never reads, no send takes long, another hears all, and the sleeper sees its loss."""
    with Publisher(bus, queue=5000) as publisher, Subscriber(bus, queue=10) as asleep, Subscriber(bus) as awake:
        publish_until_heard(publisher, awake)
        publish_until_heard(publisher, asleep)
        while awake.receive(0.05) is not None:
            pass
        sent, slowest = 20_000, 0.0
        heard = 0
        for seq in range(1, sent + 1):
            begun = time.perf_counter()
            publisher.publish("wrench/raw", wrench(seq))
            slowest = max(slowest, time.perf_counter() - begun)
            if seq % 200 == 0:
                # Patient: who gives up here would let the backlog of a starved machine pass for a loss.
                while heard < seq and awake.receive(30.0) is not None:
                    heard += 1
        until = time.monotonic() + 60.0
        for seq in itertools.count(sent + 1):
            if asleep.lost or time.monotonic() > until:
                break
            publisher.publish("wrench/raw", wrench(seq))  # one that finds the queue full is lost too
            asleep.receive(0.05)

    assert heard == sent
    assert awake.lost == {}
    assert asleep.lost["wrench/raw"] > 0
    assert slowest < 0.5


def test_address_in_use_is_one_line(tmp_path: Path) -> None:
    """A second publisher on a port is refused with what to do."""
    with Publisher("tcp://127.0.0.1:*") as first:
        address = first.socket.getsockopt(zmq.LAST_ENDPOINT).decode()
        with pytest.raises(HardwareError, match=r"cannot bind .*; is another daemon running"):
            Publisher(address)


def answer(address: str, replies: list[Reply]) -> threading.Thread:
    """A daemon's command socket that gives these answers."""

    def serve() -> None:
        context: zmq.Context[Any] = zmq.Context()
        with context, context.socket(zmq.ROUTER) as router:
            router.bind(address)
            for reply in replies:
                *route, payload = router.recv_multipart()
                request = decode_request(payload)
                assert isinstance(request, Request)
                router.send_multipart([*route, encode(msgspec.structs.replace(reply, id=reply.id or request.id))])
            router.setsockopt(zmq.LINGER, 1000)

    thread = threading.Thread(target=serve)
    thread.start()
    return thread


@pytest.mark.parametrize(
    ("kind", "expected"),
    [
        ("rejected", CommandRejectedError),
        ("unknown", UsageError),
        ("invalid", UsageError),
        ("timeout", HardwareError),
        ("fault", HardwareError),
    ],
)
def test_typed_errors_become_exceptions(tmp_path: Path, kind: str, expected: type[GalenError]) -> None:
    """Each kind of error of a reply is its exception, with what, where and todo."""
    address = f"ipc://{tmp_path}/command"
    thread = answer(address, [Reply(id="", error=CommandError(kind=kind, what="no", where="motors", todo="wait"))])
    with CommandClient(address) as client, pytest.raises(expected, match="motors: no; wait"):
        client.call("motors", "enable", timeout_s=5.0)
    thread.join()


def test_reply_to_an_earlier_request_is_passed_over(tmp_path: Path) -> None:
    """A late reply is never taken for the present one."""
    address = f"ipc://{tmp_path}/command"
    thread = answer(address, [Reply(id="late"), Reply(id="", result={"x": 1})])
    with CommandClient(address) as client:
        with pytest.raises(HardwareError, match=r"no answer within 0\.3 s"):
            client.call("a", "b", timeout_s=0.3)
        result = client.call("a", "b", timeout_s=5.0)
    thread.join()

    assert result == {"x": 1}


def test_no_daemon_says_how_to_start_one(tmp_path: Path) -> None:
    """Without anybody at the address the error names the commands."""
    with CommandClient(f"ipc://{tmp_path}/command") as client, pytest.raises(HardwareError, match="galen-hw run"):
        client.call("a", "b", timeout_s=0.05)


@given(st.binary(max_size=200))
def test_any_bytes_are_a_request_or_a_typed_error(payload: bytes) -> None:
    """The command socket's decoder never raises."""
    assert isinstance(decode_request(payload), Request | CommandError)


def test_another_protocol_version_is_refused() -> None:
    """A request of version 2 is told which version this is."""
    error = decode_request(encode(Request(id="1", target="a", name="b", version=2)))

    assert isinstance(error, CommandError)
    assert error.kind == "invalid"


@pytest.mark.parametrize("kind", ["rejected", "invalid", "fault"])
def test_error_there_and_back(kind: str) -> None:
    """An exception that crosses the bus is the same exception on the other side."""
    there = command_exception(CommandError(kind=kind, what="w", where="h", todo="t"))

    assert command_error(there) == CommandError(kind=kind, what="w", where="h", todo="t")


def test_every_topic_has_an_encoder() -> None:
    """The table has no topic that cannot be published."""
    assert all(name == name.strip("/").lower() for name in TOPICS)


def test_a_batch_holds_what_was_published_in_its_order(bus: str) -> None:
    """Full ones at once, the rest when asked for; who asks for one stream asks for no other."""
    batcher = Batcher(bus)
    with Subscriber(bus, (BATCH_TOPIC, "wrench/raw")) as subscriber:
        until = time.monotonic() + 5.0
        while "wrench/raw" in batcher.unasked or not batcher.unasked:
            batcher.send()
            assert time.monotonic() < until
        sent = [wrench(seq) for seq in range(LARGEST_BATCH + 3)]
        for message in sent:
            batcher.add(b"wrench/raw", encode(message))
        full = subscriber.receive_bytes(1.0)
        early = subscriber.receive_bytes(0.05)
        batcher.send()
        rest = subscriber.receive_bytes(1.0)
    unasked = batcher.unasked
    batcher.close()

    assert full is not None
    assert rest is not None
    assert early is None
    assert [len(decode_batch(frames[1])) for frames in (full, rest)] == [LARGEST_BATCH, 3]
    found = [decode_message(*pair)[1] for frames in (full, rest) for pair in decode_batch(frames[1])]
    assert found == sent
    assert unasked == STREAMS - {"wrench/raw"}

"""The bus: ZeroMQ publish/subscribe for messages, request/reply for commands.

A publication is two frames, `[topic][msgpack map]`, and never a third, so that PlotJuggler reads it as it is. A slow
subscriber loses messages (its own queue is full); the publisher never waits. What was lost shows in `seq`.
"""

import itertools
import time
import uuid
from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress
from functools import partial
from pathlib import Path
from types import TracebackType
from typing import Any, ClassVar, Final, Self

import zmq
from msgspec.structs import replace

from galen_hw.decoding import LARGEST_REQUEST, UnreadableError, decode_message, decode_reply, limit
from galen_hw.errors import CommandRejectedError, GalenError, HardwareError, UsageError, WrongCommandError
from galen_hw.keys import prove
from galen_hw.messages import STREAMS, TOPICS, CommandError, Message, Reply, Request, encode, encode_batch, too_old
from galen_hw.permission import require_permission

QUEUE_LENGTH: Final = 5000
"""Messages kept for one slow subscriber: about two seconds of everything at 1 kHz, then it loses."""

BATCH_TOPIC: Final = "batch"
LARGEST_BATCH: Final = 32
"""Messages: about ten milliseconds of a wrench and its compensation at 1 kHz."""

LARGEST_SUBSCRIPTION: Final = 256
"""Bytes of what a subscriber may ask of a publisher: topics are shorter."""
MOST_ASKED: Final = 200
"""Subscriptions looked at in one go, some tenths of a millisecond; ZeroMQ holds a thousand for us, and the others back."""
TOPIC_BYTES: Final = {name: name.encode() for name in TOPICS}
_FIRST: Final = int(zmq.SNDMORE) | int(zmq.NOBLOCK)
_LAST: Final = int(zmq.NOBLOCK)
_EVENTS, _POLLIN = int(zmq.EVENTS), int(zmq.POLLIN)
_ids = itertools.count(1)


class _Socket:
    """A ZeroMQ socket that closes with its `with` block."""

    def __init__(self, kind: int, context: zmq.Context[Any] | None) -> None:
        self.socket = (context or zmq.Context.instance()).socket(kind)
        self.socket.setsockopt(zmq.LINGER, 0)
        limit(self.socket)

    def close(self) -> None:
        """Close the socket; closing twice is fine."""
        self.socket.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


class Publisher(_Socket):
    """The sending end of the bus, bound to each of `addresses` (see `bind` for `mode`); sending never waits.

    Raises:
        HardwareError: an address is in use or not possible.
    """

    _kind: ClassVar[int] = zmq.PUB

    def __init__(
        self,
        *addresses: str,
        queue: int = QUEUE_LENGTH,
        mode: int | None = None,
        context: zmq.Context[Any] | None = None,
    ) -> None:
        super().__init__(self._kind, context)
        limit(self.socket, LARGEST_SUBSCRIPTION)
        self.socket.setsockopt(zmq.SNDHWM, queue)
        # The method below pyzmq's own, whose looking for options that only other sockets have is two thirds of a send.
        self._send = partial(zmq.backend.Socket.send, self.socket)
        for address in addresses:
            bind(self.socket, address, mode)

    def offer(self, address: str) -> str:
        """Bind a TCP address as well, or a free port of the same host where that is taken; what was bound.

        Raises:
            HardwareError: no port of the host can be bound.
        """
        try:
            self.socket.bind(address)
        except zmq.ZMQError:
            bind(self.socket, f"{address.rpartition(':')[0]}:*")
        return str(self.socket.getsockopt(zmq.LAST_ENDPOINT).decode())

    def publish(self, topic: str, message: Message) -> None:
        """Send one message to whoever listens."""
        payload = encode(message)
        self._send(TOPIC_BYTES[topic], _FIRST)
        self._send(payload, _LAST)

    def publish_bytes(self, topic: bytes, payload: bytes) -> None:
        """Send one message that is encoded already."""
        self._send(topic, _FIRST)
        self._send(payload, _LAST)


class HeedingPublisher(Publisher):
    """A publisher that knows what its subscribers ask for, so that what nobody asks for need not even be encoded."""

    _kind = zmq.XPUB
    unasked: frozenset[str] = frozenset()
    """Topics of `STREAMS` that nobody asked for when `look` was called last; none before that."""
    _asked: frozenset[bytes] = frozenset()

    def look(self) -> None:
        """Take note of what is asked for by now, and of what is not any more.

        ZeroMQ hands on the first subscription to each beginning of a name and the end of the last one. Beginnings of no
        topic are not kept: their number has no bound. While there is more than can be looked at, all counts as asked for.
        """
        news = receive_all(self.socket, MOST_ASKED)
        if not news and self.unasked:
            return
        for frames in news:
            sign, beginning = frames[0][:1], frames[0][1:]
            if sign == b"\x01" and any(topic.startswith(beginning) for topic in TOPIC_BYTES.values()):
                self._asked |= {beginning}
            elif sign == b"\x00":
                self._asked -= {beginning}
        asked = tuple(self._asked) if len(news) < MOST_ASKED else (b"",)
        self.unasked = frozenset(name for name in STREAMS if not TOPIC_BYTES[name].startswith(asked))


class Batcher:
    """A second bus for who only looks: one message now and then that holds what was published meanwhile.

    At 1 kHz each message costs a wake-up here and one in every process that takes it, whatever it then does with it. A
    screen can wait some hundredths of a second, and the samples of those who cannot are not held up for it.

    A batch is published under `BATCH_TOPIC`. Who subscribes to that subscribes to topics beside it, and takes from a batch
    what it asked for: what one asks for is in the batches of all.
    """

    def __init__(self, address: str, queue: int = QUEUE_LENGTH, mode: int | None = None) -> None:
        self._publisher = HeedingPublisher(address, queue=queue, mode=mode)
        self._batch: list[tuple[bytes, bytes]] = []

    @property
    def unasked(self) -> frozenset[str]:
        """See `HeedingPublisher`."""
        return self._publisher.unasked

    def add(self, topic: bytes, payload: bytes) -> None:
        """Put a message into the batch, which is sent when it is full."""
        self._batch.append((topic, payload))
        if len(self._batch) >= LARGEST_BATCH:
            self.send()

    def send(self) -> None:
        """Send what there is, and look who asks for what by now; call it some twenty times a second."""
        if self._batch:
            self._publisher.publish_bytes(BATCH_TOPIC.encode(), encode_batch(self._batch))
            self._batch.clear()
        self._publisher.look()

    def close(self) -> None:
        """Close the socket."""
        self._publisher.close()


class Subscriber(_Socket):
    """The receiving end of the bus.

    Args:
        address: of the bus, e.g. `Addresses(client_runtime_dir()).bus`.
        topics: names or beginnings of names ("wrench/"); everything if empty.
        queue: messages kept while this end is busy; more are lost (and counted in `lost`).
        as_published: `valid` as it was when the message was published. Else what is older than its topic's limit when it is
            read (it waited in the queue, or is replayed) is not `valid`: right for who acts on it, not for who records.
        keys: of a daemon's copy for viewers that demands them: files of one's own secret and of the daemon's public key.

    Raises:
        UsageError: this user may not connect there, or a key cannot be used.
    """

    def __init__(
        self,
        address: str,
        topics: Iterable[str] = (),
        *,
        queue: int = QUEUE_LENGTH,
        as_published: bool = False,
        keys: tuple[Path, Path] | None = None,
        context: zmq.Context[Any] | None = None,
    ) -> None:
        _require_permission(address)
        super().__init__(zmq.SUB, context)
        self._as_published = as_published
        if keys is not None:
            prove(self.socket, *keys)
        self.socket.setsockopt(zmq.RCVHWM, queue)
        self.socket.setsockopt(zmq.RECONNECT_IVL, 20)
        for topic in list(topics) or [""]:
            self.socket.setsockopt(zmq.SUBSCRIBE, topic.encode())
        self.socket.connect(address)
        self.lost: dict[str, int] = {}
        self.unreadable = 0
        self._last: dict[tuple[str, str], int] = {}
        self._wait_ms = -1

    def receive(self, timeout_s: float | None = None) -> tuple[str, Message] | None:
        """The next message with its topic; None after `timeout_s` (None waits for ever).

        What is not a message of the topic table is counted in `unreadable` and passed over.
        """
        deadline = None if timeout_s is None else time.monotonic() + timeout_s
        while True:
            frames = self.receive_bytes(timeout_s)
            if frames is None:
                return None
            try:
                topic, message = decode_message(*frames)
            except UnreadableError:
                self.unreadable += 1
                if deadline is not None:
                    timeout_s = max(0.0, deadline - time.monotonic())
                continue
            self._count(topic, message)
            if message.valid and not self._as_published and too_old(topic, message.t_ns, time.monotonic_ns()):
                message = replace(message, valid=False)
            return topic, message

    def receive_bytes(self, timeout_s: float | None = None) -> tuple[bytes, bytes] | None:
        """The next topic and payload as they came, without counting; None after `timeout_s`."""
        wait_ms = -1 if timeout_s is None else int(1000 * timeout_s)
        if wait_ms != self._wait_ms:
            self.socket.setsockopt(zmq.RCVTIMEO, wait_ms)
            self._wait_ms = wait_ms
        try:
            frames = self.socket.recv_multipart()
        except zmq.Again:
            return None
        return frames[0], frames[-1]

    def __iter__(self) -> Iterator[tuple[str, Message]]:
        while (received := self.receive()) is not None:
            yield received

    def _count(self, topic: str, message: Message) -> None:
        key = (topic, message.source)
        last = self._last.get(key)
        self._last[key] = message.seq
        if last is not None and message.seq > last + 1:
            self.lost[topic] = self.lost.get(topic, 0) + message.seq - last - 1


class CommandClient(_Socket):
    """Sends requests to a running daemon.

    Args:
        address: e.g. `Addresses(client_runtime_dir()).command`.

    Raises:
        UsageError: this user may not command that daemon.
    """

    def __init__(self, address: str, *, context: zmq.Context[Any] | None = None) -> None:
        _require_permission(address)
        super().__init__(zmq.DEALER, context)
        self.address = address
        self.socket.connect(address)

    def call(
        self, target: str, name: str, args: dict[str, Any] | None = None, timeout_s: float = 10.0
    ) -> dict[str, Any]:
        """Carry out a command and return its result.

        Raises:
            CommandRejectedError: not now, or not so; nothing was sent to the hardware.
            UsageError: no such target or command, or impossible arguments.
            HardwareError: no answer in time, no daemon, or it failed on the way.
        """
        reply = self.ask(Request(id=new_id(), target=target, name=name, args=args or {}), timeout_s)
        if reply.error is not None:
            raise command_exception(reply.error)
        return reply.result

    def ask(self, request: Request, timeout_s: float = 10.0) -> Reply:
        """Send a request as it is and return its reply, error or not.

        Raises:
            HardwareError: no answer in time.
            UsageError: what cannot be sent.
        """
        self.socket.send_multipart([b"", _packed(request)])
        deadline = time.monotonic() + timeout_s
        while (left := deadline - time.monotonic()) > 0:
            if self.socket.poll(int(1000 * left) + 1):
                # A reply that came too late for an earlier call is passed over here, and so is what is none.
                with suppress(UnreadableError):
                    reply = decode_reply(self.socket.recv_multipart()[-1])
                    if reply.id == request.id:
                        return reply
        raise HardwareError(
            f"no answer within {timeout_s:g} s to {request.target} {request.name}",
            where=self.address.removeprefix("ipc://"),
            todo="is the daemon running? start it with galen-hw run, or add --virtual",
        )


def command_exception(error: CommandError) -> GalenError:
    """The exception that a typed error of a reply stands for."""
    kinds: dict[str, type[GalenError]] = {
        "rejected": CommandRejectedError,
        "unknown": UsageError,
        "invalid": UsageError,
    }
    return kinds.get(error.kind, HardwareError)(error.what, where=error.where, todo=error.todo)


def command_error(error: GalenError, kind: str = "") -> CommandError:
    """The typed error of a reply that an exception becomes."""
    wrong = isinstance(error, UsageError | WrongCommandError)
    by_type = "fault" if isinstance(error, HardwareError) else "invalid" if wrong else "rejected"
    return CommandError(kind=kind or by_type, what=error.what, where=error.where, todo=error.todo)


def new_id() -> str:
    """An identity for a request that no other client makes."""
    return f"{uuid.uuid4().hex[:8]}-{next(_ids)}"


def _packed(request: Request) -> bytes:
    """A request's bytes.

    Raises:
        UsageError: numbers, text or nesting that do not travel, or too much of it.
    """
    try:
        frame = encode(request)
    except (TypeError, ValueError, OverflowError, RecursionError) as error:
        raise UsageError(f"cannot be sent ({error})", where=f"{request.target} {request.name}") from None
    if len(frame) > LARGEST_REQUEST:
        what = f"{len(frame)} bytes are more than a request may have ({LARGEST_REQUEST})"
        raise UsageError(what, where=f"{request.target} {request.name}")
    return frame


def _require_permission(address: str) -> None:
    if address.startswith("ipc://"):
        require_permission(Path(address.removeprefix("ipc://")))


def bind(socket: zmq.Socket[Any], address: str, mode: int | None = None) -> None:
    """Bind, or close the socket and say in one line why not.

    Args:
        mode: permissions of an ipc socket's file, whatever the umask: who may write to it may connect.

    Raises:
        HardwareError: in use, no permission, not an address.
    """
    try:
        socket.bind(address)
        if mode is not None:
            Path(address.removeprefix("ipc://")).chmod(mode)
    except (zmq.ZMQError, OSError) as error:
        socket.close()
        todo = "is another daemon running there? stop it, or use another directory or port"
        raise HardwareError(f"cannot bind ({error.strerror})", where=address, todo=todo) from None


def receive_all(socket: zmq.Socket[Any], limit: int = 64) -> Sequence[list[bytes]]:
    """What has arrived on a socket, up to `limit` messages, without waiting."""
    found: list[list[bytes]] = []
    while len(found) < limit and int(socket.getsockopt(_EVENTS)) & _POLLIN:
        found.append(socket.recv_multipart(_LAST))
    return found

"""The bus: ZeroMQ publish/subscribe for messages, request/reply for commands.

A publication is two frames, `[topic][msgpack map]`, and never a third, so that PlotJuggler reads it as it is. A slow
subscriber loses messages (its own queue is full); the publisher never waits. What was lost shows in `seq`.
"""

import itertools
import time
import uuid
from collections.abc import Iterable, Iterator, Sequence
from types import TracebackType
from typing import Any, Final, Self

import msgspec
import zmq

from galen_hw.errors import CommandRejectedError, GalenError, HardwareError, UsageError
from galen_hw.messages import TOPICS, CommandError, Message, Reply, Request, decode, encode

PROTOCOL_VERSION: Final = 1
QUEUE_LENGTH: Final = 5000
"""Messages kept for one slow subscriber: about two seconds of everything at 1 kHz, then it loses."""

_REPLY: Final = msgspec.msgpack.Decoder(Reply)
_REQUEST: Final = msgspec.msgpack.Decoder(Request)
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
    """The sending end of the bus, bound to each of `addresses`; sending never waits.

    Raises:
        HardwareError: an address is in use or not possible.
    """

    def __init__(self, *addresses: str, queue: int = QUEUE_LENGTH, context: zmq.Context[Any] | None = None) -> None:
        super().__init__(zmq.PUB, context)
        self.socket.setsockopt(zmq.SNDHWM, queue)
        for address in addresses:
            bind(self.socket, address)

    def publish(self, topic: str, message: Message) -> None:
        """Send one message to whoever listens."""
        self.publish_bytes(TOPIC_BYTES[topic], encode(message))

    def publish_bytes(self, topic: bytes, payload: bytes) -> None:
        """Send one message that is encoded already."""
        self.socket.send(topic, _FIRST)
        self.socket.send(payload, _LAST)


class Subscriber(_Socket):
    """The receiving end of the bus.

    Args:
        address: of the bus, e.g. `Addresses(client_runtime_dir()).bus`.
        topics: names or beginnings of names ("wrench/"); everything if empty.
        queue: messages kept while this end is busy; more are lost (and counted in `lost`).
    """

    def __init__(
        self,
        address: str,
        topics: Iterable[str] = (),
        *,
        queue: int = QUEUE_LENGTH,
        context: zmq.Context[Any] | None = None,
    ) -> None:
        super().__init__(zmq.SUB, context)
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
            topic = frames[0].decode(errors="replace")
            try:
                message = decode(topic, frames[1])
            except (KeyError, msgspec.DecodeError):
                self.unreadable += 1
                if deadline is not None:
                    timeout_s = max(0.0, deadline - time.monotonic())
                continue
            self._count(topic, message)
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
    """

    def __init__(self, address: str, *, context: zmq.Context[Any] | None = None) -> None:
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
        """
        self.socket.send_multipart([b"", encode(request)])
        deadline = time.monotonic() + timeout_s
        while (left := deadline - time.monotonic()) > 0:
            if self.socket.poll(int(1000 * left) + 1):
                reply = _REPLY.decode(self.socket.recv_multipart()[-1])
                # A reply that came too late for an earlier call is passed over here.
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
    by_type = (
        "fault" if isinstance(error, HardwareError) else "invalid" if isinstance(error, UsageError) else "rejected"
    )
    return CommandError(kind=kind or by_type, what=error.what, where=error.where, todo=error.todo)


def decode_request(payload: bytes) -> Request | CommandError:
    """A request, or why it is none: not a map of this protocol, or another version of it."""
    try:
        request = _REQUEST.decode(payload)
    except msgspec.DecodeError as error:
        return CommandError(
            kind="invalid", what=f"not a request ({error})", todo="send a msgpack map: id, target, name, args"
        )
    if request.version != PROTOCOL_VERSION:
        what = f"protocol version {request.version}, this daemon speaks {PROTOCOL_VERSION}"
        return CommandError(kind="invalid", what=what, todo="use the same version on both ends")
    return request


def decode_reply(payload: bytes) -> Reply:
    """A reply.

    Raises:
        msgspec.DecodeError: it is none.
    """
    return _REPLY.decode(payload)


def new_id() -> str:
    """An identity for a request that no other client makes."""
    return f"{uuid.uuid4().hex[:8]}-{next(_ids)}"


def bind(socket: zmq.Socket[Any], address: str) -> None:
    """Bind, or close the socket and say in one line why not.

    Raises:
        HardwareError: in use, no permission, not an address.
    """
    try:
        socket.bind(address)
    except zmq.ZMQError as error:
        socket.close()
        todo = "is another daemon running? change [bus] in the configuration or stop it"
        raise HardwareError(f"cannot bind ({error.strerror})", where=address, todo=todo) from None


def receive_all(socket: zmq.Socket[Any], limit: int = 64) -> Sequence[list[bytes]]:
    """What has arrived on a socket, up to `limit` messages, without waiting."""
    found: list[list[bytes]] = []
    while len(found) < limit and int(socket.getsockopt(_EVENTS)) & _POLLIN:
        found.append(socket.recv_multipart(_LAST))
    return found

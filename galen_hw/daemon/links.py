"""The ZeroMQ ends of one process: `core` owns the bus, the others push to it and hear it as subscribers do."""

from collections.abc import Iterable
from typing import Any, Final

import msgspec
import zmq

from galen_hw.bus import Publisher, bind, receive_all
from galen_hw.config.paths import Addresses
from galen_hw.messages import Message, Reply, Request, encode

INWARD_QUEUE: Final = 2000
BEAT: Final = b"beat"
REQUEST: Final = b"request"
REPLY: Final = b"reply"
STOP: Final = b"stop"

_BEATS: Final = msgspec.msgpack.Encoder()


class DeviceState(msgspec.Struct, frozen=True):
    """How a device is doing: state of its wire, whether it is ready, and what is wrong (what, where, todo)."""

    wire: str
    ready: bool
    optional: bool
    attempts: int = 0
    problem: tuple[str, str, str] | None = None


class Beat(msgspec.Struct, frozen=True):
    """The heartbeat of a process.

    Args:
        progress: samples published so far of the process' main topic.
        devices: by name.
    """

    progress: int = 0
    devices: dict[str, DeviceState] = {}


class _Control:
    """The line to the supervisor: beats, requests and replies, each as [kind][payload]."""

    def __init__(self, name: str, addresses: Addresses) -> None:
        self.socket: zmq.Socket[Any] = zmq.Context.instance().socket(zmq.DEALER)
        self.socket.setsockopt(zmq.IDENTITY, name.encode())
        self.socket.setsockopt(zmq.LINGER, 200)
        self.socket.connect(addresses.control)

    def send(self, kind: bytes, content: msgspec.Struct) -> None:
        """Send, or drop if the supervisor does not take anything."""
        try:
            self.socket.send_multipart([kind, encode(content)], zmq.NOBLOCK)
        except zmq.Again:
            return


class CoreLink:
    """The link of `core`: binds the bus and the viewers' copy, and passes on what the others push.

    Raises:
        HardwareError: an address cannot be bound.
    """

    def __init__(self, name: str, addresses: Addresses, viewers: str, queue: int) -> None:
        self._publisher = Publisher(addresses.bus, *([viewers] if viewers else []), queue=queue)
        self._inward: zmq.Socket[Any] = zmq.Context.instance().socket(zmq.PULL)
        self._inward.setsockopt(zmq.RCVHWM, INWARD_QUEUE)
        bind(self._inward, addresses.inward)
        self.control = _Control(name, addresses)
        self.sockets: list[zmq.Socket[Any]] = [self._inward, self.control.socket]
        self.dropped = 0
        self.publish = self._publisher.publish

    def messages(self) -> list[tuple[bytes, bytes]]:
        """What the other processes have published since; passed on to the bus already."""
        found = []
        for frames in receive_all(self._inward):
            if len(frames) == 2:
                self._publisher.publish_bytes(frames[0], frames[1])
                found.append((frames[0], frames[1]))
        return found

    def request(self, request: Request) -> None:
        """Send a request to whoever owns its target."""
        self.control.send(REQUEST, request)

    def reply(self, reply: Reply) -> None:
        """Answer a request that came from outside."""
        self.control.send(REPLY, reply)

    def beat(self, beat: Beat) -> None:
        """Tell the supervisor that we are alive."""
        self.control.send(BEAT, beat)

    def close(self) -> None:
        """Close every socket."""
        self._publisher.close()
        for socket in self.sockets:
            socket.close()


class EdgeLink:
    """The link of the other processes: pushes to `core`, subscribes to what its services take."""

    def __init__(self, name: str, addresses: Addresses, topics: Iterable[str]) -> None:
        context: zmq.Context[zmq.Socket[bytes]] = zmq.Context.instance()
        self._outward: zmq.Socket[Any] = context.socket(zmq.PUSH)
        # Nothing waits for a core that is away: what is old by the time it is back helps nobody.
        self._outward.setsockopt(zmq.IMMEDIATE, 1)
        self._outward.setsockopt(zmq.SNDHWM, INWARD_QUEUE)
        self._outward.setsockopt(zmq.LINGER, 100)
        self._outward.setsockopt(zmq.RECONNECT_IVL, 20)
        self._outward.connect(addresses.inward)
        self._bus: zmq.Socket[Any] = context.socket(zmq.SUB)
        self._bus.setsockopt(zmq.RECONNECT_IVL, 20)
        for topic in topics:
            self._bus.setsockopt(zmq.SUBSCRIBE, topic.encode())
        self._bus.connect(addresses.bus)
        self.control = _Control(name, addresses)
        self.sockets: list[zmq.Socket[Any]] = [self._bus, self.control.socket]
        self.dropped = 0

    def publish(self, topic: str, message: Message) -> None:
        """Push a message to the bus; dropped and counted when `core` does not take it."""
        try:
            self._outward.send_multipart([topic.encode(), encode(message)], zmq.NOBLOCK)
        except zmq.Again:
            self.dropped += 1

    def messages(self) -> list[tuple[bytes, bytes]]:
        """What has been published on the topics of our services since."""
        return [(frames[0], frames[-1]) for frames in receive_all(self._bus)]

    def request(self, request: Request) -> None:
        """Send a request to whoever owns its target."""
        self.control.send(REQUEST, request)

    def reply(self, reply: Reply) -> None:
        """Answer a request that came from outside."""
        self.control.send(REPLY, reply)

    def beat(self, beat: Beat) -> None:
        """Tell the supervisor that we are alive."""
        self.control.send(BEAT, beat)

    def close(self) -> None:
        """Close every socket."""
        self._outward.close()
        for socket in self.sockets:
            socket.close()

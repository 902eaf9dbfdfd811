"""The ZeroMQ ends of one process: `core` owns the bus, the others push to it and hear it as subscribers do."""

import logging
import time
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from typing import Any, Final

import msgspec
import zmq
from msgspec.structs import replace

from galen_hw.bus import TOPIC_BYTES, Batcher, HeedingPublisher, bind, receive_all
from galen_hw.config.paths import Addresses
from galen_hw.decoding import UnreadableError, decode_message, limit
from galen_hw.messages import MAX_AGE_NS, STREAMS, Message, Reply, Request, encode, too_old
from galen_hw.permission import OWN, socket_mode

INWARD_QUEUE: Final = 2000
BATCH: Final = 64
"""Messages taken in one turn of the loop, so that a crowd never keeps it from the wire."""
BEAT: Final = b"beat"
REQUEST: Final = b"request"
REPLY: Final = b"reply"
KNOWN: Final = frozenset(TOPIC_BYTES.values())
log = logging.getLogger("galen-hw")

_HEADER: Final = msgspec.msgpack.Decoder(Message)
_AGING: Final = {name.encode(): name for name in MAX_AGE_NS}


class DeviceState(msgspec.Struct, frozen=True):
    """How a device is doing: its wire, whether it is ready, what is wrong (what, where, todo), why it is held at rest."""

    wire: str
    ready: bool
    optional: bool
    attempts: int = 0
    problem: tuple[str, str, str] | None = None
    held: str = ""


class Beat(msgspec.Struct, frozen=True):
    """The heartbeat of a process.

    Args:
        progress: samples published so far of the process' main topic.
        devices: by name.
    """

    progress: int = 0
    devices: dict[str, DeviceState] = {}


def not_older(topic: bytes, payload: bytes, now_ns: int, begun_ns: int = 0) -> bytes | None:
    """A payload as it may be published now: not valid any more when it has waited beyond its topic's age limit.

    None for what a stream has left from before this process began: nobody has waited for it.
    """
    name = _AGING.get(topic)
    if name is None:
        return payload
    try:
        header = _HEADER.decode(payload)
        if header.t_ns < begun_ns and name in STREAMS:
            return None
        if not header.valid or not too_old(name, header.t_ns, now_ns):
            return payload
        return encode(replace(decode_message(topic, payload)[1], valid=False))
    except (UnreadableError, ValueError, RecursionError):
        return payload  # Whoever reads it counts it as unreadable.


class Inlet:
    """The receiving side of a socket in a loop that waits on descriptors.

    A ZeroMQ descriptor tells of changes only: it is asked again after a batch that may not have been all, and after a
    send on the same socket, which may have swallowed the change.
    """

    def __init__(self, socket: "zmq.Socket[Any]") -> None:
        self.socket = socket
        self.fd = int(socket.getsockopt(zmq.FD))
        self.pending = True

    def take(self, ready: Sequence[int]) -> Sequence[list[bytes]]:
        """What has arrived, when `ready` has this descriptor or something may be left."""
        if not self.pending and self.fd not in ready:
            return ()
        found = receive_all(self.socket, BATCH)
        self.pending = len(found) == BATCH
        return found


class _Control(Inlet):
    """The line to the supervisor: beats, requests and replies, each as [kind][payload]."""

    def __init__(self, name: str, addresses: Addresses) -> None:
        socket: zmq.Socket[Any] = zmq.Context.instance().socket(zmq.DEALER)
        limit(socket)
        socket.setsockopt(zmq.IDENTITY, name.encode())
        socket.setsockopt(zmq.LINGER, 200)
        socket.connect(addresses.control)
        super().__init__(socket)

    def send(self, kind: bytes, content: msgspec.Struct) -> None:
        """Send, or drop if the supervisor does not take anything."""
        self.pending = True
        try:
            self.socket.send_multipart([kind, encode(content)], zmq.NOBLOCK)
        except zmq.Again:
            return


@dataclass(frozen=True, slots=True)
class Origin:
    """Which robot a message is of; see `Message`. Devices and services do not know, so it is written where they publish."""

    robot: str
    virtual: bool


class _Link:
    """What every process has: what comes in from the others, and the line to the supervisor."""

    def __init__(self, name: str, addresses: Addresses, origin: Origin, inward: "zmq.Socket[Any]") -> None:
        self.inlet = Inlet(inward)
        self.control = _Control(name, addresses)
        self.dropped = self.unreadable = self.backlog = 0
        self.begun_ns = 0
        """When the process' loop began: what a stream says of the time before is dropped, and counted as backlog."""
        self._robot, self._virtual = origin.robot, origin.virtual

    @property
    def is_pending(self) -> bool:
        """Something may have arrived of which no descriptor tells; see `Inlet`."""
        return self.inlet.pending or self.control.pending

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
        self.inlet.socket.close()
        self.control.socket.close()


class CoreLink(_Link):
    """The link of `core`: binds the bus, and passes on what the others push.

    Raises:
        HardwareError: an address cannot be bound.
    """

    def __init__(self, name: str, addresses: Addresses, origin: Origin, queue: int) -> None:
        mode = socket_mode(addresses.runtime)
        self._publisher = HeedingPublisher(addresses.bus, queue=queue, mode=mode)
        self._batcher = Batcher(addresses.batches, queue, mode)
        inward: zmq.Socket[Any] = zmq.Context.instance().socket(zmq.PULL)
        inward.setsockopt(zmq.RCVHWM, INWARD_QUEUE)
        limit(inward)
        bind(inward, addresses.inward, OWN)
        super().__init__(name, addresses, origin, inward)

    def publish(self, topic: str, message: Message) -> None:
        """Put a message on the bus; one of a stream that nobody asks for is not made up for nobody.

        What comes seldom is sent in any case: who has asked a moment ago has not been seen yet, and the next is far away.
        """
        promptly, later = topic not in self._publisher.unasked, topic not in self._batcher.unasked
        if not promptly and not later:
            return
        name, payload = TOPIC_BYTES[topic], encode(replace(message, robot=self._robot, virtual=self._virtual))
        if promptly:
            self._publisher.publish_bytes(name, payload)
        if later:
            self._batcher.add(name, payload)

    def adapt(self, wanted: Collection[str]) -> None:
        """See what subscribers ask for by now; services here are handed what is published here without the bus."""
        del wanted
        self._publisher.look()
        self._batcher.send()

    def messages(self, ready: Sequence[int]) -> list[tuple[bytes, bytes]]:
        """What the other processes have published since; passed on to the bus already."""
        taken = self.inlet.take(ready)
        if not taken:
            return []
        found, now = [], time.monotonic_ns()
        for frames in taken:
            if len(frames) == 2 and frames[0] in KNOWN:
                topic, payload = frames[0], not_older(frames[0], frames[1], now, self.begun_ns)
                if payload is None:
                    self.backlog += 1
                    continue
                self._publisher.publish_bytes(topic, payload)
                if _AGING[topic] not in self._batcher.unasked:
                    self._batcher.add(topic, payload)
                found.append((topic, payload))
            else:
                self.unreadable += 1
        return found

    def close(self) -> None:
        """Close every socket."""
        self._publisher.close()
        self._batcher.close()
        super().close()


class EdgeLink(_Link):
    """The link of the other processes: pushes to `core`, subscribes to what its services want (see `adapt`)."""

    def __init__(self, name: str, addresses: Addresses, origin: Origin) -> None:
        context: zmq.Context[zmq.Socket[bytes]] = zmq.Context.instance()
        self._outward: zmq.Socket[Any] = context.socket(zmq.PUSH)
        # Nothing waits for a core that is away: what is old by the time it is back helps nobody.
        self._outward.setsockopt(zmq.IMMEDIATE, 1)
        self._outward.setsockopt(zmq.SNDHWM, INWARD_QUEUE)
        self._outward.setsockopt(zmq.LINGER, 100)
        self._outward.setsockopt(zmq.RECONNECT_IVL, 20)
        self._outward.connect(addresses.inward)
        bus: zmq.Socket[Any] = context.socket(zmq.SUB)
        limit(bus)
        bus.setsockopt(zmq.RECONNECT_IVL, 20)
        bus.connect(addresses.bus)
        self._wanted: frozenset[str] = frozenset()
        super().__init__(name, addresses, origin, bus)

    def publish(self, topic: str, message: Message) -> None:
        """Push a message to the bus; dropped and counted when `core` does not take it."""
        try:
            signed = replace(message, robot=self._robot, virtual=self._virtual)
            self._outward.send_multipart([TOPIC_BYTES[topic], encode(signed)], zmq.NOBLOCK)
        except zmq.Again:
            self.dropped += 1

    def adapt(self, wanted: Collection[str]) -> None:
        """Subscribe to these topics, and to no other any more."""
        if self._wanted == (topics := frozenset(wanted)):
            return
        for topic in topics - self._wanted:
            self.inlet.socket.setsockopt(zmq.SUBSCRIBE, topic.encode())
        for topic in self._wanted - topics:
            self.inlet.socket.setsockopt(zmq.UNSUBSCRIBE, topic.encode())
        self._wanted, self.inlet.pending = topics, True

    def messages(self, ready: Sequence[int]) -> list[tuple[bytes, bytes]]:
        """What has been published on the topics of our services since."""
        return [(frames[0], frames[-1]) for frames in self.inlet.take(ready)]

    def close(self) -> None:
        """Close every socket."""
        self._outward.close()
        super().close()

"""Answers requests of clients and services by routing them to the process that owns the target."""

import itertools
import time
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Any, Final

import msgspec
import zmq

from galen_hw.bus import bind, receive_all
from galen_hw.clock import NS_PER_S
from galen_hw.config.paths import Addresses
from galen_hw.config.problems import unknown
from galen_hw.daemon.links import BEAT, REPLY, REQUEST, Beat
from galen_hw.decoding import LARGEST_MESSAGE, Reader, UnreadableError, decode_reply, decode_request, id_of, limit
from galen_hw.messages import CommandError, Reply, Request, encode
from galen_hw.permission import OWN, socket_mode

SELF: Final = "daemon"
"""Target that the broker answers itself."""
MOST_FRAMES: Final = 8
"""Of a client's message: the route back to it (one frame for each hop), an empty one and the request."""
MOST_WAITING: Final = 1000
"""Requests without a reply, of all clients together."""
LARGEST_FROM_CLIENTS: Final = 1 << 20
"""Bytes of a client's frame; up to here it is answered, beyond ZeroMQ closes its connection."""
_BEAT: Final = Reader(Beat)


@dataclass(frozen=True, slots=True)
class _Asker:
    """Who waits for a reply: frames before the payload on the way back, the id it knows, until when."""

    socket: "zmq.Socket[Any]"
    frames: tuple[bytes, ...]
    id: str
    process: str
    what: str
    until_ns: int


class Broker:
    """Routes requests and replies; keeps the last heartbeat of each process.

    Args:
        addresses: of the daemon; owners: target to process; processes: all that there are.
        timeout_s: after which a request that nobody answered is answered with "timeout".
        info: what the target "daemon" tells about itself.

    Raises:
        HardwareError: an address cannot be bound.
    """

    def __init__(
        self,
        addresses: Addresses,
        owners: Mapping[str, str],
        processes: Iterable[str],
        timeout_s: float,
        info: Callable[[], dict[str, Any]],
    ) -> None:
        self.unreadable = 0
        """Frames that were not what their socket takes."""
        self._names = {name.encode(): name for name in processes}
        self.beats: dict[str, Beat] = {}
        self.heard_ns: dict[str, int] = {}
        self._owners, self._timeout_ns, self._info = dict(owners), round(timeout_s * NS_PER_S), info
        context: zmq.Context[zmq.Socket[bytes]] = zmq.Context.instance()
        self._clients, self._processes = context.socket(zmq.ROUTER), context.socket(zmq.ROUTER)
        self.sockets = [self._clients, self._processes]
        for socket, address, largest, mode in (
            (self._clients, addresses.command, LARGEST_FROM_CLIENTS, socket_mode(addresses.runtime)),
            (self._processes, addresses.control, LARGEST_MESSAGE, OWN),
        ):
            limit(socket, largest)
            socket.setsockopt(zmq.LINGER, 200)
            # A process that was started again takes over its name; one that is gone is an error here, not a silence.
            socket.setsockopt(zmq.ROUTER_HANDOVER, 1)
            socket.setsockopt(zmq.ROUTER_MANDATORY, 1)
            bind(socket, address, mode)
        self._waiting: dict[str, _Asker] = {}
        self._ids = itertools.count(1)

    def step(self) -> None:
        """Carry on what has arrived, and end what waited too long."""
        for frames in receive_all(self._processes):
            self._from_process(frames)
        for frames in receive_all(self._clients):
            self._from_client(frames)
        now = time.monotonic_ns()
        for id_ in [id_ for id_, asker in self._waiting.items() if asker.until_ns < now]:
            asker = self._waiting[id_]
            what = f"no answer within {self._timeout_ns / NS_PER_S:g} s"
            self._answer(Reply(id=id_, error=CommandError(kind="timeout", what=what, where=asker.what)))

    def command(self, target: str, name: str) -> None:
        """Send a request of the daemon's own, whose reply nobody waits for."""
        if owner := self._owners.get(target):
            request = Request(id=f"{SELF}/{next(self._ids)}", target=target, name=name)
            self._send(self._processes, [owner.encode(), REQUEST, encode(request)])

    def lost(self, process: str) -> None:
        """A process has died: whoever waits for it is told."""
        self.beats.pop(process, None)
        for id_ in [id_ for id_, asker in self._waiting.items() if asker.process == process]:
            what = "its process ended before it answered; it is being started again"
            self._answer(Reply(id=id_, error=CommandError(kind="fault", what=what, where=self._waiting[id_].what)))

    def close(self) -> None:
        """Close the sockets."""
        for socket in self.sockets:
            socket.close()

    def _from_process(self, frames: list[bytes]) -> None:
        """[process][kind][payload]; whatever else a peer sends is counted, and that is all."""
        process, kind = self._names.get(frames[0]), frames[1] if len(frames) == 3 else b""
        try:
            if process is not None and kind == BEAT:
                self.beats[process] = _BEAT(frames[2])
                self.heard_ns[process] = time.monotonic_ns()
            elif process is not None and kind == REPLY:
                self._answer(decode_reply(frames[2]))
            elif process is not None and kind == REQUEST:
                self._route(self._processes, (frames[0], REPLY), frames[2])
            else:
                self.unreadable += 1
        except UnreadableError:
            self.unreadable += 1

    def _from_client(self, frames: list[bytes]) -> None:
        """The route back, then the request; a crowd of frames is not a route."""
        if 2 <= len(frames) <= MOST_FRAMES:
            self._route(self._clients, tuple(frames[:-1]), frames[-1])
            return
        self.unreadable += 1
        error = CommandError(
            kind="invalid", what=f"a request of {len(frames) - 1} frames", todo="send an empty one and it"
        )
        self._send(self._clients, [frames[0], b"", encode(Reply(id="", error=error))])

    def _route(self, socket: "zmq.Socket[Any]", frames: tuple[bytes, ...], payload: bytes) -> None:
        """A request to its owner under an id of ours; what cannot be routed is answered at once."""
        request = decode_request(payload)
        if isinstance(request, CommandError):
            self.unreadable += 1
            self._send(socket, [*frames, encode(Reply(id=id_of(payload), error=request))])
            return
        result, error = self._try(request, socket, frames)
        if result is not None or error is not None:
            self._send(socket, [*frames, encode(Reply(id=request.id, result=result or {}, error=error))])

    def _try(
        self, request: Request, socket: "zmq.Socket[Any]", frames: tuple[bytes, ...]
    ) -> tuple[dict[str, Any] | None, CommandError | None]:
        if request.target == SELF:
            return self._own(request)
        owner = self._owners.get(request.target)
        if owner is None:
            todo = unknown(request.target, sorted([*self._owners, SELF]))
            return None, CommandError(kind="unknown", what=f"no target {request.target!r}", where=SELF, todo=todo)
        if len(self._waiting) >= MOST_WAITING:
            what = f"{MOST_WAITING} requests wait for their replies"
            return None, CommandError(kind="rejected", what=what, where=SELF, todo="wait, then ask again")
        own = f"{SELF}/{next(self._ids)}"
        what = f"{request.target} {request.name}"
        if not self._send(self._processes, [owner.encode(), REQUEST, encode(msgspec.structs.replace(request, id=own))]):
            return None, CommandError(
                kind="fault", what=f"process {owner} does not run", where=what, todo="try again soon"
            )
        self._waiting[own] = _Asker(socket, frames, request.id, owner, what, time.monotonic_ns() + self._timeout_ns)
        return None, None

    def _own(self, request: Request) -> tuple[dict[str, Any] | None, CommandError | None]:
        """What the daemon tells about itself."""
        if request.name != "info":
            what = f"no command {request.name!r}"
            return None, CommandError(kind="unknown", what=what, where=SELF, todo="one of: info")
        if request.args:
            what = f"info takes no {', '.join(sorted(request.args))}"
            return None, CommandError(kind="invalid", what=what, where=SELF, todo="send it without arguments")
        return self._info(), None

    def _answer(self, reply: Reply) -> None:
        """Give a reply to whoever asked; one that came too late is dropped."""
        asker = self._waiting.pop(reply.id, None)
        if asker is not None:
            self._send(asker.socket, [*asker.frames, encode(msgspec.structs.replace(reply, id=asker.id))])

    def _send(self, socket: "zmq.Socket[Any]", frames: list[bytes]) -> bool:
        try:
            socket.send_multipart(frames, zmq.NOBLOCK)
        except zmq.ZMQError:
            # The peer has gone, or takes nothing: the broker waits for nobody.
            return False
        return True

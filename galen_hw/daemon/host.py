"""Carries messages, requests and replies between the devices and services of one process and the world outside it."""

import itertools
import logging
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Any, Final, Protocol

import msgspec

from galen_hw.bus import command_error
from galen_hw.clock import NS_PER_S
from galen_hw.daemon.ages import Ages
from galen_hw.daemon.logs import FAULTS
from galen_hw.daemon.port import Port
from galen_hw.errors import CommandRejectedError, GalenError
from galen_hw.messages import (
    MAX_AGE_NS,
    STREAMS,
    TOPICS,
    CommandError,
    CompensationState,
    Fault,
    Message,
    Reply,
    Request,
    too_old,
)
from galen_hw.services.service import Service

REPLY_WITHIN_NS: Final = 30 * NS_PER_S
TICK_NS: Final = NS_PER_S // 20
_NOTED: Final = frozenset({"joints/state", "compensation/state", "fault"})
log = logging.getLogger("galen-hw")
fault_log = logging.getLogger(FAULTS)


class Link(Protocol):
    """The world outside the process."""

    def publish(self, topic: str, message: Message) -> None:
        """Put a message on the bus."""
        ...

    def request(self, request: Request) -> None:
        """Send a request to whoever owns its target."""
        ...

    def reply(self, reply: Reply) -> None:
        """Answer a request that came from outside."""
        ...


@dataclass(frozen=True, slots=True)
class _Pending:
    """A request that has no reply yet: who asked (None: outside), under which id, until when, of which device here."""

    service: Service | None
    id: str
    until_ns: int
    device: str = ""


class _Route:
    """What becomes of the messages of one topic that are made here: looked up once a message, not once a question.

    Args:
        topic: its name.
        consumers: the services here that take it.
    """

    __slots__ = ("ages", "consumers", "is_noted", "limit_ns")

    def __init__(self, topic: str, consumers: tuple[Service, ...]) -> None:
        self.consumers = consumers
        self.limit_ns = MAX_AGE_NS[topic]
        self.ages = Ages() if topic in STREAMS else None
        self.is_noted = topic in _NOTED


class Host:
    """The devices and services of one process.

    Args:
        name: of the process; begins the ids of the requests made here.
        ports: devices by name; services: by name.
        link: the world outside.
        clock: monotonic nanoseconds.
        on_done: called with a service's or device's name when it has carried out a command (what it knows is worth
            keeping).
        forbids: why a device may set nothing in motion now; empty if it may.
    """

    def __init__(
        self,
        name: str,
        ports: Mapping[str, Port],
        services: Mapping[str, Service],
        link: Link,
        *,
        clock: Callable[[], int],
        on_done: Callable[[str], None] = lambda _: None,
        forbids: Callable[[], str] = lambda: "",
    ) -> None:
        self.ports, self.services = dict(ports), dict(services)
        self.published: dict[str, int] = {}
        self.old: dict[str, int] = {}
        """Messages beyond their topic's age limit, by topic: published as not valid, or not handed on."""
        self.faults: dict[str, Fault] = {}
        self.moving = False
        self.tool = ""
        """In hand, as `compensation/state` says."""
        self._name, self._link, self._clock, self._on_done = name, link, clock, on_done
        self._forbids = forbids
        self._routes = {t: _Route(t, tuple(s for s in services.values() if t in s.consumes)) for t in TOPICS}
        self.ages = {topic: route.ages for topic, route in self._routes.items() if route.ages is not None}
        """Of the messages that describe the present, when they are published here."""
        self._pending: dict[str, _Pending] = {}
        self._ids = itertools.count(1)
        self._next_tick_ns = 0

    @property
    def wakeup_ns(self) -> int:
        """When the ticks and time-outs want to be looked at next."""
        return self._next_tick_ns

    @property
    def consumed(self) -> frozenset[str]:
        """Topics that a service here takes."""
        return frozenset(topic for topic, route in self._routes.items() if route.consumers)

    @property
    def wants(self) -> frozenset[str]:
        """Topics that a service here has a use for now."""
        return frozenset(topic for service in self.services.values() for topic in service.wants)

    def take(self, outputs: Iterable[Any], service: Service | None = None) -> None:
        """Carry the outputs of a device or (if given) of a service to where they belong."""
        for output in outputs:
            if type(output) is tuple:
                self._emit(output[0], output[1])
            elif isinstance(output, Reply):
                self._deliver(output)
            else:
                self._forward(output, service)

    def from_bus(self, topic: str, message: Message) -> bool:
        """A message from another process; false when it was too old for a service here."""
        if message.source in self.ports or message.source in self.services:
            return True
        now = self._clock()
        old = topic in STREAMS and too_old(topic, message.t_ns, now)
        everyone = self._routes[topic].consumers
        consumers = [s for s in everyone if not old or s.takes_old]
        for service in consumers:
            self.take(service.handle(topic, message, now), service)
        if len(consumers) == len(everyone):
            return True
        self.old[topic] = self.old.get(topic, 0) + 1
        return False

    def from_outside(self, request: Request) -> None:
        """A request from outside, for a device or service here."""
        device = request.target if request.target in self.ports else ""
        self._pending[request.id] = _Pending(None, request.id, self._clock() + 20 * REPLY_WITHIN_NS, device)
        self._carry_out(request)

    def reply_from_outside(self, reply: Reply) -> None:
        """The answer to a request that a service here has made."""
        self._deliver(reply)

    def tick(self, now_ns: int) -> None:
        """Give every service its tick, and end requests that nobody answers."""
        if now_ns < self._next_tick_ns:
            return
        self._next_tick_ns = now_ns + TICK_NS
        for name, service in self.services.items():
            self.take(service.tick(now_ns), service)
            if service.keep_now:
                service.keep_now = False
                self._on_done(name)
        for id_ in [id_ for id_, pending in self._pending.items() if pending.until_ns < now_ns]:
            what = f"no answer within {REPLY_WITHIN_NS // NS_PER_S} s"
            self._deliver(Reply(id=id_, error=CommandError(kind="timeout", what=what)))

    def end(self) -> None:
        """Let every service say and order what it must before the process ends."""
        now = self._clock()
        for service in self.services.values():
            self.take(service.end(now), service)

    def _emit(self, topic: str, message: Message) -> None:
        # Services first: the compensated wrench leaves before the raw one has cost its send.
        route = self._routes[topic]
        now = self._clock()
        age_ns = now - message.t_ns
        if age_ns > route.limit_ns and message.valid:
            message = msgspec.structs.replace(message, valid=False)
            self.old[topic] = self.old.get(topic, 0) + 1
        for service in route.consumers:
            self.take(service.handle(topic, message, now), service)
        self._link.publish(topic, message)
        if route.ages is not None:
            route.ages.add(age_ns)
        self.published[topic] = self.published.get(topic, 0) + 1
        if route.is_noted:
            self._note(topic, message)

    def _note(self, topic: str, message: Message) -> None:
        """What the process itself has to know of what it publishes."""
        if topic == "joints/state":
            self.moving = any(message.moving.values())  # type: ignore[attr-defined]
        elif isinstance(message, CompensationState):
            self.tool = message.tool
        elif isinstance(message, Fault):
            self.faults[message.source] = message
            fault_log.warning("%s: %s%s", message.where or message.source, message.what, _todo(message))

    def _forward(self, request: Request, service: Service | None) -> None:
        """A service's request: under an id of our own, to a device or service here or to the world outside."""
        own = f"{self._name}/{next(self._ids)}"
        device = request.target if request.target in self.ports else ""
        self._pending[own] = _Pending(service, request.id, self._clock() + REPLY_WITHIN_NS, device)
        renamed = msgspec.structs.replace(request, id=own)
        if request.target in self.ports or request.target in self.services:
            self._carry_out(renamed)
        else:
            self._link.request(renamed)

    def _carry_out(self, request: Request) -> None:
        now = self._clock()
        port, service = self.ports.get(request.target), self.services.get(request.target)
        try:
            if port is not None:
                self._refuse_blind(port, request)
                self.take(port.request(request, now))
            elif service is not None:
                self.take(service.request(request, now), service)
                self._on_done(request.target)
            else:
                error = CommandError(kind="unknown", what=f"no target {request.target!r}", where=self._name)
                self._deliver(Reply(id=request.id, error=error))
        except GalenError as error:
            self._deliver(Reply(id=request.id, error=command_error(error)))
        except Exception as error:
            # A command must never take the loop down with it: the asker is told, the log has the traceback.
            log.exception("%s %s failed", request.target, request.name)
            where = f"{request.target} {request.name}"
            self._deliver(Reply(id=request.id, error=CommandError(kind="fault", what=repr(error), where=where)))

    def _refuse_blind(self, port: Port, request: Request) -> None:
        """Let nothing be set in motion that nobody feels.

        Raises:
            CommandRejectedError: so it is.
        """
        if request.name in port.device.motions and (why := self._forbids()):
            todo = "see galen-hw monitor; nothing moves before it is back"
            raise CommandRejectedError(why, where=request.target, todo=todo)

    def _deliver(self, reply: Reply) -> None:
        """A reply to whoever asked; one that nobody waits for any more is dropped."""
        pending = self._pending.pop(reply.id, None)
        if pending is None:
            return
        if pending.device and reply.error is None:
            self._on_done(pending.device)
        if pending.service is None:
            self._link.reply(reply)
        else:
            answer = msgspec.structs.replace(reply, id=pending.id)
            self.take(pending.service.reply(answer, self._clock()), pending.service)


def _todo(fault: Fault) -> str:
    return f"; {fault.todo}" if fault.todo else ""

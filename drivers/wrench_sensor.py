"""What all force/torque sensors share: the start, `restart`, what is told when a sensor is given up, and the status.

How samples are asked for and paired, and how a sensor is zeroed, is the device's own.
"""

from abc import abstractmethod
from enum import Enum, auto
from typing import Any, ClassVar, Final, Generic, Literal, Protocol, TypeVar

from galen_hw.clock import NS_PER_S, TimeBase
from galen_hw.drivers.device import Device, Output, Wire
from galen_hw.drivers.dialogue import DialogueError
from galen_hw.drivers.gauge_watch import GaugeWatch
from galen_hw.drivers.kept_zero import Kept, KeptZero
from galen_hw.drivers.reporting import FAR_NS, Reporter
from galen_hw.errors import CommandRejectedError, WrongCommandError
from galen_hw.messages import CommandError, Reply, Request

BROKEN_HOLD_S: Final = 1.0
"""After a gauge was found broken nothing is vouched for until it has been well for so long."""
_TODO_GAUGE: Final = (
    "do not use the wrench; check the sensor's cable, stop what vibrates; if it stays, have it repaired"
)


class Phase(Enum):
    """Where the device stands."""

    OFF = auto()
    STARTING = auto()
    FAILED = auto()
    RUNNING = auto()


class Identity(Protocol):
    """What the start found out."""

    @property
    def serial_number(self) -> str:
        """Of the sensor."""
        ...

    @property
    def described(self) -> str:
        """For people."""
        ...


class Zeroing(Protocol):
    """A `zero` that may be under way."""

    active: bool
    zeroings: int
    deadline_ns: int

    def expire(self) -> list[Output]:
        """Answer it as failed, for its time is up."""
        ...

    def give_up(self, kind: str, what: str) -> list[Output]:
        """Answer it as failed, if it is under way."""
        ...


Found = TypeVar("Found", bound=Identity)


class Conversation(Protocol[Wire, Found]):
    """The questions of the start: `Dialogue` on CAN; over once `result` or `failure` is set."""

    result: Found | None
    failure: DialogueError | None
    due_ns: int
    timeouts: int

    def poll(self, now_ns: int) -> list[Wire]:
        """What to send now; sets `due_ns`."""
        ...

    def feed(self, wire: Wire, t_ns: int, /) -> bool:
        """Take what was read; false when it is no part of an answer that is waited for."""
        ...


class WrenchSensor(Device[Wire], Generic[Wire, Found]):
    """A sensor that is identified by a dialogue and then publishes `wrench/raw`.

    Args:
        name: of the device in the configuration; where: the device for people.
        asked_rate_hz: samples that it should give a second; retry_s: pause before a failed start is tried again.
        counters: names of what is counted, "samples", "timeouts" and "restarts" among them.
        silent_todo: what to look at when it does not answer.
        zeroing: of the device; zero_kept_s: how long the sensor may have been out of sight for a restored zero.
    """

    wire: ClassVar[Literal["can", "serial", "bota"]] = "can"

    def __init__(
        self,
        name: str,
        where: str,
        time_base: TimeBase,
        *,
        asked_rate_hz: float,
        retry_s: float,
        counters: tuple[str, ...],
        silent_todo: str,
        zeroing: Zeroing,
        zero_kept_s: float,
    ) -> None:
        self.name = name
        self._time_base = time_base
        self._reporter = Reporter(name, where, time_base)
        self._counters = dict.fromkeys(counters, 0)
        self._outbox: list[Output] = []
        self._phase = Phase.OFF
        self._dialogue: Conversation[Wire, Found] | None = None
        self._identity: Found | None = None
        self._restart_id: str | None = None
        self._trouble = self._trouble_todo = ""
        self._flowing = False
        self._asked_rate_hz, self._retry_s, self._silent_todo = asked_rate_hz, retry_s, silent_todo
        self._zeroing = zeroing
        self._kept_zero = KeptZero(zero_kept_s)
        self._retry_ns = FAR_NS
        self._gauges = GaugeWatch(asked_rate_hz)
        self._broken_until_ns = 0
        self._broken = ""
        self._measured: dict[str, float] = {}
        """What the sensor measures beside the wrench, for the status; each key with its unit."""

    def start(self, now_ns: int) -> None:
        """Identify the sensor (again); see `Device.start`."""
        self._reporter.start(now_ns)
        self._begin(now_ns)

    @property
    def ready(self) -> bool:
        """The sensor has been identified and samples flow."""
        return self._phase is Phase.RUNNING and self._flowing

    @property
    def counters(self) -> dict[str, int]:
        """Whole numbers that only grow."""
        return dict(self._counters)

    def request(self, request: Request, now_ns: int) -> list[Output]:
        """Carry out `zero` {samples}, `unzero`, `restart`; see `Device.request`."""
        known = {"zero": self._zero, "unzero": self._unzero, "restart": self._restart}
        if request.name not in known:
            todo = f"it knows {', '.join(known)}"
            raise WrongCommandError(f"unknown request {request.name!r}", where=self.name, todo=todo)
        return known[request.name](request, now_ns)

    @abstractmethod
    def _zero(self, request: Request, now_ns: int) -> list[Output]:
        """Begin to zero; the reply may come later."""

    @abstractmethod
    def _unzero(self, request: Request, now_ns: int) -> list[Output]:
        """Take the zero away."""

    @abstractmethod
    def _new_dialogue(self, now_ns: int) -> Conversation[Wire, Found]:
        """The questions of the start; what a start forgets is forgotten here."""

    @abstractmethod
    def _identified(self, identity: Found, now_ns: int) -> list[Wire]:
        """Take up what the start found; what to send so that samples flow."""

    @abstractmethod
    def _running(self, identity: Found, now_ns: int) -> tuple[str, str, str]:
        """Return state and detail for people while samples flow, and what to do where the state is not "ready"."""

    def restore(self, state: dict[str, Any], obstacle: str) -> None:
        """See `Device.restore`."""
        self._kept_zero.offer(state, obstacle)

    def _zero_to_restore(self, identity: Found, count: int, now_ns: int) -> Kept | None:
        """The zero that an earlier process has left for this sensor, with so many values; why not is told."""
        kept, why = self._kept_zero.decide(identity.serial_number, count, now_ns)
        if why:
            what = f"the zero of before the restart is not used: {why}"
            self._outbox += self._reporter.fault(now_ns, "zero", what, "zero the sensor, with no tool on")
        return kept

    @abstractmethod
    def _gauge_name(self, gauge: int) -> str:
        """What the gauge of this index is called, for people."""

    def _judge_gauges(self, t_ns: int) -> None:
        """Judge the gauges: tell what is broken, and vouch for nothing until none has been for a while."""
        if not self._gauges.judge():
            return
        broken = self._gauges.broken
        if not broken:
            if self._broken and t_ns >= self._broken_until_ns:
                self._broken = ""
            return
        names = ("the sensor" if one.gauge < 0 else self._gauge_name(one.gauge) for one in broken)
        self._broken = "; ".join(f"{name} {one.what}" for name, one in zip(names, broken, strict=True))
        self._broken_until_ns = t_ns + round(BROKEN_HOLD_S * NS_PER_S)
        self._outbox += self._reporter.fault(t_ns, "gauge", self._broken, _TODO_GAUGE)
        self._outbox += self._zeroing.give_up("fault", self._broken)

    @property
    def _start_due_ns(self) -> int:
        """When the start wants to be carried on."""
        if self._phase is Phase.STARTING and self._dialogue is not None:
            return self._dialogue.due_ns
        return self._retry_ns if self._phase is Phase.FAILED else FAR_NS

    def _begin(self, now_ns: int) -> None:
        self._phase, self._flowing = Phase.STARTING, False
        self._gauges.interrupt()
        self._counters["restarts"] += self._dialogue is not None
        self._dialogue = self._new_dialogue(now_ns)

    def _converse(self, now_ns: int) -> list[Wire]:
        """Carry the start on, or try it again when its time has come."""
        if self._phase is Phase.FAILED:
            if now_ns < self._retry_ns:
                return []
            self._begin(now_ns)
        assert self._dialogue is not None, "it is being started"
        timeouts = self._dialogue.timeouts
        wires: list[Wire] = self._dialogue.poll(now_ns)
        self._counters["timeouts"] += self._dialogue.timeouts - timeouts
        if self._dialogue.failure is not None:
            self._fail(now_ns, self._dialogue.failure)
        elif self._dialogue.result is not None:
            identity: Found = self._dialogue.result
            self._identity, self._trouble, self._trouble_todo = identity, "", ""
            self._phase = Phase.RUNNING
            wires += self._identified(identity, now_ns)
        return wires

    def _fail(self, now_ns: int, error: DialogueError) -> None:
        self._phase, self._flowing = Phase.FAILED, False
        self._retry_ns = now_ns + round(self._retry_s * NS_PER_S)
        self._trouble, self._trouble_todo = error.what, error.todo or self._silent_todo
        self._outbox += self._reporter.fault(now_ns, error.what, error.what, self._trouble_todo)
        self._give_up(error.what)

    def _switch_off(self) -> None:
        self._phase, self._dialogue, self._flowing = Phase.OFF, None, False
        self._give_up("the sensor was stopped")

    def _restart(self, request: Request, now_ns: int) -> list[Output]:
        request.require_only()
        if self._phase is Phase.OFF or self._restart_id is not None:
            raise CommandRejectedError("it is stopped or being restarted", where=self.name)
        self._give_up("the sensor is being restarted")
        self._begin(now_ns)
        self._restart_id = request.id
        return self._take_outbox()

    def _answer_restart(self) -> None:
        """The first sample after a restart is its answer."""
        if self._restart_id is not None and self._phase is Phase.RUNNING and self._identity is not None:
            self._outbox.append(Reply(id=self._restart_id, result={"serial_number": self._identity.serial_number}))
            self._restart_id = None

    def _give_up(self, what: str) -> None:
        """Answer the requests that are under way and cannot be carried out any more."""
        self._outbox += self._zeroing.give_up("fault", what)
        if self._restart_id is not None:
            error = CommandError(kind="fault", what=what, where=self.name)
            self._outbox.append(Reply(id=self._restart_id, error=error))
            self._restart_id = None

    def _take_outbox(self) -> list[Output]:
        outbox, self._outbox = self._outbox, []
        return outbox

    def _report(self, now_ns: int) -> Output:
        rate_hz = self._reporter.rate_hz(now_ns, self._counters["samples"])
        state, detail, todo = self._state(now_ns)
        gauges = {"rate_hz": rate_hz, "asked_rate_hz": self._asked_rate_hz, **self._measured}
        return self._reporter.status(now_ns, state, detail, self._counters, gauges, todo)

    def _state(self, now_ns: int) -> tuple[str, str, str]:
        """Return state, detail and what to do."""
        if self._phase is Phase.OFF:
            return "stopped", "", ""
        if self._phase is Phase.FAILED:
            return "fault", self._trouble, self._trouble_todo
        if not self.ready or self._identity is None:
            return "starting", self._trouble, self._trouble_todo
        state, detail, todo = self._running(self._identity, now_ns)
        return ("fault", f"{self._broken}; {detail}", _TODO_GAUGE) if self._broken else (state, detail, todo)

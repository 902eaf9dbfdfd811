"""Robotous RFT force/torque sensor, streaming over CAN; RFT series manual, revision 1.7.

Frames are in `robotous_codec`, the questions of the start in `robotous_start`; `robotous_stream` says why no sample is
a wrong one.
"""

from enum import Enum, auto
from typing import ClassVar, Final, Literal

from galen_hw.clock import NS_PER_S, TimeBase
from galen_hw.drivers.device import CanFrame, Device, Output
from galen_hw.drivers.dialogue import Dialogue, DialogueError
from galen_hw.drivers.reporting import FAR_NS, Reporter
from galen_hw.drivers.robotous_rft import codec
from galen_hw.drivers.robotous_rft.codec import DATA, OVERLOAD_MASK, Command
from galen_hw.drivers.robotous_rft.start import RobotousIdentity, RobotousSettings, identify
from galen_hw.drivers.robotous_rft.stream import Pairer
from galen_hw.drivers.robotous_rft.zero import DeviceBias
from galen_hw.errors import CommandRejectedError
from galen_hw.messages import CommandError, Reply, Request, Vector3, WrenchRaw

COUNTERS: Final = (
    "samples",  # published
    "lost",  # of which a frame is missing
    "timeouts",
    "late",  # frames nobody waited for, or that had piled up
    "doubled",  # frames that came twice
    "short",  # frames of a wrong length
    "foreign",  # frames of another device
    "echoes",  # commands, ours or another host's, shown to us by the wire
    "saturated",  # samples with an axis more than 20 % over its rating
    "restarts",
)


class Phase(Enum):
    """Where the device stands."""

    OFF = auto()
    STARTING = auto()
    FAILED = auto()
    RUNNING = auto()


class RobotousRft(Device[CanFrame]):
    """Publishes `wrench/raw` in the sensor frame about its origin, N and N m, stamped when its second frame was read.

    Requests: `zero` {samples}: the sensor's own bias, then `samples` samples that must show it; `unzero`; `restart`.
    """

    Settings = RobotousSettings
    wire: ClassVar[Literal["can", "serial"]] = "can"

    def __init__(self, name: str, settings: RobotousSettings, time_base: TimeBase) -> None:
        self.name = name
        self._settings = settings
        self._time_base = time_base
        ids = f"{settings.receiver_id:#x}, {settings.transmitter1_id:#x}, {settings.transmitter2_id:#x}"
        self._reporter = Reporter(name, f"{name} (Robotous RFT, CAN ids {ids})", time_base)
        self._counters = dict.fromkeys(COUNTERS, 0)
        self._outbox: list[Output] = []
        self._wires: list[CanFrame] = []
        self._phase = Phase.OFF
        self._due_ns = FAR_NS
        self._dialogue: Dialogue[RobotousIdentity] | None = None
        self._identity: RobotousIdentity | None = None
        self._pairer = self._new_pairer()
        self._bias = DeviceBias(name, settings)
        self._restart_id: str | None = None
        self._trouble = ""
        self._flowing = False
        self._newton = self._newton_metre = 0.0

    # ------------------------------------------------------------ the interface of every device

    def start(self, now_ns: int) -> None:
        """Stop the stream, identify and set the sensor, and start the stream (again), without a zero."""
        self._reporter.start(now_ns)
        self._begin(now_ns)

    def poll(self, now_ns: int) -> tuple[list[CanFrame], list[Output]]:
        """The conversation of the start, a stream that went silent, and the status once a second."""
        wires, self._wires = self._wires, []
        if self._phase is Phase.RUNNING and now_ns >= self._due_ns:
            self._counters["timeouts"] += 1
            self._fail(now_ns, DialogueError("no samples come", ""))
        elif self._phase is Phase.FAILED and now_ns >= self._due_ns:
            self._begin(now_ns)
        if self._phase is Phase.STARTING:
            wires += self._converse(now_ns)
        if now_ns >= self._bias.deadline_ns:
            self._outbox += self._bias.give_up("timeout", "too few samples came in time")
        if now_ns >= self._reporter.status_due_ns:
            self._outbox.append(self._report(now_ns))
        return wires, self._take_outbox()

    def feed(self, wire: CanFrame, t_ns: int) -> list[Output]:
        """Take one frame; a sample comes out with the second frame of its pair."""
        if wire.arbitration_id == self._settings.transmitter2_id:
            response = self._pairer.second(wire.data, t_ns) if self._running_or_late(wire, t_ns) else None
            if response is not None:
                return self._sample(response, t_ns)
        elif wire.arbitration_id == self._settings.transmitter1_id:
            if self._running_or_late(wire, t_ns):
                self._pairer.first(wire.data, t_ns)
        elif wire.arbitration_id == self._settings.receiver_id:
            self._counters["echoes"] += 1
        else:
            self._counters["foreign"] += 1
        return self._take_outbox() if self._outbox else []

    def request(self, request: Request, now_ns: int) -> list[Output]:
        """`zero` {samples}, `unzero`, `restart`; see `Device.request`."""
        if request.name == "zero":
            self._wires += self._bias.zero(request, now_ns, ready=self.ready)
            return []
        if request.name == "unzero":
            wires, replies = self._bias.unzero(request, ready=self.ready)
            self._wires += wires
            return replies
        if request.name != "restart":
            todo = "it knows zero, unzero, restart"
            raise CommandRejectedError(f"unknown request {request.name!r}", where=self.name, todo=todo)
        if self._phase is Phase.OFF or self._restart_id is not None:
            raise CommandRejectedError("it is stopped or being restarted", where=self.name)
        self._give_up("the sensor is being restarted")
        self._begin(now_ns)
        self._restart_id = request.id
        return self._take_outbox()

    def stop(self, now_ns: int) -> list[CanFrame]:
        """End the stream."""
        was_on = self._phase is not Phase.OFF
        self._phase, self._due_ns, self._dialogue, self._flowing, self._wires = Phase.OFF, FAR_NS, None, False, []
        self._give_up("the sensor was stopped")
        return [codec.command(self._settings.receiver_id, Command.STOP_OUTPUT)] if was_on else []

    @property
    def wakeup_ns(self) -> int:
        """When `poll` wants to be called next."""
        if self._wires:
            return 0
        starting = self._phase is Phase.STARTING and self._dialogue is not None
        due = self._dialogue.due_ns if starting and self._dialogue is not None else self._due_ns
        return min(due, self._reporter.status_due_ns, self._bias.deadline_ns)

    @property
    def ready(self) -> bool:
        """The sensor has been identified and samples flow."""
        return self._phase is Phase.RUNNING and self._flowing

    @property
    def counters(self) -> dict[str, int]:
        """Whole numbers that only grow; see `COUNTERS`."""
        return dict(self._counters)

    # ------------------------------------------------------------ start

    def _new_pairer(self) -> Pairer:
        period_ns = NS_PER_S // self._settings.rate_hz
        window_ns = min(round(self._settings.pair_window_s * NS_PER_S), period_ns // 2)
        return Pairer(period_ns, window_ns, round(self._settings.stall_s * NS_PER_S), self._counters)

    def _begin(self, now_ns: int) -> None:
        self._phase, self._flowing, self._due_ns = Phase.STARTING, False, FAR_NS
        self._counters["restarts"] += self._dialogue is not None
        if self._bias.zeroed:
            self._bias.zeroed = False
            self._outbox += self._reporter.fault(now_ns, "zero", "the sensor's zero is lost", "zero the sensor again")
        timeout_ns = round(self._settings.reply_timeout_s * NS_PER_S)
        self._dialogue = Dialogue(identify(self._settings), timeout_ns, self._settings.tries, due_ns=now_ns)

    def _converse(self, now_ns: int) -> list[CanFrame]:
        assert self._dialogue is not None
        timeouts = self._dialogue.timeouts
        wires = self._dialogue.poll(now_ns)
        self._counters["timeouts"] += self._dialogue.timeouts - timeouts
        if self._dialogue.failure is not None:
            self._fail(now_ns, self._dialogue.failure)
        elif self._dialogue.result is not None:
            self._identity, self._trouble = self._dialogue.result, ""
            self._newton, self._newton_metre = self._identity.newton, self._identity.newton_metre
            self._pairer = self._new_pairer()
            self._phase, self._due_ns = Phase.RUNNING, now_ns + self._patience_ns
            return [*wires, codec.command(self._settings.receiver_id, Command.START_OUTPUT)]
        return wires

    @property
    def _patience_ns(self) -> int:
        return round((self._settings.sample_timeout_s + 2.0 / self._settings.rate_hz) * NS_PER_S)

    def _fail(self, now_ns: int, error: DialogueError) -> None:
        self._phase, self._flowing = Phase.FAILED, False
        self._due_ns = now_ns + round(self._settings.retry_s * NS_PER_S)
        self._trouble = error.what
        self._outbox += self._reporter.fault(now_ns, error.what, error.what, error.todo or _TODO_SILENT)
        self._give_up(error.what)

    def _running_or_late(self, wire: CanFrame, t_ns: int) -> bool:
        """True when the frame is the stream's business; else it is the start's, or nobody's."""
        if self._phase is Phase.RUNNING:
            return True
        if self._phase is Phase.STARTING and self._dialogue is not None and self._dialogue.feed(wire, t_ns):
            return False
        self._counters["short" if len(wire.data) != codec.LENGTH else "late"] += 1
        return False

    # ------------------------------------------------------------ samples

    def _sample(self, response: bytes, t_ns: int) -> list[Output]:
        *axes, flags = DATA.unpack(response)
        overloaded = bool(flags & OVERLOAD_MASK)
        newton, newton_metre = self._newton, self._newton_metre
        fx, fy, fz = axes[0] * newton, axes[1] * newton, axes[2] * newton
        tx, ty, tz = axes[3] * newton_metre, axes[4] * newton_metre, axes[5] * newton_metre
        self._counters["samples"] += 1
        self._flowing, self._due_ns = True, t_ns + self._patience_ns
        if overloaded or self._bias.active or self._restart_id is not None:
            self._beside_sample(flags, (fx, fy, fz, tx, ty, tz), t_ns)
        message = WrenchRaw(
            timestamp=self._time_base.timestamp(t_ns),
            t_ns=t_ns,
            seq=self._reporter.next_seq("wrench/raw"),
            valid=not overloaded,
            source=self.name,
            force=Vector3(fx, fy, fz),
            torque=Vector3(tx, ty, tz),
            status=flags,
            saturated=overloaded,
            serial_number=self._identity.serial_number if self._identity is not None else "",
        )
        return [("wrench/raw", message), *self._take_outbox()] if self._outbox else [("wrench/raw", message)]

    def _beside_sample(self, flags: int, wrench: tuple[float, ...], t_ns: int) -> None:
        """What is rare: overload, the answer to `restart`, zeroing."""
        if flags & OVERLOAD_MASK:
            self._counters["saturated"] += 1
            what = f"overload in {', '.join(codec.overloaded_axes(flags))} (more than 20 % over the rating)"
            self._outbox += self._reporter.fault(t_ns, "overload", what, "take the load off")
        if self._restart_id is not None and self._identity is not None:
            self._outbox.append(Reply(id=self._restart_id, result={"serial_number": self._identity.serial_number}))
            self._restart_id = None
        if self._bias.active and flags & OVERLOAD_MASK:
            self._outbox += self._bias.give_up("fault", "an axis is overloaded")
        elif self._bias.active:
            wires, replies = self._bias.add(wrench, t_ns)
            self._wires += wires
            self._outbox += replies

    def _give_up(self, what: str) -> None:
        """Answer the requests that are under way and cannot be carried out any more."""
        self._outbox += self._bias.give_up("fault", what)
        if self._restart_id is not None:
            error = CommandError(kind="fault", what=what, where=self.name)
            self._outbox.append(Reply(id=self._restart_id, error=error))
            self._restart_id = None

    # ------------------------------------------------------------ status

    def _take_outbox(self) -> list[Output]:
        outbox, self._outbox = self._outbox, []
        return outbox

    def _report(self, now_ns: int) -> Output:
        rate_hz = self._reporter.rate_hz(now_ns, self._counters["samples"])
        state, detail = self._state()
        gauges = {"rate_hz": rate_hz, "asked_rate_hz": float(self._settings.rate_hz)}
        return self._reporter.status(now_ns, state, detail, self._counters, gauges)

    def _state(self) -> tuple[str, str]:
        if self._phase is Phase.OFF:
            return "stopped", ""
        if self._phase is Phase.FAILED:
            return "fault", self._trouble
        if self._identity is None or not self.ready:
            return "starting", self._trouble
        return "ready", f"{self._identity.described}, {'zeroed' if self._bias.zeroed else 'not zeroed'}"


_TODO_SILENT: Final = "check its power, CAN wiring and termination, identifiers and the bit rate (1 Mbit/s)"

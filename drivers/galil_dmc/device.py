"""Galil DMC motor controller on a serial line or a socket (`socket://`), as a device without I/O.

Joint states come from the controller's binary data record (QR) of the axes in use, one request after the other, so
that the line sets the pace; requests go between them. Units, budget and what each command does: docs/motors.md.
Sources: Galil DMC-40x0 manual and command reference; record layout of gclib.
"""

from typing import ClassVar, Final, Literal

from galen_hw.clock import NS_PER_S, TimeBase
from galen_hw.drivers.device import Device, Output
from galen_hw.drivers.galil_dmc.axes import Axes
from galen_hw.drivers.galil_dmc.jobs import Finished, GalilJobs, Job
from galen_hw.drivers.galil_dmc.link import Answer, GalilLink
from galen_hw.drivers.galil_dmc.requests import GalilRequests
from galen_hw.drivers.galil_dmc.scripts import (
    Controller,
    Result,
    Script,
    SilentError,
    WrongDeviceError,
    connect,
    disable,
    one,
    record_exchange,
    status,
)
from galen_hw.drivers.galil_dmc.settings import GalilSettings
from galen_hw.drivers.galil_dmc.state import GalilState
from galen_hw.drivers.galil_dmc.watch import BEAT, BEATS_A_TIMEOUT, THREAD, arm, beaten
from galen_hw.drivers.reporting import FAR_NS, Reporter
from galen_hw.messages import JointsState, Request

_SILENCES_TO_LOSE: Final = 2


class GalilDmc(Device[bytes]):
    """A Galil DMC-40x0, 41x3, 42x0 or 500x0: publishes `joints/state`, `status` and `fault`.

    Requests: `enable`, `disable`, `move_jp`, `servo_jv`, `stop`, `abort`, `clear_fault`; see docs/motors.md.

    Args:
        name: of the device in the configuration.
        settings: axes, rates and times.
        time_base: monotonic to wall clock.
    """

    Settings = GalilSettings
    motions: ClassVar[frozenset[str]] = frozenset({"enable", "move_jp", "servo_jv"})

    wire: ClassVar[Literal["can", "serial"]] = "serial"

    def __init__(self, name: str, settings: GalilSettings, time_base: TimeBase) -> None:
        self.name = name
        self._settings, self._time_base = settings, time_base
        self._axes = Axes(settings.axes, name, settings.stop_s)
        self._link = GalilLink(_ns(settings.reply_timeout_s), _ns(settings.quiet_s))
        self._jobs = GalilJobs(self._link)
        self._state = GalilState(self._axes, settings.limit_active_level)
        self._requests = GalilRequests(self._axes, self._state, self._jobs)
        self._report = Reporter(name, f"{name} (Galil DMC, axes {self._axes.letters})", time_base)
        self._counts = dict.fromkeys(
            ("samples", "timeouts", "lost_connections", "watchdog_stops", "controller_stops"), 0
        )
        self._outbox: list[Output] = []
        self._period_ns = round(NS_PER_S / settings.rate_hz)
        self._record = record_exchange(self._axes.letters)
        self._connected = False
        self._model = ""
        self._trouble = self._todo = ""
        self._t_ns = 0
        self._connect_ns = self._record_ns = self._status_ns = self._servo_ns = self._beat_ns = FAR_NS
        self._beat_every_ns = _ns(settings.watchdog_s / BEATS_A_TIMEOUT)

    def start(self, now_ns: int) -> None:
        """Begin, or begin again: what waits is answered, the controller is identified anew."""
        self._outbox += self._lose(now_ns) if self._connected else self._end_all(now_ns)
        self._jobs.reset()
        self._state.reset()
        self._trouble = self._todo = ""
        self._connect_ns = now_ns
        self._report.start(now_ns)

    def poll(self, now_ns: int) -> tuple[list[bytes], list[Output]]:
        """What to send now; time-outs, the watchdog of servo_jv, attempts to reconnect, a status a second."""
        out, self._outbox = self._outbox, []
        silences = self._jobs.silences
        wires, ended = self._jobs.poll(now_ns)
        out += self._finish_all(ended, now_ns)
        if self._jobs.silences > silences:
            out += self._silence(now_ns)
        out += self._watch(now_ns)
        self._schedule(now_ns)
        due = self._connected and now_ns >= self._record_ns
        beat = BEAT if self._connected and now_ns >= self._beat_ns else None
        more, ended = self._jobs.wires(now_ns, self._record if due else None, beat)
        if more == [BEAT.wire]:
            self._beat_ns = now_ns + self._beat_every_ns
        if more == [self._record.wire]:
            self._record_ns = max(self._record_ns + self._period_ns, now_ns)
        out += self._finish_all(ended, now_ns)
        if now_ns >= self._report.status_due_ns:
            out.append(self._status(now_ns))
        return wires + more, out

    def feed(self, wire: bytes, t_ns: int) -> list[Output]:
        """Take what was read at `t_ns`."""
        out, self._outbox = self._outbox, []
        for event in self._jobs.feed(wire, t_ns):
            out += self._answer(event) if isinstance(event, Answer) else self._finish(event, t_ns)
        for line in self._link.said():
            out += self._report.fault(t_ns, f"said {line}", f"the controller says: {line}")
        return out

    def request(self, request: Request, now_ns: int) -> list[Output]:
        """Begin a command; see docs/motors.md for each of them.

        Raises:
            CommandRejectedError: a number, a limit or the robot's state forbids it; nothing is sent.
        """
        ended = self._requests.take(request, connected=self._connected, fault=self._trouble)
        if request.name == "servo_jv":
            self._servo_ns = now_ns + _ns(self._settings.servo_timeout_s)
        elif request.name in {"stop", "abort", "disable"}:
            self._servo_ns = FAR_NS
        return self._finish_all(ended, now_ns)

    def stop(self, now_ns: int) -> list[bytes]:
        """ST for all axes, even while an answer is pending; nothing more is sent until the next `start`."""
        if self._connected:
            self._outbox += self._lose(now_ns)
        self._outbox += self._end_all(now_ns)
        self._link.drain(now_ns)  # what still arrives belongs to nobody
        self._connect_ns = FAR_NS
        self._trouble, self._todo = "stopped", ""
        wires = [f"ST {self._axes.letters}\r".encode()]
        return [*wires, f"HX {THREAD}\r".encode()] if self._settings.watchdog_s else wires

    def trip(self, what: str, now_ns: int) -> list[Output]:
        """ST before all that waits, which is cancelled; motion is refused until `clear_fault`."""
        self._state.latched["trip"] = what
        self._servo_ns = FAR_NS
        self._requests.jogging.clear()
        out = self._finish_all(self._jobs.cancel(), now_ns)
        self._stop_soon()
        return out + self._report.fault(now_ns, "trip", what, f"remove the cause, then {self._axes.again}")

    @property
    def held(self) -> str:
        """What is latched until `clear_fault`."""
        latched = "; ".join(self._state.latched.values())
        return f"{latched}; remove the cause, then {self._axes.again}" if latched else ""

    @property
    def live(self) -> bool:
        """A motor is on, or what may move the robot waits."""
        return self._connected and (self._state.powered or self._jobs.pending)

    @property
    def wakeup_ns(self) -> int:
        """The next time-out, record, watchdog or status; 0 when there is something to send or to say now."""
        if self._outbox or (self._link.idle and self._jobs.pending):
            return 0
        waiting = self._link.deadline_ns
        times = [self._connect_ns, self._servo_ns, self._report.status_due_ns]
        if waiting is not None:
            return min([waiting, *times])
        return min([self._record_ns, self._status_ns, self._beat_ns, *times] if self._connected else times)

    @property
    def ready(self) -> bool:
        """Identified, and joint states flow."""
        return self._connected and self._t_ns > 0

    @property
    def counters(self) -> dict[str, int]:
        """Joint states published, time-outs, lost connections, and what the line held besides answers."""
        return self._counts | dict(self._link.counters)

    def _schedule(self, now_ns: int) -> None:
        if now_ns >= self._connect_ns:
            self._connect_ns = FAR_NS
            self._add("connect", self._connect())
        if self._connected and (now_ns >= self._status_ns or self._state.status_due) and not self._jobs.named("status"):
            self._status_ns = now_ns + _ns(self._settings.status_interval_s)
            self._add("status", status(self._axes.letters))

    def _connect(self) -> Script:
        """Identify the controller, then set up its own time-out."""
        found = yield from connect(self._axes, write_limits=self._settings.write_limits)
        if self._settings.watchdog_s:
            found |= yield from arm(self._axes.letters, self._settings.watchdog_s)
        return found

    def _add(self, name: str, script: Script, *, urgent: bool = False) -> None:
        self._jobs.add(Job(name, script, urgent=urgent))

    def _watch(self, now_ns: int) -> list[Output]:
        """Stop the axes that jog on without a refresh."""
        if now_ns < self._servo_ns:
            return []
        self._servo_ns = FAR_NS
        if not self._requests.jogging and not self._jobs.named("servo_jv"):
            return []
        out = self._finish_all(self._jobs.cancel(), now_ns)
        self._stop_soon()
        if self._requests.at_zero:  # it ended as it should
            return out
        self._counts["watchdog_stops"] += 1
        what = f"servo_jv was not refreshed for {self._settings.servo_timeout_s:g} s, stopped"
        return out + self._report.fault(now_ns, "watchdog", what, "send servo_jv more often, or stop when done")

    def _stop_soon(self) -> None:
        if not self._jobs.named("safety stop"):
            self._add("safety stop", one(f"ST {self._axes.letters}", {}), urgent=True)

    def _silence(self, now_ns: int) -> list[Output]:
        """An answer did not come: ask for a record first, which cannot be mistaken; the second time, start anew."""
        self._counts["timeouts"] += 1
        self._record_ns = min(self._record_ns, now_ns)
        if not self._connected or self._jobs.silences < _SILENCES_TO_LOSE:
            return []
        self._trouble = "the controller does not answer"
        self._todo = "check power, cable and baud rate; a jogging axis is stopped by the controller's own limits only"
        self._counts["lost_connections"] += 1
        self._connect_ns = now_ns + _ns(self._settings.reconnect_s)
        return [*self._lose(now_ns), *self._report.fault(now_ns, "lost", self._trouble, self._todo)]

    def _lose(self, now_ns: int) -> list[Output]:
        """Forget the connection: who waits is answered, and subscribers see that the joint state is no longer good."""
        self._connected = False
        self._record_ns = self._status_ns = self._servo_ns = self._beat_ns = FAR_NS
        self._state.arming = False
        out = self._end_all(now_ns)
        self._requests.jogging.clear()
        return [*out, self._joints(now_ns, valid=False)]

    def _end_all(self, now_ns: int) -> list[Output]:
        return self._finish_all(self._jobs.abandon(SilentError()), now_ns)

    def _answer(self, answer: Answer) -> list[Output]:
        if answer.exchange is BEAT:
            return [] if beaten(answer) and not self._state.arming else self._lapsed(answer.t_ns)
        if answer.record is None:
            if answer.exchange.record:
                return self._report.fault(answer.t_ns, "QR", "the controller refuses QR", "check its model")
            return []
        faults = self._state.take_record(answer.record)
        self._requests.jogging &= self._state.moving_joints
        out: list[Output] = []
        for what, todo in faults:
            out += self._report.fault(answer.t_ns, what, what, todo)
        if not self._connected:
            return out
        if self._state.disagreeing and not self._jobs.named("disable"):
            out += self._all_off(answer.t_ns)
        if answer.exchange is not self._record:
            self._record_ns += self._period_ns  # the status brought this joint state
        self._counts["samples"] += 1
        self._t_ns = max(answer.sent_ns, answer.t_ns - _ns(self._settings.record_age_s), self._t_ns + 1)
        return [self._joints(self._t_ns, valid=True), *out]

    def _lapsed(self, t_ns: int) -> list[Output]:
        """The controller's time-out has run out, or its program is gone: nothing begins before it is set up anew."""
        self._beat_ns, self._state.arming = FAR_NS, True
        self._requests.jogging.clear()
        out = self._finish_all(self._jobs.cancel(), t_ns)
        self._add("arm", arm(self._axes.letters, self._settings.watchdog_s), urgent=True)
        return out

    def _armed(self, result: Result, now_ns: int) -> list[Output]:
        """What the controller's time-out has done, and whether there is one now."""
        self._state.arming = False
        out: list[Output] = []
        if result["tripped"]:
            self._counts["controller_stops"] += 1
            what = f"the controller heard nothing for {self._settings.watchdog_s:g} s and stopped the axes"
            self._state.latched["watchdog"] = what
            out += self._report.fault(now_ns, "watchdog", what, f"find out why, then {self._axes.again}")
        if result["unwatched"]:
            what = f"the controller stops nothing by itself when it hears nothing: {result['unwatched']}"
            out += self._report.fault(now_ns, "unwatched", what, "see docs/motors.md, or set watchdog_s = 0")
        else:
            self._beat_ns = now_ns
        return out

    def _all_off(self, t_ns: int) -> list[Output]:
        what = "some motors are on and some are off, all are switched off"
        self._state.latched["motors"] = what
        out = self._finish_all(self._jobs.cancel(), t_ns)
        self._add("disable", disable(self._axes.letters), urgent=True)
        return out + self._report.fault(t_ns, "motors", what, f"find the axis that tripped, then {self._axes.again}")

    def _finish_all(self, ended: list[Finished], now_ns: int) -> list[Output]:
        return [output for finished in ended for output in self._finish(finished, now_ns)]

    def _finish(self, finished: Finished, now_ns: int) -> list[Output]:
        """A script's end: the reply to its request, and what the driver itself makes of it."""
        job, error = finished.job, finished.error
        out: list[Output] = []
        if job.name == "connect":
            out += self._connection(finished.result, error, now_ns)
        elif job.name == "arm":
            out += self._armed(finished.result, now_ns) if error is None else self._unarmed(error, now_ns)
        elif error is None and job.name in {"status", "clear_fault"}:
            out += self._take_status(finished.result, now_ns)
        elif isinstance(error, SilentError) and job.name in {"move_jp", "servo_jv", "enable"} and self._connected:
            self._stop_soon()  # it may have been carried out
        elif error is not None and not job.request_id:
            out += self._report.fault(now_ns, job.name, f"{job.name}: {error}", getattr(error, "todo", ""))
        return [*out, self._requests.reply(finished)] if job.request_id else out

    def _unarmed(self, error: Exception, now_ns: int) -> list[Output]:
        """The time-out could not be set up: it is tried again with the next beat, and until then nothing begins."""
        self._beat_ns = now_ns + self._beat_every_ns
        what = f"the controller's own time-out cannot be set up: {error or 'no answer'}"
        return self._report.fault(now_ns, "unwatched", what, "see docs/motors.md")

    def _take_status(self, result: Result, now_ns: int) -> list[Output]:
        faults = self._state.take_status(amplifier_status=result["amplifier_status"], abort_input=result["abort_input"])
        return [output for what, todo in faults for output in self._report.fault(now_ns, what, what, todo)]

    def _connection(self, result: Result, error: Exception | None, now_ns: int) -> list[Output]:
        if error is not None:
            wrong = isinstance(error, WrongDeviceError)
            self._trouble = str(error) or "no answer from the controller"
            self._connect_ns = now_ns + _ns(self._settings.reconnect_s)
            self._todo = "check the port in the configuration" if wrong else "check power, cable, port and baud rate"
            return self._report.fault(now_ns, "connect", self._trouble, self._todo)
        controller: Controller = result["controller"]
        self._connected, self._model = True, controller.model
        self._trouble = self._todo = ""
        self._state.disabled_limits = controller.disabled_limits
        self._record_ns = now_ns
        self._status_ns = now_ns + _ns(self._settings.status_interval_s)
        out = self._take_status(result, now_ns)
        return out + self._armed(result, now_ns) if self._settings.watchdog_s else out

    def _joints(self, t_ns: int, *, valid: bool) -> Output:
        message = JointsState(
            timestamp=self._time_base.timestamp(t_ns),
            t_ns=t_ns,
            seq=self._report.next_seq("joints/state"),
            valid=valid,
            source=self.name,
            estop=self._state.estop,
            **self._state.joints(),  # type: ignore[arg-type]
        )
        return ("joints/state", message)

    def _status(self, now_ns: int) -> Output:
        if not self._connected:
            state = {"": "starting", "stopped": "stopped"}.get(self._trouble, "fault")
        else:
            state = "fault" if self._state.latched or self._state.estop else "ready"
        latched = "; ".join(self._state.latched.values())
        detail = self._trouble or latched or self._model
        gauges = {"rate_hz": self._report.rate_hz(now_ns, self._counts["samples"])}
        if self._t_ns:
            gauges["age_s"] = (now_ns - self._t_ns) / NS_PER_S
        return self._report.status(now_ns, state, detail, self.counters, gauges, self._todo or self._state.todo)


def _ns(seconds: float) -> int:
    return round(seconds * NS_PER_S)

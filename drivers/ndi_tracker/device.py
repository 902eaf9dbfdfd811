"""NDI optical tracker (Polaris, Vega, Aurora) by the Combined API, on a serial line or a socket, without I/O.

Tracking replies are asked for faster than frames come, so that every frame is seen; what makes a sample is a new frame
number, and the frame number is its clock (see `ndi_clock`). NDI says so itself: the frame number, not the host's time,
tells when data was collected.
"""

from string import hexdigits
from typing import ClassVar, Final, Literal

from galen_hw.clock import NS_PER_S, TimeBase
from galen_hw.drivers.device import Device, Output
from galen_hw.drivers.ndi_tracker.codec import BadReplyError, Tracking, parse_bx, parse_tx
from galen_hw.drivers.ndi_tracker.link import NdiLink, NdiReply
from galen_hw.drivers.ndi_tracker.poses import TODO_UNSEEN, NdiPoses
from galen_hw.drivers.ndi_tracker.scripts import (
    Ask,
    Hear,
    NdiError,
    NdiSetupError,
    NdiSilentError,
    NdiUnsettledError,
    Pause,
    Script,
    Step,
    connect,
)
from galen_hw.drivers.ndi_tracker.settings import NdiSettings
from galen_hw.drivers.reporting import FAR_NS, Reporter
from galen_hw.drivers.serial_line import LineControl
from galen_hw.errors import CommandRejectedError, WrongCommandError
from galen_hw.messages import Reply, Request

_FAILURES_TO_LOSE: Final = 3
_NOT_TRACKING: Final = frozenset({0x0C, 0x10})


class NdiTracker(Device[bytes]):
    """An NDI tracker: publishes `tracker/tool` and `tracker/reference`, `status` and `fault`; takes `restart`.

    Args:
        name: of the device in the configuration.
        settings: marker bodies, line, rates.
        time_base: monotonic to wall clock.
    """

    Settings = NdiSettings

    wire: ClassVar[Literal["can", "serial"]] = "serial"

    def __init__(self, name: str, settings: NdiSettings, time_base: TimeBase) -> None:
        self.name = name
        self._settings = settings
        self._link = NdiLink()
        self._report = Reporter(name, f"{name} (NDI tracker)", time_base)
        self._poses = NdiPoses(self._report, settings.frame_rate_hz, settings.latency_s, settings.missing_s)
        self._counts = dict.fromkeys(("timeouts", "errors", "lost_connections"), 0)
        self._outbox: list[Output] = []
        self._script: Script | None = None
        self._step: Step | None = None
        self._unsettled = False
        self._tracking = False
        self._stopped = True
        self._trouble = self._todo = ""
        self._failures = 0
        self._connect_ns = self._ask_ns = FAR_NS

    def start(self, now_ns: int) -> None:
        """Begin, or begin again: the tracker is brought from any state to tracking."""
        self._forget()
        self._stopped, self._trouble, self._todo = False, "", ""
        self._connect_ns = now_ns
        self._report.start(now_ns)

    def poll(self, now_ns: int) -> tuple[list[bytes], list[Output]]:
        """What to send now: the steps of the connection, then one tracking request after the other."""
        out, self._outbox = self._outbox, []
        if now_ns >= self._connect_ns:
            self._begin()
        out += self._expire(now_ns)
        wires, more = self._steps(now_ns)
        out += more
        if self._tracking and now_ns >= self._ask_ns and not self._link.busy:
            wires.append(self._link.send(f"{self._settings.reply}:0801", now_ns, _ns(self._settings.reply_timeout_s)))
            self._ask_ns = max(self._ask_ns + round(NS_PER_S / self._settings.poll_rate_hz), now_ns)
        if now_ns >= self._report.status_due_ns:
            out.append(self._status(now_ns))
        return wires, out

    def feed(self, wire: bytes, t_ns: int) -> list[Output]:
        """Take what was read at `t_ns`."""
        out, self._outbox = self._outbox, []
        for reply in self._link.feed(wire, t_ns, _ns(self._settings.quiet_s)):
            if reply.error:
                self._unsettled = True
                continue  # the drain that follows ends in a failure
            if self._script is not None:
                out += self._answer(reply)
            elif self._tracking:
                out += self._track(reply)
        return out

    def request(self, request: Request, now_ns: int) -> list[Output]:
        """`restart`: connect anew.

        Raises:
            CommandRejectedError: not started yet. WrongCommandError: anything else.
        """
        if request.name != "restart" or request.args:
            raise WrongCommandError(
                f"no command {request.name!r}", where=self.name, todo="the tracker takes restart, without arguments"
            )
        if self._stopped:
            raise CommandRejectedError("not started", where=self.name)
        self.start(now_ns)
        return [Reply(id=request.id)]

    def stop(self, now_ns: int) -> list[bytes]:
        """End tracking; nothing more is sent until the next `start`."""
        self._forget()
        self._stopped = True
        self._link.drain(now_ns)
        return [NdiLink().send("TSTOP:", now_ns, 0)]

    @property
    def wakeup_ns(self) -> int:
        """The next time-out, step, request or status; 0 when there is something to send or say now."""
        if self._outbox:
            return 0
        times = [self._connect_ns, self._report.status_due_ns]
        if self._link.busy:
            return min(self._link.deadline_ns, *times)
        if self._step is not None:
            return 0
        return min(self._ask_ns, *times) if self._tracking else min(times)

    @property
    def ready(self) -> bool:
        """Tracking, and at least one reply has come."""
        return self._tracking and self._poses.replies > 0

    @property
    def counters(self) -> dict[str, int]:
        """Samples, repeated and dropped frames, missing bodies, time-outs, errors, bad checksums, foreign bytes."""
        return self._poses.counts | self._counts | dict(self._link.counters)

    def _forget(self) -> None:
        self._link.reset()
        self._unsettled = False
        self._script = self._step = None
        self._tracking = False
        self._failures = 0
        self._connect_ns = self._ask_ns = FAR_NS

    def _begin(self) -> None:
        settings = self._settings
        self._forget()
        self._script = connect(
            settings.markers, settings.baud_rate or None, _ns(settings.init_timeout_s), _ns(settings.reset_timeout_s)
        )
        self._step = next(self._script)

    def _expire(self, now_ns: int) -> list[Output]:
        """A reply that is overdue drains the line; the end of a drain ends a pause, or fails what was asked."""
        if not self._link.busy or now_ns < self._link.deadline_ns:
            return []
        if self._link.asked:
            self._counts["timeouts"] += not isinstance(self._step, Hear)
            self._link.drain(now_ns + _ns(self._settings.quiet_s))
            return []
        self._link.draining = False
        if self._script is not None:
            silence = NdiUnsettledError() if self._unsettled else NdiSilentError()
            self._unsettled = False
            return self._advance("" if isinstance(self._step, Pause) else silence, now_ns)
        return self._fail("no readable reply from the tracker", now_ns) if self._tracking else []

    def _steps(self, now_ns: int) -> tuple[list[bytes], list[Output]]:
        """Carry out the steps of the connection up to the next that takes time."""
        wires: list[bytes] = []
        out: list[Output] = []
        while self._step is not None and not self._link.busy:
            step = self._step
            if isinstance(step, Ask):
                timeout_ns = step.timeout_ns or _ns(self._settings.reply_timeout_s)
                wires.append(self._link.send(step.text, now_ns, timeout_ns))
            elif isinstance(step, Hear):
                self._link.listen(now_ns, step.timeout_ns)
            elif isinstance(step, Pause):
                self._link.drain(now_ns + step.duration_ns)
            else:
                wires.append(LineControl(step))
                out += self._advance("", now_ns)
        return wires, out

    def _answer(self, reply: NdiReply) -> list[Output]:
        """Give the connection's script the reply it waits for."""
        text = reply.text
        if text.startswith("ERROR") and isinstance(self._step, Ask):
            return self._advance(NdiError(self._step.text, _code(text)), reply.t_ns)
        if text == "RESET" and not isinstance(self._step, Hear):
            return self._advance(NdiUnsettledError(), reply.t_ns)
        return self._advance(text, reply.t_ns)

    def _advance(self, given: str | Exception, t_ns: int) -> list[Output]:
        assert self._script is not None
        try:
            self._step = self._script.throw(given) if isinstance(given, Exception) else self._script.send(given)
        except StopIteration as end:
            self._script = self._step = None
            self._poses.begin(end.value, t_ns)
            self._tracking, self._failures, self._ask_ns = True, 0, t_ns
            self._trouble = self._todo = ""
            return []
        except (NdiError, NdiSetupError, NdiSilentError, BadReplyError) as error:
            what = str(error) or "no answer from the tracker"
            todo = getattr(error, "todo", "check power, cable, port and baud rate")
            return self._lose(what, todo, t_ns)
        return []

    def _track(self, reply: NdiReply) -> list[Output]:
        """A tracking reply, or what came instead."""
        if reply.text.startswith("ERROR"):
            error = NdiError(self._settings.reply, _code(reply.text))
            self._counts["errors"] += 1
            return self._fail(str(error), reply.t_ns, now=error.code in _NOT_TRACKING)
        if reply.text == "RESET":
            return self._fail("the tracker was reset", reply.t_ns, now=True)
        try:
            tracking: Tracking = parse_bx(reply.body) if reply.body else parse_tx(reply.text)
        except BadReplyError as error:
            self._counts["errors"] += 1
            return self._fail(str(error), reply.t_ns)
        self._failures = 0
        return self._poses.take(tracking, reply.t_ns)

    def _fail(self, what: str, t_ns: int, *, now: bool = False) -> list[Output]:
        """A failed request: told, and after three in a row the connection is made anew."""
        self._failures += 1
        todo = "check power and cable"
        if now or self._failures >= _FAILURES_TO_LOSE:
            self._counts["lost_connections"] += 1
            return self._lose(what, todo, t_ns)
        return self._report.fault(t_ns, "reply", what, todo)

    def _lose(self, what: str, todo: str, t_ns: int) -> list[Output]:
        self._forget()
        self._trouble, self._todo = what, todo
        self._connect_ns = t_ns + _ns(self._settings.reconnect_s)
        return self._report.fault(t_ns, "connection", what, todo)

    def _status(self, now_ns: int) -> Output:
        if self._stopped:
            state = "stopped"
        elif self._tracking:
            state = "degraded" if self._poses.unseen(now_ns) else "ready"
        else:
            state = "fault" if self._trouble else "starting"
        todo = self._todo or (TODO_UNSEEN if state == "degraded" else "")
        detail = self._trouble or ("tracking " + self._poses.detail(now_ns) if self._tracking else "")
        gauges = {"rate_hz": self._report.rate_hz(now_ns, self._poses.counts["samples"])}
        return self._report.status(now_ns, state, detail, self.counters, gauges, todo)


def _code(text: str) -> int:
    """Of an "ERRORXX" reply, 0 where two hexadecimal digits are not there (`int` alone would take "+1")."""
    digits = text[5:7]
    return int(digits, 16) if len(digits) == 2 and set(digits) <= set(hexdigits) else 0


def _ns(seconds: float) -> int:
    return round(seconds * NS_PER_S)

"""The calibration sweep: moves the robot through its poses and writes the raw sweep; the fit is done elsewhere.

Requests: start {tool, kind: "sweep" | "check", owner, hold, counts, ...overrides of the settings}, resume {} (the sensor
is bare, or the tool is on), heartbeat {owner}, stop {owner}. A client that has started a sweep sends a heartbeat several
times a second; after `heartbeat_s` (0.7 s) of silence, so that the arm is at rest within a second, or when anything is
wrong, the motors stop and the poses so far are kept.

`owner` is a word of the client's own: with it in start, only heartbeats that bear it count. `stop` without it always
stops; with it, it stops that owner's sweep only, so that a client whose start was refused cannot end another's sweep.
With `hold` a sweep that was accepted moves nothing before `resume`: whoever was refused has not touched the robot.
A start waits for a first wrench, `stale_s` at most: while no sweep runs nobody here asks the bus for wrenches.
`counts` are the positions of each swept axis, in the order of the settings, whose ranges stay.
"""

import datetime as dt
import re
from collections.abc import Callable
from typing import Any, ClassVar, Final

from pydantic import BaseModel

from galen_hw.clock import NS_PER_S
from galen_hw.config.tool_file import NAME
from galen_hw.errors import CommandRejectedError, GalenError, UsageError, WrongCommandError
from galen_hw.messages import CommandError, Fault, JointsState, Message, Reply, Request, Status, WrenchRaw
from galen_hw.services.calibration.file import SweepFile
from galen_hw.services.calibration.hold import Expectation
from galen_hw.services.calibration.plan import duration_s, make_plan
from galen_hw.services.calibration.script import Script, Wait, check, sweep
from galen_hw.services.calibration.settings import CalibrationSettings, overridden
from galen_hw.services.calibration.state import Run, StaleError, SweepStoppedError
from galen_hw.services.service import Output, Service, ServiceContext

PROGRESS_NS: Final = NS_PER_S // 5
DISK_ENDS_S: Final = 2.0
IDLE: Final = ("joints/state",)
"""Topics that are wanted while no sweep runs."""


class CalibrationService(Service):
    """Runs one sweep or check at a time; see `Service` for the arguments."""

    Settings: ClassVar[type[BaseModel]] = CalibrationSettings
    consumes: ClassVar[tuple[str, ...]] = ("wrench/raw", "joints/state")
    produces: ClassVar[tuple[str, ...]] = ("calibration/progress", "status", "fault")

    def __init__(self, name: str, settings: CalibrationSettings, context: ServiceContext) -> None:
        self.name, self._settings, self._context = name, settings, context
        self._run: Run | None = None
        self._file: SweepFile | None = None
        self._script: Script | None = None
        self._wait: Wait | None = None
        self._deadline_ns = self._heartbeat_ns = self._next_status_ns = self._next_progress_ns = 0
        self._seq = self._sweeps = 0
        self._last_raw: WrenchRaw | None = None
        self._last_joints: JointsState | None = None
        self._last_stop = self._owner = ""
        self._asked: Request | None = None
        """A start that waits for a first wrench, until `_asked_until_ns`."""
        self._asked_until_ns = 0

    @property
    def wants(self) -> tuple[str, ...]:
        """Wrenches only for a sweep."""
        return IDLE if self._run is None and self._asked is None else self.consumes

    def handle(self, topic: str, message: Message, now_ns: int) -> list[Output]:
        """Take a raw wrench or a joint state."""
        del topic
        if type(message) is WrenchRaw:
            self._last_raw = message
        elif type(message) is JointsState:
            self._last_joints = message
        run = self._run
        if run is None:
            return self._start_asked(now_ns)
        run.now_ns = now_ns
        try:
            if type(message) is WrenchRaw:
                run.take_raw(message)
            elif type(message) is JointsState:
                run.take_joints(message)
            self._advance(run)
        except SweepStoppedError as stop:
            return self._stop(run, stop)
        return self._flush(run)

    def request(self, request: Request, now_ns: int) -> list[Output]:
        """Carry out start, resume, heartbeat or stop.

        Raises:
            CommandRejectedError: not known, or not now; nothing has changed. UsageError: arguments that are not possible.
        """
        if request.name == "start":
            return self._start(request, now_ns)
        run = self._run
        owner = str(request.args.get("owner", ""))
        if request.name in ("heartbeat", "resume"):  # A stop is obeyed whatever else it holds.
            request.require_only("owner")
        if request.name == "heartbeat":
            if self._owner in ("", owner):
                self._heartbeat_ns = now_ns
            return [Reply(id=request.id, result={"running": run is not None})]
        if request.name == "resume" and run is not None and (run.held or run.state == "waiting"):
            run.now_ns, run.tool_on, run.held = now_ns, not run.held, False
            return [Reply(id=request.id)]
        if request.name == "stop":
            # A stop without a name is anybody's and always obeyed.
            meant = run if owner in ("", self._owner) else None
            stopped = [] if meant is None else self._stop(meant, SweepStoppedError("stopped by request"))
            if self._asked is not None and owner in ("", str(self._asked.args.get("owner", ""))):
                stopped += self._refuse_asked(CommandRejectedError("stopped by request", where=self.name))
            return [*stopped, Reply(id=request.id, result={"running": meant is not None})]
        todo = "calibration takes start, resume, heartbeat and stop"
        if request.name == "resume":
            what = "nothing waits for the tool" + (f": {self._last_stop}" if self._last_stop else "")
            raise CommandRejectedError(what, where=self.name, todo=todo)
        raise WrongCommandError(f"no request {request.name!r}", where=self.name, todo=todo)

    def reply(self, reply: Reply, now_ns: int) -> list[Output]:
        """Take a device's answer."""
        run = self._run
        if run is None or reply.id not in run.waiting_for:
            return []
        run.now_ns = now_ns
        run.waiting_for.discard(reply.id)
        run.replies[reply.id] = reply
        try:
            self._advance(run)
        except SweepStoppedError as stop:
            return self._stop(run, stop)
        return self._flush(run)

    def tick(self, now_ns: int) -> list[Output]:
        """Time-outs, the watch over client and data, progress and status."""
        outputs: list[Output] = []
        if self._asked is not None and now_ns >= self._asked_until_ns:
            outputs += self._refuse_asked(self._no_samples(self._context.sensor))
        run = self._run
        if run is not None:
            run.now_ns = now_ns
            try:
                self._watch(run, now_ns)
                self._advance(run)
            except SweepStoppedError as stop:
                outputs += self._stop(run, stop)
            else:
                if now_ns >= self._next_progress_ns:
                    self._next_progress_ns = now_ns + PROGRESS_NS
                    run.publish()
                outputs += self._flush(run)
        if now_ns >= self._next_status_ns:
            self._next_status_ns = now_ns + NS_PER_S
            outputs.append(("status", self._status(now_ns)))
        return outputs

    def end(self, now_ns: int) -> list[Output]:
        """Stop a sweep that runs and say so: its client must not wait for what has gone."""
        run = self._run
        if run is None:
            return self._refuse_asked(CommandRejectedError("the daemon ends", where=self.name))
        run.now_ns = now_ns
        return self._stop(run, SweepStoppedError("the daemon ends"))

    def close(self) -> None:
        """Let the files of the last sweep reach the disk."""
        if self._file is not None:
            self._file.wait(DISK_ENDS_S)

    def snapshot(self) -> dict[str, Any]:
        """Nothing of a sweep outlives the process but its file."""
        return {"version": 1, "identity": self._context.identity}

    def restore(self, state: dict[str, Any]) -> bool:
        """Take a snapshot back."""
        return (state.get("version"), state.get("identity")) == (1, self._context.identity)

    def _start(self, request: Request, now_ns: int) -> list[Output]:
        """Plan a sweep and set it going, or wait for a first wrench.

        Raises:
            CommandRejectedError: one runs already, or not now. UsageError: the arguments are not possible.
        """
        if self._run is not None or self._asked is not None:
            kind = "start" if self._run is None else self._run.kind
            todo = "wait, or stop it: galen-hw command calibration stop"
            raise CommandRejectedError(f"a {kind} runs already", where=self.name, todo=todo)
        args = dict(request.args)
        owner, hold = str(args.pop("owner", "")), args.pop("hold", False) is True
        tool, kind = str(args.pop("tool", "")), str(args.pop("kind", "sweep"))
        if not re.fullmatch(NAME, tool) or kind not in ("sweep", "check"):
            todo = "start takes tool (a name) and kind (sweep or check)"
            raise WrongCommandError("not a sweep that can be started", where=self.name, todo=todo)
        settings = self._overridden(args)
        if not self._is_fresh(self._last_joints, now_ns):
            raise self._no_samples(self._context.motors)
        if not self._is_fresh(self._last_raw, now_ns):
            self._asked, self._asked_until_ns = request, now_ns + round(self._settings.stale_s * NS_PER_S)
            return []
        run = self._make_run(tool, kind, settings, now_ns)
        run.held, self._owner = hold, owner
        self._run, self._script = run, (sweep if kind == "sweep" else check)(run)
        self._heartbeat_ns, self._next_progress_ns, self._last_stop = now_ns, now_ns, ""
        try:
            self._resume_script(run)
        except SweepStoppedError as stop:
            return [*self._stop(run, stop), Reply(id=request.id)]
        folder = str(run.file.folder) if kind == "sweep" else ""
        seconds = duration_s(settings, (*run.plan.bare, *run.plan.tool))
        return [
            Reply(
                id=request.id,
                result={"sweep": folder, "poses": run.poses, "seconds": seconds, "began_ns": run.began_ns},
            ),
            *self._flush(run),
        ]

    def _overridden(self, args: dict[str, Any]) -> CalibrationSettings:
        try:
            return overridden(self._settings, args)
        except UsageError as error:
            raise UsageError(error.what, where=f"{self.name}: {error.where}", todo=error.todo) from error

    def _is_fresh(self, message: Message | None, now_ns: int) -> bool:
        return message is not None and message.t_ns >= now_ns - round(self._settings.stale_s * NS_PER_S)

    def _no_samples(self, who: str) -> CommandRejectedError:
        return CommandRejectedError(f"no samples from {who}", where=self.name, todo="galen-hw check")

    def _start_asked(self, now_ns: int) -> list[Output]:
        """Carry out the start that has waited, if there is one, now that wrenches come."""
        asked = self._asked
        if asked is None or not self._is_fresh(self._last_raw, now_ns):
            return []
        self._asked = None
        try:
            return self._start(asked, now_ns)
        except GalenError as error:
            self._asked = asked
            return self._refuse_asked(error)

    def _refuse_asked(self, error: GalenError) -> list[Output]:
        """Answer a start that has waited in vain."""
        asked, self._asked = self._asked, None
        if asked is None:
            return []
        kind = "invalid" if isinstance(error, UsageError) else "rejected"
        refusal = CommandError(kind=kind, what=error.what, where=error.where, todo=error.todo)
        return [Reply(id=asked.id, error=refusal)]

    def _make_run(self, tool: str, kind: str, settings: CalibrationSettings, now_ns: int) -> Run:
        assert self._last_raw is not None
        plan = make_plan(settings, self._context.robot)
        date = iso_date(self._context.time_base.timestamp(now_ns))
        about = {
            "schema": 1,
            "tool": tool,
            "robot": self._context.robot.name,
            "sensor_serial": self._last_raw.serial_number,
            "date": date,
            "virtual": self._context.virtual,
            "settings": settings.model_dump(),
        }
        stamp = re.sub(r"\D", "", date)[:14]
        self._sweeps += 1
        folder = self._context.state_dir / "sweeps" / f"{tool}-{stamp[:8]}-{stamp[8:]}"
        if folder.exists():
            folder = folder.with_name(f"{folder.name}-{self._sweeps}")
        self._file = SweepFile(folder, self._context.robot, about)
        run = Run(self.name, kind, settings, self._context, plan, self._file, now_ns, now_ns)
        run.raw, run.joints = self._last_raw, self._last_joints
        run.raw_ns = run.joints_ns = run.joints_heard_ns = now_ns
        run.expectation = Expectation(run.gravity)
        run.poses = len(plan.bare) + len(plan.tool) if kind == "sweep" else len(plan.check)
        return run

    def _advance(self, run: Run) -> None:
        """Let the script go on as far as its conditions hold."""
        try:
            run.file.check()
        except UsageError as error:
            raise SweepStoppedError(str(error)) from error
        while self._run is run and self._wait is not None and self._wait.until():
            self._resume_script(run)
        if self._run is run and self._wait is not None and run.now_ns > self._deadline_ns:
            raise SweepStoppedError(self._wait.reason(), "see galen-hw monitor")

    def _resume_script(self, run: Run) -> None:
        self._wait_for(run, next)

    def _wait_for(self, run: Run, go_on: Callable[[Script], Wait]) -> None:
        """Let the script go on to its next wait; it may end, or end the sweep."""
        assert self._script is not None
        try:
            self._wait = go_on(self._script)
        except StopIteration:
            self._wait = None
        except StaleError:
            raise SweepStoppedError("a device fell silent", "galen-hw check") from None
        except UsageError as error:
            raise SweepStoppedError(str(error)) from error
        else:
            self._deadline_ns = run.now_ns + round(self._wait.timeout_s * NS_PER_S)

    def _watch(self, run: Run, now_ns: int) -> None:
        """Raise if the client or the data have gone."""
        if now_ns - self._heartbeat_ns > run.settings.heartbeat_s * NS_PER_S:
            silent_s = (now_ns - self._heartbeat_ns) / NS_PER_S
            what = f"the client that started the sweep is gone, or too busy: silent for {silent_s:.1f} s"
            raise SweepStoppedError(what, "start it again", kind="lost")
        if run.paused or not (who := run.silent()):
            return
        if self._script is None or run.state not in ("moving", "settling", "averaging") or run.kind == "check":
            raise SweepStoppedError(f"no samples from {who} for {run.settings.stale_s:g} s", "galen-hw check")
        run.paused = True
        run.send(run.context.motors, "stop", {})
        self._wait_for(run, lambda script: script.throw(StaleError()))

    def _stop(self, run: Run, stop: SweepStoppedError) -> list[Output]:
        """Motors to rest, the poses so far kept, everyone told."""
        run.send(run.context.motors, "stop", {})
        kept = f"; {len(run.file)} poses kept in {run.file.folder}" if len(run.file) else ""
        if run.kind == "sweep" and len(run.file):
            try:
                run.file.check()
                run.file.note("stopped", stop.what)
            except UsageError:
                # The disk may be what stopped the sweep; the stop that is queued must leave all the same.
                kept += ", whose sweep.json could not be brought up to date"
        run.file.close()
        run.show("stopped", f"{stop.what}{kept}" + (f"; {stop.todo}" if stop.todo else ""))
        self._last_stop = stop.what
        outputs = run.outputs
        fault = Fault(**self._header(run.now_ns), valid=True, what=stop.what, where=self.name, todo=stop.todo)
        self._run = self._script = self._wait = None
        return [*outputs, ("fault", fault)]

    def _flush(self, run: Run) -> list[Output]:
        outputs, run.outputs = run.outputs, []
        if run.done:
            self._run = self._script = self._wait = None
        return outputs

    def _header(self, t_ns: int) -> dict[str, Any]:
        self._seq += 1
        timestamp = self._context.time_base.timestamp(t_ns)
        return {"timestamp": timestamp, "t_ns": t_ns, "seq": self._seq, "source": self.name}

    def _status(self, now_ns: int) -> Status:
        run = self._run
        detail = self._last_stop if run is None else f"{run.kind}: {run.state}, pose {run.pose} of {run.poses}"
        return Status(
            **self._header(now_ns), valid=True, state="ready", detail=detail, counters={"sweeps": self._sweeps}
        )


def iso_date(timestamp: float) -> str:
    """Seconds since the epoch as an ISO date, UTC."""
    return dt.datetime.fromtimestamp(timestamp, dt.UTC).isoformat(timespec="seconds")

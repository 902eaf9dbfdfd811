"""The compensation: measured minus predicted wrench for every sample (report, equations 9 to 12).

Pure and repeatable: the outputs depend on the messages alone, and `compensation/state` says all that a replay needs
beside them. See `docs/compensation.md`.
"""

from collections import deque
from math import isfinite, nan
from typing import Any, ClassVar, Final

from msgspec.structs import replace
from pydantic import BaseModel

from galen_hw.clock import NS_PER_S
from galen_hw.config.tool_store import ToolStore
from galen_hw.messages import (
    CompensationState,
    Fault,
    JointsState,
    Message,
    Request,
    Status,
    Vector3,
    WrenchCompensated,
    WrenchRaw,
)
from galen_hw.services.compensation.commands import CompensationCommands
from galen_hw.services.compensation.correction import Correction
from galen_hw.services.compensation.gravity_direction import GravityDirection
from galen_hw.services.compensation.model import ZERO, Six
from galen_hw.services.compensation.settings import CompensationSettings
from galen_hw.services.joint_history import JointHistory
from galen_hw.services.service import Output, Service, ServiceContext

VERSION: Final = 1


class CompensationService(Service):
    """Subtracts what the tool in hand makes the sensor read; see `Service` for the arguments.

    Requests: select_tool {tool: name or null}, set_enabled {enabled}, tare, untare, set_contact {x, y, z}, reload.
    """

    Settings: ClassVar[type[BaseModel]] = CompensationSettings
    consumes: ClassVar[tuple[str, ...]] = ("wrench/raw", "joints/state")
    produces: ClassVar[tuple[str, ...]] = (
        "wrench/compensated",
        "wrench/contact",
        "compensation/state",
        "status",
        "fault",
    )

    def __init__(self, name: str, settings: CompensationSettings, context: ServiceContext) -> None:
        self.name, self._settings, self._context = name, settings, context
        self._settings_text = settings.model_dump_json()
        robot, turning = context.robot, GravityDirection(context.robot).joints
        order = [*turning, *(i for i in range(len(robot.joint_names)) if i not in turning)]
        self._order = [order.index(i) for i in range(len(order))]
        self._history = JointHistory(tuple(robot.joint_names[i] for i in order), settings.max_extrapolation_s)
        self._waiting: deque[WrenchRaw] = deque()
        self._correction = Correction(robot, enabled=settings.enabled, blend_s=settings.blend_s)
        store = ToolStore(context.state_dir, virtual=context.virtual)
        self._commands = CompensationCommands(name, settings, self._correction, store, robot.name)
        self._age_s, self._seq = nan, 0
        self._topic_seq = dict.fromkeys(("compensation/state", "status", "fault"), 0)
        self._counters = dict.fromkeys(("samples", "invalid_samples", "old_joints", "unzeroed", "tool_unseen"), 0)
        self._zeroings: int | None = None
        self._offset = False
        self._next_status_ns = 0
        self._commands.take_up_selected()

    def handle(self, topic: str, message: Message, now_ns: int) -> list[Output]:
        """Take a raw wrench or a joint state."""
        del topic, now_ns
        if type(message) is WrenchRaw:
            if self._settings.alignment == "extrapolate" or (not self._waiting and self._is_due(message.t_ns)):
                return self.compensate(message)
            self._waiting.append(message)
            return self._release()
        if type(message) is JointsState and self._history.add(message):
            self._update_inertial()
            return self._release()
        return []

    def _update_inertial(self) -> None:
        if self._settings.dynamic and self._correction.model is not None:
            window = self._settings.dynamic_window
            self._correction.model.update_inertial(self._history.last(window), self._order, window)

    def _is_due(self, t_ns: int) -> bool:
        """With interpolation: the joints at this time are known, or the newest sample shows that they never will be."""
        newest = self._history.newest
        if newest is None or newest.t_ns >= t_ns:
            return True
        latest = self._waiting[-1].t_ns if self._waiting else t_ns
        return latest - newest.t_ns > self._settings.max_extrapolation_s * NS_PER_S

    def _release(self) -> list[Output]:
        """Samples that need not wait any longer."""
        outputs: list[Output] = []
        while self._waiting and self._is_due(self._waiting[0].t_ns):
            outputs += self.compensate(self._waiting.popleft())
        return outputs

    def compensate(self, raw: WrenchRaw) -> list[Output]:
        """Compensate a sample at once, with the joints that are known by now."""
        correction = self._correction
        outputs = [] if raw.zeroings == self._zeroings else self._zero_changed(raw.zeroings)
        if correction.changed:
            self._update_inertial()
        joints = self._history.at(raw.t_ns)
        if raw.serial_number != self._commands.serial:
            self._commands.check_serial(raw.serial_number)
        predicted = ZERO if joints is None else correction.predict(joints[0], raw)
        seen = correction.awaited and self._looks_like_tool(raw, joints, predicted)
        if correction.changed or seen:
            if correction.changed:
                correction.begin(raw.t_ns, predicted)
            outputs.append(("compensation/state", self._state()))
        (a, b, c, d, e, f, *point), progress = correction.apply(raw.t_ns, predicted)
        force, torque = raw.force, raw.torque
        wrench = (force.x - a, force.y - b, force.z - c, torque.x - d, torque.y - e, torque.z - f)
        fresh = joints is not None and joints[2]
        usable = self._judge(raw, joints, wrench, fresh=fresh)
        # Before the tare: one that ends with this sample is taken off from the next one on.
        flags = self._flags(raw, usable=usable, fresh=fresh)
        if self._commands.tare is not None and usable:
            outputs += self._commands.feed_tare(self._commands.tare, raw, predicted)
        return outputs + self._messages(raw, wrench, point, progress, flags)

    def _zero_changed(self, zeroings: int) -> list[Output]:
        """The sensor's zero is not the one of the sample before: what was tared on top of that goes with it."""
        known, self._zeroings = self._zeroings is not None, zeroings
        if not known:
            # A zero of before this process: whether the tool was on then is not known. A replay is told by its states.
            self._correction.awaited = zeroings > 0 and self._context.virtual is not None
            return []
        self._correction.retare(ZERO)
        self._correction.awaited = zeroings > 0
        return self._commands.abandon_tare("the sensor's zero changed meanwhile")

    def _looks_like_tool(
        self, raw: WrenchRaw, joints: tuple[tuple[float, ...], int, bool] | None, predicted: Six
    ) -> bool:
        """The first usable sample after a zeroing that reads as the tool does; `predicted` holds it only with joints."""
        usable = raw.valid and not raw.saturated and joints is not None and joints[2]
        return usable and self._correction.look_for_tool(raw, predicted)

    def _judge(
        self, raw: WrenchRaw, joints: tuple[tuple[float, ...], int, bool] | None, wrench: Six, *, fresh: bool
    ) -> bool:
        """Return whether the sample may be used as far as wire, joints and calibration go, with its counters."""
        self._age_s = nan if joints is None else joints[1] / NS_PER_S
        good = raw.valid and not raw.saturated and not self._commands.problem and isfinite(sum(wrench))
        counters = self._counters
        counters["samples"] += 1
        counters["old_joints"] += not fresh
        return good and (fresh or not self._correction.active)

    def _flags(self, raw: WrenchRaw, *, usable: bool, fresh: bool) -> tuple[bool, bool, bool, bool]:
        """Return whether the wrench is vouched for: not with the sensor's own offset in it, with a tool or without one.

        And why not: (valid, unzeroed, tool unseen, joints extrapolated beyond their bound).
        """
        correction, counters = self._correction, self._counters
        unzeroed = correction.unzeroed(raw)
        self._offset = unzeroed and correction.holds_offset(raw)
        unseen = correction.unseen
        valid = usable and not unseen and not self._offset
        counters["unzeroed"] += unzeroed
        counters["tool_unseen"] += unseen
        counters["invalid_samples"] += not valid
        return valid, unzeroed, unseen, not fresh and correction.active

    def _messages(
        self, raw: WrenchRaw, wrench: Six, point: list[float], progress: float, flags: tuple[bool, ...]
    ) -> list[Output]:
        fx, fy, fz, tx, ty, tz = wrench
        px, py, pz = point
        valid, unzeroed, unseen, extrapolated = flags
        model = self._correction.model if self._correction.enabled else None
        sample = WrenchCompensated(
            timestamp=raw.timestamp,
            t_ns=raw.t_ns,
            seq=self._seq,
            valid=valid,
            source=self.name,
            force=Vector3(fx, fy, fz),
            torque=Vector3(tx, ty, tz),
            tool="" if model is None else model.name,
            calibration="" if model is None else model.calibration,
            enabled=model is not None,
            joints_age_s=self._age_s,
            joints_extrapolated=extrapolated,
            blend=progress,
            terms=0 if model is None else model.terms,
            unzeroed=unzeroed,
            tool_unseen=unseen,
        )
        self._seq += 1
        moved = Vector3(tx - (py * fz - pz * fy), ty - (pz * fx - px * fz), tz - (px * fy - py * fx))
        return [("wrench/compensated", sample), ("wrench/contact", replace(sample, torque=moved))]

    def request(self, request: Request, now_ns: int) -> list[Output]:
        """Carry out a command; see the class.

        Raises:
            CommandRejectedError: not known, or not now.
            UsageError: no such tool, or impossible arguments.
        """
        return self._commands.carry_out(request, now_ns)

    def tick(self, now_ns: int) -> list[Output]:
        """Time-out of a tare; status, state and what is wrong, once a second."""
        outputs = self._commands.time_out(now_ns)
        if now_ns < self._next_status_ns:
            return outputs
        self._next_status_ns = now_ns + NS_PER_S
        outputs.append(("status", self._status(now_ns)))
        if self._commands.problem:
            header = self._header("fault", now_ns)
            what, todo = self._commands.problem, self._todo()
            outputs.append(("fault", Fault(**header, valid=True, what=what, where=self.name, todo=todo)))
        if self._correction.last_ns and not self._correction.changed:
            outputs.append(("compensation/state", self._state()))
        return outputs

    def _status(self, now_ns: int) -> Status:
        counters = self._counters | {"unusable_joints": self._history.unusable, "late_joints": self._history.late}
        state = "fault" if self._commands.problem else "ready" if self._counters["samples"] else "starting"
        if state == "ready" and (self._correction.unseen or self._offset):
            state = "degraded"
        header = self._header("status", now_ns)
        gauges = {"joints_age_s": self._age_s}
        detail = self._commands.problem or self._describe()
        return Status(
            **header, valid=True, state=state, detail=detail, counters=counters, gauges=gauges, todo=self._todo()
        )

    def _todo(self) -> str:
        """Return what an operator does about the first thing that keeps the wrench from being valid, empty if nothing does."""
        if self._commands.problem:
            return self._commands.todo or "calibrate the tool, or select another"
        if self._offset:
            return "zero it with no tool on, or tare untouched"
        if self._correction.unseen:
            return "put it on; if it was on, zero without it, or tare untouched"
        return ""

    def _describe(self) -> str:
        model = self._correction.model
        offset = ""
        if self._offset:
            offset = "; the sensor is not zeroed"
        elif self._correction.unseen:
            offset = "; zeroed, and the tool not felt since"
        if model is None:
            return "no tool selected: the wrench holds its weight" + offset
        return f"{model.calibration}" + ("" if self._correction.enabled else ", switched off") + offset

    def _header(self, topic: str, t_ns: int) -> dict[str, Any]:
        self._topic_seq[topic] += 1
        timestamp = self._context.time_base.timestamp(t_ns)
        return {"timestamp": timestamp, "t_ns": t_ns, "seq": self._topic_seq[topic] - 1, "source": self.name}

    def _state(self) -> CompensationState:
        return self._correction.state(
            self._header("compensation/state", self._correction.last_ns),
            serial=self._commands.serial,
            problem=self._commands.problem,
            settings=self._settings_text,
            samples=self._seq,
        )

    def take_tool(self, name: str) -> None:
        """Use a tool's calibration from now on, without remembering it (for a replay).

        Raises:
            GalenError: no such tool, never calibrated, or not of this robot.
        """
        self._commands.use(name)

    def adopt(self, state: CompensationState) -> None:
        """Go on from a recorded state, for a replay.

        Raises:
            UsageError: the recorded tool's file cannot be read.
        """
        self._correction.restore(state)
        self._update_inertial()
        self._seq, self._commands.serial, self._commands.problem = state.samples, state.sensor_serial, state.problem

    def pass_over(self, seq: int) -> int:
        """Leave out the samples before `seq` that a replay does not have; how many (0 if it was there already)."""
        missing = max(0, seq - self._seq)
        self._seq += missing
        return missing

    def snapshot(self) -> dict[str, Any]:
        """The switch; the tool in hand is remembered by the tools' store, a tare never outlives the process."""
        return {"version": VERSION, "identity": self._context.identity, "enabled": self._correction.enabled}

    def restore(self, state: dict[str, Any]) -> bool:
        """Take a snapshot back."""
        if (state.get("version"), state.get("identity")) != (VERSION, self._context.identity):
            return False
        self._correction.set(enabled=state.get("enabled") is True)
        return True

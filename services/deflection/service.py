"""The deflection service: where the tool's tip really is when the arm gives under load.

Every joint state makes `pose/reported` (rigid kinematics), every compensated wrench `pose/corrected`. Pure: outputs
depend on the messages, the model's file and the tool's file alone. See `docs/deflection.md`.
"""

from math import isfinite
from typing import Any, ClassVar, Final

import numpy as np
from pydantic import BaseModel

from galen_hw.clock import NS_PER_S
from galen_hw.errors import GalenError, WrongCommandError
from galen_hw.identification.deflection.stream import NONE, Place, Six, Triple, turned
from galen_hw.messages import (
    CompensationState,
    Fault,
    JointsState,
    Message,
    Pose,
    Quaternion,
    Reply,
    Request,
    Status,
    Vector3,
    WrenchCompensated,
)
from galen_hw.services.deflection.model import ServedModel
from galen_hw.services.deflection.settings import DeflectionSettings
from galen_hw.services.joint_history import RESET_NS, JointHistory
from galen_hw.services.service import Output, Service, ServiceContext

VERSION: Final = 1
COMMANDS: Final = ("set_enabled", "reload")
RIGID: Final = ("compensation/state", "joints/state")
"""What the reported pose needs: the joints, and which tool is in hand."""


class DeflectionService(Service):
    """Corrects the tip for the arm's give; see `Service` for the arguments.

    Requests: set_enabled {enabled}, reload.
    """

    Settings: ClassVar[type[BaseModel]] = DeflectionSettings
    patience_s: ClassVar[float] = 0.0  # the corrected pose belongs to its wrench, not to one of five milliseconds ago
    consumes: ClassVar[tuple[str, ...]] = ("wrench/compensated", *RIGID)
    produces: ClassVar[tuple[str, ...]] = ("pose/reported", "pose/corrected", "status", "fault")

    def __init__(self, name: str, settings: DeflectionSettings, context: ServiceContext) -> None:
        self.name, self._settings, self._context = name, settings, context
        self._history = JointHistory(tuple(context.robot.joint_names), settings.max_joints_age_s)
        self._served = ServedModel(context, settings.model)
        self._enabled = settings.enabled
        self._place: Place | None = None
        self._place_ns = 0
        self._last_ns = 0
        self._give: Six = NONE
        self._max_gap_ns = round(settings.max_gap_s * NS_PER_S)
        self._max_age_ns = round(settings.max_joints_age_s * NS_PER_S)
        self._seq = dict.fromkeys(self.produces, 0)
        self._counters = dict.fromkeys(("samples", "invalid_samples", "gaps", "late_samples", "resets"), 0)
        self._next_status_ns = 0

    @property
    def wants(self) -> tuple[str, ...]:
        """Wrenches only for a model that serves: at 1 kHz they cost a wake-up each."""
        return self.consumes if self._corrects else RIGID

    @property
    def _corrects(self) -> bool:
        """Return whether there is a model, and it is switched on."""
        return self._served.stream is not None and self._enabled

    def handle(self, topic: str, message: Message, now_ns: int) -> list[Output]:
        """Take a joint state, a compensated wrench or what the compensation says of the tool."""
        del topic, now_ns
        if type(message) is WrenchCompensated:
            return self._correct(message)
        if type(message) is CompensationState:
            # With a model the wrenches say it themselves, each its own.
            if not self._corrects:
                self._hold(message.tool)
            return []
        if type(message) is JointsState and self._history.add(message):
            return self._report(message)
        return []

    def _report(self, message: JointsState) -> list[Output]:
        newest = self._history.newest
        assert newest is not None, "it was just added"
        dq = np.array(newest.dq)
        with np.errstate(all="ignore"):
            place = Place.of(self._context.robot, self._served.tip, np.array(newest.q), dq)
        if not isfinite(float(place.tip @ place.tip) + float(place.screws.sum()) + sum(place.velocity)):
            self._place = None  # Joints where the kinematics has no answer (rods that cannot reach).
            return []
        self._place, self._place_ns = place, newest.t_ns
        if self._served.stream is not None:
            self._served.stream.place(place)
        x, y, z = place.tip.tolist()
        pose = Pose(
            **self._header("pose/reported", message.t_ns),
            valid=True,
            position=Vector3(x, y, z),
            orientation=Quaternion(*place.quaternion),
            tool=self._served.tool,
        )
        return [("pose/reported", pose)]

    def _correct(self, message: WrenchCompensated) -> list[Output]:
        """The corrected pose of one sample, NONE of it while there is no model or it is switched off."""
        self._hold(message.tool)
        stream, place = self._served.stream, self._place
        if stream is None or not self._enabled or place is None:
            return []
        t_ns, self._counters["samples"] = message.t_ns, self._counters["samples"] + 1
        late = self._look_at_clock(t_ns)
        f, m = message.force, message.torque
        usable = message.valid and message.enabled and not late and isfinite(f.x + f.y + f.z + m.x + m.y + m.z)
        if usable:
            force, moment = in_base(place, (f.x, f.y, f.z), (m.x, m.y, m.z))
            self._give = stream.step(t_ns / NS_PER_S, force, moment)
        age_ns = t_ns - self._place_ns
        valid = usable and not self._served.problem and -self._max_age_ns <= age_ns <= self._max_age_ns
        valid = valid and isfinite(sum(self._give))
        self._counters["invalid_samples"] += not valid
        return [("pose/corrected", self._pose(message, place, max(min(age_ns, self._max_age_ns), 0), valid=valid))]

    def _hold(self, tool: str) -> None:
        """Take the tip of the tool in hand; the next joint state makes the place again."""
        if tool != self._served.asked:
            self._served.take_tool(tool)
            self._place = None

    def _look_at_clock(self, t_ns: int) -> bool:
        """True for a sample that comes too late to be used; gaps and another clock are told to the model."""
        stream, step = self._served.stream, t_ns - self._last_ns
        assert stream is not None, "asked only with a model"
        if self._last_ns and -RESET_NS <= step < 0:
            self._counters["late_samples"] += 1
            return True
        if self._last_ns and step < 0:
            self._counters["resets"] += 1
            stream.reset()
        elif self._last_ns and step > self._max_gap_ns:
            self._counters["gaps"] += 1
            stream.gap()
        self._last_ns = t_ns
        return False

    def _pose(self, message: WrenchCompensated, place: Place, age_ns: int, *, valid: bool) -> Pose:
        """Rigid tip, carried on by the joints' rates, and the give on top."""
        dt = age_ns / NS_PER_S
        x, y, z = place.tip.tolist()
        u, v, w, a, b, c = place.velocity
        dx, dy, dz, i, j, k = self._give
        served = self._served
        assert served.stream is not None, "asked only with a model"
        seq = self._seq["pose/corrected"]
        self._seq["pose/corrected"] = seq + 1
        return Pose(
            timestamp=message.timestamp,
            t_ns=message.t_ns,
            seq=seq,
            valid=valid,
            source=self.name,
            position=Vector3(x + u * dt + dx, y + v * dt + dy, z + w * dt + dz),
            orientation=Quaternion(*turned(place.quaternion, a * dt + i, b * dt + j, c * dt + k)),
            covariance=served.stream.covariance(),
            tool=served.tool,
            model=served.id,
        )

    def request(self, request: Request, now_ns: int) -> list[Output]:
        """Carry out a command; see the class.

        Raises:
            CommandRejectedError: not known, or impossible arguments.
            UsageError: the model's file is damaged.
        """
        del now_ns
        if request.name == "set_enabled":
            request.require_only("enabled")
            enabled = request.args.get("enabled")
            if not isinstance(enabled, bool):
                raise WrongCommandError("enabled must be true or false", todo='send {"enabled": true}')
            if enabled and not self._enabled and self._served.stream is not None:
                self._served.stream.gap()  # What happened while it was off is not known.
            self._enabled = enabled
        elif request.name == "reload":
            request.require_only()
            self._served.load()
            self._place = None
        else:
            what = f"no command {request.name!r}"
            raise WrongCommandError(what, where=self.name, todo=f"one of: {', '.join(COMMANDS)}")
        return [Reply(id=request.id, result={"model": self._served.id, "enabled": self._enabled})]

    def tick(self, now_ns: int) -> list[Output]:
        """Status, and what is wrong, once a second."""
        if now_ns < self._next_status_ns:
            return []
        self._next_status_ns = now_ns + NS_PER_S
        served, counters = self._served, self._counters | {"unusable_joints": self._history.unusable}
        state = "fault" if served.problem else "ready" if self._place is not None else "starting"
        detail = served.problem or served.id or "no model: the reported pose alone"
        detail += "" if self._enabled or served.problem else ", switched off"
        header = self._header("status", now_ns)
        outputs: list[Output] = [
            ("status", Status(**header, valid=True, state=state, detail=detail, counters=counters, todo=served.todo))
        ]
        if served.problem:
            header = self._header("fault", now_ns)
            fault = Fault(**header, valid=True, what=served.problem, where=self.name, todo=served.todo)
            outputs.append(("fault", fault))
        return outputs

    def _header(self, topic: str, t_ns: int) -> dict[str, Any]:
        self._seq[topic] += 1
        timestamp = self._context.time_base.timestamp(t_ns)
        return {"timestamp": timestamp, "t_ns": t_ns, "seq": self._seq[topic] - 1, "source": self.name}

    def snapshot(self) -> dict[str, Any]:
        """The switch and what the model remembers of the past load."""
        served = self._served
        memory = {} if served.stream is None else served.stream.memory()
        own = {"enabled": self._enabled, "model": served.id, "memory": memory}
        return {"version": VERSION, "identity": self._context.identity, **own}

    def restore(self, state: dict[str, Any]) -> bool:
        """Take a snapshot back; the memory only for the same model, and less surely than before."""
        if (state.get("version"), state.get("identity")) != (VERSION, self._context.identity):
            return False
        self._enabled = state.get("enabled") is True
        memory = state.get("memory")
        if self._served.stream is not None and state.get("model") == self._served.id and isinstance(memory, dict):
            try:
                self._served.stream.remember(memory)
            except (GalenError, KeyError, TypeError, ValueError):
                self._served.stream.reset()
        return True


def in_base(place: Place, force: Triple, torque: Triple) -> tuple[Triple, Triple]:
    """A wrench of the sensor, (N, N m) in its frame, in base axes about the base's origin."""
    (a, b, c), (d, e, f), (g, h, i) = place.R.tolist()
    x, y, z = force
    u, v, w = torque
    fx, fy, fz = a * x + b * y + c * z, d * x + e * y + f * z, g * x + h * y + i * z
    px, py, pz = place.sensor.tolist()
    return (fx, fy, fz), (
        a * u + b * v + c * w + py * fz - pz * fy,
        d * u + e * v + f * w + pz * fx - px * fz,
        g * u + h * v + i * w + px * fy - py * fx,
    )

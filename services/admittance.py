"""Hand-over-hand control of the virtual robot: the tool goes where the user pushes it, as fast as he pushes.

An admittance: velocity at the contact point in proportion to the wrench there, beyond a dead band. It shows what the
compensation is for: a weight that is left in the wrench is a push that never ends, and the tool drifts. It is not a
controller for a real robot (no force limits, no safety case) and refuses to run on one.
"""

from typing import Any, ClassVar, Final

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from galen_hw.clock import NS_PER_S
from galen_hw.errors import CommandRejectedError, WrongCommandError
from galen_hw.messages import CompensationState, Fault, JointsState, Message, Reply, Request, Status, WrenchCompensated
from galen_hw.services.joint_rates import JointRates
from galen_hw.services.service import Output, Service, ServiceContext
from galen_hw.spatial import Array

VERSION: Final = 1
FARTHEST_M: Final = 2.0
STRONGEST: Final = 1e4
"""N or N m; what is beyond is no hand."""
OVERSHOOT: Final = 0.1
"""Joints this far beyond their limits (m or rad) are not believed."""


class AdmittanceSettings(BaseModel):
    """Settings of the hand-over-hand control.

    Args:
        force_gain: m/s a newton; torque_gain: rad/s a newton metre.
        force_deadband, torque_deadband: N and N m that move nothing.
        max_speed, max_turn: of the contact point, m/s and rad/s.
        max_acceleration, max_turn_acceleration: of the commanded motion, m/s^2 and rad/s^2.
        max_joint_speed: m/s or rad/s of any joint.
        wrench_timeout_s, joints_timeout_s: older ones stop the motion.
        limit_margin: distance from a joint's limit at which it stops, m or rad.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    force_gain: float = Field(default=0.01, gt=0.0, le=0.1)
    torque_gain: float = Field(default=0.5, gt=0.0, le=5.0)
    force_deadband: float = Field(default=0.3, ge=0.0, le=20.0)
    torque_deadband: float = Field(default=0.02, ge=0.0, le=5.0)
    max_speed: float = Field(default=0.08, gt=0.0, le=0.25)
    max_turn: float = Field(default=0.5, gt=0.0, le=2.0)
    max_acceleration: float = Field(default=0.5, gt=0.0, le=5.0)
    max_turn_acceleration: float = Field(default=3.0, gt=0.0, le=20.0)
    max_joint_speed: float = Field(default=0.6, gt=0.0, le=2.0)
    wrench_timeout_s: float = Field(default=0.05, gt=0.0, le=1.0)
    joints_timeout_s: float = Field(default=0.2, gt=0.0, le=1.0)
    limit_margin: float = Field(default=0.01, ge=0.0, le=0.2)


class AdmittanceService(Service):
    """Turns `wrench/contact` into `servo_jv` requests, one for each joint state; see `Service` for the arguments.

    Requests: set_enabled {enabled}.
    """

    Settings: ClassVar[type[BaseModel]] = AdmittanceSettings
    consumes: ClassVar[tuple[str, ...]] = ("wrench/contact", "compensation/state", "joints/state")
    produces: ClassVar[tuple[str, ...]] = ("status", "fault")

    def __init__(self, name: str, settings: AdmittanceSettings, context: ServiceContext) -> None:
        self.name, self._settings, self._context = name, settings, context
        self._rates = JointRates(context.robot, max_speed=settings.max_joint_speed, margin=settings.limit_margin)
        self._enabled = False
        self._moving = self._settling = False
        self._reason = "switched off"
        self._contact: Array | None = None
        self._mean, self._sum = np.zeros(6), np.zeros(6)
        self._samples = self._wrench_ns = 0
        self._twist = np.zeros(6)
        self._joints: JointsState | None = None
        self._pending: str | None = None
        self._requests = 0
        self._seq = dict.fromkeys(("status", "fault"), 0)
        self._next_status_ns = 0

    def handle(self, topic: str, message: Message, now_ns: int) -> list[Output]:
        """Gather wrenches; answer each joint state with a velocity."""
        if type(message) is WrenchCompensated and topic == "wrench/contact":
            self._gather(message)
        elif type(message) is CompensationState:
            c = message.contact
            known = max(abs(c.x), abs(c.y), abs(c.z)) <= FARTHEST_M
            self._contact = np.array([c.x, c.y, c.z]) if known else None
        elif type(message) is JointsState:
            return self._step(message, now_ns)
        return []

    def _gather(self, message: WrenchCompensated) -> None:
        f, t = message.force, message.torque
        wrench = (f.x, f.y, f.z, t.x, t.y, t.z)
        if message.valid and all(abs(value) <= STRONGEST for value in wrench):
            self._sum += wrench
            self._samples += 1
            self._wrench_ns = message.t_ns

    def _step(self, message: JointsState, now_ns: int) -> list[Output]:
        previous, self._joints = self._joints, message
        if self._samples:
            self._mean, self._sum, self._samples = self._sum / self._samples, np.zeros(6), 0
        self._settling = self._settling and any(message.moving.values())
        if not self._enabled:
            return []
        if message.estop or not all(message.enabled.get(name, True) for name in self._context.robot.joint_names):
            return self._give_up("emergency stop" if message.estop else "the motors are off", now_ns)
        q = self._positions(message)
        self._reason = self._why_not(q, now_ns)
        if self._reason or q is None or self._contact is None:
            return self._rest()
        dt = 0.025 if previous is None else min(0.1, max(1e-3, (message.t_ns - previous.t_ns) / NS_PER_S))
        twist = self._slew(self.wanted(self._mean, q), dt)
        if not twist.any():
            return self._rest()
        return self._go(self._rates.solve(q, self._contact, twist, message.at_lower, message.at_upper))

    def _positions(self, message: JointsState) -> Array | None:
        robot = self._context.robot
        values = np.array([message.position.get(name, np.nan) for name in robot.joint_names])
        inside = (values >= robot.lower - OVERSHOOT) & (values <= robot.upper + OVERSHOOT)
        return values if message.valid and inside.all() else None

    def _why_not(self, q: Array | None, now_ns: int) -> str:
        """Why the tool must rest now; empty if it may move."""
        joints = self._joints
        if q is None or joints is None or now_ns - joints.t_ns > self._settings.joints_timeout_s * NS_PER_S:
            return "no fresh joint state"
        if now_ns - self._wrench_ns > self._settings.wrench_timeout_s * NS_PER_S:
            return "no fresh valid wrench"
        return "" if self._contact is not None else "the contact point is not known yet"

    def wanted(self, wrench: Array, q: Array) -> Array:
        """Twist (6,) of the contact point in base axes that answers a contact wrench (6,) in sensor axes."""
        s, R = self._settings, self._context.robot.sensor_pose(q)[0, :3, :3]
        linear = _answer(R @ wrench[:3], s.force_deadband, s.force_gain, s.max_speed)
        angular = _answer(R @ wrench[3:], s.torque_deadband, s.torque_gain, s.max_turn)
        return np.concatenate([linear, angular])

    def _slew(self, wanted: Array, dt: float) -> Array:
        """Towards the wanted twist, no faster than the accelerations allow."""
        s, step = self._settings, wanted - self._twist
        for part, limit in ((slice(0, 3), s.max_acceleration), (slice(3, 6), s.max_turn_acceleration)):
            size = float(np.linalg.norm(step[part]))
            if size > limit * dt:
                step[part] *= limit * dt / size
        self._twist = self._twist + step
        return self._twist

    def _go(self, rates: Array) -> list[Output]:
        if self._pending is not None or self._settling:
            # The line is busy with the last one, or the axes still slow down after a stop and would refuse it: a newer
            # velocity follows with the next joint state.
            return []
        self._moving = True
        named = dict(zip(self._context.robot.joint_names, rates.tolist(), strict=True))
        return [self._ask("servo_jv", {"velocity": named})]

    def _rest(self) -> list[Output]:
        """Come to rest, once."""
        self._twist = np.zeros(6)
        if not self._moving:
            return []
        self._moving, self._settling = False, True
        return [self._ask("stop", {})]

    def _give_up(self, why: str, now_ns: int) -> list[Output]:
        """Switch off for good: the user must switch on again."""
        self._enabled, self._reason = False, why
        header, todo = self._header("fault", now_ns), "see to it, then set_enabled again"
        fault = Fault(**header, valid=True, what=f"hand-over-hand control ended: {why}", where=self.name, todo=todo)
        return [*self._rest(), ("fault", fault)]

    def _ask(self, name: str, args: dict[str, Any]) -> Request:
        self._requests += 1
        self._pending = f"{self.name}-{self._requests}" if name == "servo_jv" else None
        return Request(id=f"{self.name}-{self._requests}", target=self._context.motors, name=name, args=args)

    def reply(self, reply: Reply, now_ns: int) -> list[Output]:
        """The motors have answered; a refusal ends the control."""
        if reply.id == self._pending:
            self._pending = None
            if reply.error is not None and self._enabled:
                return self._give_up(reply.error.what, now_ns)
        return []

    def request(self, request: Request, now_ns: int) -> list[Output]:
        """Switch on or off.

        Raises:
            CommandRejectedError: on a real robot, or not known, or the motors are not ready.
        """
        enabled = request.args.get("enabled")
        if request.name != "set_enabled" or not isinstance(enabled, bool):
            raise WrongCommandError("not a command", where=self.name, todo="set_enabled enabled=true or false")
        if not enabled:  # Whatever else the request holds: off is off.
            self._enabled, self._reason = False, "switched off"
            return [*self._rest(), Reply(id=request.id)]
        request.require_only("enabled")
        if not self._context.virtual:
            todo = "start the daemon with --virtual"
            raise CommandRejectedError(
                "hand-over-hand control is for the virtual robot only", where=self.name, todo=todo
            )
        joints = self._joints
        if joints is None or now_ns - joints.t_ns > self._settings.joints_timeout_s * NS_PER_S:
            raise CommandRejectedError("there is no fresh joint state", where=self.name, todo="galen-hw monitor")
        if joints.estop or not all(joints.enabled.values()):
            todo = "galen-hw command motors enable"
            raise CommandRejectedError("the motors are off or stopped", where=self.name, todo=todo)
        self._enabled, self._reason = True, ""
        return [Reply(id=request.id)]

    def tick(self, now_ns: int) -> list[Output]:
        """Rest when nothing comes any more; status once a second."""
        outputs: list[Output] = []
        if self._enabled and self._moving and self._joints is not None:
            self._reason = self._why_not(self._positions(self._joints), now_ns)
            outputs += self._rest() if self._reason else []
        if now_ns >= self._next_status_ns:
            self._next_status_ns = now_ns + NS_PER_S
            detail = "following the hand" if self._enabled and not self._reason else self._reason
            header = self._header("status", now_ns)
            outputs.append(("status", Status(**header, valid=True, state="ready", detail=detail)))
        return outputs

    def _header(self, topic: str, t_ns: int) -> dict[str, Any]:
        self._seq[topic] += 1
        timestamp = self._context.time_base.timestamp(t_ns)
        return {"timestamp": timestamp, "t_ns": t_ns, "seq": self._seq[topic] - 1, "source": self.name}

    def snapshot(self) -> dict[str, Any]:
        """Nothing: it is off after a start, always."""
        return {"version": VERSION, "identity": self._context.identity}

    def restore(self, state: dict[str, Any]) -> bool:
        """Take a snapshot back."""
        return (state.get("version"), state.get("identity")) == (VERSION, self._context.identity)


def _answer(vector: Array, deadband: float, gain: float, most: float) -> Array:
    """Velocity for a force or torque: nothing in the dead band, in proportion beyond it, no more than `most`."""
    size = float(np.linalg.norm(vector))
    if size <= deadband:
        return np.zeros(3)
    return vector * (min(most, gain * (size - deadband)) / size)

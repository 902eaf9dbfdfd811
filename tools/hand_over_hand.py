"""A virtual robot in simulated time with the live services: what the user's hand does, and what the tool does then.

The world, its sensor noise and its hand are those of the virtual robot; compensation and admittance are the services
that the daemon runs. Only the wires are left out, so that ten seconds take about two.
"""

import tempfile
from collections import deque
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from galen_hw.clock import NS_PER_S, TimeBase
from galen_hw.config.tool_file import ToolFile
from galen_hw.config.tool_store import ToolStore
from galen_hw.drivers.virtual.world import World
from galen_hw.kinematics import GalenRobot
from galen_hw.messages import CommandError, JointsState, Message, Reply, Request, Vector3, WrenchCompensated, WrenchRaw
from galen_hw.services.admittance import AdmittanceService, AdmittanceSettings
from galen_hw.services.compensation.service import CompensationService
from galen_hw.services.compensation.settings import CompensationSettings
from galen_hw.services.service import Output, ServiceContext
from galen_hw.spatial import Array

if TYPE_CHECKING:
    from collections.abc import Callable

BASE: Final = TimeBase(1_700_000_000 * NS_PER_S)
SAMPLE_NS: Final = 2_000_000
JOINTS_NS: Final = 24_000_000
DELIVERY_NS: Final = 10_000_000
ACCELERATION: Final = np.array([1.0, 1.0, 1.0, 8.0, 8.0])


@dataclass
class Trace:
    """What happened, a row a sample.

    Args:
        time: (N,) s; tip: (N, 3) m, base; joints: (N, 5); contact: (N, 6) wrench at the contact point as the control
            sees it; hand: (N,) whether the hand holds the tool; valid: (N,) of the wrench.
    """

    time: Array
    tip: Array
    joints: Array
    contact: Array
    hand: Array
    valid: Array

    def after(self, t: float) -> "Trace":
        """The part from time `t` on."""
        keep = self.time >= t
        return Trace(*(getattr(self, name)[keep] for name in self.__dataclass_fields__))

    @property
    def travel(self) -> Array:
        """(N,) distance of the tip from where it was at the first row, m."""
        return np.asarray(np.linalg.norm(self.tip - self.tip[0], axis=1))


@dataclass
class HandOverHand:
    """The robot, its world, and the two services.

    Args:
        tool: calibrated file of the tool in the robot's hand; held: its name in the world, or None for an empty hand.
        seed: of the noise.
        admittance: settings of the control.
    """

    tool: ToolFile
    held: str | None = "retractor"
    seed: int = 0
    admittance: AdmittanceSettings = field(default_factory=AdmittanceSettings)

    def __post_init__(self) -> None:
        self.robot = GalenRobot()
        self.world = World(self.robot, seed=self.seed)
        with tempfile.TemporaryDirectory() as folder:
            store = ToolStore(Path(folder), virtual=True)
            store.save(self.tool.on_virtual())
            store.select(self.tool.name)
            context = ServiceContext(self.robot, BASE, Path(folder), identity="simulated", virtual=True)
            self.compensation = CompensationService("compensation", CompensationSettings(), context)
            self.control = AdmittanceService("admittance", self.admittance, context)
        self.now, self.seq = NS_PER_S, 0
        self.q, self.dq, self.target = np.zeros(5), np.zeros(5), np.zeros(5)
        self.acceleration = ACCELERATION.copy()
        self.replies: dict[str, Reply] = {}
        self.log: list[tuple[str, Message]] = []
        self.requests: list[Request] = []
        self.silent: set[str] = set()
        self.spoil: Callable[[WrenchRaw], WrenchRaw] = lambda message: message
        self.refuse = ""
        self.estop = self._jogging = False
        self._later: deque[tuple[int, JointsState]] = deque()
        self._rows: list[tuple[Any, ...]] = []
        self._began_ns = self.now
        self._zero = self._read_empty()
        self.world.attach(self.held)

    def _read_empty(self) -> Array:
        """The sensor is zeroed at home with no tool, as for the calibration."""
        self.world.set_joints(self.q, self.dq, np.zeros(5), self.now)
        return np.asarray(np.mean([self.world.wrench(self.now) for _ in range(1000)], axis=0))

    def ask(self, target: str, name: str, **args: Any) -> Reply | None:
        """Send a request to a service; its reply if it comes at once."""
        request = Request(id=f"user-{name}", target=target, name=name, args=args)
        service = self.compensation if target == "compensation" else self.control
        self._take(service.request(request, self.now))
        return self.replies.get(request.id)

    def run(self, seconds: float) -> None:
        """Let time pass."""
        end = self.now + round(seconds * NS_PER_S)
        while self.now < end:
            self._step()

    def begin_trace(self) -> None:
        """Forget what was traced so far; now is time 0."""
        self._rows.clear()
        self._began_ns = self.now

    def trace(self) -> Trace:
        """Everything so far."""
        time, tip, joints, contact, hand, valid = zip(*self._rows, strict=True)
        return Trace(
            np.array(time), np.array(tip), np.array(joints), np.array(contact), np.array(hand), np.array(valid)
        )

    def _step(self) -> None:
        self.now += SAMPLE_NS
        self.seq += 1
        self._move(SAMPLE_NS / NS_PER_S)
        self.world.advance(self.now)
        if self.now % JOINTS_NS < SAMPLE_NS and "motors" not in self.silent:
            self._later.append((self.now + DELIVERY_NS, self._joints_state()))
        while self._later and self._later[0][0] <= self.now:
            self._publish("joints/state", self._later.popleft()[1])
        if "ft" not in self.silent:
            self._publish("wrench/raw", self.spoil(self._sample()))
        if self.now % (NS_PER_S // 20) < SAMPLE_NS:
            self._take(self.compensation.tick(self.now))
            self._take(self.control.tick(self.now))

    def _move(self, dt: float) -> None:
        """Axes that follow their commanded velocity with a limited acceleration, inside their limits."""
        step = np.clip(self.target - self.dq, -self.acceleration * dt, self.acceleration * dt)
        self.dq = self.dq + step
        q = self.q + dt * self.dq
        self.q = np.clip(q, self.robot.lower, self.robot.upper)
        self.dq[q != self.q] = 0.0
        self.world.set_joints(self.q, self.dq, step / dt, self.now)

    @property
    def _moving(self) -> dict[str, bool]:
        return {n: bool(abs(v) > 1e-6) for n, v in zip(self.robot.joint_names, self.dq, strict=True)}

    def _joints_state(self) -> JointsState:
        names = self.robot.joint_names
        return JointsState(
            timestamp=BASE.timestamp(self.now),
            t_ns=self.now,
            seq=self.seq,
            valid=True,
            source="motors",
            position=dict(zip(names, self.q.tolist(), strict=True)),
            velocity=dict(zip(names, self.dq.tolist(), strict=True)),
            effort={},
            moving=self._moving,
            enabled=dict.fromkeys(names, not self.estop),
            estop=self.estop,
        )

    def _sample(self) -> WrenchRaw:
        fx, fy, fz, tx, ty, tz = (self.world.wrench(self.now) - self._zero).tolist()
        return WrenchRaw(
            timestamp=BASE.timestamp(self.now),
            t_ns=self.now,
            seq=self.seq,
            valid=True,
            source="ft",
            force=Vector3(fx, fy, fz),
            torque=Vector3(tx, ty, tz),
        )

    def _publish(self, topic: str, message: Message) -> None:
        self.log.append((topic, message))
        if topic in self.compensation.consumes:
            self._take(self.compensation.handle(topic, message, self.now))
        if topic in self.control.consumes:
            self._take(self.control.handle(topic, message, self.now))
        if topic == "wrench/contact" and isinstance(message, WrenchCompensated):
            self._note(message)

    def _note(self, message: WrenchCompensated) -> None:
        f, t = message.force, message.torque
        tip = self.world.tip_pose(self.now)[:3, 3]
        row = (f.x, f.y, f.z, t.x, t.y, t.z)
        seconds = (self.now - self._began_ns) / NS_PER_S
        self._rows.append((seconds, tip, self.q.copy(), row, not self.world.hand.idle, message.valid))

    def _take(self, outputs: list[Output]) -> None:
        for output in outputs:
            if isinstance(output, Request):
                self.requests.append(output)
                self._carry_out(output)
            elif isinstance(output, Reply):
                self.replies[output.id] = output
            else:
                self._publish(*output)

    def _carry_out(self, request: Request) -> None:
        """The motor controller's answer."""
        velocity = request.args.get("velocity", {})
        # As a Galil does: an axis that slows down after a stop takes no velocity before it stands.
        busy = "is moving to a position" if not self._jogging and any(self._moving.values()) else ""
        refused = (self.refuse or busy) if velocity else ""
        error = CommandError(kind="rejected", what=refused) if refused else None
        if error is None:
            self._jogging = bool(velocity)
            self.target = np.array([velocity.get(name, 0.0) for name in self.robot.joint_names])
        self._take(self.control.reply(Reply(id=request.id, error=error), self.now))

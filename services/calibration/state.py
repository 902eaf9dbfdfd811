"""What a running calibration knows: newest messages, samples of the hold, pace, and what it sends."""

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from galen_hw.clock import NS_PER_S
from galen_hw.messages import CalibrationProgress, JointsState, Reply, Request, WrenchRaw
from galen_hw.services.calibration.file import SweepFile
from galen_hw.services.calibration.hold import Expectation, Sample
from galen_hw.services.calibration.plan import Plan, duration_s, move_s
from galen_hw.services.calibration.settings import CalibrationSettings
from galen_hw.services.service import Output, ServiceContext
from galen_hw.spatial import Array


class SweepStoppedError(Exception):
    """The sweep cannot go on.

    Args:
        what: why; todo: what to do; kind: "stopped", "loaded" or "lost".
    """

    def __init__(self, what: str, todo: str = "", *, kind: str = "stopped") -> None:
        super().__init__(what)
        self.what, self.todo, self.kind = what, todo, kind


class StaleError(Exception):
    """A device has fallen silent; the motors have been stopped."""


@dataclass(slots=True)
class Run:
    """One sweep or check under way.

    Args:
        name: of the service; kind: "sweep" or "check"; began_ns: its start.
        held: accepted, but nothing moves before the client says so; tool_on: the client says that the tool is on.
        home_bare: (6,) reading at home without the tool; noise: (6,) sigma of one sample, None until known.
    """

    name: str
    kind: str
    settings: CalibrationSettings
    context: ServiceContext
    plan: Plan
    file: SweepFile
    began_ns: int
    now_ns: int = 0
    pose: int = 0
    poses: int = 0
    state: str = "checking"
    detail: str = ""
    done: bool = False
    held: bool = False
    tool_on: bool = False
    paused: bool = False
    raw: WrenchRaw | None = None
    joints: JointsState | None = None
    raw_ns: int = 0
    joints_ns: int = 0
    joints_heard_ns: int = 0
    samples: list[Sample] = field(default_factory=list)
    bad_samples: int = 0
    noise: Array | None = None
    home_bare: Array = field(default_factory=lambda: np.zeros(6))
    outputs: list[Output] = field(default_factory=list)
    replies: dict[str, Reply] = field(default_factory=dict)
    waiting_for: set[str] = field(default_factory=set)
    expectation: Expectation = field(default_factory=lambda: Expectation(np.zeros(3)))
    seq: int = 0
    requests: int = 0
    _rest_since_ns: int = 0
    _hold_from_ns: int = 0
    _raw_t_ns: int = 0
    _pace: float = 1.0
    _moved_ns: int = 0

    @property
    def gravity(self) -> Array:
        """(3,) in the base, m/s^2."""
        return self.context.robot.gravity

    @property
    def remaining_s(self) -> float:
        """Expected time left, by the pace so far."""
        if self.done:
            return 0.0
        if self.kind == "check":
            return max(0.0, 13.0 * (self.poses - self.pose))
        steps = (*self.plan.bare, *self.plan.tool)[max(self.pose - 1, 0) :]
        return self._pace * duration_s(self.settings, steps)

    def take_raw(self, message: WrenchRaw) -> None:
        """A raw sample: into the hold if it is good and newer than the last."""
        if message.t_ns < self._raw_t_ns:
            return
        self.raw, self.raw_ns, self._raw_t_ns = message, self.now_ns, message.t_ns
        # On a busy machine samples wait in the queue: one from before the hold shows another pose.
        if message.t_ns < self._hold_from_ns:
            return
        f, t = message.force, message.torque
        sample = (f.x, f.y, f.z, t.x, t.y, t.z)
        if not message.valid or message.saturated or not abs(sum(sample)) < 1e6:
            self.bad_samples += 1
            if message.saturated and not self.held:
                raise SweepStoppedError("the sensor is saturated", "take off what presses on it")
            return
        limit = self.settings.overload_force_n
        guarded = self.kind == "sweep" and self.noise is not None and self.state != "waiting"
        if guarded and max(abs(f.x), abs(f.y), abs(f.z)) > limit:
            what = f"overload: a force above {limit:g} N on the sensor"
            raise SweepStoppedError(what, "free the tool, then calibrate again")
        self.samples.append(sample)

    def take_joints(self, message: JointsState) -> None:
        """A joint state."""
        if message.t_ns < self.joints_ns:
            return
        self.joints, self.joints_ns, self.joints_heard_ns = message, message.t_ns, self.now_ns
        if not self.resting():
            self._rest_since_ns = message.t_ns
        if message.estop:
            again = f"galen-hw command {self.context.motors} clear_fault"
            again += f", galen-hw command {self.context.motors} enable, and calibrate again"
            raise SweepStoppedError("emergency stop", f"release it, then {again}")

    def begin_hold(self) -> None:
        """Forget the samples so far, and those that are still under way."""
        self.samples = []
        self._hold_from_ns = self.now_ns
        self.bad_samples = 0

    def positions(self) -> Array:
        """(n,) newest joint positions."""
        assert self.joints is not None
        return np.array([self.joints.position.get(name, np.nan) for name in self.context.robot.joint_names])

    def resting(self) -> bool:
        """No joint moves."""
        return not self.moving_joint()

    def moving_joint(self) -> str:
        """Name of a joint that moves, empty if none does."""
        joints = self.joints
        if joints is None:
            return "no joint state"
        for name in self.context.robot.joint_names:
            speed = joints.velocity.get(name, 0.0)
            if joints.moving.get(name, False) or abs(speed) > self.settings.still_velocity_rad_per_s:
                return f"joint {name} moves"
        return ""

    def rested_s(self) -> float:
        """Time since the last motion."""
        return (self.joints_ns - self._rest_since_ns) / NS_PER_S

    def arrived(self, target: dict[str, float], tolerance: float) -> bool:
        """At rest at the target, by a joint state that is newer than the command."""
        if self.joints is None or self.joints_ns <= self._moved_ns or not self.resting():
            return False
        return all(abs(self.joints.position.get(name, np.inf) - x) < tolerance for name, x in target.items())

    def not_arrived(self) -> str:
        """Why a move did not end."""
        joints = self.joints
        stops = {} if joints is None else {n: c for n, c in joints.stop_code.items() if c not in (0, 1)}
        why = "".join(f", {name} stopped with code {code}" for name, code in stops.items())
        return f"the robot does not reach its pose{why}"

    def silent(self) -> str:
        """Name of a device that has not been heard of for `stale_s`, empty if there is none."""
        oldest = self.now_ns - self.settings.stale_s * NS_PER_S
        names = ((self.context.sensor, self.raw_ns), (self.context.motors, self.joints_heard_ns))
        return next((name for name, heard_ns in names if heard_ns < oldest), "")

    def absent(self) -> str:
        """Which of sensor and joints is silent."""
        who = self.context.sensor if self.raw is None else self.context.motors
        return f"no samples from {who}"

    def require_health(self) -> None:
        """Sensor and motors are fit for a sweep.

        Raises:
            SweepStoppedError: they are not.
        """
        assert self.raw is not None
        assert self.joints is not None
        if not self.raw.valid:
            raise SweepStoppedError(
                f"the sensor's samples are not valid (status {self.raw.status:#x})", "galen-hw check"
            )
        missing = [n for n in self.context.robot.joint_names if not np.isfinite(self.joints.position.get(n, np.nan))]
        if missing:
            raise SweepStoppedError(f"no position of joint {missing[0]}", "galen-hw check")

    def changed(self, target: dict[str, float]) -> dict[str, float]:
        """The joints of a target that are not there yet."""
        here = dict(zip(self.context.robot.joint_names, self.positions(), strict=True))
        return {name: x for name, x in target.items() if not abs(here[name] - x) < 1e-4}

    def move_arguments(self, target: dict[str, float], *, slow: bool) -> dict[str, Any]:
        """Arguments of `move_jp`; all swept joints with the speeds of the settings, others with the carriages'."""
        s = self.settings
        turn = s.check_velocity_rad_per_s if slow else s.velocity_rad_per_s
        ramp = s.check_acceleration_rad_per_s2 if slow else s.acceleration_rad_per_s2
        velocity = {name: turn if name in s.axes else s.home_velocity_m_per_s for name in target}
        return {"position": target, "velocity": velocity, "acceleration": {n: ramp for n in target if n in s.axes}}

    def move_timeout_s(self, target: dict[str, float], *, slow: bool) -> float:
        """Longest time that a move may take."""
        here = dict(zip(self.context.robot.joint_names, self.positions(), strict=True))
        s = self.settings
        farthest = max(abs(here[n] - x) / (1.0 if n in s.axes else s.home_velocity_m_per_s) for n, x in target.items())
        turn = s.check_velocity_rad_per_s if slow else s.velocity_rad_per_s
        return float(s.pose_timeout_s + 3.0 * farthest / min(turn, 1.0))

    def send(self, target: str, name: str, args: dict[str, Any]) -> str:
        """Queue a request; its id."""
        self.requests += 1
        request_id = f"{self.name}-{self.began_ns}-{self.requests}"
        self.outputs.append(Request(id=request_id, target=target, name=name, args=args))
        self.waiting_for.add(request_id)
        self._moved_ns = self.now_ns
        return request_id

    def show(self, state: str, detail: str = "") -> None:
        """Publish where the sweep stands."""
        self.state, self.detail = state, detail
        self.publish()

    def publish(self) -> None:
        """Publish progress."""
        self.seq += 1
        progress = CalibrationProgress(
            timestamp=self.context.time_base.timestamp(self.now_ns),
            t_ns=self.now_ns,
            seq=self.seq,
            valid=True,
            source=self.name,
            state=self.state,
            pose=self.pose,
            poses=self.poses,
            remaining_s=self.remaining_s,
            detail=self.detail,
        )
        self.outputs.append(("calibration/progress", progress))

    def learn_pace(self, began_ns: int) -> None:
        """Compare the pose that has just ended with what was expected."""
        steps = (*self.plan.bare, *self.plan.tool)
        here = steps[self.pose - 1]
        before = steps[self.pose - 2] if self.pose > 1 else self.plan.home
        expected = move_s(self.settings, before.target, here.target) + duration_s(self.settings, (here,))
        self._pace += 0.2 * ((self.now_ns - began_ns) / NS_PER_S / expected - self._pace)

    def finish(self) -> None:
        """All poses are done."""
        self.file.check()
        self.file.close()
        self.done = True
        self.show("done", str(self.file.folder) if self.kind == "sweep" else "")

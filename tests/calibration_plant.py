"""A robot in simulated time for the sweep: trapezoidal joints, a sensor at 250 Hz, the virtual world."""

from dataclasses import dataclass, field

import numpy as np

from galen_hw.clock import TimeBase
from galen_hw.drivers.virtual.world import World
from galen_hw.kinematics import GalenRobot
from galen_hw.messages import (
    CommandError,
    JointsState,
    Reply,
    Request,
    Vector3,
    WrenchRaw,
)
from galen_hw.services.calibration.service import CalibrationService
from galen_hw.services.calibration.settings import CalibrationSettings
from galen_hw.services.service import ServiceContext

SAMPLE_NS, JOINTS_EVERY, TICK_EVERY = 4_000_000, 6, 12


@dataclass
class Plant:
    """Drives one CalibrationService; `until` runs it, hooks see every sample and may change the world."""

    state_dir: object
    settings: CalibrationSettings = field(default_factory=lambda: CalibrationSettings(samples=100, zero_samples=100))
    seed: int = 3
    serial: str = "FT12345"

    def __post_init__(self):
        self.robot = GalenRobot()
        self.world = World(self.robot, seed=self.seed)
        context = ServiceContext(self.robot, TimeBase(1_700_000_000 * 10**9), self.state_dir, identity="test")
        self.service = CalibrationService("calibration", self.settings, context)
        self.now, self.count = 10**9, 0
        self.q = np.zeros(5)
        self.start, self.goal, self.began, self.v, self.a = self.q.copy(), self.q.copy(), 0, 1.0, 3.0
        self.zero = np.zeros(6)
        self.zeroing, self.zero_samples = None, []
        self.enabled, self.estop, self.stopped = False, False, 0
        self.progress, self.faults, self.replies, self.moves = [], [], {}, []
        self.silent = set()
        self.heartbeats = self.patient = True
        self.hooks = []

    def ask(self, name, **args):
        """Send a request to the service; its reply."""
        self.take(
            self.service.request(Request(id=f"client-{name}", target="calibration", name=name, args=args), self.now)
        )
        return self.replies.get(f"client-{name}")

    def begin(self, **args):
        """Let samples flow, then start a sweep."""
        self.run_for(0.2)
        return self.ask("start", **({"tool": "retractor"} | args))

    def run_for(self, seconds):
        end = self.now + int(seconds * 1e9)
        while self.now < end:
            self.step()

    def until(self, *states, seconds=600.0):
        """Run until progress shows one of these states; the message."""
        end, seen = self.now + int(seconds * 1e9), len(self.progress)
        while self.now < end:
            self.step()
            for message in self.progress[seen:]:
                if message.state in states:
                    return message
            seen = len(self.progress)
        raise AssertionError(f"never {states}; last {self.progress[-1] if self.progress else None}")

    def sweep(self, tool="retractor", **args):
        """A whole sweep, the tool put on when it is asked for; the last progress message."""
        self.begin(tool=tool, **args)
        message = self.until("waiting", "stopped")
        if message.state == "stopped":
            return message
        self.world.attach(tool)
        self.ask("resume")
        return self.until("done", "stopped")

    def step(self):
        if self.patient and self.service._file is not None:
            assert self.service._file.wait(30.0)  # simulated time stands while the disk works
        self.now += SAMPLE_NS
        self.count += 1
        dq, ddq = self._joints()
        self.world.set_joints(self.q, dq, ddq, self.now)
        self.world.advance(self.now)
        for hook in self.hooks:
            hook(self)
        if self.count % JOINTS_EVERY == 0 and "motors" not in self.silent:
            self.take(self.service.handle("joints/state", self._joint_state(dq), self.now))
        if "ft" not in self.silent:
            self._sample()
        if self.count % TICK_EVERY == 0:
            if self.heartbeats:
                self.ask("heartbeat")
            self.take(self.service.tick(self.now))

    def take(self, outputs):
        for output in outputs:
            if isinstance(output, Request):
                self._request(output)
            elif isinstance(output, Reply):
                self.replies[output.id] = output
            elif output[0] == "calibration/progress":
                self.progress.append(output[1])
            elif output[0] == "fault":
                self.faults.append(output[1])

    def _request(self, request):
        error = None
        if request.target == "ft" and request.name == "zero":
            self.zeroing, self.zero_samples = request.id, []
            return
        if request.name == "enable":
            self.enabled = True
        elif request.name == "move_jp":
            self._move(request.args)
        elif request.name == "stop":
            self.goal, self.start, self.stopped = self.q.copy(), self.q.copy(), self.stopped + 1
        else:
            error = CommandError(kind="unknown", what=request.name)
        self.take(self.service.reply(Reply(id=request.id, error=error), self.now))

    def _move(self, args):
        assert self.enabled
        self.moves.append(args)
        self.start, self.goal = self.q.copy(), self.q.copy()
        for name, value in args["position"].items():
            self.goal[self.robot.joint_names.index(name)] = value
        self.v = max(args["velocity"].values())
        self.a = max(args["acceleration"].values(), default=3.0)
        self.began = self.now

    def _joints(self):
        t, d = 1e-9 * (self.now - self.began), np.abs(self.goal - self.start).max()
        if d == 0.0:
            return np.zeros(5), np.zeros(5)
        v = min(self.v, np.sqrt(d * self.a))
        ramp, total = v / self.a, d / v + v / self.a
        share, rate, force = 1.0, 0.0, 0.0
        if t < ramp:
            share, rate, force = 0.5 * self.a * t * t / d, self.a * t / d, self.a / d
        elif t < total - ramp:
            share, rate = (v * t - 0.5 * v * ramp) / d, v / d
        elif t < total:
            left = total - t
            share, rate, force = 1.0 - 0.5 * self.a * left * left / d, self.a * left / d, -self.a / d
        self.q = self.start + share * (self.goal - self.start)
        return rate * (self.goal - self.start), force * (self.goal - self.start)

    def _joint_state(self, dq):
        named = dict(zip(self.robot.joint_names, self.q.tolist(), strict=True))
        moving = dict.fromkeys(named, bool(np.abs(dq).max() > 0.0))
        return JointsState(
            timestamp=0.0, t_ns=self.now, seq=self.count, valid=True, source="motors", position=named,
            velocity=dict(zip(named, dq.tolist(), strict=True)), effort={}, moving=moving, estop=self.estop,
        )  # fmt: skip

    def _sample(self):
        raw = self.world.wrench(self.now)
        if self.zeroing is not None:
            self.zero_samples.append(raw)
            if len(self.zero_samples) >= 100:
                self.zero, done, self.zeroing = np.mean(self.zero_samples, axis=0), self.zeroing, None
                self.take(self.service.reply(Reply(id=done), self.now))
        f = (raw - self.zero).tolist()
        message = WrenchRaw(
            timestamp=0.0, t_ns=self.now, seq=self.count, valid=True, source="ft", force=Vector3(*f[:3]),
            torque=Vector3(*f[3:]), serial_number=self.serial,
        )  # fmt: skip
        self.take(self.service.handle("wrench/raw", message, self.now))

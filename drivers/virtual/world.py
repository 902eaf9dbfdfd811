"""One world for all virtual devices: robot, what hangs on it, a hand, hidden effects, noise and faults."""

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import ArrayLike

from galen_hw.drivers.virtual.effects import Cable, Drift, Thermal
from galen_hw.drivers.virtual.hand import Guide, Hand, Push
from galen_hw.drivers.virtual.load import load_matrix, load_wrench
from galen_hw.drivers.virtual.motion import JointHistory, JointState, SensorMotion, motion_function
from galen_hw.drivers.virtual.truth import BIAS_BODY, NOISE_SIGMA, Body, tool_named
from galen_hw.kinematics import GalenRobot, Robot
from galen_hw.spatial import Array, inverse, transform

if TYPE_CHECKING:
    from galen_hw.drivers.virtual.give import Compliance

_NOISE_BLOCK: Final = 4096
_BEND_PERIOD_NS: Final = 5_000_000


class World:
    """What is really there. The virtual motor controller sets the joints; the sensors read.

    A wrench that acts on the sensor is written [force, torque], sensor frame, N and N m, with the sign of
    `spec/recording`: a tool of weight vector w (base) at rest reads force R^T w, torque c x R^T w.

    Args:
        robot: geometry, limits and gravity.
        seed: of the noise and the random walks.
        inertial: whether moving masses also read as forces.
    """

    def __init__(self, robot: Robot | None = None, seed: int = 0, *, inertial: bool = True) -> None:
        self.robot: Robot = GalenRobot() if robot is None else robot
        self.seed, self.inertial, self.now_ns = seed, inertial, 0
        self.faults: set[str] = set()
        self.hand = Hand()
        self.drift: Drift | None = None
        self.cable: Cable | None = None
        self.thermal = Thermal()
        self.compliance: Compliance | None = None
        self.noise_scale = 1.0
        self.noise_sigma: Array = np.array(NOISE_SIGMA)
        self._joints = JointHistory(len(self.robot.joint_names))
        self._motion_of = motion_function(self.robot)
        self._gravity = np.asarray(self.robot.gravity, dtype=float)
        self._cached_state: JointState | None = None
        self._bent: tuple[int, Array] | None = None
        self._displacement: Array = np.eye(4)
        self._rng = np.random.default_rng(seed)
        self._noise, self._next_noise = np.empty((0, 6)), 0
        self.attach(None)

    @property
    def limits(self) -> tuple[Array, Array]:
        """Lower and upper joint limits, m and rad."""
        return self.robot.lower, self.robot.upper

    @property
    def temperature(self) -> float:
        """Of the sensor now, degrees Celsius."""
        return self.thermal.temperature(self.now_ns)

    @property
    def contact(self) -> Array:
        """(3,) where the hand touches, sensor frame, m."""
        return self._tip if self.hand.contact is None else self.hand.contact

    def attach(self, tool: str | Mapping[str, Any] | Body | None) -> None:
        """Put a tool in the holder (a name of `truth.TOOLS`, or numbers), or take it away.

        Raises:
            UsageError: no such tool.
        """
        self.tool = tool_named(tool)
        bodies = [BIAS_BODY] if self.tool is None else [BIAS_BODY, self.tool]
        self._matrix = load_matrix(bodies)
        self._tip = np.asarray((0.0, 0.0, 0.0) if self.tool is None else self.tool.tip)
        self._cached_state = self._bent = None

    def advance(self, now_ns: int) -> None:
        """Let time pass: what has ended is dropped. Never backwards."""
        self.now_ns = max(self.now_ns, now_ns)
        if not self.hand.idle:
            self.hand.forget(self.now_ns)

    def set_joints(self, q: ArrayLike, dq: ArrayLike, ddq: ArrayLike, t_ns: int) -> None:
        """What the joints do at `t_ns`; (n,) m or rad and rates, in the order of `robot.joint_names`."""
        self._joints.set(q, dq, ddq, t_ns)

    def joints(self, t_ns: int) -> JointState:
        """(q, dq, ddq) at any time: interpolated, or extrapolated for 0.1 s and then at rest."""
        return self._joints.at(t_ns)

    def push(
        self, force: ArrayLike = (0, 0, 0), torque: ArrayLike = (0, 0, 0), seconds: float = 1.0, rise_s: float = 0.0
    ) -> None:
        """The hand pushes from now: N and N m in base axes at `contact`."""
        self.hand.pushes.append(Push(self.now_ns, np.concatenate((force, torque)).astype(float), seconds, rise_s))

    def guide(self, by: ArrayLike = (0, 0, 0), turn: ArrayLike = (0, 0, 0), **options: float) -> None:
        """The hand takes hold and leads by `by` (m) and `turn` (rotation vector, rad), base axes; see `Guide`."""
        motion = self.motion(self.now_ns)
        position = motion.p + motion.R @ self.contact
        by, turn = np.asarray(by, dtype=float), np.asarray(turn, dtype=float)
        self.hand.guide = Guide(self.now_ns, position, motion.R, by, turn, **options)

    def motion(self, t_ns: int) -> SensorMotion:
        """How the rigid robot's sensor moves; the same object again while it rests."""
        state = self._joints.at(t_ns)
        if state is not self._cached_state:
            self._cached_state, self._cached_motion = state, self._motion_of(state)
        return self._cached_motion

    def load(self, t_ns: int) -> Array:
        """(6,) that truly acts on the sensor: bodies, hand and cable; no drift, no noise."""
        motion = self.motion(t_ns)
        if self.compliance is not None:
            pose = self._bend(t_ns)
            return self._carried(t_ns, motion, pose[:3, :3], pose[:3, 3])
        if self.hand.idle and self.cable is None:
            return self._bodies(motion.R, motion)
        return self._carried(t_ns, motion, motion.R, motion.p)

    def wrench(self, t_ns: int) -> Array:
        """(6,) that the sensor would read with perfect gauges and no zero: load, drift, temperature, noise."""
        out = self.load(t_ns) + self.thermal.wrench(t_ns) + self._sample_noise()
        return out if self.drift is None else out + self.drift.wrench(t_ns)

    def sensor_pose(self, t_ns: int) -> Array:
        """(4, 4) sensor in the base, true: bent where the arm gives."""
        if self.compliance is not None:
            return self._bend(t_ns, fresh=True)
        motion = self.motion(t_ns)
        return transform(motion.R, motion.p)

    def tip_pose(self, t_ns: int) -> Array:
        """(4, 4) tool tip in the base, true; the sensor's own pose without a tool."""
        return np.asarray(self.sensor_pose(t_ns) @ transform(np.eye(3), self._tip))

    def _bodies(self, R: Array, motion: SensorMotion) -> Array:
        return load_wrench(self._matrix, R, motion, self._gravity, inertial=self.inertial)

    def _carried(self, t_ns: int, motion: SensorMotion, R: Array, p: Array) -> Array:
        """Bodies, hand and cable on a sensor at `R`, `p`; what acts elsewhere is moved to the sensor's origin."""
        out = self._bodies(R, motion)
        if not self.hand.idle:
            out += _at_origin(self.hand.wrench(t_ns, motion, self.contact), R, self.contact)
        if self.cable is not None:
            force = self.cable.force(p + R @ self.cable.attached)
            out += _at_origin(np.concatenate((force, np.zeros(3))), R, self.cable.attached)
        return out

    def _bend(self, t_ns: int, *, fresh: bool = False) -> Array:
        """(4, 4) under load, kept for 5 ms: the turn that it adds to gravity is small, and the work is not."""
        if not fresh and self._bent is not None and 0 <= t_ns - self._bent[0] < _BEND_PERIOD_NS:
            return self._bent[1]
        give = self.compliance
        assert give is not None
        if give.remembers:
            for step_ns in give.missing(t_ns):
                give.advance(step_ns, self._joints.at(step_ns)[0], self._effort(step_ns)[1])
        q, motion = self._joints.at(t_ns)[0], self.motion(t_ns)
        load, effort = self._effort(t_ns)
        moved = q + give.at(t_ns) if give.remembers else give.joints(q, effort)
        pose = np.asarray(self.robot.sensor_pose(moved)[0] @ give.bend(load))
        self._displacement = inverse(transform(motion.R, motion.p)) @ pose
        self._bent = (t_ns, pose)
        return pose

    def _effort(self, t_ns: int) -> tuple[Array, Array]:
        """(6,) load on the sensor and (n,) efforts on the joints, taken where the last bend left the sensor."""
        motion = self.motion(t_ns)
        guess = transform(motion.R, motion.p) @ self._displacement
        load = self._carried(t_ns, motion, guess[:3, :3], guess[:3, 3])
        base = np.concatenate((guess[:3, :3] @ load[:3], guess[:3, :3] @ load[3:]))
        return load, np.asarray(self.robot.sensor_jacobian(self._joints.at(t_ns)[0])[0].T @ base)

    def _sample_noise(self) -> Array:
        if self._next_noise >= len(self._noise):
            self._noise = self._rng.standard_normal((_NOISE_BLOCK, 6))
            self._next_noise = 0
        row = self._noise[self._next_noise]
        self._next_noise += 1
        return np.asarray(row * (self.noise_scale * self.noise_sigma))


def _at_origin(wrench: Array, R: Array, point: Array) -> Array:
    """(6,) about the sensor's origin in its frame, of a wrench in base axes at `point` (sensor frame)."""
    f, t = (wrench[:3] @ R), (wrench[3:] @ R)
    moment = (
        point[1] * f[2] - point[2] * f[1] + t[0],
        point[2] * f[0] - point[0] * f[2] + t[1],
        point[0] * f[1] - point[1] * f[0] + t[2],
    )
    return np.concatenate((f, moment))

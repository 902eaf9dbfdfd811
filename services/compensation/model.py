"""What the sensor must read with one tool in one pose: the report's equation (11) as one map a sample.

Derivation: `docs/compensation.md`. Everything constant (weights, first moments, the zeroing pose, the sensor's offset)
is put into M (6 x 4) once; a sample costs s = R^T g and nine products.
"""

import importlib
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from galen_hw.config.tool_file import ToolFile
from galen_hw.errors import UsageError
from galen_hw.kinematics import Robot
from galen_hw.messages import WrenchRaw
from galen_hw.physics.observations import Belief
from galen_hw.physics.rigid import Body, gravity_map, inertial_wrench
from galen_hw.services.compensation.gravity_direction import GravityDirection
from galen_hw.services.joint_history import JointSample
from galen_hw.spatial import Array, rotation_from_quaternion

Six = tuple[float, float, float, float, float, float]
ZERO: Six = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


@dataclass(frozen=True, slots=True)
class TermSample:
    """What a further effect may look at.

    Args:
        t_ns, timestamp: of the raw wrench, monotonic ns and s since the epoch.
        q: positions of the joints that turn the sensor, then of the others, rad or m.
        predicted: (6,) by the rigid bodies; raw: (6,) as measured, N and N m.
    """

    t_ns: int
    timestamp: float
    q: tuple[float, ...]
    predicted: Six
    raw: Six


class TermStream(Protocol):
    """Further effects of the prediction, sample by sample."""

    def step(self, sample: TermSample) -> Sequence[float]:
        """(6,) that they add to the reading, sensor frame, N and N m."""
        ...


class CompensationModel:
    """The prediction for one calibrated tool.

    Args:
        tool: its file, calibrated.
        robot: that carries the sensor.
    """

    def __init__(self, tool: ToolFile, robot: Robot) -> None:
        assert tool.mass is not None, "only calibrated tools come here"
        assert tool.com is not None, "mass and com come together"
        self.tool = tool
        self.name, self.calibration, self.terms = tool.name, tool.calibration_id, len(tool.terms)
        self._robot = robot
        self._bodies = (_body(tool.mass, tool.com, tool.inertia), _bias_body(tool))
        M = gravity_map(
            self._bodies[0],
            bias_body=self._bodies[1],
            zeroed_rotation=_zeroed_rotation(tool, robot),
            offset=tool.bias,
            gravity=tool.gravity,
        )
        self.direction = GravityDirection(robot, tool.gravity)
        self.weight = tool.mass * float(np.linalg.norm(tool.gravity))
        """N, of the tool alone."""
        self._mass = float(M[0, 0])
        self._moment = (float(M[5, 1]), float(M[3, 2]), float(M[4, 0]))
        self._constant: Six = tuple(float(x) for x in M[:, 3])  # type: ignore[assignment]
        self._inertial: Six = ZERO
        self._streams = _streams(tool, robot, self.direction.joints)

    def predict(self, turning: Sequence[float]) -> Six:
        """Wrench that the sensor should read, N and N m, without further terms.

        Args:
            turning: positions of the joints `direction.joints`, rad.
        """
        x, y, z = self.direction(turning)
        m, (hx, hy, hz), (a, b, c, d, e, f) = self._mass, self._moment, self._constant
        i = self._inertial
        return (
            m * x + a + i[0],
            m * y + b + i[1],
            m * z + c + i[2],
            hy * z - hz * y + d + i[3],
            hz * x - hx * z + e + i[4],
            hx * y - hy * x + f + i[5],
        )

    def add_terms(self, predicted: Six, q: Sequence[float], raw: WrenchRaw) -> Six:
        """The prediction with the further effects of the tool's file; once for each sample, for they may remember."""
        f, t = raw.force, raw.torque
        sample = TermSample(raw.t_ns, raw.timestamp, tuple(q), predicted, (f.x, f.y, f.z, t.x, t.y, t.z))
        for stream in self._streams:
            predicted = tuple([a + float(b) for a, b in zip(predicted, stream.step(sample), strict=True)])  # type: ignore[assignment]
        return predicted

    def update_inertial(self, states: list[JointSample], order: Sequence[int], window: int) -> None:
        """Dynamic forces from the last joint states: acceleration is the slope of a line through `window` velocities.

        A finite window (no recursive filter), so that a replay forgets its beginning and repeats every bit.

        Args:
            states: oldest first; order: where each joint of the robot stands in them.
            window: states needed.
        """
        if len(states) < window:
            self._inertial = ZERO
            return
        t = np.array([(s.t_ns - states[-1].t_ns) * 1e-9 for s in states])
        dq = np.array([s.dq for s in states])[:, order]
        t = t - t.mean()
        ddq = (t @ dq) / (t @ t)
        motion = self._robot.sensor_motion(np.array(states[-1].q)[order], dq[-1], ddq)
        wrench = inertial_wrench(motion, *self._bodies)[0]
        self._inertial = tuple(wrench.tolist()) if np.isfinite(wrench).all() else ZERO


def _body(mass: float, com: Sequence[float], inertia: Sequence[Sequence[float]] | None) -> Body:
    return Body(mass, np.array(com), np.zeros((3, 3)) if inertia is None else np.array(inertia))


def _bias_body(tool: ToolFile) -> Body:
    return Body() if tool.bias_body is None else _body(tool.bias_body.mass, tool.bias_body.com, None)


def _zeroed_rotation(tool: ToolFile, robot: Robot) -> Array | None:
    joints = _zeroed_joints(tool, robot)
    if joints is not None:
        return np.asarray(robot.sensor_pose(joints)[0, :3, :3])
    return rotation_from_quaternion(tool.zeroed_at) if isinstance(tool.zeroed_at, tuple) else None


def _zeroed_joints(tool: ToolFile, robot: Robot) -> Array | None:
    """Of a tool that was zeroed at joint positions: (n,) in the robot's order."""
    zeroed = tool.zeroed_at
    if not isinstance(zeroed, dict):
        return None
    q = np.zeros(len(robot.joint_names))
    for i, name in enumerate(robot.joint_names):
        if name in zeroed:
            q[i] = zeroed[name]
        elif i in GravityDirection(robot).joints:
            where = f"tool {tool.name!r}: zeroed_at"
            raise UsageError(f"joint {name!r} is missing", where=where, todo=f"calibrate {tool.name} again")
    return q


def _streams(tool: ToolFile, robot: Robot, turning: tuple[int, ...]) -> tuple[TermStream, ...]:
    """The tool's further effects, ready to step.

    Raises:
        UsageError: this version cannot apply one of them; a tool is never compensated by half.
    """
    if not tool.terms:
        return ()
    names = robot.joint_names
    order = tuple(names[i] for i in turning) + tuple(n for i, n in enumerate(names) if i not in turning)
    try:
        build = importlib.import_module("galen_hw.physics.effects.live").build_streams
    except ModuleNotFoundError:
        effects = ", ".join(term.effect for term in tool.terms)
        where, todo = f"tool {tool.name!r}: terms", f"galen-hw tool rollback {tool.name}"
        raise UsageError(f"this version cannot apply {effects} live", where=where, todo=todo) from None
    belief = Belief(
        tool=_body(tool.mass or 0.0, tool.com or (0.0, 0.0, 0.0), tool.inertia),
        bias_body=_bias_body(tool),
        zeroed_rotation=_zeroed_rotation(tool, robot),
        zeroed_joints=_zeroed_joints(tool, robot),
        gravity=np.array(tool.gravity),
    )
    return tuple(build(tool.terms, joint_names=order, robot=robot, belief=belief))

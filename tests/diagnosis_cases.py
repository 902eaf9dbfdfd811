"""Recordings with a concealed effect, every formula written here and not taken from the program's physics."""

from collections.abc import Callable
from typing import Any

import numpy as np

from galen_hw.kinematics import GalenRobot, UrdfRobot
from galen_hw.physics.observations import Belief, Observations
from galen_hw.physics.rigid import Body

Array = np.ndarray
G = 9.80665
MASS, COM = 0.287, np.array([0.031, 0.004, -0.063])
JOINTS = ("carriage1", "carriage2", "carriage3", "roll", "tilt")
WRENCH = tuple(f"wrench.{kind}.{axis}" for kind in ("force", "torque") for axis in "xyz")
SIGMA = np.array([0.015, 0.015, 0.02, 2.5e-4, 2.5e-4, 2e-4])
ARM = """<robot name="arm"><link name="base"/>
<link name="upper"><inertial><origin xyz="0.25 0 0"/><mass value="2"/>
<inertia ixx="0.01" iyy="0.05" izz="0.05" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="shoulder" type="revolute"><parent link="base"/><child link="upper"/><axis xyz="0 1 0"/>
<limit lower="-3" upper="3" velocity="5" effort="100"/></joint></robot>"""
"""A beam of 2 kg, centre at 0.25 m, inertia 0.05 about it, turning about a level axis."""


def sines(rng: np.random.Generator, t: Array, size: float, low: float = 0.03, high: float = 0.3) -> Array:
    """Four sines of random frequency and phase, rms `size`."""
    x = sum(
        np.sin(2 * np.pi * f * t + p) for f, p in zip(rng.uniform(low, high, 4), rng.uniform(0, 6.3, 4), strict=True)
    )
    return size * x / np.std(x)


def rotation(roll: Array, tilt: Array) -> Array:
    """(N, 3, 3) sensor to base, Rx(roll) Ry(tilt), element by element."""
    cr, sr, ct, st = np.cos(roll), np.sin(roll), np.cos(tilt), np.sin(tilt)
    zero = np.zeros_like(cr)
    rows = [[ct, zero, st], [sr * st, cr, -sr * ct], [-cr * st, sr, cr * ct]]
    return np.moveaxis(np.array(rows), (0, 1), (1, 2))


def hanging(R: Array, mass: float = MASS, com: Array = COM, gravity: Array | None = None) -> Array:
    """(N, 6) R^T w and c x R^T w."""
    g = np.array([0.0, 0.0, -G]) if gravity is None else gravity
    force = mass * np.einsum("nji,j->ni", R, g)
    return np.concatenate([force, np.cross(com, force)], axis=1)


class Bench:
    """A tool turned about two axes, its wrench and what is concealed in it.

    Args:
        seed: of motion and noise; rows, rate: of the recording.
    """

    def __init__(self, seed: int = 1, rows: int = 2000, rate: float = 20.0) -> None:
        self.rng = np.random.default_rng(seed)
        self.t = np.arange(rows) / rate
        self.q = np.stack(
            [sines(self.rng, self.t, s) for s in (0.02, 0.02, 0.02, 0.45, 0.35)],
            axis=1,
        )
        self.R = rotation(self.q[:, 3], self.q[:, 4])
        self.wrench = hanging(self.R)
        self.columns: dict[str, Array] = {}
        self.noise = self.rng.normal(size=self.wrench.shape) * SIGMA
        self.belief: dict[str, Any] = {}

    def observations(self) -> Observations:
        """What the program is given."""
        columns = {"time": self.t} | {f"joint.{n}.position": self.q[:, i] for i, n in enumerate(JOINTS)}
        columns |= dict(zip(WRENCH, (self.wrench + self.noise).T, strict=True)) | self.columns
        known = {"robot": GalenRobot(), "tool": Body(MASS, COM), "dynamic": False, "bias_free": True}
        return Observations("wrench", columns, None, Belief(**known | self.belief))


def lagged(t: Array, x: Array, constant: float, *, straight: bool = False) -> Array:
    """T dy/dt = x - y, settled at the start, of commands held over each step, or of values that run in straight lines."""
    y, out, fine = x[0], np.empty_like(x), 100 if straight else 1
    share = 1.0 - np.exp(-(t[1] - t[0]) / constant / fine)
    for k, value in enumerate(x):
        before = x[max(k - 1, 0)] if straight else value
        for part in np.arange(1, fine + 1) - 0.5:
            y = y + share * (before + (value - before) * part / fine - y)
        out[k] = y
    return out


def played(x: Array, half_width: float) -> Array:
    """What follows through a dead band."""
    y, out = x[0], np.empty_like(x)
    for k, value in enumerate(x):
        if value - y > half_width:
            y = value - half_width
        elif y - value > half_width:
            y = value + half_width
        out[k] = y
    return out


# -- wrench ------------------------------------------------------------------------------------------------------------


def drift(b: Bench) -> None:
    b.wrench[:, 0] += 0.15 * b.t / b.t[-1]


def step(b: Bench) -> None:
    b.wrench[:, 1] += 0.08 * (b.t > 41.3)


def temperature(b: Bench) -> None:
    b.columns["temperature.sensor"] = 22.0 + 2.0 * np.sin(2 * np.pi * b.t / 37.0) + 0.01 * b.t
    b.wrench[:, 2] += 0.03 * (b.columns["temperature.sensor"] - 22.0)


def gain(b: Bench) -> None:
    b.wrench[:, 0] *= 1.08


def cross_talk(b: Bench) -> None:
    b.wrench[:, 4] += 2e-3 * b.wrench[:, 1]


def saturation(b: Bench) -> None:
    b.wrench[:, 1] = np.minimum(b.wrench[:, 1], 0.7)
    b.noise[b.wrench[:, 1] >= 0.7, 1] = 0.0


def time_delay(b: Bench) -> None:
    late = [np.interp(b.t - 0.12, b.t, c) for c in b.wrench.T]
    b.wrench = np.stack(late, axis=1)


def lag(b: Bench) -> None:
    b.wrench = np.stack([lagged(b.t, c, 0.6, straight=True) for c in b.wrench.T], axis=1)


def creep(b: Bench) -> None:
    b.wrench[:, 0] += 0.15 * lagged(b.t, b.wrench[:, 0], 6.0, straight=True)


def hysteresis(b: Bench) -> None:
    x = b.wrench[:, 1]
    scale = np.ptp(x) / 2
    b.wrench[:, 1] = x + sum(0.08 * (played(x, r * scale) - x) for r in (0.1, 0.3, 0.6))


def vibration(b: Bench) -> None:
    b.wrench[:, 2] += 0.03 * np.sin(2 * np.pi * 3.7 * b.t + 0.4)


def glitches(b: Bench) -> None:
    rows = b.rng.choice(len(b.t), 15, replace=False)
    b.wrench[rows, 0] += b.rng.choice([-1.0, 1.0], 15) * 1.5


def payload(b: Bench) -> None:
    """In slow motion: this is a weight at rest, without inertia."""
    b.q = np.stack([sines(b.rng, b.t, s, 0.005, 0.05) for s in (0.02, 0.02, 0.02, 0.45, 0.35)], axis=1)
    b.R = rotation(b.q[:, 3], b.q[:, 4])
    b.wrench = hanging(b.R, MASS + 0.02, COM + np.array([0.0, 0.0, 0.004]))


def base_tilt(b: Bench) -> None:
    b.wrench = hanging(b.R, gravity=G * np.array([np.sin(0.01), 0.0, -np.cos(0.01)]))


def joint_offset(b: Bench) -> None:
    b.wrench = hanging(rotation(b.q[:, 3], b.q[:, 4] + 0.03))


def joint_scale(b: Bench) -> None:
    b.wrench = hanging(rotation(b.q[:, 3], 1.05 * b.q[:, 4]))


def sensor_mounting(b: Bench) -> None:
    a = 0.04  # about the sensor's own z
    turn = np.array([[np.cos(a), -np.sin(a), 0.0], [np.sin(a), np.cos(a), 0.0], [0.0, 0.0, 1.0]])
    b.wrench = hanging(b.R @ turn)


def cable_drag(b: Bench) -> None:
    T = GalenRobot().sensor_pose(b.q)  # kinematics only; the force is written here
    point, anchor = np.array([0.0, 0.01, -0.03]), np.array([0.2, -0.3, 0.5])
    end = T[:, :3, 3] + T[:, :3, :3] @ point
    force = np.einsum("nji,nj->ni", T[:, :3, :3], 2.0 * (anchor - end))
    b.wrench += np.concatenate([force, np.cross(point, force)], axis=1)


def contact(b: Bench) -> None:
    inside = ((b.t > 30) & (b.t < 36)) | ((b.t > 70) & (b.t < 74))
    b.wrench[inside, 2] += 0.4
    b.wrench[inside, 4] += 0.01


def inertial(b: Bench) -> None:
    """A quick motion: the centre of mass accelerates in the base (central differences of its path)."""
    b.t = np.arange(len(b.t)) / 200.0
    b.q = np.stack([sines(b.rng, b.t, s, 0.3, 2.0) for s in (0.0, 0.0, 0.0, 0.25, 0.2)], axis=1)
    b.R = rotation(b.q[:, 3], b.q[:, 4])

    h = 1e-4
    first = np.gradient(b.q, b.t, axis=0)
    second = np.gradient(first, b.t, axis=0)

    def path(s: float) -> Array:
        T = GalenRobot().sensor_pose(b.q + s * first + 0.5 * s * s * second)
        return T[:, :3, 3] + T[:, :3, :3] @ COM

    acceleration = (path(h) - 2.0 * path(0.0) + path(-h)) / h**2
    force = MASS * np.einsum("nji,nj->ni", b.R, np.array([0.0, 0.0, -G]) - acceleration)
    b.wrench = np.concatenate([force, np.cross(COM, force)], axis=1)


def bias(b: Bench) -> None:
    b.belief["bias_free"] = False
    b.wrench[:, 0] += 0.1


IN_WRENCH: dict[str, Callable[[Bench], None]] = {
    f.__name__: f
    for f in (
        bias, step, drift, temperature, gain, cross_talk, saturation, time_delay, lag, creep, hysteresis, vibration,
        glitches, payload, base_tilt, inertial, joint_offset, joint_scale, sensor_mounting, cable_drag, contact,
    )
}  # fmt: skip


# -- efforts of one beam -----------------------------------------------------------------------------------------------


class Beam:
    """A beam that turns about a level axis, and its motor's torque, in closed form."""

    def __init__(self, seed: int = 1, rows: int = 3000, rate: float = 50.0) -> None:
        self.rng = np.random.default_rng(seed)
        self.t = np.arange(rows) / rate
        f, p = self.rng.uniform(0.05, 0.5, 5), self.rng.uniform(0.0, 6.3, 5)
        w = 2.0 * np.pi * f
        self.q = 0.35 * sum(np.sin(a * self.t + b) for a, b in zip(w, p, strict=True))
        self.dq = 0.35 * sum(a * np.cos(a * self.t + b) for a, b in zip(w, p, strict=True))
        self.ddq = -0.35 * sum(a * a * np.sin(a * self.t + b) for a, b in zip(w, p, strict=True))
        self.effort = (0.05 + 2.0 * 0.25**2) * self.ddq - 2.0 * G * 0.25 * np.cos(self.q)
        self.sigma, self.dynamic = 0.05, True

    def observations(self) -> Observations:
        """What the program is given."""
        noisy = self.effort + self.sigma * self.rng.normal(size=len(self.t))
        columns = {
            "time": self.t,
            "joint.shoulder.position": self.q,
            "joint.shoulder.velocity": self.dq,
            "joint.shoulder.effort": noisy,
        }
        belief = Belief(robot=UrdfRobot(ARM), dynamic=self.dynamic)
        return Observations("effort", columns, None, belief)


def friction(b: Beam) -> None:
    b.effort = b.effort + 0.3 * np.tanh(b.dq / 0.01) + 0.1 * b.dq


def torque_ripple(b: Beam) -> None:
    b.effort = b.effort + 0.1 * np.sin(30.0 * b.q + 0.3)


def heavier(b: Beam) -> None:
    b.effort = b.effort + 0.3 * 0.5**2 * b.ddq - 0.3 * G * 0.5 * np.cos(b.q)


IN_EFFORT: dict[str, tuple[str, Callable[[Beam], None]]] = {
    "friction": ("friction", friction),
    "torque_ripple": ("torque_ripple", torque_ripple),
    "payload": ("payload", heavier),
}


# -- positions of a servo ----------------------------------------------------------------------------------------------


def carriage(mass: float) -> str:
    """URDF of a carriage of so many kg on a level axis."""
    return f"""<robot name="slide"><link name="base"/><link name="carriage"><inertial><mass value="{mass}"/>
<inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="axis" type="prismatic"><parent link="base"/><child link="carriage"/><axis xyz="1 0 0"/>
<limit lower="-1" upper="1" velocity="1" effort="500"/></joint></robot>"""


class Servo:
    """Two joints that follow their command, with what is concealed between the two."""

    def __init__(self, seed: int = 1, rows: int = 3000, rate: float = 50.0) -> None:
        self.rng = np.random.default_rng(seed)
        self.t = np.arange(rows) / rate
        self.command = np.stack([sines(self.rng, self.t, 0.5, 0.05, 0.5) for _ in range(2)], axis=1)
        self.position = self.command.copy()
        self.load = np.stack([sines(self.rng, self.t, 4.0, 0.02, 0.2) for _ in range(2)], axis=1)
        self.sigma = 1e-3

    def observations(self) -> Observations:
        """What the program is given."""
        noisy = self.position + self.sigma * self.rng.normal(size=self.position.shape)
        columns = {"time": self.t}
        for i, name in enumerate(("pan", "lift")):
            columns |= {f"joint.{name}.position": noisy[:, i], f"joint.{name}.command": self.command[:, i]}
            columns |= {f"joint.{name}.effort": self.load[:, i]}
        return Observations("position", columns, None, Belief())


def backlash(s: Servo) -> None:
    s.position[:, 0] = played(s.command[:, 0], 0.01)


def late_servo(s: Servo) -> None:
    s.position = np.stack([np.interp(s.t - 0.06, s.t, c) for c in s.command.T], axis=1)


def slow_servo(s: Servo) -> None:
    s.position = np.stack([lagged(s.t, c, 0.3) for c in s.command.T], axis=1)


def zero_off(s: Servo) -> None:
    s.position[:, 1] += 0.01


def scale_off(s: Servo) -> None:
    s.position[:, 0] *= 1.01


def soft_joint(s: Servo) -> None:
    s.position[:, 1] -= 2e-3 * s.load[:, 1]


IN_POSITION: dict[str, tuple[str, Callable[[Servo], None]]] = {
    "backlash": ("backlash", backlash),
    "time_delay": ("time_delay", late_servo),
    "lag": ("lag", slow_servo),
    "joint_offset": ("joint_offset", zero_off),
    "joint_scale": ("joint_scale", scale_off),
    "compliance": ("compliance", soft_joint),
}


# -- poses -------------------------------------------------------------------------------------------------------------


def turned(axis: Array, angle: Array) -> Array:
    """(N, 3, 3) by Rodrigues' formula about one axis."""
    x, y, z = axis / np.linalg.norm(axis)
    K = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.eye(3) + np.sin(angle)[:, None, None] * K + (1.0 - np.cos(angle))[:, None, None] * (K @ K)


def sweep(tilt_axis: Array, seed: int = 1, samples: int = 400) -> Observations:
    """56 poses of a calibration, averaged, with no clock; the tilt axis points where it is told to."""
    rng = np.random.default_rng(seed)
    roll, tilt = (x.ravel() for x in np.meshgrid(np.linspace(-1.2, 1.2, 7), np.linspace(-0.9, 0.8, 8)))
    order = rng.permutation(len(roll))
    roll, tilt = roll[order], tilt[order]
    R = turned(np.array([1.0, 0.0, 0.0]), roll) @ turned(tilt_axis, tilt)
    wrench = hanging(R) + rng.normal(size=(len(roll), 6)) * SIGMA / np.sqrt(samples)
    columns = {f"joint.{n}.position": np.zeros(len(roll)) for n in JOINTS}
    columns |= {"joint.roll.position": roll, "joint.tilt.position": tilt} | dict(zip(WRENCH, wrench.T, strict=True))
    belief = Belief(robot=GalenRobot(), tool=Body(MASS, COM), dynamic=False, bias_free=True)
    return Observations("wrench", columns, None, belief)


def tracked(
    compliance: float = 0.0,
    cubic: float = 0.0,
    seed: int = 1,
    rows: int = 400,
    *,
    clock: bool = True,
    law: Callable[[Array, Array], Array] | None = None,
) -> Observations:
    """The tip under a known force, seen by a tracker; the tilt joint gives by the moment about it.

    Args:
        compliance: rad/(N m); cubic: rad/(N m)^3 of a spring that softens; law: of time and moment (N,) instead, rad.
    """
    rng = np.random.default_rng(seed)
    t = np.arange(rows) / 20.0
    q = np.stack([sines(rng, t, s) for s in (0.02, 0.02, 0.02, 0.4, 0.3)], axis=1)
    force = np.stack([sines(rng, t, 6.0, 0.1, 0.9) for _ in range(3)], axis=1)
    robot, tip = GalenRobot(), np.array([0.045, 0.0, -0.14])
    T = robot.sensor_pose(q)
    at = T[:, :3, 3] + T[:, :3, :3] @ tip
    axis = turned(np.array([1.0, 0.0, 0.0]), q[:, 3])[:, :, 1]
    pivot = T[:, :3, 3] - T[:, :3, :3] @ np.array([0.055, 0.0, 0.0])  # spec of the nominal Galen: tilt to sensor
    moment = np.einsum("ni,ni->n", axis, np.cross(at - pivot, force))
    give = compliance * moment + cubic * moment**3 if law is None else law(t, moment)
    moved = at + np.cross(axis * give[:, None], at - pivot) + 7e-5 * rng.normal(size=(rows, 3))
    columns = ({"time": t} if clock else {}) | {f"joint.{n}.position": q[:, i] for i, n in enumerate(JOINTS)}
    columns |= {f"applied.force.{a}": force[:, i] for i, a in enumerate("xyz")}
    columns |= {f"pose.position.{a}": moved[:, i] for i, a in enumerate("xyz")}
    return Observations("pose", columns, None, Belief(robot=robot, tip=tip, bias_free=True))

"""A six-joint arm of drawn size in MuJoCo: what its wrist sensor, its motors and a tracker read along a path; its URDF."""

from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from galen_hw.tools.blind_proof.generator.motion import Path, between, sines
from galen_hw.tools.blind_proof.mistakes import turns
from galen_hw.tools.blind_proof.mistakes.recording import FORCE, POINT, TORQUE, TURN, Load, Recording

Array = NDArray[np.float64]

JOINTS = ("j1", "j2", "j3", "j4", "j5", "j6")
AXES = {"universal": "zyyyzy", "wrist in line": "zyyzyz"}
REACH = (0.15, 0.12, 0.42, 0.38, 0.1, 0.1)
MASSES = (4.0, 7.0, 2.5, 1.4, 1.2, 0.4)
SPEEDS = np.array([0.9, 0.7, 0.9, 1.2, 1.2, 1.5])
HOME = np.array([0.2, -0.5, 0.8, 0.2, 0.4, 0.0])


@dataclass(frozen=True)
class Link:
    """One moved body: its joint's place and axis in the parent, mass, centre of mass, diagonal inertia about that."""

    origin: tuple[float, ...]
    axis: tuple[float, ...]
    mass: float
    com: tuple[float, ...]
    inertia: tuple[float, ...]


@dataclass(frozen=True)
class Arm:
    """Links, and where the sensor sits on the last: m and a quaternion w x y z."""

    links: tuple[Link, ...]
    mount: tuple[float, ...]
    mount_turn: tuple[float, ...]
    mount_rpy: tuple[float, ...]


def draw(rng: np.random.Generator) -> Arm:
    """An arm of one of two kinds, lengths and masses within 20 %."""
    axes = AXES[str(rng.choice(list(AXES)))]
    links = []
    for k, letter in enumerate(axes):
        up = REACH[k] * rng.uniform(0.85, 1.15)
        mass = MASSES[k] * rng.uniform(0.8, 1.2)
        size = 0.35 * REACH[min(k + 1, 5)]
        com = (0.0, float(rng.uniform(-0.04, 0.04)), float(rng.uniform(0.3, 0.5) * REACH[min(k + 1, 5)]))
        inertia = (mass * size**2, mass * size**2 * 1.1, mass * size**2 * 0.6)
        side = float(rng.uniform(-0.08, 0.08))
        axis = {"x": (1, 0, 0), "y": (0, 1, 0), "z": (0, 0, 1)}[letter]
        links.append(Link((0.0, side, up), axis, round(mass, 4), com, inertia))
    roll = float(rng.choice([0.0, np.pi / 2, -np.pi / 2]))
    # Roll alone: the URDF's rpy and MuJoCo's quaternion are then the same turn without a convention between them.
    return Arm(tuple(links), (0.0, 0.0, 0.05), (np.cos(roll / 2), np.sin(roll / 2), 0.0, 0.0), (roll, 0.0, 0.0))


FT_MASS, FT_COM, FT_INERTIA = 0.1, (0.0, 0.0, 0.005), (2e-4, 2e-4, 3e-4)
TOOL_INERTIA = (8e-4, 7e-4, 4e-4)
TIP = (0.01, 0.0, 0.12)


def urdf(arm: Arm) -> str:
    """The arm for the recording's folder."""
    links, joints, parent = ['  <link name="base"/>'], [], "base"
    for k, link in enumerate(arm.links):
        name = f"l{k + 1}"
        links.append(_urdf_link(name, link.mass, link.com, link.inertia))
        joints.append(
            f'  <joint name="{JOINTS[k]}" type="revolute"><parent link="{parent}"/><child link="{name}"/>'
            f'<origin xyz="{_v(link.origin)}" rpy="0 0 0"/><axis xyz="{_v(link.axis)}"/>'
            '<limit lower="-3.2" upper="3.2" effort="200" velocity="3"/></joint>'
        )
        parent = name
    links.append(_urdf_link("ft", FT_MASS, FT_COM, FT_INERTIA))
    joints.append(
        f'  <joint name="mount" type="fixed"><parent link="{parent}"/><child link="ft"/>'
        f'<origin xyz="{_v(arm.mount)}" rpy="{_v(arm.mount_rpy)}"/></joint>'
    )
    return "\n".join(['<?xml version="1.0"?>', '<robot name="arm">', *links, *joints, "</robot>", ""])


def _urdf_link(name: str, mass: float, com: Sequence[float], inertia: Sequence[float]) -> str:
    ixx, iyy, izz = (f"{i:.9g}" for i in inertia)
    return (
        f'  <link name="{name}"><inertial><origin xyz="{_v(com)}" rpy="0 0 0"/><mass value="{mass:.9g}"/>'
        f'<inertia ixx="{ixx}" iyy="{iyy}" izz="{izz}" ixy="0" ixz="0" iyz="0"/></inertial></link>'
    )


def mjcf(arm: Arm, load: Load | None) -> str:
    """MJCF: the arm, the sensor's body, and a tool on it whose site is the sensor's origin."""
    inner, closing = "", ""
    for k, link in enumerate(arm.links):
        inner += (
            f'<body name="l{k + 1}" pos="{_v(link.origin)}"><joint name="{JOINTS[k]}" axis="{_v(link.axis)}"/>'
            f'<inertial pos="{_v(link.com)}" mass="{link.mass}" diaginertia="{_v(link.inertia)}"/>'
        )
        closing += "</body>"
    tool = load or Load(1e-9, (0.0, 0.0, 0.0))
    inertia = TOOL_INERTIA if load else (1e-12, 1e-12, 1e-12)
    inner += (
        f'<body name="ft" pos="{_v(arm.mount)}" quat="{_v(arm.mount_turn)}">'
        f'<inertial pos="{_v(FT_COM)}" mass="{FT_MASS}" diaginertia="{_v(FT_INERTIA)}"/>'
        f'<body name="tool"><inertial pos="{_v(tool.com)}" mass="{tool.mass}" diaginertia="{_v(inertia)}"/>'
        f'<site name="ft"/><site name="tip" pos="{_v(TIP)}"/></body></body>'
    )
    return f"""<mujoco><compiler angle="radian" balanceinertia="true"/><option gravity="0 0 -9.80665"/>
<worldbody>{inner}{closing}</worldbody><sensor><force site="ft"/><torque site="ft"/></sensor></mujoco>"""


def sensor_turn(arm: Arm, q: Array) -> Array:
    """Rotations (N, 3, 3) from sensor to base."""
    model = mujoco.MjModel.from_xml_string(mjcf(arm, None))
    data = mujoco.MjData(model)
    out = np.empty((len(q), 3, 3))
    for i, at in enumerate(q):
        data.qpos[:] = at
        mujoco.mj_kinematics(model, data)
        out[i] = data.site("ft").xmat.reshape(3, 3)
    return out


def static_joints(rng: np.random.Generator, poses: int) -> Array:
    """Joints (poses, 6) that turn the wrist in all directions."""
    return np.asarray(HOME + rng.uniform(-1, 1, (poses, 6)) * [0.5, 0.7, 0.7, 1.8, 1.8, 2.5])


def path(rng: np.random.Generator, rows: int, hz: float) -> Path:
    """Moving all the time, or with rests between."""
    t = np.arange(rows) / hz
    if rng.random() < 0.7:
        p = sines(rng, t, SPEEDS, fast_hz=0.35)
    else:
        p = between(t, rng.uniform(-1, 1, (int(t[-1] / 2.5) + 3, 6)) * SPEEDS, move_s=1.5, dwell_s=1.0)
    return Path(p.t, p.q + HOME, p.dq, p.ddq)


def _columns(rng: np.random.Generator, p: Path, *, velocity: bool) -> dict[str, Array]:
    jitter = rng.choice([0.0, 1e-5])
    out = {"time": p.t}
    for k, joint in enumerate(JOINTS):
        out[f"joint.{joint}.position"] = p.q[:, k] + jitter * rng.normal(size=len(p.t))
        if velocity:
            out[f"joint.{joint}.velocity"] = p.dq[:, k] + 1e-4 * rng.normal(size=len(p.t))
    return out


def _info(predict: str, **more: object) -> dict[str, object]:
    return {"schema": 1, "robot": "arm.urdf", "base_link": "base", "sensor_link": "ft", "predict": predict} | more


def _wants(rng: np.random.Generator, needs: frozenset[str], what: str) -> bool:
    return bool(rng.random() < 0.5) or what in needs


def wrench(rng: np.random.Generator, needs: frozenset[str]) -> Recording:
    """The wrist sensor along a path, offsets free; nothing is wrong with it."""
    arm, p = draw(rng), path(rng, int(rng.integers(700, 1200)), 40.0)
    load = Load(float(rng.uniform(0.4, 1.5)), (0.012, -0.004, float(rng.uniform(0.04, 0.08))))
    clean = _sensed(arm, load, p)
    bias = np.concatenate([rng.uniform(-4, 4, 3), rng.uniform(-0.1, 0.1, 3)])
    reading = clean + bias + rng.normal(size=clean.shape) * ([0.03] * 3 + [1.2e-3] * 3)
    columns = _columns(rng, p, velocity=_wants(rng, needs, "velocity"))
    columns |= dict(zip((*FORCE, *TORQUE), reading.T, strict=True))
    tool = {"name": "tool", "mass": load.mass, "com": list(load.com), "inertia": np.diag(TOOL_INERTIA).tolist()}
    info = _info("wrench", tool=tool, model={"bias": "free", "dynamics": "rigid"})
    turn = sensor_turn(arm, p.q)
    return Recording(columns, info, {"arm.urdf": urdf(arm)}, None, "", (), load, turn, clean)


def _sensed(arm: Arm, load: Load, p: Path) -> Array:
    """What the sensor reads (N, 6): MuJoCo's sensor gives what the child does to the parent, the reading is its negative."""
    model = mujoco.MjModel.from_xml_string(mjcf(arm, load))
    data = mujoco.MjData(model)
    out = np.empty((len(p.t), 6))
    for i in range(len(p.t)):
        data.qpos[:], data.qvel[:], data.qacc[:] = p.q[i], p.dq[i], p.ddq[i]
        mujoco.mj_inverse(model, data)
        out[i] = -data.sensordata
    return out


LOSS = np.array([4.0, 5.0, 3.0, 1.0, 0.8, 0.5])


def efforts(arm: Arm, p: Path) -> Array:
    """Joint efforts (N, 6) that the path needs, without friction and without a tool."""
    model = mujoco.MjModel.from_xml_string(mjcf(arm, None))
    data = mujoco.MjData(model)
    out = np.empty((len(p.t), 6))
    for i in range(len(p.t)):
        data.qpos[:], data.qvel[:], data.qacc[:] = p.q[i], p.dq[i], p.ddq[i]
        mujoco.mj_inverse(model, data)
        out[i] = data.qfrc_inverse
    return out


def effort(rng: np.random.Generator, needs: frozenset[str]) -> Recording:
    """Joint efforts along a path: exactly the URDF's, or with dry friction besides."""
    arm, p = draw(rng), path(rng, int(rng.integers(600, 1000)), 50.0)
    out = efforts(arm, p)
    loss = LOSS * rng.uniform(0.6, 1.4, 6) * (rng.random() < 0.4)
    out += loss * np.tanh(p.dq / 0.004)
    out += rng.normal(size=out.shape) * [0.15, 0.15, 0.1, 0.03, 0.03, 0.02]
    columns = _columns(rng, p, velocity=_wants(rng, needs, "velocity"))
    columns |= {f"joint.{j}.effort": out[:, k] for k, j in enumerate(JOINTS)}
    effects = ("friction",) if loss.any() else ()
    info = _info("effort", model={"dynamics": "rigid"})
    coulomb = float(loss.max()) if loss.any() else None
    return Recording(columns, info, {"arm.urdf": urdf(arm)}, None, "", effects, coulomb=coulomb)


def pose(rng: np.random.Generator, needs: frozenset[str]) -> Recording:
    """A tracked tip along a path, position and orientation."""
    arm, p = draw(rng), path(rng, int(rng.integers(500, 1000)), 20.0)
    at, turn = _tip(arm, p.q)
    columns = _columns(rng, p, velocity=_wants(rng, needs, "velocity"))
    columns |= dict(zip(POINT, (at + 7e-5 * rng.normal(size=at.shape)).T, strict=True))
    turned = np.einsum("nij,njk->nik", turn, turns.small(rng, len(turn), 2e-4))
    columns |= dict(zip(TURN, turns.to_quat(turned).T, strict=True))
    tool = {"name": "pointer", "mass": 0.1, "com": [0.0, 0.0, 0.03], "tip": list(TIP)}
    info = _info("pose", tool=tool, tip_link="ft")
    return Recording(columns, info, {"arm.urdf": urdf(arm)}, None, "", (), turn=turn)


def targets(rng: np.random.Generator, needs: frozenset[str]) -> Recording:
    """Three tracked points on the tool, in the frame of a tracker that stands somewhere."""
    del needs
    arm, count = draw(rng), int(rng.integers(80, 200))
    q = static_joints(rng, count)
    at, turn = _tip(arm, q)
    stand, where = turns.anywhere(rng, 1)[0], rng.uniform(-2.5, 2.5, 3)
    columns = {f"joint.{j}.position": q[:, k] for k, j in enumerate(JOINTS)}
    for number, point in enumerate(([0.05, 0.0, 0.02], [-0.04, 0.05, 0.0], [0.0, -0.05, 0.05])):
        seen = (at + turn @ np.array(point)) @ stand.T + where + 5e-5 * rng.normal(size=at.shape)
        columns |= {f"target.{number + 1}.position.{a}": seen[:, k] for k, a in enumerate("xyz")}
    info = _info("targets", tip_link="ft")
    return Recording(columns, info, {"arm.urdf": urdf(arm)}, None, "", (), turn=turn)


def _tip(arm: Arm, q: Array) -> tuple[Array, Array]:
    """Position (N, 3) and orientation (N, 3, 3) of the tip in the base."""
    model = mujoco.MjModel.from_xml_string(mjcf(arm, None))
    data = mujoco.MjData(model)
    at, turn = np.empty((len(q), 3)), np.empty((len(q), 3, 3))
    for i, joints in enumerate(q):
        data.qpos[:] = joints
        mujoco.mj_kinematics(model, data)
        at[i], turn[i] = data.site("tip").xpos, data.site("tip").xmat.reshape(3, 3)
    return at, turn


def _v(values: Sequence[float]) -> str:
    return " ".join(f"{float(v):.9g}" for v in values)

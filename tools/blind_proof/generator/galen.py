"""The Galen as a MuJoCo model, with what a case changes in its mechanics; and its sensor's reading along a path."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import mujoco
import numpy as np
from numpy.typing import NDArray

from galen_hw.tools.blind_proof.generator.motion import Path

Array = NDArray[np.float64]

JOINTS = ("carriage1", "carriage2", "carriage3", "roll", "tilt")


@dataclass(frozen=True)
class Tool:
    """Mass kg, centre of mass and tip m in the sensor frame, diagonal inertia kg m^2 about the centre of mass."""

    mass: float
    com: tuple[float, float, float]
    tip: tuple[float, float, float]
    inertia: tuple[float, float, float]


TOOLS = {
    "pointer": Tool(0.152, (0.012, -0.003, -0.046), (0.0, 0.0, -0.165), (2.1e-4, 2.0e-4, 3e-5)),
    "retractor": Tool(0.287, (0.031, 0.004, -0.063), (0.045, 0.0, -0.14), (5.6e-4, 6.4e-4, 1.4e-4)),
}
BIAS_MASS, BIAS_COM = 0.085, (0.002, -0.001, 0.011)
GRAVITY = (0.0, 0.0, -9.80665)


def carriages(platform: Array) -> Array:
    """Carriage heights (N, 3) from platform positions (N, 3): rods of 0.4 m from towers at 0.15 m."""
    out = np.empty_like(platform)
    for i, azimuth in enumerate(np.radians([90.0, 210.0, 330.0])):
        dx = platform[:, 0] - 0.15 * np.cos(azimuth)
        dy = platform[:, 1] - 0.15 * np.sin(azimuth)
        out[:, i] = platform[:, 2] - np.sqrt(0.16 - dx * dx - dy * dy) + np.sqrt(0.16 - 0.0225)
    return out


@dataclass(frozen=True)
class Cable:
    """Stiffness N/m, rest length m, anchor m in the base, friction in the conduit N."""

    stiffness: float
    rest: float
    anchor: tuple[float, float, float]
    friction: float = 0.0


@dataclass
class Mechanics:
    """How the real arm differs from the nominal one.

    Args:
        gravity: (3,) m/s^2 in the base.
        tilt_axis: (3,) of the tilt joint in the roll frame.
        tilt_origin: (3,) m.
        sensor_quat: (4,) w x y z of the sensor on its flange.
        extra_mass: kg at `extra_at` (3,) m on the tool.
        offset, scale: of the real joint against the reported one, roll and tilt.
        cable: from the room to the tool, or None.
        tip_forces: (N, 3) N in the base, at the tip.
    """

    gravity: tuple[float, float, float] = GRAVITY
    tilt_axis: tuple[float, float, float] = (0.0, 1.0, 0.0)
    tilt_origin: tuple[float, float, float] = (0.21, 0.0, 0.035)
    sensor_quat: tuple[float, float, float, float] = (1.0, 0.0, 0.0, 0.0)
    extra_mass: float = 0.0
    extra_at: tuple[float, float, float] = (0.0, 0.0, -0.1)
    offset: Array = field(default_factory=lambda: np.zeros(2))
    scale: Array = field(default_factory=lambda: np.ones(2))
    cable: Cable | None = None
    tip_forces: Array | None = None


def model_xml(tool: str, mech: Mechanics) -> str:
    """MJCF of the arm with the bias body, the tool, a possible extra mass and a possible cable on the tool."""
    t = TOOLS[tool]
    extra = ""
    if mech.extra_mass > 0:
        extra = (
            f'<body name="extra"><inertial pos="{_v(mech.extra_at)}" mass="{mech.extra_mass}" '
            'diaginertia="1e-7 1e-7 1e-7"/></body>'
        )
    anchor = mech.cable.anchor if mech.cable else (0.3, 0.0, 0.5)
    return f"""<mujoco><compiler angle="radian" balanceinertia="true"/><option gravity="{_v(mech.gravity)}"/>
<worldbody><site name="anchor" pos="{_v(anchor)}"/>
<body name="platform"><inertial pos="0 0 0" mass="2" diaginertia=".02 .02 .02"/>
<joint name="x" type="slide" axis="1 0 0"/><joint name="y" type="slide" axis="0 1 0"/>
<joint name="z" type="slide" axis="0 0 1"/>
<body name="roll_link" pos="0 0 0.045"><joint name="roll" axis="1 0 0"/>
<inertial pos=".1 0 0" mass="1" diaginertia=".01 .01 .01"/>
<body name="tilt_link" pos="{_v(mech.tilt_origin)}"><joint name="tilt" axis="{_v(mech.tilt_axis)}"/>
<inertial pos=".03 0 0" mass=".4" diaginertia=".001 .001 .001"/>
<body name="sensed" pos="0.055 0 0" quat="{_v(mech.sensor_quat)}"><site name="ft"/>
<inertial pos="{_v(BIAS_COM)}" mass="{BIAS_MASS}" diaginertia="1e-7 1e-7 1e-7"/>
<body name="tool"><inertial pos="{_v(t.com)}" mass="{t.mass}" diaginertia="{_v(t.inertia)}"/>
<site name="clip" pos="0.02 0 -0.03"/><site name="tip" pos="{_v(t.tip)}"/></body>{extra}
</body></body></body></body></worldbody>
<tendon><spatial name="cable"><site site="anchor"/><site site="clip"/></spatial></tendon>
<sensor><force site="ft"/><torque site="ft"/></sensor></mujoco>"""


def wrench_along(path: Path, tool: str, mech: Mechanics) -> Array:
    """What the sensor reads (N, 6) along a path of platform, roll and tilt, its zero taken at home without the tool.

    MuJoCo's sensor gives what the child does to the parent; the reading is its negative.
    """
    model = mujoco.MjModel.from_xml_string(model_xml(tool, mech))
    data = mujoco.MjData(model)
    q = path.q.copy()
    q[:, 3:] = q[:, 3:] * mech.scale + mech.offset
    rate, bend = path.dq.copy(), path.ddq.copy()
    rate[:, 3:] *= mech.scale
    bend[:, 3:] *= mech.scale
    sensed, tip, clip = (_id(model, kind, n) for kind, n in (("body", "tool"), ("site", "tip"), ("site", "clip")))
    out, tension_before = np.empty((len(q), 6)), 0.0
    for i in range(len(q)):
        data.qpos[:], data.qvel[:], data.qacc[:] = q[i], rate[i], bend[i]
        data.xfrc_applied[:] = 0.0
        if mech.cable or mech.tip_forces is not None:
            mujoco.mj_fwdPosition(model, data)
            mujoco.mj_fwdVelocity(model, data)
            if mech.cable:
                tension_before = _pull(data, mech.cable, clip, sensed, tension_before)
            if mech.tip_forces is not None:
                _apply(data, sensed, mech.tip_forces[i], data.site_xpos[tip])
        mujoco.mj_inverse(model, data)
        out[i] = -data.sensordata
    return out - _zero(mech)


def _pull(data: mujoco.MjData, cable: Cable, clip: int, body: int, before: float) -> float:
    """A taut cable pulls the tool's clip towards the anchor; friction in its conduit holds it back."""
    wanted = cable.stiffness * max(float(data.ten_length[0]) - cable.rest, 0.0)
    # Friction in the conduit: the tension follows only when the spring has overcome it.
    tension = max(min(max(before, wanted - cable.friction), wanted + cable.friction), 0.0)
    at = data.site_xpos[clip]
    towards = np.asarray(cable.anchor) - at
    _apply(data, body, tension * towards / np.linalg.norm(towards), at)
    return tension


def _apply(data: mujoco.MjData, body: int, force: Array, at: Array) -> None:
    """Add a force (3,) N at a point (3,) m, both in the world, to a body."""
    data.xfrc_applied[body, :3] += force
    data.xfrc_applied[body, 3:] += np.cross(at - data.xipos[body], force)


def _zero(mech: Mechanics) -> Array:
    """The reading that was zeroed away: the bias body's weight at home, on the real arm."""
    bare = Mechanics(
        gravity=mech.gravity,
        tilt_axis=mech.tilt_axis,
        sensor_quat=mech.sensor_quat,
        offset=mech.offset,
        scale=mech.scale,
    )
    xml = model_xml("pointer", bare)
    model = mujoco.MjModel.from_xml_string(xml)
    data = mujoco.MjData(model)
    tool = _id(model, "body", "tool")
    model.body_mass[tool], model.body_inertia[tool] = 0.0, 0.0
    data.qpos[3:] = bare.offset
    mujoco.mj_inverse(model, data)
    return np.asarray(-data.sensordata)


def tip_along(q: Array, tool: str, mech: Mechanics) -> tuple[Array, Array]:
    """Position (N, 3) m and quaternion (N, 4) x y z w of the tip for platform, roll, tilt (N, 5)."""
    model = mujoco.MjModel.from_xml_string(model_xml(tool, mech))
    data = mujoco.MjData(model)
    tip = _id(model, "site", "tip")
    position, quat = np.empty((len(q), 3)), np.empty((len(q), 4))
    for i in range(len(q)):
        data.qpos[:] = q[i]
        data.qpos[3:] = q[i, 3:] * mech.scale + mech.offset
        mujoco.mj_kinematics(model, data)
        position[i] = data.site_xpos[tip]
        wxyz = np.empty(4)
        mujoco.mju_mat2Quat(wxyz, data.site_xmat[tip])
        quat[i] = [*wxyz[1:], wxyz[0]]
    return position, quat


def _id(model: mujoco.MjModel, kind: str, name: str) -> int:
    code = {"body": mujoco.mjtObj.mjOBJ_BODY, "site": mujoco.mjtObj.mjOBJ_SITE, "joint": mujoco.mjtObj.mjOBJ_JOINT}[
        kind
    ]
    return int(mujoco.mj_name2id(model, code, name))


def _v(values: Sequence[float]) -> str:
    return " ".join(f"{float(v):.12g}" for v in values)

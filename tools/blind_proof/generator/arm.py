"""A three-joint arm: its efforts along a path against the URDF, its positions under servo against an ideal servo."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import mujoco
import numpy as np
from numpy.typing import NDArray

from galen_hw.tools.blind_proof.generator import signal
from galen_hw.tools.blind_proof.generator.case import Case, Injected
from galen_hw.tools.blind_proof.generator.motion import Path, between, episodes, sines
from galen_hw.tools.blind_proof.generator.servo_arm import STEP_S, Servo, Stepper

Array = NDArray[np.float64]

JOINTS = ("turn", "shoulder", "elbow")
LINKS = (  # name, origin in the parent, axis, centre of mass, mass, inertia, visual length
    ("turret", (0, 0, 0.2), (0, 0, 1), (0.0, 0.01, 0.05), 2.0, (0.01, 0.01, 0.008)),
    ("upper", (0, 0, 0.1), (0, 1, 0), (0.14, 0.0, 0.0), 1.6, (0.002, 0.016, 0.016)),
    ("fore", (0.3, 0, 0), (0, 1, 0), (0.11, 0.01, 0.0), 1.0, (0.001, 0.007, 0.007)),
)
HAND = (0.25, 0.0, 0.0)
EFFORT_SIGMA = np.array([0.03, 0.05, 0.03])
SPRINGS = np.array([400.0, 400.0, 250.0])
"""N m/rad of the position servos."""
POSITION_SIGMA = np.array([4e-4, 4e-4, 4e-4])


def urdf() -> str:
    """The nominal arm for the recording's folder."""
    links, joints, parent = '<link name="base"/>', "", "base"
    for (name, origin, axis, com, mass, inertia), joint in zip(LINKS, JOINTS, strict=True):
        ixx, iyy, izz = inertia
        links += (
            f'<link name="{name}"><inertial><origin xyz="{_v(com)}" rpy="0 0 0"/><mass value="{mass}"/>'
            f'<inertia ixx="{ixx}" iyy="{iyy}" izz="{izz}" ixy="0" ixz="0" iyz="0"/></inertial></link>'
        )
        joints += (
            f'<joint name="{joint}" type="revolute"><parent link="{parent}"/><child link="{name}"/>'
            f'<origin xyz="{_v(origin)}" rpy="0 0 0"/><axis xyz="{_v(axis)}"/>'
            '<limit lower="-3" upper="3" effort="60" velocity="5"/></joint>'
        )
        parent = name
    return f'<robot name="bench_arm">{links}{joints}</robot>\n'


@dataclass
class Machine:
    """How the real arm differs: friction and damping (3,), ripple, cable, payload, play, forces at the hand."""

    loss: Array = field(default_factory=lambda: np.zeros(3))
    damping: Array = field(default_factory=lambda: np.zeros(3))
    gravity: tuple[float, float, float] = (0.0, 0.0, -9.80665)
    payload: float = 0.0
    cable: tuple[float, float] | None = None
    offset: Array = field(default_factory=lambda: np.zeros(3))
    hand_force: Array | None = None
    play: Array = field(default_factory=lambda: np.zeros(3))
    sag: bool = False
    gains: Array = field(default_factory=lambda: np.ones(3))


@dataclass
class ArmScene:
    """One arm recording while it is being made."""

    case: Case
    path: Path
    machine: Machine = field(default_factory=Machine)
    command: Array | None = None
    after: list[Callable[[Array], Array]] = field(default_factory=list)


def mjcf(machine: Machine, *, servo: bool) -> str:
    """MJCF of the arm: with dry friction and damping, or as the mechanism alone, which `servo_arm` drives and holds.

    Under servo with a play joint behind each motor that has play.
    """
    inner, closing = "", ""
    for k, (link, joint) in enumerate(zip(LINKS, JOINTS, strict=True)):
        name, origin, axis, com, mass, inertia = link
        lift = ' gravcomp="1"' if servo and not machine.sag else ""
        resists = "" if servo else f'frictionloss="{machine.loss[k]}" damping="{machine.damping[k]}"'
        turns = f'<joint name="{joint}" axis="{_v(axis)}" {resists} armature="{0.05 if servo else 0}"/>'
        if machine.play[k] > 0:
            inner += (
                f'<body name="{name}_m" pos="{_v(origin)}">{turns}'
                '<inertial pos="0 0 0" mass="1e-3" diaginertia="1e-5 1e-5 1e-5"/>'
                f'<body name="{name}"{lift}><joint name="{joint}_play" axis="{_v(axis)}"/>'
            )
            closing = "</body>" + closing
        else:
            inner += f'<body name="{name}"{lift} pos="{_v(origin)}">{turns}'
        inner += f'<inertial pos="{_v(com)}" mass="{mass}" diaginertia="{_v(inertia)}"/>'
        closing = "</body>" + closing
    load = (
        f'<body name="load" pos="{_v(HAND)}"><inertial pos="0 0 -0.02" mass="{max(machine.payload, 1e-9)}" '
        'diaginertia="1e-9 1e-9 1e-9"/><site name="hand"/></body>'
    )
    stiffness, rest = machine.cable or (0.0, 0.3)
    tendon = (
        f'<tendon><spatial name="hose" stiffness="{stiffness}" springlength="0 {rest}">'
        '<site site="anchor"/><site site="hand"/></spatial></tendon>'
    )
    return f"""<mujoco><compiler angle="radian" balanceinertia="true"/>
<option gravity="{_v(machine.gravity)}"/>
<worldbody><site name="anchor" pos="0.1 0.5 0.8"/>{inner}{load}{closing}</worldbody>
{tendon}</mujoco>"""


def efforts(scene: ArmScene) -> Array:
    """Joint efforts (N, 3) that the path needs."""
    m = scene.machine
    model = mujoco.MjModel.from_xml_string(mjcf(m, servo=False))
    data = mujoco.MjData(model)
    load = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, "load")
    out = np.empty((len(scene.path.q), 3))
    for i in range(len(out)):
        data.qpos[:], data.qvel[:], data.qacc[:] = scene.path.q[i] + m.offset, scene.path.dq[i], scene.path.ddq[i]
        mujoco.mj_inverse(model, data)
        out[i] = data.qfrc_inverse
        if m.hand_force is not None:
            # MuJoCo's inverse dynamics leaves applied forces out; what the hand bears, the motors need not.
            pushed = np.zeros(model.nv)
            mujoco.mj_applyFT(model, data, m.hand_force[i], np.zeros(3), data.xpos[load], load, pushed)
            out[i] -= pushed
    for change in scene.after:
        out = change(out)
    return out


def positions(scene: ArmScene) -> Array:
    """Positions (N, 3) of the links while the motors follow the command; what friction holds stands still."""
    assert scene.command is not None
    model = mujoco.MjModel.from_xml_string(mjcf(scene.machine, servo=True))
    names = [model.joint(i).name for i in range(model.njnt)]
    link = np.array([[name.removesuffix("_play") == joint for name in names] for joint in JOINTS], dtype=float)
    motor = np.array([[name == joint for name in names] for joint in JOINTS], dtype=float)
    stepper = Stepper(model, _servo(scene.machine, names), scene.command[0] @ motor)
    per_row = round(1 / scene.case.rate_hz / STEP_S)
    out = np.empty((len(scene.command), 3))
    for i, command in enumerate(scene.command @ motor):
        out[i] = link @ stepper.q
        for _ in range(per_row):
            stepper.step(command)
    for change in scene.after:
        out = change(out)
    return out


def _servo(machine: Machine, names: Sequence[str]) -> Servo:
    """Position servos with a viscous part that gives all gains the same time constant of 30 ms; play behind them."""
    rows = []
    for name in names:
        k = JOINTS.index(name.removesuffix("_play"))
        b = machine.play[k]
        motor = (SPRINGS[k] * machine.gains[k], SPRINGS[k] * 0.03, machine.loss[k], machine.damping[k], -np.inf, np.inf)
        rows.append((0.0, 0.0, 0.0, 0.4, -b, b) if name.endswith("_play") else motor)
    return Servo(*np.array(rows).T)


def make_scene(rng: np.random.Generator, case: Case) -> ArmScene:
    """A path for effort, a command for position."""
    t = np.arange(round(case.duration_s * case.rate_hz)) / case.rate_hz
    if case.motion == "stream":
        path = sines(rng, t, np.array([1.4, 1.1, 1.6]), fast_hz=0.5)
    else:
        path = between(
            t, rng.uniform(-1, 1, (int(case.duration_s / 3) + 2, 3)) * [1.2, 0.8, 1.2], move_s=1.4, dwell_s=1.6
        )
    return ArmScene(case, path, command=path.q)


def baseline(scene: ArmScene) -> Array:
    """The nominal arm's efforts, or the ideal servo's positions."""
    nominal = ArmScene(scene.case, scene.path, command=scene.path.q)
    return efforts(nominal) if scene.case.group == "effort" else positions(nominal)


def columns(scene: ArmScene, reading: Array, rng: np.random.Generator) -> dict[str, Array]:
    """The recording's columns."""
    out = {"time": scene.path.t}
    if scene.case.group == "effort":
        noisy = scene.path.q + rng.normal(0, max(scene.case.encoder, 1e-5), scene.path.q.shape)
        for k, joint in enumerate(JOINTS):
            out |= {f"joint.{joint}.position": noisy[:, k], f"joint.{joint}.effort": reading[:, k]}
        return out
    for k, joint in enumerate(JOINTS):
        out |= {f"joint.{joint}.command": scene.path.q[:, k], f"joint.{joint}.position": reading[:, k]}
    return out


Maker = Callable[[ArmScene, Injected, np.random.Generator, float], None]


def _joints(rng: np.random.Generator, hidden: Injected, *, only: tuple[int, ...] = (0, 1, 2)) -> Array:
    """Which joints have the effect: one of them, or all."""
    mask = np.zeros(3)
    mask[list(only) if rng.random() < 0.5 else rng.choice(only)] = 1.0
    hidden.joints = [j for j, m in zip(JOINTS, mask, strict=True) if m]
    return mask


def friction(scene: ArmScene, hidden: Injected, rng: np.random.Generator, a: float) -> None:
    """Dry friction, half the time with a viscous part."""
    mask = _joints(rng, hidden)
    scale = np.array([0.05, 0.08, 0.05]) if scene.case.group == "effort" else np.array([0.2, 0.2, 0.12])
    scene.machine.loss = a * mask * scale
    if rng.random() < 0.5:
        scene.machine.damping = 0.6 * a * mask * scale
    # A servo's positions show friction as the way that its spring gives for it, in rad.
    spring = np.ones(3) if scene.case.group == "effort" else SPRINGS * scene.machine.gains
    hidden.parameters = {
        "coulomb": float((scene.machine.loss / spring).max()),
        "viscous": float((scene.machine.damping / spring).max()),
    }


def payload(scene: ArmScene, hidden: Injected, rng: np.random.Generator, a: float) -> None:
    """Something is in the hand."""
    del rng
    scene.machine.payload = 0.01 * a
    hidden.parameters = {"mass": 0.01 * a}


def torque_ripple(scene: ArmScene, hidden: Injected, rng: np.random.Generator, a: float) -> None:
    """Cogging of the motors' poles."""
    mask, poles, phase = _joints(rng, hidden), int(rng.integers(6, 25)), rng.uniform(0, 6, 3)
    hidden.parameters = {"periods_per_turn": float(poles)}
    wave = np.sin(poles * scene.path.q + phase)
    scene.after.append(lambda x: x + 0.04 * a * mask * wave)


def cable_drag(scene: ArmScene, hidden: Injected, rng: np.random.Generator, a: float) -> None:
    """A hose from a bracket to the hand."""
    scene.machine.cable = (0.5 * a, float(rng.uniform(0.1, 0.35)))
    hidden.kind = "spring"


def base_tilt(scene: ArmScene, hidden: Injected, rng: np.random.Generator, a: float) -> None:
    """The base stands askew."""
    azimuth, s = rng.uniform(0, 2 * np.pi), np.sin(0.004 * a)
    g = 9.80665
    scene.machine.gravity = (
        float(g * s * np.cos(azimuth)),
        float(g * s * np.sin(azimuth)),
        float(-g * np.sqrt(1 - s * s)),
    )
    hidden.parameters = {"angle": 0.004 * a}


def gain(scene: ArmScene, hidden: Injected, rng: np.random.Generator, a: float) -> None:
    """One torque sensor's scale is off."""
    k = int(rng.integers(1, 3))
    hidden.joints, hidden.parameters = [JOINTS[k]], {"gain": 0.01 * a}
    scene.after.append(lambda x: x * (1 + 0.01 * a * np.eye(3)[k]))


def joint_offset(scene: ArmScene, hidden: Injected, rng: np.random.Generator, a: float) -> None:
    """A joint's zero is off."""
    k = int(rng.integers(1, 3)) if scene.case.group == "effort" else int(rng.integers(3))
    hidden.joints, hidden.parameters = [JOINTS[k]], {"offset": 0.004 * a}
    if scene.case.group == "effort":
        scene.machine.offset[k] = 0.004 * a
    else:
        hidden.parameters = {"offset": 2e-4 * a}
        scene.after.append(lambda x: x + 2e-4 * a * np.eye(3)[k])


def time_delay(scene: ArmScene, hidden: Injected, rng: np.random.Generator, a: float) -> None:
    """The recorded stream is late against the joints or the command."""
    del rng
    d = (0.004 if scene.case.group == "effort" else 0.001) * a
    hidden.parameters = {"delay": d}
    scene.after.append(lambda x: signal.delayed(scene.path.t, x, d))


def contact(scene: ArmScene, hidden: Injected, rng: np.random.Generator, a: float) -> None:
    """Somebody pushes the hand a few times."""
    t = scene.path.t
    hidden.when = episodes(rng, t[-1], count=int(rng.integers(2, 5)), length_s=(0.8, 4.0))
    force = np.zeros((len(t), 3))
    for start, end in hidden.when:
        u = np.clip((t - start) / (end - start), 0, 1)
        direction = rng.normal(size=3)
        force += 0.4 * a * (np.sin(np.pi * u) ** 0.5)[:, None] * direction / np.linalg.norm(direction)
    scene.machine.hand_force = force


def drift(scene: ArmScene, hidden: Injected, rng: np.random.Generator, a: float) -> None:
    """A torque sensor warms up."""
    k, t = int(rng.integers(3)), scene.path.t
    hidden.kind, hidden.joints = "warm-up", [JOINTS[k]]
    shape = signal.warm_up(t, 0.3 * t[-1])
    scene.after.append(lambda x: x + a * 0.05 * shape[:, None] * np.eye(3)[k])


def vibration(scene: ArmScene, hidden: Injected, rng: np.random.Generator, a: float) -> None:
    """A hum in one torque channel."""
    k, hz = int(rng.integers(3)), rng.uniform(8, 35)
    hidden.joints, hidden.parameters = [JOINTS[k]], {"frequency": float(hz)}
    hum = signal.narrow_band(rng, scene.path.t, hz)
    scene.after.append(lambda x: x + a * 0.05 * hum[:, None] * np.eye(3)[k])


def lag(scene: ArmScene, hidden: Injected, rng: np.random.Generator, a: float) -> None:
    """A filter behind the encoder."""
    del rng
    hidden.parameters = {"time_constant": 0.001 * a}
    scene.after.append(lambda x: signal.lagged(x, 1 / scene.case.rate_hz, 0.001 * a))


def backlash(scene: ArmScene, hidden: Injected, rng: np.random.Generator, a: float) -> None:
    """Play behind the motor: two stops that the link falls between."""
    mask = _joints(rng, hidden, only=(1, 2))
    scene.machine.play = mask * 2e-4 * a
    hidden.parameters = {"half_width": 2e-4 * a}


def compliance(scene: ArmScene, hidden: Injected, rng: np.random.Generator, a: float) -> None:
    """The servos are springs and nobody told them of the arm's weight."""
    del rng
    scene.machine.sag, scene.machine.gains = True, np.full(3, 20.0 / a)
    hidden.kind, hidden.joints = "sag under the arm's own weight", ["shoulder", "elbow"]


def joint_scale(scene: ArmScene, hidden: Injected, rng: np.random.Generator, a: float) -> None:
    """An encoder's scale is off."""
    k = int(rng.integers(3))
    hidden.joints, hidden.parameters = [JOINTS[k]], {"scale": 1e-3 * a}
    scene.after.append(lambda x: x * (1 + 1e-3 * a * np.eye(3)[k]))


EFFORT_EFFECTS: dict[str, Maker] = {
    f.__name__: f
    for f in (
        friction,
        payload,
        torque_ripple,
        cable_drag,
        base_tilt,
        gain,
        joint_offset,
        time_delay,
        contact,
        drift,
        vibration,
    )
}
POSITION_EFFECTS: dict[str, Maker] = {
    f.__name__: f for f in (friction, time_delay, lag, backlash, joint_offset, joint_scale)
}


def _v(values: Sequence[float]) -> str:
    return " ".join(f"{float(v):.12g}" for v in values)

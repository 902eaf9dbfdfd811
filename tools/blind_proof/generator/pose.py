"""Poses of the Galen's tip under known pushes: an arm with passive joints that give, stick, creep and have play.

Active joints follow their command exactly. Between platform and roll link, and at the tilt joint, sit passive joints,
two turns and one vertical slide; each effect is something that these joints do under the load that MuJoCo gives them.
"""

from collections.abc import Callable
from dataclasses import dataclass, field

import mujoco
import numpy as np
from numpy.typing import NDArray

from galen_hw.tools.blind_proof.generator import signal
from galen_hw.tools.blind_proof.generator.case import Case, Injected
from galen_hw.tools.blind_proof.generator.galen import BIAS_COM, BIAS_MASS, GRAVITY, JOINTS, TOOLS, carriages
from galen_hw.tools.blind_proof.generator.motion import Path, between, pushes
from galen_hw.tools.blind_proof.generator.wrench import JITTER

Array = NDArray[np.float64]

CHANNELS = tuple(f"pose.position.{axis}" for axis in "xyz")
SIGMA = np.array([7e-5, 7e-5, 7e-5])
RATE_HZ = 60.0
PASSIVE = ("lift", "roll", "tilt")
KNOWN = {"lift": 1e-9, "roll": 6e-4, "tilt": 9e-4}
"""Compliance that the recording may state (m/N, rad/(N m)), or so many times it, when the effect to be found lies beyond it."""


@dataclass
class Give:
    """What the passive joints do, one entry a joint in the order of PASSIVE (m/N or rad/(N m), N or N m, m or rad).

    Args:
        compliance: linear give; friction: that must be overcome; play: free half width; creep: delayed give;
        hardening: share by which the give falls at the reference load.
    """

    compliance: Array = field(default_factory=lambda: np.array([1e-9, 1e-7, 1e-7]))
    friction: Array = field(default_factory=lambda: np.zeros(3))
    play: Array = field(default_factory=lambda: np.zeros(3))
    creep: Array = field(default_factory=lambda: np.zeros(3))
    creep_tau_s: float = 6.0
    hardening: float = 0.0
    tilt_axis: tuple[float, float, float] = (0.0, 1.0, 0.0)
    offset: Array = field(default_factory=lambda: np.zeros(2))
    scale: Array = field(default_factory=lambda: np.ones(2))


@dataclass
class PoseScene:
    """One pose recording while it is being made."""

    case: Case
    path: Path
    force: Array
    tool: str
    give: Give = field(default_factory=Give)
    known_compliance: bool = False
    softness: float = 1.0
    after: list[Callable[[Array], Array]] = field(default_factory=list)


def arm_xml(tool: str, give: Give) -> str:
    """MJCF: the Galen with its passive joints. The links are balanced: only tool and bias body load them."""
    t = TOOLS[tool]
    lift = '<joint name="lift" type="slide" axis="0 0 1"/>'
    roll = '<joint name="give_roll" axis="1 0 0"/>'
    tilt = '<joint name="give_tilt" axis="0 1 0"/>'
    axis = " ".join(map(str, give.tilt_axis))
    com, tip, inertia = (" ".join(map(str, v)) for v in (t.com, t.tip, t.inertia))
    massless = '<inertial pos="0 0 0" mass="0.001" diaginertia="1e-6 1e-6 1e-6"/>'
    return f"""<mujoco><compiler angle="radian" balanceinertia="true"/>
<option gravity="{" ".join(map(str, GRAVITY))}" timestep="0.002" integrator="implicitfast"/><worldbody>
<body name="lifted">{lift}{massless}
<body name="roll_link" pos="0 0 0.045"><joint name="roll" axis="1 0 0"/>{massless}<body name="rolled">{roll}
{massless}
<body name="tilt_link" pos="0.21 0 0.035"><joint name="tilt" axis="{axis}"/>{massless}<body name="tilted">{tilt}
{massless}
<body name="bias" pos="0.055 0 0">
<inertial pos="{" ".join(map(str, BIAS_COM))}" mass="{BIAS_MASS}" diaginertia="1e-5 1e-5 1e-5"/>
<body name="tool"><inertial pos="{com}" mass="{t.mass}" diaginertia="{inertia}"/>
<site name="tip" pos="{tip}"/></body></body>
</body></body></body></body></body></worldbody></mujoco>"""


def stated(scene: PoseScene) -> Array:
    """Compliance (3,) that the recording states, in the order of PASSIVE."""
    return scene.softness * np.array([KNOWN[k] for k in PASSIVE])


def simulate(scene: PoseScene) -> Array:
    """Tip positions (N, 3): quasi-static, the passive joints solved for balance at every row."""
    tip = _tip_along(scene)
    for change in scene.after:
        tip = change(tip)
    return tip


def baseline(scene: PoseScene) -> Array:
    """What the recording's model says: rigid, or with the compliance that it states."""
    give = Give(compliance=stated(scene)) if scene.known_compliance else Give()
    return _tip_along(PoseScene(scene.case, scene.path, scene.force, scene.tool, give))


def _tip_along(scene: PoseScene) -> Array:
    """Positions of the tip: MuJoCo gives each passive joint's load, the joint's law its give."""
    give = scene.give
    model = mujoco.MjModel.from_xml_string(arm_xml(scene.tool, give))
    data = mujoco.MjData(model)
    tool = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, "tool")
    site = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_SITE, "tip")
    at = {n: model.joint(n).qposadr[0] for n in ("lift", "roll", "give_roll", "tilt", "give_tilt")}
    passive = [at["lift"], at["give_roll"], at["give_tilt"]]
    law = _Law(give, 1.0 / scene.case.rate_hz)
    out = np.empty((len(scene.path.q), 3))
    for i, q in enumerate(scene.path.q):
        data.qpos[at["roll"]], data.qpos[at["tilt"]] = q[3:] * give.scale + give.offset
        data.qvel[:] = data.qacc[:] = 0.0
        for _ in range(2):
            data.qpos[passive] = law.position(_load(model, data, tool, site, scene.force[i])[passive])
        law.commit()
        mujoco.mj_kinematics(model, data)
        out[i] = data.site_xpos[site] + q[:3]
    return out


def _load(model: mujoco.MjModel, data: mujoco.MjData, tool: int, site: int, force: Array) -> Array:
    """Generalised force (nv,) that pushes each joint: weight and the push at the tip."""
    mujoco.mj_fwdPosition(model, data)
    mujoco.mj_fwdVelocity(model, data)
    push = np.zeros(model.nv)
    mujoco.mj_applyFT(model, data, force, np.zeros(3), data.site_xpos[site], tool, push)
    return np.asarray(push - data.qfrc_bias)


class _Law:
    """How a passive joint answers its load: spring, friction in the bearing, play, a slow branch."""

    def __init__(self, give: Give, dt: float) -> None:
        self.give, self.pole = give, float(np.exp(-dt / give.creep_tau_s))
        self.held: Array | None = None
        self.slow: Array | None = None
        self._next: tuple[Array, Array] | None = None

    def position(self, load: Array) -> Array:
        """Joint positions (3,) under `load` (3,), from the state of the row before."""
        give = self.give
        held = load.copy() if self.held is None else self.held
        # Friction carries part of the load: the spring feels a load that follows within the friction's band.
        spring_load = np.clip(held, load - give.friction, load + give.friction)
        soft = give.compliance / (1.0 + give.hardening * np.abs(spring_load) / np.array([8.0, 1.2, 1.2]))
        target = give.creep * spring_load
        slow = target if self.slow is None else self.pole * self.slow + (1 - self.pole) * target
        self._next = (spring_load, slow)
        return np.asarray(soft * spring_load + slow + give.play * np.tanh(spring_load / 0.02))

    def commit(self) -> None:
        """The row is done: its state is the next row's past."""
        assert self._next is not None
        self.held, self.slow = self._next


def make_scene(rng: np.random.Generator, case: Case) -> PoseScene:
    """Configurations held for ten seconds each, a push at each."""
    t = np.arange(round(case.duration_s * case.rate_hz)) / case.rate_hz
    count = int(case.duration_s / 10.0) + 2
    targets = np.hstack(
        [rng.uniform(-0.04, 0.04, (count, 3)), rng.uniform(-0.8, 0.8, (count, 1)), rng.uniform(-0.5, 0.5, (count, 1))]
    )
    path = between(t, targets, move_s=1.5, dwell_s=8.5)
    return PoseScene(case, path, pushes(rng, t, newtons=8.0, period_s=10.0), str(rng.choice(["pointer", "retractor"])))


def columns(scene: PoseScene, reading: Array, rng: np.random.Generator) -> dict[str, Array]:
    """The recording's columns; a third of the recordings are of tracked points instead of poses."""
    q = np.hstack([carriages(scene.path.q[:, :3]), scene.path.q[:, 3:]])
    q += scene.case.encoder * JITTER * rng.normal(size=q.shape)
    out = {"time": scene.path.t}
    out |= {f"joint.{name}.position": q[:, i] for i, name in enumerate(JOINTS)}
    measured = scene.force + rng.normal(0, 0.01, scene.force.shape)
    out |= {f"applied.force.{a}": measured[:, i] for i, a in enumerate("xyz")}
    return out | {name: reading[:, i] for i, name in enumerate(CHANNELS)}


Maker = Callable[[PoseScene, Injected, np.random.Generator, float], None]


def compliance(scene: PoseScene, hidden: Injected, rng: np.random.Generator, a: float) -> None:
    """One or all joints give in proportion to their load."""
    share = rng.dirichlet(np.ones(3))
    scene.give.compliance = scene.give.compliance + a * share * np.array([2e-5, 5e-4, 5e-4])
    hidden.parameters = {k: float(v) for k, v in zip(PASSIVE, scene.give.compliance, strict=True)}


def hardening(scene: PoseScene, hidden: Injected, rng: np.random.Generator, a: float) -> None:
    """The arm, whose linear give is known, gives less the more it is loaded; the softer the arm, the more of that is seen."""
    del hidden
    scene.known_compliance, scene.softness = True, a
    scene.give.compliance = stated(scene)
    scene.give.hardening = float(rng.uniform(0.15, 0.6))


def hysteresis(scene: PoseScene, hidden: Injected, rng: np.random.Generator, a: float) -> None:
    """Friction in the bearings of an arm whose linear give is known; the softer the arm, the more of that is seen."""
    scene.known_compliance, scene.softness = True, a
    scene.give.compliance = stated(scene)
    scene.give.friction = float(rng.uniform(0.2, 0.8)) * np.array([2.0, 0.3, 0.3])
    hidden.kind = "bearing friction"


def backlash(scene: PoseScene, hidden: Injected, rng: np.random.Generator, a: float) -> None:
    """A bearing has play: it lies on one side or the other, as the load says."""
    j = int(rng.integers(1, 3))
    scene.give.play[j] = 1e-4 * a
    hidden.joints, hidden.parameters = [PASSIVE[j]], {"half_width": 1e-4 * a}


def creep(scene: PoseScene, hidden: Injected, rng: np.random.Generator, a: float) -> None:
    """Part of the give comes late."""
    tau = float(rng.uniform(1.0, 4.0))
    scene.known_compliance = True
    scene.give.compliance = stated(scene)
    scene.give.creep, scene.give.creep_tau_s = 0.05 * a * scene.give.compliance, tau
    hidden.parameters = {"time_constant": tau}


def joint_offset(scene: PoseScene, hidden: Injected, rng: np.random.Generator, a: float) -> None:
    """A zero of roll or tilt is off."""
    j = int(rng.integers(2))
    scene.give.offset[j] += 2e-4 * a
    hidden.joints, hidden.parameters = [JOINTS[3 + j]], {"offset": 2e-4 * a}


def joint_scale(scene: PoseScene, hidden: Injected, rng: np.random.Generator, a: float) -> None:
    """A scale of roll or tilt is off."""
    j = int(rng.integers(2))
    scene.give.scale[j] *= 1 + 5e-4 * a
    hidden.joints, hidden.parameters = [JOINTS[3 + j]], {"scale": 5e-4 * a}


def link_geometry(scene: PoseScene, hidden: Injected, rng: np.random.Generator, a: float) -> None:
    """The tilt joint's axis is turned."""
    angle = 5e-4 * a
    scene.give.tilt_axis = (angle, 1.0, 0.0) if rng.random() < 0.5 else (0.0, 1.0, angle)
    hidden.joints, hidden.parameters = ["tilt"], {"angle": angle}


def drift(scene: PoseScene, hidden: Injected, rng: np.random.Generator, a: float) -> None:
    """The tracker's base settles."""
    t, direction = scene.path.t, rng.normal(size=3)
    hidden.kind = "warm-up"
    shape = signal.warm_up(t, 0.3 * t[-1])[:, None] * direction / np.linalg.norm(direction)
    scene.after.append(lambda x: x + a * 1e-4 * shape)


def step(scene: PoseScene, hidden: Injected, rng: np.random.Generator, a: float) -> None:
    """The marker was knocked."""
    at, direction = rng.uniform(0.2, 0.8) * scene.path.t[-1], rng.normal(size=3)
    hidden.when, hidden.parameters = [(float(at), float(at))], {"time": float(at)}
    scene.after.append(lambda x: x + a * 1e-4 * (scene.path.t >= at)[:, None] * direction)


def time_delay(scene: PoseScene, hidden: Injected, rng: np.random.Generator, a: float) -> None:
    """The tracker is late."""
    del rng
    hidden.parameters = {"delay": 0.005 * a}
    scene.after.append(lambda x: signal.delayed(scene.path.t, x, 0.005 * a))


EFFECTS: dict[str, Maker] = {
    f.__name__: f
    for f in (
        compliance,
        hardening,
        hysteresis,
        backlash,
        creep,
        joint_offset,
        joint_scale,
        link_geometry,
        drift,
        step,
        time_delay,
    )
}

"""Small scenes of every group, made without the program's own simulation where that matters."""

from dataclasses import replace

import numpy as np

from galen_hw.diagnosis.estimation.candidate import identity_of
from galen_hw.kinematics import GalenRobot
from galen_hw.physics.effects.cable import CableDrag
from galen_hw.physics.effects.clocks import BETWEEN
from galen_hw.physics.effects.drift import Drift
from galen_hw.physics.effects.events import Contact, Glitches, Step, Vibration
from galen_hw.physics.effects.friction import TorqueRipple
from galen_hw.physics.effects.load import Payload
from galen_hw.physics.effects.registry import EFFECTS, effect_class, scene_of
from galen_hw.physics.effects.timing import Lag, TimeDelay
from galen_hw.physics.observations import Belief, Group, Observations
from galen_hw.physics.rigid import Body
from galen_hw.physics.scenes.base import Scene

JOINTS = GalenRobot().joint_names
WRENCH = tuple(f"wrench.{kind}.{axis}" for kind in ("force", "torque") for axis in "xyz")
URDF = """<robot name="arm"><link name="base"/>
<link name="upper"><inertial><origin xyz="0 0 0.2"/><mass value="3"/>
<inertia ixx="0.05" iyy="0.05" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial></link>
<link name="fore"><inertial><origin xyz="0.15 0 0"/><mass value="2"/>
<inertia ixx="0.01" iyy="0.03" izz="0.03" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="shoulder" type="revolute"><parent link="base"/><child link="upper"/><axis xyz="0 1 0"/>
<limit lower="-3" upper="3" velocity="2" effort="100"/></joint>
<joint name="elbow" type="revolute"><parent link="upper"/><child link="fore"/><origin xyz="0 0 0.4"/><axis xyz="0 1 0"/>
<limit lower="-3" upper="3" velocity="2" effort="100"/></joint></robot>"""


def belief(*, bias_free: bool = False, dynamic: bool = True) -> Belief:
    """The Galen with the retractor."""
    return Belief(
        robot=GalenRobot(),
        tool=Body(0.287, np.array([0.031, 0.004, -0.063]), np.diag([5.6e-4, 6.4e-4, 1.4e-4])),
        tip=np.array([0.045, 0.0, -0.14]),
        bias_body=Body(0.085, np.array([0.002, -0.001, 0.011])),
        zeroed_rotation=np.eye(3),
        bias_free=bias_free,
        dynamic=dynamic,
    )


def motion(rng: np.random.Generator, rows: int, rate: float, joints: int = 5) -> tuple[np.ndarray, np.ndarray]:
    """Time (N,) and sums of four sines a joint, (N, joints)."""
    t = np.arange(rows) / rate
    amplitude = np.array([0.05, 0.05, 0.05, 0.8, 0.5])[:joints] if joints == 5 else np.full(joints, 0.7)
    q = np.zeros((rows, joints))
    for j in range(joints):
        for f, phase in zip(rng.uniform(0.03, 0.35, 4), rng.uniform(0.0, 6.28, 4), strict=True):
            q[:, j] += amplitude[j] / 2.0 * np.sin(2.0 * np.pi * f * t + phase)
    return t, q


def scene(group: Group, rng: np.random.Generator, rows: int = 400, rate: float = 20.0, **options: bool) -> Scene:
    """A scene of the group whose recording is its simulation; positions are compared with a command."""
    if group in ("effort", "position"):
        return _joints(group, rng, rows, rate)
    t, q = motion(rng, rows, rate)
    columns = {"time": t} | {f"joint.{n}.position": q[:, i] for i, n in enumerate(JOINTS)}
    columns |= {f"applied.force.{a}": rng.normal(size=rows) for a in "xyz"} if group != "wrench" else {}
    if group == "wrench":
        columns |= {name: np.zeros(rows) for name in WRENCH} | {"temperature.sensor": 20.0 + np.sin(t / 7.0)}
    if group == "pose":
        columns |= {f"pose.position.{a}": np.zeros(rows) for a in "xyz"}
        columns |= {f"pose.orientation.{a}": np.full(rows, 0.5) for a in "xyzw"}
    if group == "targets":
        pose = scene("pose", np.random.default_rng(3), rows, rate)
        for k, x in enumerate(np.array([[0.05, 0, 0], [0, 0.06, 0], [0, 0, 0.04]])):
            points = np.einsum("nij,j->ni", pose.T_sensor[:, :3, :3], x) + pose.T_sensor[:, :3, 3]  # type: ignore[attr-defined]
            columns |= {f"target.{k}.position.{a}": points[:, i] for i, a in enumerate("xyz")}
    return scene_of(Observations(group, columns, None, belief(**options)))


def _joints(group: Group, rng: np.random.Generator, rows: int, rate: float) -> Scene:
    from galen_hw.kinematics import UrdfRobot

    t, q = motion(rng, rows, rate, 2)
    columns = {"time": t}
    for i, name in enumerate(("shoulder", "elbow")):
        columns |= {f"joint.{name}.position": q[:, i], f"joint.{name}.effort": np.sin(t + i)}
        columns |= {f"joint.{name}.command": q[:, i]} if group == "position" else {}
    return scene_of(Observations(group, columns, None, Belief(robot=UrdfRobot(URDF))))


def proposals(group, static=False):
    """A scene of a group, and every hypothesis that it allows, those that are sought from others included."""
    made = (
        scene(group, np.random.default_rng(1), dynamic=not static)
        if group == "wrench"
        else scene(group, np.random.default_rng(1))
    )
    found = [e for key in EFFECTS for e in effect_class(key).propose(made)]
    first, last = made.channels[0], made.channels[-1]
    found += [Drift("", "wander", None, 0.0, 10.0, (first, last)), Drift("", "warm_up", 3.0, 0.0, 10.0, (first, last))]
    found += [Step((first,), 5.0), Vibration((first, last), 3.0), Contact((first,), ((2.0, 4.0), (7.0, 8.0)))]
    found += [Step((first,), 5.0, one.name) for one in made.slipping()] + [Contact((first,), ((2.0, 4.0),), 3)]
    if group in ("wrench", "effort"):
        found += [
            CableDrag("tendon"),
            CableDrag("tendon_dry"),
            CableDrag("tendon_eye"),
            Payload("point", (0.02, -0.01, -0.1)),
        ]
        tied = [e for e in CableDrag.propose(made) if e.anchored or e.clipped]
        found += [replace(e, form=form) for e in tied for form in ("tendon", "tendon_dry", "tendon_eye")]
    clocks = [TimeDelay(between="bows"), *(Lag(0.2, between=x) for x in BETWEEN)]
    clocks += [Lag(0.2, damping=0.4, between=x) for x in BETWEEN]
    found += clocks if made.clock else []
    found += [richer for e in found for richer in e.richer(made)]
    found += [Glitches((first,), (3, 9))] + ([TorqueRipple("elbow", 9.0)] if group == "effort" else [])
    return made, list({identity_of(e): e for e in found}.values())

"""What several effects do together: each on a machine that has the others."""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

sys.path.insert(0, str(Path(__file__).parent))

from physics_scenes import JOINTS, URDF, WRENCH, belief, motion, proposals

from galen_hw.kinematics import UrdfRobot
from galen_hw.physics.effects.creep import Creep
from galen_hw.physics.effects.geometry import JointOffset, JointScale, LinkGeometry, SensorMounting
from galen_hw.physics.effects.interactions import compound, meet
from galen_hw.physics.effects.live import EffectStream
from galen_hw.physics.effects.load import INERTIA, BaseTilt, Payload
from galen_hw.physics.effects.registry import kinds, scene_of
from galen_hw.physics.effects.sensor import CrossTalk, Gain
from galen_hw.physics.observations import Belief, Observations
from galen_hw.physics.rigid import Body
from galen_hw.physics.scenes.wrench import ORIENTATION
from galen_hw.spatial import rotation_exp

BODY = np.array([0.05, 0.001, -0.002, 0.003])
POINT = (0.02, -0.04, 0.06)
"""BODY's moment over its mass."""


def test_one_alone_does_what_it_does_alone():
    """Nothing is there to meet: every hypothesis of every group that carries loads."""
    for group in ("wrench", "effort", "pose"):
        scene, found = proposals(group)
        for effect in found:
            theta = np.full(len(effect.parameters(scene)), 0.013)
            (alone,) = compound(scene, [(effect, theta)])
            np.testing.assert_array_equal(alone, effect.change(scene, theta))


def test_what_carries_nothing_meets_nothing():
    """Two errors of an arm that is tracked: each as if alone, and nothing to be told of both."""
    scene, found = proposals("pose")
    placed = [
        (e, np.full(len(e.parameters(scene)), 0.013)) for e in found if e.KEY in ("joint_offset", "backlash", "gain")
    ]
    assert len(placed) > 3
    assert not meet(scene, placed)
    for change, (effect, theta) in zip(compound(scene, placed), placed, strict=True):
        np.testing.assert_array_equal(change, effect.change(scene, theta))
    loads, _ = proposals("wrench")
    payload, gain = (Payload("body"), BODY), (Gain("wrench.force.x"), np.array([0.1]))
    assert meet(loads, [payload, gain])
    assert not meet(loads, [payload])


def test_a_new_load_is_turned_by_a_wrong_joint_and_scaled_by_a_wrong_gain():
    """The same as simulating the other machine and scaling what it reads; the sum of both alone is not."""
    scene, _ = proposals("wrench")
    tool = scene.belief.tool.with_parameters(np.concatenate([BODY, np.zeros(6)]))
    q = scene.observations.columns["joint.tilt.position"] + 0.03
    columns = dict(scene.observations.columns) | {"joint.tilt.position": q}
    real = scene_of(
        replace(scene.observations, columns=columns, belief=replace(scene.belief, tool=tool)), rates=scene.rates
    )
    wanted = real.simulated.copy()
    wanted[:, 2] *= 1.07
    placed = [
        (Gain("wrench.force.z"), np.array([0.07])),
        (JointOffset("tilt"), np.array([0.03])),
        (Payload("full"), np.concatenate([BODY, np.zeros(6)])),
    ]
    together = sum(compound(scene, placed))
    np.testing.assert_allclose(scene.simulated + together, wanted, atol=1e-9)
    apart = sum(effect.change(scene, theta) for effect, theta in placed)
    assert np.max(np.abs(together - apart)) > 1e-3


def test_the_calibration_matrix_comes_after_the_memory_of_the_load():
    """In whatever order they are named."""
    scene, _ = proposals("wrench")
    creep = Creep(0.5, "wrench.force.x")
    placed = [
        (Gain("wrench.force.x"), np.array([0.1])),
        (CrossTalk("wrench.force.y", "wrench.force.x"), np.array([0.2])),
        (creep, np.array([0.05])),
    ]
    gain, leak, slow = compound(scene, placed)
    np.testing.assert_array_equal(slow, creep.change(scene, np.array([0.05])))
    crept = scene.simulated + slow
    np.testing.assert_allclose(leak[:, 1], 0.2 * crept[:, 0])
    np.testing.assert_allclose(gain[:, 0], 0.1 * crept[:, 0])
    other = compound(scene, placed[::-1])[::-1]
    for a, b in zip((gain, leak, slow), other, strict=True):
        np.testing.assert_array_equal(a, b)


def test_efforts_carry_the_new_load_too():
    """A last link that is heavier, in another pose: the same as the inverse dynamics of both."""
    scene, _ = proposals("effort")
    robot, joint = scene.belief.robot, scene.joint_names[1]
    body = np.concatenate([[0.3], 0.3 * np.array(POINT), [1e-3, 0.0, 1e-3, 0.0, 0.0, 1e-3]])
    shift = np.zeros(len(scene.joint_names))
    shift[1] = 0.02
    real = robot.with_load(body).inverse_dynamics(scene.q + shift, *scene.rates)
    together = sum(compound(scene, [(JointOffset(joint), np.array([0.02])), (Payload("full"), body)]))
    order = [scene.joint_index(name.split(".")[1]) for name in scene.channels]
    np.testing.assert_allclose(scene.simulated + together, real[:, order], atol=1e-9)


ARM = {"scale": 0.03, "offset": 0.04, "tilt": np.array([0.02, -0.03]), "turn": np.array([0.01, -0.02, 0.03])}


def wrong_arm(joint):
    """Everything that may be wrong about how an arm stands, named in no order."""
    return [
        (BaseTilt("xy"), ARM["tilt"]),
        (JointOffset(joint), np.array([ARM["offset"]])),
        (JointScale(joint), np.array([ARM["scale"]])),
    ]


@pytest.mark.parametrize("zeroed", [False, True])
def test_errors_of_an_arm_meet_each_other(zeroed):
    """A scale, a zero, a tilted base and a turned sensor at once: the reading of the arm that has them all."""
    scene, _ = proposals("wrench")
    joint, b = "tilt", scene.belief
    at = scene.joint_index(joint)

    def really(q):
        out = np.array(q, dtype=float)
        out[..., at] = (1.0 + ARM["scale"]) * out[..., at] + ARM["offset"]
        return out

    turn, gravity = rotation_exp(ARM["turn"]), rotation_exp(np.append(ARM["tilt"], 0.0)) @ b.gravity
    stood = np.array([0.0, 0.0, -0.2, 0.15, 0.3])
    bias = Body(0.4, np.array([0.01, 0.0, -0.03]))
    belief = real = replace(b, dynamic=False)
    if zeroed:
        R, its = (b.robot.sensor_pose(q[None])[0, :3, :3] for q in (stood, really(stood)))
        belief = replace(belief, bias_body=bias, zeroed_rotation=R, zeroed_joints=tuple(stood))
        real = replace(belief, zeroed_rotation=its @ turn)
    scene = scene_of(replace(scene.observations, belief=belief), rates=scene.rates)
    real = replace(real, gravity=gravity)
    turned = scene_of(
        replace(
            scene.observations,
            belief=replace(real, robot=None),
            columns=_orientations(b.robot.sensor_pose(really(scene.q))[:, :3, :3] @ turn),
        )
    )
    placed = [(SensorMounting("turn"), ARM["turn"]), *wrong_arm(joint)]
    assert meet(scene, placed)
    together = sum(compound(scene, placed))
    np.testing.assert_allclose(scene.simulated + together, turned.simulated, atol=1e-9)
    apart = sum(effect.change(scene, theta) for effect, theta in placed)
    assert np.max(np.abs(together - apart)) > 1e-3


def _orientations(R):
    return dict(zip(ORIENTATION, Rotation.from_matrix(R).as_quat().T, strict=True))


def test_efforts_of_a_wrong_arm_are_those_of_its_motion():
    """Inverse dynamics under another gravity, of the joint's real motion."""
    scene, _ = proposals("effort")
    joint = scene.joint_names[1]
    together = sum(compound(scene, wrong_arm(joint)))
    q, dq, ddq = (x.copy() for x in (scene.q, *scene.rates))
    for x in (q, dq, ddq):
        x[:, 1] *= 1.0 + ARM["scale"]
    q[:, 1] += ARM["offset"]
    gravity = rotation_exp(np.append(ARM["tilt"], 0.0)) @ scene.belief.gravity
    real = scene.belief.robot.under(gravity).inverse_dynamics(q, dq, ddq)
    order = [scene.joint_index(name.split(".")[1]) for name in scene.channels]
    np.testing.assert_allclose(scene.simulated + together, real[:, order], atol=1e-9)


def test_a_stream_of_several_gives_what_the_batch_gives():
    """Two that remember do not share their memory; a gain scales what they add."""
    scene, _ = proposals("wrench")
    placed = [
        (Creep(0.5, "wrench.force.x"), np.array([0.05])),
        (Creep(2.0, "wrench.torque.y"), np.array([0.03])),
        (Gain("wrench.force.x"), np.array([0.1])),
        (Payload("body"), BODY),
        (JointScale("tilt"), np.array([0.02])),
        (JointOffset("tilt"), np.array([0.03])),
        (BaseTilt("x"), np.array([0.02])),
    ]
    batch = sum(compound(scene, placed))
    stream = EffectStream(placed, JOINTS, belief())
    rows = [
        stream.at(scene.time[k], scene.q[k], scene.rates[0][k], scene.rates[1][k], scene.simulated[k])
        for k in range(len(scene))
    ]
    np.testing.assert_allclose(np.array(rows), batch, atol=1e-10)


def test_every_reader_has_its_place():
    """Whatever says that it reads a load, or that an arm stands otherwise, says when."""
    read = sorted((e for e in kinds() if np.isfinite(e.READ_ORDER)), key=lambda e: e.READ_ORDER)
    assert [e.KEY for e in read] == ["hysteresis", "creep", "cross_talk", "gain"]
    wrong = sorted((e for e in kinds() if np.isfinite(e.GEOMETRY_ORDER)), key=lambda e: e.GEOMETRY_ORDER)
    assert [e.KEY for e in wrong] == ["joint_scale", "joint_offset", "base_tilt", "link_geometry", "sensor_mounting"]
    for group in ("wrench", "effort"):
        scene, found = proposals(group)
        assert {type(e) for e in found if e.reads(scene)} <= set(read)
        meeting = [e for e in found if e.stands(scene, np.full(len(e.parameters(scene)), 0.01)) is not None]
        assert {"joint_offset", "base_tilt"} <= {e.KEY for e in meeting}
        assert {type(e) for e in meeting} <= set(wrong)


@given(
    mass=st.floats(0.01, 3.0),
    com=st.lists(st.floats(-0.2, 0.2), min_size=3, max_size=3),
    more=st.floats(0.001, 1.0),
    at=st.lists(st.floats(-0.2, 0.2), min_size=3, max_size=3),
)
@settings(max_examples=50)
def test_a_point_of_mass_added_to_a_body_is_the_body_of_both(mass, com, more, at):
    """Mass, moment and the inertia about the common centre (Steiner)."""
    c, p = np.array(com), np.array(at)
    inertia = more * (p @ p * np.eye(3) - np.outer(p, p))
    six = [inertia[0, 0], inertia[0, 1], inertia[1, 1], inertia[0, 2], inertia[1, 2], inertia[2, 2]]
    both = Body(mass, c, 1e-3 * np.eye(3)).with_parameters(np.array([more, *(more * p), *six]))
    assert both is not None
    d = c - p
    steiner = 1e-3 * np.eye(3) + mass * more / (mass + more) * (d @ d * np.eye(3) - np.outer(d, d))
    np.testing.assert_allclose(both.mass, mass + more)
    np.testing.assert_allclose(both.com, (mass * c + more * p) / (mass + more), atol=1e-12)
    np.testing.assert_allclose(both.inertia, steiner, atol=1e-9)


def test_what_would_weigh_nothing_is_no_body():
    """A load of more than minus the tool."""
    assert Body(0.1).with_parameters(np.array([-0.2, *np.zeros(9)])) is None
    assert len(INERTIA) == 6


@pytest.mark.parametrize("effect", [JointOffset("tilt"), JointScale("tilt"), SensorMounting("turn")])
def test_a_wrong_arm_accelerates_otherwise_too(effect):
    """In a model with inertia the change is that of the whole reading, not of its weight alone."""
    scene, _ = proposals("wrench")
    static = scene_of(replace(scene.observations, belief=replace(scene.belief, dynamic=False)), rates=scene.rates)
    theta = np.full(len(effect.parameters(scene)), 0.02)
    assert scene.belief.dynamic
    assert np.max(np.abs(effect.change(scene, theta) - effect.change(static, theta))) > 1e-6


@pytest.mark.parametrize(("error", "axis"), [("axis_tilt.z", (-1.0, 0.0)), ("axis_tilt.x", (0.0, 1.0))])
def test_a_turned_axis_is_that_of_the_other_arm_in_motion_too(error, axis):
    """Weight and inertia of a tool on an arm whose elbow turns about another axis, simulated by pinocchio."""
    angle, (t, q) = 0.03, motion(np.random.default_rng(4), 400, 20.0, 2)
    other = f"{axis[0] * np.sin(angle):.15f} {np.cos(angle):.15f} {axis[1] * np.sin(angle):.15f}"
    head, _, tail = URDF.rpartition('<axis xyz="0 1 0"/>')
    columns = {"time": t} | {f"joint.{n}.position": q[:, i] for i, n in enumerate(("shoulder", "elbow"))}
    columns |= {name: np.zeros(len(t)) for name in WRENCH}
    believed, real = (
        scene_of(
            Observations("wrench", columns, None, Belief(robot=UrdfRobot(urdf), tool=belief().tool, dynamic=True)),
        )
        for urdf in (URDF, f'{head}<axis xyz="{other}"/>{tail}')
    )
    effect, theta = LinkGeometry("elbow", (error,)), np.array([angle])
    wanted = real.simulated - believed.simulated
    np.testing.assert_allclose(effect.change(believed, theta), wanted, atol=0.05 * np.max(np.abs(wanted)))
    slope = effect.columns(believed).values[:, :, 0]
    assert np.max(np.abs(slope * angle - wanted)) < 0.05 * np.max(np.abs(wanted))
    assert not effect.change(believed, np.zeros(1)).any()

"""Sweeps of few poses, one row each: what happened at some of them; laws that no family of functions holds."""

import sys
from pathlib import Path

import numpy as np
import pytest
from scipy.signal import lfilter

sys.path.insert(0, str(Path(__file__).parent))

from diagnosis_cases import ARM, COM, JOINTS, MASS, SIGMA, WRENCH, Bench, hanging, rotation, sines

from galen_hw.diagnosis import pipeline
from galen_hw.diagnosis.result import Diagnosis
from galen_hw.kinematics import GalenRobot, UrdfRobot
from galen_hw.physics.effects.registry import scene_of
from galen_hw.physics.observations import Belief, Observations
from galen_hw.physics.rigid import Body
from galen_hw.spatial import Array

AVERAGED = SIGMA / 5.0
"""Of the mean of 25 readings."""


def grid(rng: np.random.Generator) -> Array:
    """(56, 2) roll and tilt of the calibration sweep in random order, rad."""
    roll, tilt = np.meshgrid(np.linspace(-0.9, 0.9, 8), np.linspace(-0.6, 0.6, 7))
    return rng.permutation(np.stack([roll.ravel(), tilt.ravel()], axis=-1))


def sweep(rng: np.random.Generator, besides: Array | None = None, *, clock: bool = True, **extra: Array) -> Diagnosis:
    """What is said of a sweep with something besides the tool's weight."""
    turned = grid(rng)
    q = np.concatenate([rng.uniform(-0.03, 0.03, (56, 3)), turned], axis=1)
    y = hanging(rotation(*turned.T)) + rng.normal(size=(56, 6)) * AVERAGED + (0.0 if besides is None else besides)
    columns = {f"joint.{name}.position": q[:, i] for i, name in enumerate(JOINTS)}
    columns |= dict(zip(WRENCH, y.T, strict=True)) | extra | ({"time": 6.0 * np.arange(56.0)} if clock else {})
    belief = Belief(robot=GalenRobot(), tool=Body(MASS, COM), dynamic=False, bias_free=True)
    return pipeline.diagnose(scene_of(Observations("wrench", columns, None, belief))).diagnosis


@pytest.mark.parametrize("clock", [True, False])
def test_a_hand_on_the_tool_at_six_poses_is_a_contact_at_these(clock: bool) -> None:
    """Too few rows for running means, and none of them must pass for noise."""
    push = np.zeros((56, 6))
    push[18:24] = [0.09, 0.0, 0.06, 0.0, 0.003, 0.0]
    told = sweep(np.random.default_rng(5), push, clock=clock)
    assert [f.effect for f in told.findings] == ["contact"]
    step = 6.0 if clock else 1.0
    assert told.when == [pytest.approx((18 * step, 23 * step), abs=step)]


def test_three_spoilt_poses_are_glitches_even_the_last() -> None:
    """A twentieth of all rows, and the last one has no neighbour behind it."""
    spoilt = np.zeros((56, 6))
    spoilt[[7, 28, 55]] = 25.0 * AVERAGED * np.array([[1.0], [-1.0], [1.0]])
    assert [f.effect for f in sweep(np.random.default_rng(6), spoilt).findings] == ["glitches"]


def test_offsets_that_follow_a_thermometer_are_no_drift() -> None:
    """A wander in three channels at once takes more than a temperature in one."""
    t = 6.0 * np.arange(56.0)
    warm = 23.0 + 1.5 * np.sin(2.0 * np.pi * t / 200.0 + 1.0)
    moved = (warm - 23.0)[:, None] * AVERAGED * np.array([2.5, 0.0, 0.0, 0.0, 2.5, 2.5])
    told = sweep(np.random.default_rng(7), moved, **{"temperature.sensor": warm})
    assert [f.effect for f in told.findings] == ["temperature"]
    assert set(told.findings[0].channels) == {"wrench.force.x", "wrench.torque.y", "wrench.torque.z"}
    values = [v for n, v in told.findings[0].parameters.items() if n == "coefficient_wrench.torque.y"]
    assert values[0].value == pytest.approx(2.5 * AVERAGED[4], abs=4.0 * values[0].std)


def tracked(rng: np.random.Generator, give: float) -> Diagnosis:
    """Random poses two seconds apart, three markers seen in each, the tilt joint giving way by `give` rad/(N m)."""
    n, t = 200, 2.0 * np.arange(200.0)
    robot = GalenRobot()
    q = np.concatenate([rng.uniform(-0.04, 0.04, (n, 3)), rng.uniform(-0.6, 0.6, (n, 2))], axis=1)
    force, tip = rng.uniform(-8.0, 8.0, (n, 3)), np.array([0.045, 0.0, -0.14])
    T = robot.sensor_pose(q)
    axis = rotation(q[:, 3], np.zeros(n))[:, :, 1]
    hinge = T[:, :3, 3] - T[:, :3, :3] @ np.array([0.055, 0.0, 0.0])
    at = T[:, :3, 3] + T[:, :3, :3] @ tip
    bent = q.copy()
    bent[:, 4] += give * np.sum(np.cross(at - hinge, force) * axis, axis=1)
    T, columns = robot.sensor_pose(bent), {"time": t}
    columns |= {f"joint.{name}.position": q[:, i] for i, name in enumerate(JOINTS)}
    columns |= {f"applied.force.{a}": force[:, i] for i, a in enumerate("xyz")}
    away = rotation(np.array([0.7]), np.array([-0.4]))[0]
    for k, point in enumerate(([0.0, 0.0, -0.165], [0.05, 0.02, -0.1], [-0.03, 0.05, -0.12])):
        seen = (T[:, :3, 3] + T[:, :3, :3] @ point) @ away + [0.2, -0.1, 1.1] + 1e-4 * rng.normal(size=(n, 3))
        columns |= {f"target.{k}.position.{a}": seen[:, i] for i, a in enumerate("xyz")}
    belief = Belief(robot=robot, tool=Body(MASS, COM), dynamic=False, bias_free=False, tip=tip)
    return pipeline.diagnose(scene_of(Observations("targets", columns, None, belief))).diagnosis


def test_random_poses_under_a_clock_are_no_noise_of_the_encoders() -> None:
    """White over the rows as they are, the tracker saw the arm go there."""
    told = tracked(np.random.default_rng(8), 1.5e-3)
    assert [f.effect for f in told.findings] == ["compliance"]
    assert max(told.fit["noise_floor"].values()) < 1.2e-4
    assert tracked(np.random.default_rng(9), 0.0).verdict == "agrees"


def test_a_weight_that_nothing_accelerates_is_a_payload_and_no_cable() -> None:
    """Poses that were simulated at rest: a body that accelerates fits less well than the pull of a cable hung far below."""
    case = Bench(11, rows=6000, rate=50.0)
    case.wrench += hanging(case.R, 0.02, np.array([0.03, 0.0, -0.05]))
    told = pipeline.diagnose(scene_of(case.observations())).diagnosis
    assert [f.effect for f in told.findings] == ["payload"]
    mass = told.findings[0].parameters["mass"]
    assert mass.value == pytest.approx(0.02, abs=4.0 * mass.std)


def test_slow_noise_at_rest_is_noise() -> None:
    """Where nothing moves there are no inputs that it could follow."""
    rng = np.random.default_rng(3)
    q = np.tile([0.0, 0.0, 0.0, 0.3, 0.2], (2000, 1))
    slow = lfilter([1.0], [1.0, -0.97], rng.normal(size=(2000, 6)), axis=0)
    y = hanging(rotation(q[:, 3], q[:, 4])) + SIGMA * (rng.normal(size=(2000, 6)) + 0.5 * slow)
    columns = {"time": 0.5 * np.arange(2000.0)} | {f"joint.{name}.position": q[:, i] for i, name in enumerate(JOINTS)}
    belief = Belief(robot=GalenRobot(), tool=Body(MASS, COM), dynamic=False, bias_free=True)
    seen = Observations("wrench", columns | dict(zip(WRENCH, y.T, strict=True)), None, belief)
    assert pipeline.diagnose(scene_of(seen)).diagnosis.verdict == "agrees"


ELBOW = """<link name="fore"><inertial><origin xyz="0.15 0 0"/><mass value="1.5"/>
<inertia ixx="0.004" iyy="0.02" izz="0.02" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="elbow" type="revolute"><parent link="upper"/><child link="fore"/><origin xyz="0.4 0 0"/><axis xyz="0 1 0"/>
<limit lower="-3" upper="3" velocity="5" effort="100"/></joint></robot>"""


def test_a_law_of_two_joints_that_no_family_holds_is_not_called_noise() -> None:
    """By its own slowness it would pass for slow noise; trees foretell it in blocks that they have not seen."""
    rng = np.random.default_rng(10)
    t = np.arange(0.0, 60.0, 0.01)
    q = np.stack([sines(rng, t, 0.5, 0.1, 0.6), sines(rng, t, 0.5, 0.1, 0.6)], axis=1)
    speed = np.gradient(q[:, 1], t)
    law = 0.3 * np.sin(9.0 * q[:, 0]) * np.tanh(speed / 0.2)
    robot = UrdfRobot(ARM.replace("</robot>", ELBOW))
    columns = {"time": t}
    belief = Belief(robot=robot, dynamic=True, bias_free=False)
    for i, name in enumerate(("shoulder", "elbow")):
        columns |= {f"joint.{name}.position": q[:, i], f"joint.{name}.effort": np.zeros(len(t))}
    clean = scene_of(Observations("effort", columns, None, belief)).simulated
    noise = rng.normal(size=clean.shape) * np.array([0.15, 0.06])
    for besides, verdict in ((law, "unexplained"), (0.0 * law, "agrees")):
        efforts = clean + noise + np.stack([besides, np.zeros(len(t))], axis=1)
        columns |= {f"joint.{name}.effort": efforts[:, i] for i, name in enumerate(("shoulder", "elbow"))}
        assert (
            pipeline.diagnose(scene_of(Observations("effort", dict(columns), None, belief))).diagnosis.verdict
            == verdict
        )

"""The answer does not hang on which blocks are set aside."""

import numpy as np
import pytest

from galen_hw.diagnosis.pipeline import diagnose
from galen_hw.kinematics import UrdfRobot
from galen_hw.physics.effects.registry import scene_of
from galen_hw.physics.observations import Belief, Observations

LINK = (
    '<link name="{}"><inertial><origin xyz="{} 0 0" rpy="0 0 0"/><mass value="{}"/>'
    '<inertia ixx="0.005" iyy="0.03" izz="0.03" ixy="0" ixz="0" iyz="0"/></inertial></link>'
)
JOINT = (
    '<joint name="{}" type="revolute"><parent link="{}"/><child link="{}"/><origin xyz="{} 0 0" rpy="0 0 0"/>'
    '<axis xyz="0 1 0"/><limit lower="-4" upper="4" effort="60" velocity="5"/></joint>'
)
URDF = (
    '<robot name="two"><link name="base"/>'
    + LINK.format("upper", 0.2, 2.0)
    + LINK.format("fore", 0.15, 1.0)
    + JOINT.format("j1", "base", "upper", 0.0)
    + JOINT.format("j2", "upper", "fore", 0.4)
    + "</robot>"
)
COULOMB, VISCOUS, NOISE = np.array([1.5, 0.5]), np.array([0.7, 0.2]), 0.03


@pytest.mark.inject
@pytest.mark.parametrize("seed", range(5))
def test_friction_of_two_joints_is_friction_with_every_seed(
    seed: int, tmp_path_factory: pytest.TempPathFactory
) -> None:
    """Both joints of a hanging arm swing alike: a clock that is off does more than one joint's friction, less than both do.

    It had been told as a delay of seconds with hysteresis and `unknown` beside it, or as friction, as the blocks fell.
    """
    urdf = tmp_path_factory.mktemp("arm") / "arm.urdf"
    urdf.write_text(URDF)
    robot = UrdfRobot(urdf)
    t, w = np.arange(600)[:, None] / 50.0, 2 * np.pi * 0.15
    size, phase = np.array([0.8, 0.7]), np.array([0.0, 0.3])
    q = size * np.sin(w * t + phase) + [np.pi / 2, 0.0]
    dq, ddq = size * w * np.cos(w * t + phase), -size * w**2 * np.sin(w * t + phase)
    effort = robot.inverse_dynamics(q, dq, ddq) + COULOMB * np.sign(dq) + VISCOUS * dq
    effort += NOISE * np.random.default_rng(0).normal(size=effort.shape)
    columns = {"time": t[:, 0]} | {f"joint.j{k + 1}.position": q[:, k] for k in range(2)}
    columns |= {f"joint.j{k + 1}.effort": effort[:, k] for k in range(2)}
    work = diagnose(scene_of(Observations("effort", columns, None, Belief(robot=robot))), seed=seed)
    assert [f.effect for f in work.diagnosis.findings] == ["friction"]
    assert set(work.diagnosis.findings[0].joints) == {"j1", "j2"}
    assert work.diagnosis.verdict == "explained"

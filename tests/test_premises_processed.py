"""Wrenches without their slow part or weight, stamps without zeros, bodies that are named twice, joints that are coupled.

Mechanics here are this file's own, as in `test_premises.py`, or the robot's own model where a joint is read otherwise.
"""

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter
from scipy.spatial.transform import Rotation

from galen_hw.kinematics import UrdfRobot
from galen_hw.physics.effects.registry import scene_of
from galen_hw.physics.observations import Belief, Observations
from galen_hw.physics.rigid import Body
from galen_hw.premises import Action, examined
from galen_hw.premises.high_pass import HighPassedWrench
from galen_hw.premises.load import ToolTwice
from galen_hw.premises.unpadded import UnpaddedStamps
from galen_hw.premises.weightless import WeightlessTool
from tests.test_premises import COM, FORCE, MASS, TORQUE, G, keys, matrix, moving, seen

STAMPS = 1_718_207_311.0 + 0.3476
WRENCH = FORCE + TORQUE


def stamped(rate: float, padded: bool) -> dict[str, np.ndarray]:
    """A motion whose stamps were joined of seconds and nanoseconds, with all nine digits or without leading zeros."""
    columns = moving()
    t = STAMPS + np.arange(len(columns["time"])) / rate
    seconds = np.floor(t).astype(int)
    nanoseconds = np.round((t - seconds) * 1e9).astype(int)
    text = [f"{s}.{n:09d}" if padded else f"{s}.{n}" for s, n in zip(seconds, nanoseconds, strict=True)]
    return columns | {"time": np.array(text, dtype=float)}


@pytest.mark.parametrize("rate", [50.0, 333.0])
@pytest.mark.parametrize("padded", [True, False])
def test_leading_zeros_of_nanoseconds_are_put_back(rate: float, *, padded: bool) -> None:
    found = list(UnpaddedStamps().examine(seen(stamped(rate, padded))))
    assert len(found) == (not padded)
    for one in found:
        assert one.repaired is not None
        assert np.allclose(one.repaired.columns["time"], stamped(rate, padded=True)["time"], rtol=0.0, atol=1e-6)


def test_a_clock_that_was_set_back_has_all_its_zeros() -> None:
    columns = stamped(50.0, padded=True)
    columns["time"][700:] -= 3.2
    assert not list(UnpaddedStamps().examine(seen(columns)))


@pytest.mark.parametrize("constant", [None, 1.5, 6.0])
def test_a_wrench_behind_a_high_pass_is_refused_with_its_time_constant(constant: float | None) -> None:
    columns = moving()
    if constant is not None:
        keep = constant / (constant + 0.02)
        wrench = matrix(columns, WRENCH)
        passed = lfilter([keep, -keep], [1.0, -keep], wrench - wrench[0], axis=0)
        columns |= dict(zip(WRENCH, passed.T, strict=True))
    found = list(HighPassedWrench().examine(seen(columns, named=True)))
    assert [one.action for one in found] == [Action.REFUSED] * (constant is not None)
    for one in found:
        told = float(one.what.split("time constant of ")[1].split(" s")[0])
        assert told == pytest.approx(constant, rel=0.1)


def test_gauges_that_warm_up_are_no_high_pass() -> None:
    columns = moving()
    columns["wrench.force.z"] = columns["wrench.force.z"] + 30.0 * (1.0 - np.exp(-columns["time"] / 6.0))
    assert not list(HighPassedWrench().examine(seen(columns, named=True)))


@pytest.mark.parametrize("share", [0.0, 0.5, 1.0])
def test_a_tool_whose_weight_was_taken_off_is_compared_without_it(share: float) -> None:
    """Half the weight is a gain or another tool, which are physics."""
    columns = moving()
    wrench = matrix(columns, WRENCH)
    turn = Rotation.from_quat(matrix(columns, [f"sensor.orientation.{a}" for a in "xyzw"]))
    force = MASS * turn.inv().apply(np.tile(G, (len(turn), 1)))
    off = (1.0 - share) * np.concatenate([force, np.cross(COM, force)], axis=1)
    columns |= dict(zip(WRENCH, (wrench - off).T, strict=True))
    found = list(WeightlessTool().examine(seen(columns, named=True)))
    assert len(found) == (share == 0.0)
    for one in found:
        assert one.repaired is not None
        assert one.repaired.belief.tool.mass == 0.0


@pytest.mark.parametrize("both", [True, False])
def test_the_tool_that_hung_on_when_the_sensor_was_zeroed_is_weighed_once(*, both: bool) -> None:
    """Beside a plate of the same weight the readings hold two."""
    columns = moving()
    zeroed = np.eye(3)
    belief = {"bias_body": Body(MASS, COM), "zeroed_rotation": zeroed}
    bare = Belief(tool=Body(MASS, COM) if both else Body(), bias_free=True, dynamic=False, **belief)
    model = scene_of(Observations("wrench", columns, None, bare)).simulated
    noise = np.random.default_rng(5).normal(size=model.shape) * ([0.02] * 3 + [0.001] * 3)
    columns |= dict(zip(WRENCH, (model + noise).T, strict=True))
    found = examined(seen(columns, named=True, **belief))
    assert keys(found) == ["tool_twice"] * (not both)
    for one in found.remarks:
        assert "zeroed" in one.what
        assert found.observations.belief.tool.mass == 0.0


def arm_efforts(borne: bool) -> Observations:
    """An arm of the conformance tests with a tool of 0.4 kg, of which its efforts hold nothing, or all."""
    t = np.arange(2500) / 100.0
    robot = UrdfRobot(URDF, sensor_link="hand")
    tool = Body(0.4, np.array([0.0, 0.01, 0.1]), np.diag([1e-3, 1e-3, 5e-4]))
    loaded = robot.carrying(tool.mass, tool.com, tool.inertia)
    joints = {f"joint.{n}.position": 0.9 * np.sin((0.5 + 0.21 * k) * t + k) for k, n in enumerate(robot.joint_names)}
    names = [f"joint.{n}.effort" for n in robot.joint_names]
    belief = Belief(robot=loaded if borne else robot, tool=tool, dynamic=True)
    empty = Observations("effort", {"time": t} | joints | dict.fromkeys(names, 0.0 * t), None, belief)
    noise = np.random.default_rng(2).normal(size=(len(t), len(names))) * 0.02
    efforts = scene_of(empty).simulated + noise
    columns = dict(empty.columns) | dict(zip(names, efforts.T, strict=True))
    return replace(empty, columns=columns, belief=replace(belief, robot=loaded))


@pytest.mark.parametrize("borne", [True, False])
def test_efforts_that_hold_nothing_of_the_tool_are_compared_without_it(*, borne: bool) -> None:
    found = list(ToolTwice().examine(arm_efforts(borne)))
    assert len(found) == (not borne)
    for one in found:
        assert one.repaired is not None
        scene = scene_of(one.repaired)
        assert np.std(scene.measured - scene.simulated) == pytest.approx(0.02, rel=0.05)


@pytest.mark.parametrize("sign", [0.0, 1.0, -1.0])
def test_a_joint_that_is_counted_against_the_link_before_is_read_so(sign: float) -> None:
    """Poses of an arm; the pendant shows the third joint less, or with, the second one."""
    t = np.arange(2500) / 100.0
    robot = UrdfRobot(URDF, sensor_link="hand")
    joints = {f"joint.{n}.position": 0.8 * np.sin((0.5 + 0.21 * k) * t + k) for k, n in enumerate(robot.joint_names)}
    pose = [f"pose.position.{a}" for a in "xyz"] + [f"pose.orientation.{a}" for a in "xyzw"]
    zeros = dict.fromkeys(pose, 0.0 * t) | {"pose.orientation.w": np.ones(len(t))}
    empty = Observations("pose", {"time": t} | joints | zeros, None, Belief(robot=robot))
    T = robot.sensor_pose(np.stack(list(joints.values()), axis=1))
    place = T[:, :3, 3] + np.random.default_rng(2).normal(size=(len(t), 3)) * 1e-4
    columns = dict(empty.columns) | dict(zip(pose[:3], place.T, strict=True))
    columns |= dict(zip(pose[3:], Rotation.from_matrix(T[:, :3, :3]).as_quat().T, strict=True))
    second, third = (f"joint.{n}.position" for n in robot.joint_names[1:3])
    columns[third] = columns[third] - sign * columns[second]
    found = examined(replace(empty, columns=columns))
    assert keys(found) == ["joint_reading"] * (sign != 0.0)
    assert np.allclose(found.observations.columns[third], joints[third])


URDF = """<robot name="bench"><link name="base"/>{}<link name="hand"/>
<joint name="flange" type="fixed"><parent link="link4"/><child link="hand"/><origin xyz="0 0 0.08"/></joint></robot>""".format(
    "".join(
        f"""<link name="link{k}"><inertial><origin xyz="0 0.02 0.15"/><mass value="{4.5 - k}"/>
<inertia ixx="0.03" iyy="0.03" izz="0.005" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="j{k}" type="revolute"><parent link="{"base" if k == 1 else f"link{k - 1}"}"/><child link="link{k}"/>
<origin xyz="0 0 {0.1 if k == 1 else 0.3}"/><axis xyz="{axis}"/><limit lower="-3" upper="3" effort="200" velocity="5"/></joint>"""
        for k, axis in enumerate(("0 0 1", "0 1 0", "0 1 0", "1 0 0"), start=1)
    )
)
"""An arm of four joints; the hand weighs nothing."""

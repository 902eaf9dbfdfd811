"""Kinematics: the delta both ways, its Jacobian, and the closed form against pinocchio's reading of the URDF."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from galen_hw.errors import UsageError
from galen_hw.kinematics import GalenRobot, LinearDelta, UrdfRobot

URDF = Path(__file__).parent.parent / "config" / "galen.urdf"
inside = st.tuples(*[st.floats(-0.08, 0.08)] * 3).map(np.array)


def poses(n: int = 20) -> tuple[np.ndarray, np.ndarray]:
    """Random joint vectors of both descriptions: carriages for the Galen, platform for the URDF."""
    rng = np.random.default_rng(5)
    platform, turns = rng.uniform(-0.08, 0.08, (n, 3)), rng.uniform(-0.9, 0.9, (n, 2))
    return np.hstack([LinearDelta().carriages(platform), turns]), np.hstack([platform, turns])


@given(inside)
def test_delta_forward_undoes_inverse(platform: np.ndarray) -> None:
    """Platform to carriages and back."""
    delta = LinearDelta()
    assert_allclose(delta.platform(delta.carriages(platform)), platform, atol=1e-12)


def test_delta_is_zero_at_home_and_follows_the_published_formula() -> None:
    """All carriages are 0 at the platform's origin, and one other pose matches the formula written out by hand."""
    delta = LinearDelta()
    assert_allclose(delta.carriages(np.zeros(3)), np.zeros(3), atol=1e-15)
    x, y, z, a = 0.02, -0.03, 0.05, np.deg2rad(210.0)
    flat2 = (x - 0.15 * np.cos(a)) ** 2 + (y - 0.15 * np.sin(a)) ** 2
    expected = z - np.sqrt(0.4**2 - flat2) + np.sqrt(0.4**2 - 0.15**2)
    assert_allclose(delta.carriages([x, y, z])[1], expected, atol=1e-15)


def test_delta_out_of_reach_is_not_a_number() -> None:
    """Where the rods do not meet there is no platform, and no made-up one either."""
    assert np.isnan(LinearDelta().platform([0.6, 0.0, -0.6])).any()
    assert np.isnan(LinearDelta().carriages([0.5, 0.0, 0.0])).any()


@given(inside)
def test_delta_jacobian_is_the_numerical_one(platform: np.ndarray) -> None:
    """Against central differences of the forward kinematics."""
    delta, h = LinearDelta(), 1e-6
    c = delta.carriages(platform)
    numerical = np.stack(
        [(delta.platform(c + h * e) - delta.platform(c - h * e)) / (2 * h) for e in np.eye(3)], axis=-1
    )
    assert_allclose(delta.jacobian(platform), numerical, atol=1e-7)


def test_closed_form_and_urdf_agree_on_pose_and_jacobian() -> None:
    """Two independent descriptions of the nominal Galen: numpy's closed form and pinocchio on the URDF."""
    q, x = poses()
    galen, urdf = GalenRobot(), UrdfRobot(URDF, sensor_link="sensor")
    assert_allclose(galen.sensor_pose(q), urdf.sensor_pose(x), atol=1e-12)
    chain = np.zeros((len(q), 5, 5))
    chain[:, :3, :3] = galen.delta.jacobian(x[:, :3])
    chain[:, 3, 3] = chain[:, 4, 4] = 1.0
    assert_allclose(galen.sensor_jacobian(q), urdf.sensor_jacobian(x) @ chain, atol=1e-12)


def test_closed_form_and_urdf_agree_on_motion() -> None:
    """Acceleration, angular velocity and angular acceleration along one smooth path."""
    t = np.linspace(0.0, 1.0, 4001)
    platform = np.array([0.05, 0.04, 0.06]) * np.sin(2 * t[:, None] + [0.0, 1.0, 2.0])
    turns = 0.5 * np.sin(3 * t[:, None] + [0.0, 1.0])
    galen, urdf = GalenRobot(), UrdfRobot(URDF, sensor_link="sensor")

    def rates(x: np.ndarray) -> list[np.ndarray]:
        dx = np.gradient(x, t, axis=0)
        return [x, dx, np.gradient(dx, t, axis=0)]

    ours = galen.sensor_motion(*rates(np.hstack([galen.delta.carriages(platform), turns])))
    theirs = urdf.sensor_motion(*rates(np.hstack([platform, turns])))
    inner = slice(5, -5)
    for name in ("T", "acceleration", "omega", "alpha"):
        assert_allclose(getattr(ours, name)[inner], getattr(theirs, name)[inner], atol=1e-6)


def test_gravity_in_a_turned_base_link_is_that_of_the_root() -> None:
    """Gravity is given in the base link's frame: a base mounted on a wall bears the same as one on the floor."""
    upright = UrdfRobot(_pendulum("0 0 0"), base_link="base")
    lying = UrdfRobot(_pendulum("1.5707963267948966 0 0"), base_link="base")
    zero = np.zeros((1, 1))
    expected = [[9.80665 * np.sin(0.5)]]
    for robot in (upright, lying):
        assert_allclose(robot.inverse_dynamics(zero, zero, zero), [[0.0]], atol=1e-9)
        assert_allclose(robot.inverse_dynamics([[0.5]], zero, zero), expected, atol=1e-9)


def test_unreadable_urdf_and_unknown_link_are_one_line() -> None:
    """What, where and what to do."""
    with pytest.raises(UsageError, match=r"no link 'gripper'.*one of:.*sensor"):
        UrdfRobot(URDF, sensor_link="gripper")
    with pytest.raises(UsageError, match="no such file"):
        UrdfRobot(Path("no/such/file.urdf"))
    for text in ("<robot", "a table\n" * 1000, "config/galen.urdf"):
        with pytest.raises(UsageError, match=r"^URDF: not a readable URDF"):
            UrdfRobot(text)


def _pendulum(rpy: str) -> str:
    return f"""<robot name="pendulum"><link name="world"/><link name="base"/>
    <joint name="fix" type="fixed"><parent link="world"/><child link="base"/><origin rpy="{rpy}" xyz="0 0 0"/></joint>
    <link name="bob"><inertial><origin xyz="0 0 -1" rpy="0 0 0"/><mass value="1"/>
    <inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial></link>
    <joint name="hinge" type="revolute"><parent link="base"/><child link="bob"/><axis xyz="0 1 0"/>
    <limit lower="-3" upper="3" effort="1" velocity="1"/></joint></robot>"""


def test_a_robot_of_one_joint_has_a_jacobian_of_one_column():
    """A beam of 0.5 m about a level axis: its end moves across it, one metre a second for two radians."""
    urdf = """<robot name="beam"><link name="base"/><link name="arm"/><link name="end"/>
    <joint name="turn" type="revolute"><parent link="base"/><child link="arm"/><axis xyz="0 1 0"/>
    <limit lower="-3" upper="3" velocity="5" effort="9"/></joint>
    <joint name="tip" type="fixed"><parent link="arm"/><child link="end"/><origin xyz="0.5 0 0"/></joint></robot>"""
    J = UrdfRobot(urdf).sensor_jacobian([[0.0], [0.4]])
    assert J.shape == (2, 6, 1)
    assert_allclose(J[0, :, 0], [0.0, 0.0, -0.5, 0.0, 1.0, 0.0], atol=1e-12)


def test_links_of_the_closed_form_stand_where_the_urdf_has_them() -> None:
    """Roll and tilt of both, and the sensor at its offset from the last; its chain is in the order of the joints."""
    robot, q = GalenRobot(), np.random.default_rng(4).uniform(-0.05, 0.05, (5, 5))
    tilt = robot.link_pose(q, "tilt")
    sensor = tilt @ np.array([[1, 0, 0, 0.055], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])
    assert_allclose(sensor, robot.sensor_pose(q), atol=1e-12)
    platform, roll = robot.link_pose(q, "carriage2"), robot.link_pose(q, "roll")
    assert_allclose(platform[:, :3, 3], robot.delta.platform(q[:, :3]), atol=1e-15)
    assert_allclose(np.linalg.inv(platform) @ roll @ [0, 0, 0, 1], np.tile([0, 0, 0.045, 1], (5, 1)), atol=1e-12)
    assert [joints[-1] for joints in robot.chain] == ["carriage3", "roll", "tilt"]


def test_links_of_a_urdf_move_as_their_jacobian_says() -> None:
    """By small steps of every joint; what is beyond the link moves it not."""
    robot = UrdfRobot(URDF, sensor_link="sensor")
    names = [joint for (joint,) in robot.chain]
    q = np.random.default_rng(5).uniform(-0.2, 0.2, (1, len(robot.joint_names)))
    for joint in names:
        J, step = robot.link_jacobian(q, joint)[0], 1e-6
        for k in range(len(robot.joint_names)):
            up, down = (robot.link_pose(q + s * step * np.eye(q.shape[1])[k], joint)[0, :3, 3] for s in (1.0, -1.0))
            assert_allclose(J[:3, k], (up - down) / (2.0 * step), atol=1e-8)
    last = robot.joint_names.index(names[-1])
    assert not robot.link_jacobian(q, names[0])[0][:, last].any()

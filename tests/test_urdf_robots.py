"""URDFs as people have them: grippers and heads beside the arm, bases that move, continuous and mimicking joints."""

from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose

from galen_hw.errors import UsageError
from galen_hw.kinematics import UrdfRobot
from galen_hw.spatial import rotation_about
from tests.urdf_parts import arm_with_gripper, joint, link, robot

Q = np.random.default_rng(3).uniform(-1.0, 1.0, (6, 2))
BODY = np.array([0.4, 0.01, -0.02, 0.05, 0.002, 0.0, 0.002, 0.0, 0.0, 0.001])
PLAIN = UrdfRobot(arm_with_gripper(beside=False), sensor_link="sensor")


@pytest.mark.parametrize("gripper", ["a", "gripper", "zz"])
@pytest.mark.parametrize("head", ["a_head", "z_head"])
def test_what_stands_beside_the_arm_changes_nothing_whatever_its_name(gripper: str, head: str) -> None:
    """Pose, Jacobian, and what a load at the sensor adds to each joint, as without gripper and head."""
    whole = UrdfRobot(arm_with_gripper(gripper, head), sensor_link="sensor")
    assert set(whole.joint_names) == {"shoulder", "elbow", f"{gripper}_l", f"{head}_pan"}
    assert whole.moving() == ("shoulder", "elbow")
    arm = whole.keeping(whole.moving())
    assert arm.joint_names == ("shoulder", "elbow")
    assert_allclose(arm.sensor_pose(Q), PLAIN.sensor_pose(Q), atol=1e-12)
    assert_allclose(arm.sensor_jacobian(Q), PLAIN.sensor_jacobian(Q), atol=1e-12)
    port = arm.load_regressor(Q, 0.3 * Q, 2.0 * Q)
    assert_allclose(port, PLAIN.load_regressor(Q, 0.3 * Q, 2.0 * Q), atol=1e-12)
    loaded = arm.with_load(BODY)
    assert loaded is not None
    more = loaded.inverse_dynamics(Q, 0.3 * Q, 2.0 * Q) - arm.inverse_dynamics(Q, 0.3 * Q, 2.0 * Q)
    assert_allclose(more, port @ BODY, atol=1e-12)
    assert np.abs(more).max() > 0.1


def test_nothing_carries_a_sensor_that_is_fixed_to_the_root() -> None:
    fixed = UrdfRobot(arm_with_gripper(), sensor_link="base")
    assert fixed.moving() == ()
    assert fixed.with_load(BODY) is None
    assert not fixed.load_regressor(*(np.zeros((2, 4)),) * 3).any()


def test_a_link_and_a_joint_may_have_one_name() -> None:
    """`flange` is the name of both in many files."""
    text = robot(link("base"), link("flange", 1.0), joint("flange", "base", "flange"), link("tool"))
    text = text.replace("</robot>", joint("tool", "flange", "tool", kind="fixed") + "</robot>")
    arm = UrdfRobot(text, sensor_link="tool", base_link="base")
    assert_allclose(arm.frame_pose([[0.5]], "flange"), arm.link_pose([[0.5]], "flange"), atol=1e-12)
    assert_allclose(arm.sensor_pose([[0.5]])[0, :3, 3], [0.3 * np.sin(0.5), 0.0, 0.3 + 0.3 * np.cos(0.5)], atol=1e-12)
    assert arm.link_body("flange")[0] == 1.0
    assert UrdfRobot(text, sensor_link="flange").sensor_link == "flange"


def test_a_roots_own_body_is_its_files() -> None:
    mass, com, _ = UrdfRobot(arm_with_gripper()).link_body("base")
    assert mass == 5.0
    assert_allclose(com, [0.0, 0.0, 0.1])


def lifted(kind: str = "revolute") -> str:
    """An arm of one joint on a base that a joint of the trunk moves."""
    return robot(
        link("root"),
        link("base", 1.0),
        joint("trunk", "root", "base", "0 1 0" if kind == "revolute" else "0 0 1", kind=kind, at="0 0 0.5"),
        link("bob", 1.0, com="0 0 0.2"),
        joint("hinge", "base", "bob", at="0 0 0.1"),
        link("sensor"),
        joint("mount", "bob", "sensor", kind="fixed", at="0 0 0.4"),
    )


@pytest.mark.parametrize("kind", ["revolute", "prismatic"])
def test_poses_in_a_base_that_moves_are_poses_in_it(kind: str) -> None:
    """As of the arm alone, wherever the trunk stands; the Jacobian too, with nothing for the trunk."""
    alone = UrdfRobot(lifted(kind), base_link="base", sensor_link="sensor").keeping(["hinge"])
    arm = UrdfRobot(lifted(kind), base_link="base", sensor_link="sensor")
    q = np.array([[0.4, 0.3], [-0.2, 1.0], [0.35, 0.0]])
    assert arm.joint_names == ("trunk", "hinge")
    assert arm.moving() == ("hinge",)
    assert arm.moving_base == ("trunk",)
    assert_allclose(arm.sensor_pose(q), alone.sensor_pose(q[:, 1:]), atol=1e-12)
    J = arm.sensor_jacobian(q)
    assert_allclose(J[:, :, 1:], alone.sensor_jacobian(q[:, 1:]), atol=1e-12)
    assert_allclose(J[:, :, 0], 0.0, atol=1e-12)
    (frame,) = arm.turning_frames(q)
    assert frame[0] == "hinge"
    assert_allclose(frame[1][:, :3, 3], np.tile([0.0, 0.0, 0.1], (3, 1)), atol=1e-12)


def test_gravity_stays_in_the_root_where_the_base_tilts() -> None:
    """Seen from where the base was at zero, and in the efforts: 1 kg at 0.2 m, the angles of trunk and hinge together."""
    arm = UrdfRobot(lifted(), base_link="base", sensor_link="sensor")
    q, zero = np.array([[0.4, 0.3]]), np.zeros((1, 2))
    assert_allclose(arm.inverse_dynamics(q, zero, zero)[0, 1], -9.80665 * 0.2 * np.sin(0.7), atol=1e-9)
    still = arm.standing()
    assert_allclose(still.sensor_pose(q)[0, :3, :3], rotation_about(1, 0.7), atol=1e-12)
    assert_allclose(still.sensor_pose(zero), arm.sensor_pose(zero), atol=1e-12)


def test_a_turned_base_has_axes_of_its_own_for_gravity_and_for_joints() -> None:
    """Gravity that is set and frames of joints are in the base's axes, not in the root's."""
    turned = joint("fix", "world", "base", kind="fixed", at="1 0 0").replace(
        'xyz="1 0 0"/>', f'xyz="1 0 0" rpy="{np.pi / 2} 0 0"/>'
    )
    text = robot(
        link("world"), link("base"), turned, link("bob", 1.0, com="0.2 0 0"), joint("hinge", "base", "bob", "0 0 1")
    )
    arm, zero = UrdfRobot(text, base_link="base", sensor_link="bob"), np.zeros((1, 1))
    assert_allclose(arm.under([0.0, -9.80665, 0.0]).inverse_dynamics(zero, zero, zero), [[9.80665 * 0.2]], atol=1e-9)
    assert_allclose(arm.under([0.0, 0.0, -9.80665]).inverse_dynamics(zero, zero, zero), [[0.0]], atol=1e-9)
    ((_, frame, axis),) = arm.turning_frames(zero)
    assert_allclose(frame[0, :3, 3], [0.0, 0.0, 0.3], atol=1e-12)
    assert_allclose(frame[0, :3, :3] @ axis, [0.0, 0.0, 1.0], atol=1e-12)


@pytest.mark.parametrize("axis", ["0 1 0", "0.6 0 0.8"])
def test_a_continuous_joint_is_an_angle_without_an_end(axis: str) -> None:
    """The same as a revolute one at any angle, with no limits."""
    parts = [link("base"), link("bob", 1.0), link("sensor"), joint("mount", "bob", "sensor", kind="fixed")]
    free, bound = (
        UrdfRobot(robot(*parts, joint("turn", "base", "bob", axis, kind=k)), sensor_link="sensor")
        for k in ("continuous", "revolute")
    )
    q, dq = np.array([[0.3], [7.0], [-40.0]]), np.array([[1.0], [-2.0], [3.0]])
    assert_allclose(free.sensor_pose(q), bound.sensor_pose(q), atol=1e-12)
    assert_allclose(free.sensor_pose(q), free.sensor_pose(q + 2.0 * np.pi), atol=1e-9)
    assert_allclose(free.inverse_dynamics(q, dq, dq), bound.inverse_dynamics(q, dq, dq), atol=1e-12)
    assert free.lower[0] == -np.inf
    assert free.upper[0] == np.inf


def mimicking() -> str:
    """A parallel linkage: the second joint turns back as far as the first turns, and 0.1 rad more; a third follows that."""
    return robot(
        link("base"),
        link("one", 1.0),
        joint("first", "base", "one"),
        link("two", 1.0),
        joint("second", "one", "two", more='<mimic joint="first" multiplier="-2" offset="0.1"/>'),
        link("three", 1.0),
        joint("third", "two", "three", more='<mimic joint="second" multiplier="0.5"/>'),
    )


def test_a_mimicking_joint_is_computed_from_its_source() -> None:
    """Poses, Jacobian and efforts as of the same file without <mimic>, at the joints that it implies."""
    tied = UrdfRobot(mimicking())
    loose = UrdfRobot(mimicking().replace("<mimic", "<safety"))
    assert tied.joint_names == ("first",)
    assert loose.joint_names == ("first", "second", "third")
    q, A = np.array([[0.3], [-0.7]]), np.array([[1.0, -2.0, -1.0]])
    full = q @ A + [0.0, 0.1, 0.05]
    assert_allclose(tied.sensor_pose(q), loose.sensor_pose(full), atol=1e-12)
    assert_allclose(tied.sensor_jacobian(q), loose.sensor_jacobian(full) @ A.T, atol=1e-12)
    dq, ddq = 0.5 * q, 2.0 * q
    efforts = loose.inverse_dynamics(full, dq @ A, ddq @ A) @ A.T
    assert_allclose(tied.inverse_dynamics(q, dq, ddq), efforts, atol=1e-12)
    port = np.einsum("ij,njk->nik", A, loose.load_regressor(full, dq @ A, ddq @ A))
    assert_allclose(tied.load_regressor(q, dq, ddq), port, atol=1e-12)


@pytest.mark.parametrize(
    ("names", "taken"),
    [(("l", "r"), "palm"), (("r", "l"), "palm"), (("l",), "finger_l")],
    ids=["both", "swapped", "one"],
)
def test_without_a_name_the_longest_way_is_taken_and_no_finger_of_two(names: tuple[str, ...], taken: str) -> None:
    parts = [
        link("base"),
        link("palm"),
        joint("wrist", "base", "palm"),
        link("camera"),
        joint("c", "base", "camera", kind="fixed"),
    ]
    for name in names:
        parts += [link(f"finger_{name}"), joint(f"slide_{name}", "palm", f"finger_{name}", kind="prismatic")]
    assert UrdfRobot(robot(*parts)).sensor_link == taken


def test_a_floating_joint_is_refused_only_where_it_moves_the_sensor() -> None:
    text = robot(
        link("world"),
        link("base"),
        joint("float", "world", "base", kind="floating"),
        link("bob"),
        joint("turn", "base", "bob"),
    )
    assert UrdfRobot(text, base_link="base").joint_names == ("turn",)
    with pytest.raises(UsageError, match=r"joint float: floating joints are not read.*base_link"):
        UrdfRobot(text)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (robot(link("a"), link("b")), "not one tree of links"),
        (robot(link("r"), link("a"), link("b"), joint("x", "a", "b"), joint("y", "b", "a")), "form a loop"),
        (robot(link("a"), link("a")), "two links are named 'a'"),
        (robot(link("a"), joint("x", "a", "b")), "no link 'b'"),
        (robot(link("a"), link("b"), joint("x", "a", "b", "0 0 0")), "axis has no length"),
        (robot(link("a"), link("b"), joint("x", "a", "b", kind="ball")), "unknown type 'ball'"),
        (robot(link("a"), link("b"), joint("x", "a", "b", "0 1")), "three numbers"),
        (robot(link("a"), link("b"), joint("x", "a", "b", more='<mimic joint="x"/>')), "mimic each other in a loop"),
        (robot(link("a"), link("b"), joint("x", "a", "b").replace("<limit", "<bounds")), "no <limit>"),
        ("<sdf/>", "its root is <sdf>"),
        ('<!DOCTYPE r [<!ENTITY a "b">]><robot/>', "document type"),
    ],
)
def test_a_file_that_is_no_robot_is_one_line(text: str, said: str) -> None:
    with pytest.raises(UsageError, match=said):
        UrdfRobot(text)


def test_a_file_may_name_its_encoding(tmp_path: Path) -> None:
    text = '<?xml version="1.0" encoding="latin-1"?>' + robot(link("Fuß"), link("b"), joint("x", "Fuß", "b"))
    (tmp_path / "a.urdf").write_text(text, encoding="latin-1")
    for given in (text, tmp_path / "a.urdf"):
        assert UrdfRobot(given).base_link == "Fuß"


def test_a_xacro_file_is_refused_with_what_makes_a_urdf_of_it(tmp_path: Path) -> None:
    """It would run expressions and read other files: never done unasked."""
    head = '<robot xmlns:xacro="http://www.ros.org/wiki/xacro" name="x">'
    text = head + '<xacro:property name="w" value="1"/><link name="a"/></robot>'
    (tmp_path / "arm.urdf.xacro").write_text(text)
    with pytest.raises(UsageError, match="a xacro file, which is no URDF yet; for a recording name it with --robot"):
        UrdfRobot(tmp_path / "arm.urdf.xacro")

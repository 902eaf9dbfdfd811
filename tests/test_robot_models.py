"""Robots as their makers publish them: every URDF of example-robot-data and rtb-data loads and agrees with other readers.

Gravity torques and the Jacobian of the farthest link, at drawn positions, to 1e-9: with pinocchio's own reader, and for arms
with MuJoCo's and, where it is installed (250 MB: pip install drake), with Drake's. The packages are files alone; no network
is asked. What cannot be had so: robot_descriptions fetches each robot with git when it is imported, mujoco-menagerie has MJCF
alone. rtb-data's xacro files: tests/test_xacro.py.
"""

import importlib.util
import site
import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from numpy.testing import assert_allclose

from galen_hw.errors import UsageError
from galen_hw.kinematics import UrdfRobot
from galen_hw.kinematics.urdf import MOVING
from galen_hw.units import STANDARD_GRAVITY

FOLDERS = [Path(p) / "cmeel.prefix/share/example-robot-data/robots" for p in site.getsitepackages()]
FOLDER = next((f for f in FOLDERS if f.is_dir()), None)
RTB = importlib.util.find_spec("rtbdata")
FILES = [] if FOLDER is None else sorted(FOLDER.rglob("*.urdf"))
TOOLBOX = [] if RTB is None or RTB.origin is None else sorted(Path(RTB.origin).parent.rglob("*.urdf"))
"""Industrial arms of the Robotics Toolbox; some bear no masses, or links whose inertia no body has, which MuJoCo refuses."""
MODELS = [*FILES, *TOOLBOX]
ARMS = (
    "panda",
    "ur3_robot",
    "ur5_robot",
    "ur10_robot",
    "xarm7",
    "z1",
    "kinova",
    "so100",
    "so101",
    "talos_left_arm",
    "baxter",
    "kr120r2500pro",
    "kr16_2",
    "kr210l150",
)
"""Files of arms, which MuJoCo reads too."""
REFUSED = {"ur3": "not one tree of links: 0 links", "test": "not a readable URDF"}
"""Files that hold no robot, and what is said of them."""
TOLERANCE = 1e-9

pytestmark = pytest.mark.skipif(not FILES, reason="example-robot-data is not installed: pip install 'galen-hw[dev]'")


def named(path):
    return path.stem


def farthest(robot):
    """The link below the most joints, the first in the file."""
    return max(robot.urdf.links, key=lambda link: len(robot.urdf.carriers(link)))


def loaded(path):
    """The robot with its farthest link as the sensor's, and (n,) positions within its limits."""
    robot = UrdfRobot(path, sensor_link=farthest(UrdfRobot(path)))
    low, high = np.maximum(robot.lower, -3.0), np.minimum(robot.upper, 3.0)
    return robot, np.random.default_rng(0).uniform(low, high)


def followed(robot, name):
    """(source, factor, offset) of a joint: itself, or what it mimics."""
    mimic = robot.urdf.joints[name].mimic
    if mimic is None:
        return name, 1.0, 0.0
    source, factor, offset = followed(robot, mimic.source)
    return source, mimic.multiplier * factor, mimic.multiplier * offset + mimic.offset


def pinocchios(path, robot, q):
    """Gravity torques (n,) and Jacobian (6, n) by pinocchio's own reader, which takes mimicking joints for free ones."""
    model = pin.buildModelFromUrdf(str(path))
    model.gravity.linear = np.array([0.0, 0.0, -STANDARD_GRAVITY])
    data, whole = model.createData(), pin.neutral(model)
    share = np.zeros((model.nv, len(q)))
    for index in range(1, model.njoints):
        joint, (source, factor, offset) = model.joints[index], followed(robot, model.names[index])
        place = robot.joint_names.index(source)
        angle = factor * q[place] + offset
        whole[joint.idx_q : joint.idx_q + joint.nq] = angle if joint.nq == 1 else [np.cos(angle), np.sin(angle)]
        share[joint.idx_v, place] = factor
    frame = model.getFrameId(robot.sensor_link, pin.FrameType.BODY)
    jacobian = pin.computeFrameJacobian(model, data, whole, frame, pin.ReferenceFrame.LOCAL_WORLD_ALIGNED)
    return share.T @ pin.computeGeneralizedGravity(model, data, whole), jacobian @ share


def bare(path):
    """The file's tree without shapes, whose meshes are not needed, and without what other programs read."""
    tree = ET.parse(path).getroot()
    for link in tree.findall("link"):
        for shape in [*link.findall("visual"), *link.findall("collision")]:
            link.remove(shape)
    for other in [*tree.findall("transmission"), *tree.findall("gazebo"), *tree.findall("mujoco")]:
        tree.remove(other)
    return tree


def mujocos(path, robot, q):
    """The same by MuJoCo."""
    import mujoco

    tree = bare(path)
    rules = ET.SubElement(ET.SubElement(tree, "mujoco"), "compiler")
    rules.attrib |= {"fusestatic": "false", "boundmass": "0", "boundinertia": "0", "balanceinertia": "false"}
    model = mujoco.MjModel.from_xml_string(ET.tostring(tree, encoding="unicode"))
    model.opt.gravity[:] = [0.0, 0.0, -STANDARD_GRAVITY]
    data, share = mujoco.MjData(model), np.zeros((model.nv, len(q)))
    for joint in range(model.njnt):
        source, factor, offset = followed(robot, model.joint(joint).name)
        place = robot.joint_names.index(source)
        data.qpos[model.jnt_qposadr[joint]] = factor * q[place] + offset
        share[model.jnt_dofadr[joint], place] = factor
    mujoco.mj_forward(model, data)
    jacobian = np.zeros((6, model.nv))
    body = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, robot.sensor_link)
    mujoco.mj_jacBody(model, data, jacobian[:3], jacobian[3:], body)
    return share.T @ data.qfrc_bias, jacobian @ share


def drakes(path, robot, q):
    """The same by Drake, which takes mimicking joints for free ones too."""
    from pydrake.multibody.parsing import Parser
    from pydrake.multibody.plant import MultibodyPlant
    from pydrake.multibody.tree import JacobianWrtVariable

    plant, tree = MultibodyPlant(0.0), bare(path)
    for joint in tree.findall("joint"):
        # It does not read a <mimic> of a fixed joint, and others are free for it all the same.
        for mimic in joint.findall("mimic"):
            joint.remove(mimic)
    Parser(plant).AddModelsFromString(ET.tostring(tree, encoding="unicode"), "urdf")
    plant.mutable_gravity_field().set_gravity_vector([0.0, 0.0, -STANDARD_GRAVITY])
    if robot.urdf.root != "world":  # such a link is Drake's own world
        plant.WeldFrames(plant.world_frame(), plant.GetFrameByName(robot.urdf.root))
    plant.Finalize()
    context, share = plant.CreateDefaultContext(), np.zeros((plant.num_velocities(), len(q)))
    for name, joint in robot.urdf.joints.items():
        if joint.kind not in MOVING:
            continue
        moved, (source, factor, offset) = plant.GetJointByName(name), followed(robot, name)
        place = robot.joint_names.index(source)
        plant.SetPositions(
            context, _set(plant.GetPositions(context), moved.position_start(), factor * q[place] + offset)
        )
        share[moved.velocity_start(), place] = factor
    frame, world = plant.GetFrameByName(robot.sensor_link), plant.world_frame()
    turning, moving = np.split(
        plant.CalcJacobianSpatialVelocity(context, JacobianWrtVariable.kV, frame, np.zeros(3), world, world), 2
    )
    return share.T @ -plant.CalcGravityGeneralizedForces(context), np.vstack([moving, turning]) @ share


def _set(values, place, value):
    values = values.copy()
    values[place] = value
    return values


@pytest.mark.parametrize("path", [p for p in MODELS if p.stem not in REFUSED], ids=named)
def test_every_model_agrees_with_pinocchio(path):
    """Humanoids, hands and legs as well as arms."""
    robot, q = loaded(path)
    torque, jacobian = pinocchios(path, robot, q)
    assert_allclose(robot.inverse_dynamics(q[None], 0.0 * q[None], 0.0 * q[None])[0], torque, atol=TOLERANCE)
    assert_allclose(robot.sensor_jacobian(q)[0], jacobian, atol=TOLERANCE)


@pytest.mark.skipif(importlib.util.find_spec("mujoco") is None, reason="mujoco is not installed")
@pytest.mark.parametrize("path", [p for p in MODELS if p.stem in ARMS], ids=named)
def test_arms_agree_with_mujoco(path):
    """A reader and a dynamics of its own: gravity and Jacobian, grippers that mimic included."""
    robot, q = loaded(path)
    torque, jacobian = mujocos(path, robot, q)
    assert_allclose(robot.inverse_dynamics(q[None], 0.0 * q[None], 0.0 * q[None])[0], torque, atol=TOLERANCE)
    assert_allclose(robot.sensor_jacobian(q)[0], jacobian, atol=TOLERANCE)


@pytest.mark.skipif(importlib.util.find_spec("pydrake") is None, reason="Drake is not installed: pip install drake")
@pytest.mark.filterwarnings("default")  # its own
@pytest.mark.parametrize("path", [p for p in MODELS if p.stem in ARMS], ids=named)
def test_arms_agree_with_drake(path):
    """A third reader."""
    robot, q = loaded(path)
    torque, jacobian = drakes(path, robot, q)
    assert_allclose(robot.inverse_dynamics(q[None], 0.0 * q[None], 0.0 * q[None])[0], torque, atol=TOLERANCE)
    assert_allclose(robot.sensor_jacobian(q)[0], jacobian, atol=TOLERANCE)


def test_the_table_is_long():
    """The pinned package has sixty and more; fewer were found if its layout has changed."""
    assert len(FILES) >= 60
    assert {p.stem for p in MODELS} >= set(ARMS) - (set() if TOOLBOX else {"kr120r2500pro", "kr16_2", "kr210l150"})


@pytest.mark.skipif(not TOOLBOX, reason="rtb-data is not installed: pip install 'galen-hw[dev]'")
def test_the_toolboxs_arms_are_there():
    """ABB, KUKA, Lynxmotion and the Puma 560."""
    assert {p.stem for p in TOOLBOX} >= {"irb140", "kr16_2", "lbr_iiwa_14_r820", "al5d_robot", "puma560_robot"}


@pytest.mark.parametrize("path", [p for p in MODELS if p.stem in REFUSED], ids=named)
def test_what_holds_no_robot_is_refused_and_why(path):
    """One line: the generated file is empty; a file of another kind."""
    with pytest.raises(UsageError, match=REFUSED[path.stem]):
        UrdfRobot(path)

"""Recordings with joints that slide, joints that nobody measured, several segments, and clocks that run backwards."""

from dataclasses import replace

import numpy as np

from galen_hw.kinematics import UrdfRobot
from galen_hw.physics.effects.compliance import Compliance, Hardening
from galen_hw.physics.effects.creep import Creep
from galen_hw.physics.effects.friction import Friction
from galen_hw.physics.effects.geometry import JointOffset
from galen_hw.physics.effects.registry import scene_of
from galen_hw.physics.observations import Belief, Observations
from galen_hw.premises import examined
from tests.urdf_parts import joint, link, robot

RAIL = robot(
    link("base"),
    link("arm", 2.0),
    joint("turn", "base", "arm", "0 0 1"),
    link("slide", 1.0),
    joint("rail", "arm", "slide", "0 0 1", kind="prismatic"),
)
T = np.arange(1000) / 50.0


def rail(read: tuple[str, ...] = ("turn", "rail"), factor: float = 1.0) -> Observations:
    """A turning and a sliding joint and their commands; of these only some are read."""
    columns = {"time": T}
    for name, size, w in (("turn", 0.9, 0.7), ("rail", 0.04, 0.9)):
        if name in read:
            q = size * np.sin(w * T)
            columns |= {f"joint.{name}.command": factor * q, f"joint.{name}.position": factor * q}
    return Observations("position", columns, None, Belief(robot=UrdfRobot(RAIL).keeping(read)))


def test_parameters_of_a_joint_that_slides_are_in_metres():
    """Whatever it is called, and whichever joints are read."""
    scene = scene_of(rail(("rail",)))
    units = [effect.parameters(scene)[0].unit for effect in (JointOffset("rail"), Friction("rail", "viscous", 0.01))]
    assert units == ["m", "s"]
    pose = scene_of(replace(rail(), predict="pose"))
    found = [Compliance("joint", "rail"), Hardening("rail", 2, 1.0), Creep(1.0, joint="rail")]
    assert [effect.parameters(pose)[0].unit for effect in found] == ["m/N"] * 3
    found = [Compliance("joint", "turn"), Hardening("turn", 2, 1.0), Creep(1.0, joint="turn")]
    assert [effect.parameters(pose)[0].unit for effect in found] == ["rad/(N m)"] * 3


def test_metres_are_no_angles_where_the_first_joints_are_not_read():
    """A rail in millimetres is beyond its limits by a factor of millimetres, not of degrees."""
    found = examined(rail(("rail",), factor=1e3))
    assert [remark.premise for remark in found.remarks] == ["position_units"]
    assert "is it in mm" in found.remarks[0].what

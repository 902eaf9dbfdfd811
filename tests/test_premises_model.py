"""Models that no machine can be: each finding with its words, and none for a model that is right."""

import re

import numpy as np
import pytest

from galen_hw.kinematics import UrdfRobot
from galen_hw.premises.model import base_problems, missing_joints, model_problems
from tests.urdf_parts import arm_with_gripper, joint, link, robot


def arm(first: str, second: str = link("lower", 1.0), more: str = "") -> UrdfRobot:
    """Two links of 0.3 m, the first as given, and a sensor."""
    parts = [
        link("base"),
        first,
        joint("shoulder", "base", "upper", more=more),
        second,
        joint("elbow", "upper", "lower"),
    ]
    return UrdfRobot(
        robot(*parts, link("sensor"), joint("mount", "lower", "sensor", kind="fixed")), sensor_link="sensor"
    )


GOOD = link("upper", 2.0)
NOT_READ = link("upper", 2.0).replace("<mass", "<weight")


@pytest.mark.parametrize(
    ("machine", "severity", "said"),
    [
        (arm(link("upper"), link("lower")), "refuse", "no mass: none of the 3 links that move weighs anything"),
        (arm(link("upper", 2000.0), link("lower", 1e4)), "refuse", "more than a block of steel"),
        (arm(link("upper", 2e-3), link("lower", 1e-3)), "refuse", "beyond the arm's reach"),
        (arm(link("upper", 2e-3, inertia=(1e-5,) * 3), link("lower", 1e-3, inertia=(1e-5,) * 3)), "note", "hydrogen"),
        (arm(link("upper", 2.0, inertia=(1e4, 1e4, 1e4))), "refuse", "link upper: an inertia of 1e+04 kg m^2 at 2 kg"),
        (
            arm(link("upper", 2.0, inertia=(1e-6, 1e-6, 1e-6))),
            "note",
            "the inertia of upper is less than that of any material",
        ),
        (
            arm(link("upper", 2.0, inertia=(0.1, 0.01, 0.01))),
            "note",
            "moments of inertia that no body has.*upper (0.01, 0.01, 0.1)",
        ),
        (arm(link("upper", 2.0, inertia=(0.1, 0.1, -0.01))), "refuse", "link upper: a moment of inertia below zero"),
        (arm(link("upper", -2.0)), "refuse", "link upper: a mass of -2 kg"),
        (arm(link("upper", "2,0")), "refuse", "link upper: its <inertial> is not read: <mass> value is '2,0'"),
        (arm(NOT_READ), "refuse", "link upper: its <inertial> is not read: it has no <mass>"),
        (arm(link("upper")), "note", "no <inertial> of upper, nor of what is fixed to it"),
        (
            arm(GOOD, more='<dynamics friction="1.5" damping="0.2"/>'),
            "note",
            "no part of the simulation: shoulder (1.5 N m",
        ),
    ],
)
def test_each_finding_is_said(machine: UrdfRobot, severity: str, said: str) -> None:
    found = model_problems(machine, sensor_named=True)
    pattern = ".*".join(map(re.escape, said.split(".*")))
    assert {p.severity for p in found if re.search(pattern, str(p))} == {severity}, [str(p) for p in found]
    assert all(p.what and p.where and p.todo for p in found)


def test_a_model_that_is_right_is_left_in_peace() -> None:
    assert model_problems(arm(GOOD), sensor_named=True) == []
    assert model_problems(UrdfRobot(arm_with_gripper(), sensor_link="sensor"), sensor_named=True) == []
    # The digits of a plate, whose moments sum exactly, and a frame that weighs nothing to speak of.
    plate = link("upper", 2.0, inertia=(0.0100, 0.0233, 0.0334))
    assert model_problems(arm(plate), sensor_named=True) == []
    dust = link("lower", 1e-6, inertia=(1e-18, 1e-20, -1e-20))
    assert model_problems(arm(GOOD, dust), sensor_named=True) == []


def test_masses_are_left_out_where_nothing_is_weighed() -> None:
    assert model_problems(arm(link("upper"), link("lower")), sensor_named=True, masses=False) == []


def test_what_is_not_read_is_not_judged() -> None:
    """The head's body is nobody's business where only the arm is read."""
    whole = UrdfRobot(arm_with_gripper().replace('<mass value="0.8"/>', '<mass value="-0.8"/>'), sensor_link="sensor")
    assert [p.where.rpartition(" ")[2] for p in model_problems(whole, sensor_named=True)] == ["head"]
    assert model_problems(whole.keeping(whole.moving()), sensor_named=True) == []


def test_a_sensor_that_nobody_named() -> None:
    """Refused where several links could be meant and their axes count; said where one is taken."""
    several = UrdfRobot(arm_with_gripper())
    (refused,) = model_problems(several, sensor_named=False, masses=False)
    assert refused.severity == "refuse"
    assert "ends in 3 links" in refused.what
    (noted,) = model_problems(several, sensor_named=False, frames=False, masses=False)
    assert noted.severity == "note"
    assert "taken to be link gripper_palm" in noted.what
    (single,) = model_problems(UrdfRobot(arm_with_gripper(beside=False)), sensor_named=False, masses=False)
    assert single.severity == "note"
    assert "taken to be link sensor" in single.what


def test_joints_that_nobody_reads() -> None:
    (found,) = missing_joints(("shoulder", "elbow"), ("roll", "elbow"), "robot arm")
    assert str(found) == "robot arm: no motor has the joint shoulder; name them alike: there are some for roll, elbow"
    assert missing_joints(("elbow",), ("roll", "elbow"), "robot arm") == []
    base = UrdfRobot(arm_with_gripper(), base_link="upper", sensor_link="sensor")
    (moved,) = base_problems(base, ["elbow"])
    assert "base_link upper is moved by shoulder, taken to stand at zero" in moved.what
    assert base_problems(base, ["elbow", "shoulder"]) == []
    assert np.isfinite(base.sensor_pose(np.zeros((1, 4)))).all()

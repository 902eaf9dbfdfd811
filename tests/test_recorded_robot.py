"""Which joints of a URDF a recording must hold, and what is said of its model: by `diagnose` and `calibrate --from` alike."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from numpy.testing import assert_allclose

from galen_hw.errors import UsageError
from galen_hw.kinematics import UrdfRobot
from galen_hw.physics.effects.registry import scene_of
from galen_hw.physics.scenes.base import Scene
from galen_hw.recording import Recording, read_recording
from galen_hw.recording.observations import observations_of
from galen_hw.recording.robot import model_notes, robot_of
from galen_hw.tools.calibration.poses import poses_of
from tests.urdf_parts import arm_with_gripper, joint, link, robot

T = np.arange(0.0, 4.0, 0.02)
ARM = {"joint.shoulder.position": 0.7 * np.sin(1.3 * T), "joint.elbow.position": 0.5 * np.cos(2.1 * T)}
Q = np.stack(list(ARM.values()), axis=1)
WRENCH = [f"wrench.{kind}.{axis}" for kind in ("force", "torque") for axis in "xyz"]


def written(folder: Path, urdf: str, columns: dict[str, Any], **info: Any) -> Recording:
    """A recording of a robot, read back."""
    folder.mkdir(parents=True, exist_ok=True)
    pd.DataFrame({"time": T} | columns).to_csv(folder / "recording.csv", index=False)
    (folder / "arm.urdf").write_text(urdf)
    plain = {"schema": 1, "robot": "arm.urdf", "base_link": "base", "sensor_link": "sensor"}
    (folder / "recording.json").write_text(json.dumps({k: v for k, v in (plain | info).items() if v is not None}))
    return read_recording(folder)


def efforts(names: tuple[str, ...], urdf: str) -> dict[str, Any]:
    """Columns of efforts, of the arm alone."""
    arm = UrdfRobot(urdf, sensor_link="sensor").keeping(["shoulder", "elbow"])
    dq, ddq = (np.gradient(Q, T, axis=0, edge_order=2) for _ in range(2))
    tau = arm.inverse_dynamics(Q, dq, ddq)
    return {f"joint.{name}.effort": tau[:, i] for i, name in enumerate(names)}


def scene(recording: Recording) -> Scene:
    return scene_of(observations_of(recording))


@pytest.mark.parametrize("gripper", ["a", "zz"])
@pytest.mark.parametrize("predict", ["wrench", "effort", "targets"])
def test_only_the_arms_joints_are_asked_for(tmp_path: Path, predict: str, gripper: str) -> None:
    """Gripper and head were not recorded: the arm is simulated, with what the gripper weighs at zero, and that is said."""
    urdf = arm_with_gripper(gripper, f"{gripper}_head")
    extra: dict[str, Any] = dict.fromkeys(WRENCH, 0.0 * T)
    if predict == "effort":
        extra = efforts(("shoulder", "elbow"), urdf)
    if predict == "targets":
        extra = {f"target.{axis}": 0.0 * T for axis in "xyz"}
    recording = written(tmp_path, urdf, ARM | extra, predict=predict)
    arm = robot_of(recording, predict)
    assert isinstance(arm, UrdfRobot)
    assert arm.joint_names == ("shoulder", "elbow")
    assert_allclose(arm.sensor_pose(Q), UrdfRobot(arm_with_gripper(beside=False), sensor_link="sensor").sensor_pose(Q))
    notes = model_notes(recording, arm, predict)
    assert len(notes) == (predict == "effort"), notes
    if predict == "effort":
        assert f"no position of {gripper}_l: what hangs there is taken to stand at zero" in notes[0]


@pytest.mark.parametrize(("gripper", "head"), [("a", "z_head"), ("zz", "a_head")])
def test_a_load_is_sought_at_the_sensor_whatever_stands_beside(tmp_path: Path, gripper: str, head: str) -> None:
    """The port of a body and the scene with it, of efforts, as of the arm without gripper and head."""
    urdf = arm_with_gripper(gripper, head)
    still = {f"joint.{name}.position": 0.0 * T for name in (f"{gripper}_l", f"{head}_pan")}
    whole = scene(
        written(tmp_path / "whole", urdf, ARM | still | efforts(("shoulder", "elbow"), urdf), predict="effort")
    )
    plain = arm_with_gripper(beside=False)
    alone = scene(written(tmp_path / "alone", plain, ARM | efforts(("shoulder", "elbow"), plain), predict="effort"))
    assert whole.joint_names == tuple(n for n in whole.joint_names if n in ("shoulder", "elbow", f"{gripper}_l"))
    port, other = whole.body_port(), alone.body_port()
    assert port is not None
    assert other is not None
    assert_allclose(port, other, atol=1e-9)
    body = np.array([0.4, 0.0, 0.0, 0.1, *np.zeros(6)])
    loaded = whole.with_body(body)
    assert loaded is not None
    heavy, light = loaded.belief.robot, whole.belief.robot
    assert isinstance(heavy, UrdfRobot)
    assert isinstance(light, UrdfRobot)
    more = heavy.inverse_dynamics(whole.q, *whole.rates) - light.inverse_dynamics(whole.q, *whole.rates)
    assert_allclose(more[:, [whole.joint_index(n) for n in ("shoulder", "elbow")]], port @ body, atol=1e-9)


def test_a_joint_on_the_way_is_asked_for_by_name(tmp_path: Path) -> None:
    from galen_hw.diagnosis.preprocessing.checks import screened

    columns = {"joint.shoulder.position": Q[:, 0]} | dict.fromkeys(WRENCH, 0.0 * T)
    made = scene(written(tmp_path, arm_with_gripper(), columns, predict="wrench"))
    with pytest.raises(UsageError, match=r"1 of the robot's joints have no position, first elbow"):
        screened(made)


def test_a_finger_of_the_sensors_own_bodies_is_asked_for(tmp_path: Path) -> None:
    columns = ARM | dict.fromkeys(WRENCH, 0.0 * T)
    named = written(tmp_path, arm_with_gripper(), columns, predict="wrench", distal_bodies=["gripper_finger_r"])
    arm = robot_of(named, "wrench")
    assert arm is not None
    assert arm.joint_names == ("shoulder", "elbow", "gripper_l")


def test_a_base_that_moves_is_where_its_joint_was_recorded(tmp_path: Path) -> None:
    """Positions of a target in the base; for a wrench gravity turns with it, and without a record that is said."""
    urdf = arm_with_gripper(beside=False)
    info: dict[str, Any] = {"base_link": "upper", "predict": "targets"}
    columns = ARM | {f"target.{axis}": 0.0 * T for axis in "xyz"}
    arm = robot_of(written(tmp_path / "targets", urdf, columns, **info), "targets")
    assert arm is not None
    assert arm.joint_names == ("elbow",)
    turning = UrdfRobot(urdf, base_link="upper", sensor_link="sensor")
    assert_allclose(arm.sensor_pose(Q[:, 1:]), turning.sensor_pose(Q), atol=1e-12)

    wrench = dict.fromkeys(WRENCH, 0.0 * T)
    tool = {"name": "t", "mass": 1.0, "com": [0, 0, 0]}
    both = written(
        tmp_path / "both",
        urdf,
        ARM | wrench,
        base_link="upper",
        predict="wrench",
        tool=tool,
        model={"dynamics": "static"},
    )
    made = scene(both)
    angle = Q.sum(axis=1)
    down = 9.80665 * np.stack([np.sin(angle), 0.0 * T, -np.cos(angle)], axis=1)
    assert_allclose(made.simulated[:, :3], down, atol=1e-9)
    assert model_notes(both, made.belief.robot, "wrench") == []
    one = written(
        tmp_path / "one", urdf, {"joint.elbow.position": Q[:, 1]} | wrench, base_link="upper", predict="wrench"
    )
    (note,) = model_notes(one, robot_of(one, "wrench"), "wrench")
    assert "base_link upper is moved by shoulder, taken to stand at zero" in note


def test_efforts_on_a_urdf_without_masses_are_refused_and_a_wrench_is_not(tmp_path: Path) -> None:
    bare = robot(
        *(link(n) for n in ("base", "upper", "lower", "sensor")),
        joint("shoulder", "base", "upper"),
        joint("elbow", "upper", "lower"),
        joint("mount", "lower", "sensor", kind="fixed"),
    )
    effort = {"joint.shoulder.effort": T, "joint.elbow.effort": T}
    recording = written(tmp_path, bare, ARM | effort | dict.fromkeys(WRENCH, T), predict="effort")
    with pytest.raises(UsageError, match="no mass: none of the 3 links that move weighs anything"):
        model_notes(recording, robot_of(recording, "effort"), "effort")
    assert model_notes(recording, robot_of(recording, "wrench"), "wrench") == []


def test_a_sensor_that_nobody_named_is_refused_for_a_calibration(tmp_path: Path) -> None:
    recording = written(tmp_path, arm_with_gripper(), ARM | dict.fromkeys(WRENCH, 0.0 * T), sensor_link=None)
    with pytest.raises(
        UsageError, match=r"no sensor_link is named, and the model ends in 3 links; name the sensor's link"
    ):
        poses_of(recording)


def test_zeroing_joints_may_leave_out_what_does_not_move_the_sensor(tmp_path: Path) -> None:
    """By name the arm's are enough; a list holds the arm's joints or all."""
    columns = ARM | {"joint.gripper_l.position": 0.0 * T} | dict.fromkeys(WRENCH, 0.0 * T)
    expected = UrdfRobot(arm_with_gripper(beside=False), sensor_link="sensor").sensor_pose([[0.3, -0.2]])[0, :3, :3]
    body = {"mass": 0.2, "com": [0.0, 0.0, 0.1]}
    order = UrdfRobot(arm_with_gripper()).joint_names
    named = {"shoulder": 0.3, "elbow": -0.2}
    for zeroed in (named, [0.3, -0.2], {n: named.get(n, 0.0) for n in order}):
        info = {"predict": "wrench", "bias_body": body, "zeroed_at": zeroed}
        made = scene(written(tmp_path, arm_with_gripper(), columns, **info))
        assert made.belief.zeroed_rotation is not None
        assert_allclose(made.belief.zeroed_rotation, expected, atol=1e-12)
    with pytest.raises(UsageError, match="no value for joint 'elbow'"):
        scene(
            written(
                tmp_path, arm_with_gripper(), columns, predict="wrench", bias_body=body, zeroed_at={"shoulder": 0.3}
            )
        )

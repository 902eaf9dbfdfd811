"""What the simulation believes, as `recording.json` says it: links on the sensor, the tool on the arm, the tip's link."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from galen_hw.errors import UsageError
from galen_hw.kinematics import UrdfRobot
from galen_hw.physics.effects.registry import scene_of
from galen_hw.physics.scenes.base import Scene
from galen_hw.recording import read_recording
from galen_hw.recording.observations import observations_of

G = 9.80665
ARM = """<robot name="arm"><link name="base"/>
<link name="upper"><inertial><origin xyz="0.1 0 0"/><mass value="2"/>
<inertia ixx="0.01" iyy="0.02" izz="0.02" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="shoulder" type="revolute"><parent link="base"/><child link="upper"/><axis xyz="0 1 0"/>
<limit lower="-3" upper="3" velocity="2" effort="100"/></joint>
<link name="sensor"/>
<joint name="flange" type="fixed"><parent link="upper"/><child link="sensor"/>
<origin xyz="0.3 0 0" rpy="0 1.5707963267948966 0"/></joint>
<link name="palm"><inertial><origin xyz="0 0.02 0.05" rpy="0 0 1.5707963267948966"/><mass value="0.7"/>
<inertia ixx="0.001" iyy="0.002" izz="0.003" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="palm_mount" type="fixed"><parent link="sensor"/><child link="palm"/><origin xyz="0 0 0.01"/></joint>
<link name="tip"/>
<joint name="tip_mount" type="fixed"><parent link="palm"/><child link="tip"/>
<origin xyz="0 0 0.1" rpy="1.5707963267948966 0 0"/></joint>
<link name="finger"><inertial><origin xyz="0 0 0.02"/><mass value="0.05"/>
<inertia ixx="1e-5" iyy="1e-5" izz="1e-5" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="grip" type="prismatic"><parent link="palm"/><child link="finger"/><axis xyz="1 0 0"/><origin xyz="0 0 0.08"/>
<limit lower="0" upper="0.04" velocity="1" effort="10"/></joint></robot>"""
T = np.arange(0.0, 4.0, 0.01)
SHOULDER = 0.7 * np.sin(1.3 * T)
PALM: dict[str, Any] = {"mass": 0.7, "com": [0.0, 0.02, 0.06], "inertia": [[0.002, 0, 0], [0, 0.001, 0], [0, 0, 0.003]]}
"""The same body as the link `palm`, written down in the sensor's axes."""


def scene(folder: Path, predict: str, grip: Any = 0.0, **info: Any) -> Scene:
    """Of a recording written to a folder, nothing compared but zeros."""
    columns: dict[str, object] = {"time": T, "joint.shoulder.position": SHOULDER, "joint.grip.position": grip + 0.0 * T}
    groups = {
        "wrench": [f"wrench.{kind}.{axis}" for kind in ("force", "torque") for axis in "xyz"],
        "effort": ["joint.shoulder.effort"],
        "pose": [f"pose.position.{axis}" for axis in "xyz"] + [f"pose.orientation.{axis}" for axis in "xyzw"],
    }
    columns |= {name: np.zeros(len(T)) for name in groups[predict]}
    if predict == "pose":
        columns["pose.orientation.w"] = np.ones(len(T))
    folder.mkdir(exist_ok=True)
    pd.DataFrame(columns).to_csv(folder / "recording.csv", index=False)
    (folder / "arm.urdf").write_text(ARM)
    plain = {"schema": 1, "robot": "arm.urdf", "base_link": "base", "sensor_link": "sensor", "predict": predict}
    (folder / "recording.json").write_text(json.dumps(plain | info))
    return scene_of(observations_of(read_recording(folder)))


def test_the_body_of_a_link_is_the_files_whether_it_is_fixed_or_moved() -> None:
    robot = UrdfRobot(ARM, sensor_link="sensor")
    mass, com, inertia = robot.link_body("palm")
    assert mass == pytest.approx(0.7)
    np.testing.assert_allclose(com, [0.0, 0.02, 0.05], atol=1e-12)
    np.testing.assert_allclose(inertia, np.diag([0.002, 0.001, 0.003]), atol=1e-12)
    # Pinocchio has put the palm, which is fixed to it, into the upper link.
    mass, com, inertia = robot.link_body("upper")
    assert mass == pytest.approx(2.0)
    np.testing.assert_allclose(com, [0.1, 0.0, 0.0], atol=1e-12)
    np.testing.assert_allclose(inertia, np.diag([0.01, 0.02, 0.02]), atol=1e-9)
    assert robot.link_body("sensor")[0] == 0.0


def test_links_on_the_sensor_weigh_there_beside_the_tool(tmp_path: Path) -> None:
    made = scene(tmp_path, "wrench", model={"dynamics": "static"}, distal_bodies=["palm"])
    # The sensor's z points along the arm, its x down in the arm's zero.
    down = np.stack([np.cos(SHOULDER), 0.0 * T, np.sin(SHOULDER)], axis=1) * 0.7 * G
    np.testing.assert_allclose(made.simulated[:, :3], down, atol=1e-9)
    np.testing.assert_allclose(made.simulated[:, 3:], np.cross(PALM["com"], down), atol=1e-9)


def test_a_link_reads_like_a_tool_of_the_same_mass_and_inertia(tmp_path: Path) -> None:
    link = scene(
        tmp_path / "link", "wrench", distal_bodies=["palm"], tool={"name": "t", "mass": 0.1, "com": [0, 0, 0.2]}
    )
    tool = scene(tmp_path / "tool", "wrench", tool={"name": "t"} | PALM)
    light = scene(tmp_path / "light", "wrench", tool={"name": "t", "mass": 0.1, "com": [0, 0, 0.2]})
    np.testing.assert_allclose(link.simulated, tool.simulated + light.simulated, atol=1e-9)
    assert np.ptp(link.simulated, axis=0).max() > 1.0
    port, heavy, other = (one.gravity_port() for one in (link, tool, light))
    assert port is not None
    assert heavy is not None
    assert other is not None
    np.testing.assert_allclose(port, heavy + other, atol=1e-9)


@pytest.mark.parametrize(
    ("links", "grip", "what"),
    [(["finger"], 0.02 * np.sin(T), "moves against the sensor"), (["thumb"], 0.0, "no link 'thumb'")],
)
def test_a_link_that_cannot_be_weighed_is_said(tmp_path: Path, links: list[str], grip: Any, what: str) -> None:
    with pytest.raises(UsageError, match=what):
        scene(tmp_path, "wrench", grip, distal_bodies=links)


def test_links_without_a_urdf_are_said(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="no URDF"):
        scene(tmp_path, "wrench", robot=None, distal_bodies=["palm"])


def test_a_finger_that_stands_still_is_weighed_where_it_stands(tmp_path: Path) -> None:
    made = scene(tmp_path, "wrench", 0.03, model={"dynamics": "static"}, distal_bodies=["finger"])
    down = np.stack([np.cos(SHOULDER), 0.0 * T, np.sin(SHOULDER)], axis=1) * 0.05 * G
    np.testing.assert_allclose(made.simulated[:, 3:], np.cross([0.03, 0.0, 0.11], down), atol=1e-9)


def test_motors_bear_the_tool_at_the_sensor(tmp_path: Path) -> None:
    info = {"model": {"dynamics": "static"}}
    bare = scene(tmp_path / "bare", "effort", **info)
    with_tool = scene(tmp_path / "tool", "effort", tool={"name": "t", "mass": 0.4, "com": [0.05, 0.0, 0.1]}, **info)
    # Along the arm 0.3 + 0.1, across it (down in the arm's zero) 0.05.
    lever = 0.4 * np.cos(SHOULDER) - 0.05 * np.sin(SHOULDER)
    np.testing.assert_allclose((with_tool.simulated - bare.simulated)[:, 0], -0.4 * G * lever, atol=1e-9)


def test_the_pose_is_that_of_the_tips_link(tmp_path: Path) -> None:
    made = scene(tmp_path, "pose", tip_link="tip")
    reach = 0.3 + 0.01 + 0.1
    place = np.stack([reach * np.cos(SHOULDER), 0.0 * T, -reach * np.sin(SHOULDER)], axis=1)
    np.testing.assert_allclose(made.simulated[:, :3], place, atol=1e-9)
    # No turn as measured against Ry(shoulder) Ry(pi/2) Rx(pi/2): at rest a turn of 120 degrees.
    turn = np.linalg.norm(made.measured[np.argmin(np.abs(SHOULDER)), 3:])
    assert np.degrees(turn) == pytest.approx(120.0, abs=0.1)
    named = scene(tmp_path, "pose", tip_link="tip", tool={"name": "t", "tip": [0.0, 0.0, 0.2]})
    assert named.simulated[0, 0] == pytest.approx(0.5)

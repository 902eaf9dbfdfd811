"""Recordings as files of other programs: what goes out comes back in."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from galen_hw.cli import main
from galen_hw.formats import read
from galen_hw.recording import Recording, RecordingInfo, write_table
from galen_hw.recording.recording import POSE
from tests.import_files import arm, motion, table, turns


def recording() -> Recording:
    """Wrench, how the sensor stood, a tracked pose, joints, a target, a temperature, some cells empty."""
    columns = {name: values.copy() for name, values in table().items()}
    columns |= dict(zip(POSE, np.c_[0.1 * turns()[:, :3], turns()].T, strict=True))
    _, q, dq, _ = motion()
    for i in range(2):
        columns |= {f"joint.arm_joint{i + 1}.position": q[:, i], f"joint.arm_joint{i + 1}.velocity": dq[:, i]}
    columns |= {f"target.1.position.{a}": q[:, k] for k, a in enumerate("xyz")}
    columns["temperature.room"] = 20.0 + 0.01 * np.arange(len(q))
    columns["wrench.force.x"][7] = np.nan
    return Recording(
        columns, RecordingInfo(robot="arm.urdf", predict="wrench"), attachments={"arm.urdf": arm()}, epoch=1.7e9
    )


EXPORTED = pytest.mark.parametrize(("kind", "name"), [("mat", "run.mat"), ("rosbag2", "bag"), ("foxglove", "run.mcap")])


@EXPORTED
@pytest.mark.parametrize("robot", ["galen", "arm.urdf"])
def test_what_a_recording_belongs_to_goes_along(kind: str, name: str, robot: str, tmp_path: Path) -> None:
    """Robot, tool, bias body, gravity, what is compared: a Galen's recording had come back without any of them."""
    body = {"mass": 0.085, "com": [0.002, -0.001, 0.011]}
    about = {"robot": robot, "predict": "effort", "virtual": True, "gravity": [0.0, 0.1, -9.8], "bias_body": body}
    about |= {"tool": {"name": "pointer", "mass": 0.152, "com": [0.0, 0.0, -0.04]}, "zeroed_at": [0.0, 0.0, 0.0, 1.0]}
    written = replace(recording(), info=RecordingInfo.model_validate(about))
    write_table(written, tmp_path / "table")
    assert main(["export", str(tmp_path / "table"), str(tmp_path / "out" / name), "--format", kind]) == 2
    (tmp_path / "out").mkdir()
    assert main(["export", str(tmp_path / "table"), str(tmp_path / "out" / name), "--format", kind]) == 0
    back = read(tmp_path / "out" / name)
    assert back.info == written.info
    assert back.urdf_text == written.urdf_text
    assert not any("not taken" in line for line in back.warnings)


@EXPORTED
def test_what_goes_out_comes_back(kind: str, name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Every column that the format has a place for, every digit; what it has none for is said."""
    written = recording()
    write_table(written, tmp_path / "table")
    out = tmp_path / name
    assert main(["export", str(tmp_path / "table"), str(out), "--format", kind]) == 0
    said = capsys.readouterr().out
    back = read(out)
    assert set(back.columns) - {"covariate.joint_age"} <= set(written.columns), (
        "an effort that nobody measured is no zero"
    )
    assert not any("is left out" in line for line in back.warnings)
    for column, values in written.columns.items():
        if column not in back.columns:
            assert kind == "rosbag2"
            assert column in said
            continue
        found = back.columns[column]
        kept = values
        if len(found) < len(values):  # a wrench of which a part is missing is no message
            kept = values[np.isfinite(written.columns["wrench.force.x"])]
        if column == "time":
            np.testing.assert_allclose(found - found[0], kept - kept[0], atol=1e-9)
            continue
        same = np.isclose(found, kept, rtol=0.0, atol=1e-9, equal_nan=True)
        assert same.mean() > 0.97, column
        assert np.isfinite(found).sum() >= np.isfinite(kept).sum() - 1


def test_a_bag_of_ours_is_one_of_ros(tmp_path: Path) -> None:
    """rosbags reads it, with the types, frames and stamps that ROS expects, and the robot's description."""
    from rosbags.highlevel import AnyReader

    write_table(recording(), tmp_path / "table")
    assert main(["export", str(tmp_path / "table"), str(tmp_path / "bag"), "--format", "rosbag2"]) == 0
    with AnyReader([tmp_path / "bag"]) as bag:
        kinds = {c.topic: c.msgtype.rpartition("/")[2] for c in bag.connections}
        assert kinds == {
            "/robot_description": "String",
            "/ft/wrench": "WrenchStamped",
            "/sensor/orientation": "QuaternionStamped",
            "/tool/pose": "PoseStamped",
            "/target/1": "PointStamped",
            "/joint_states": "JointState",
        }
        states = [bag.deserialize(raw, c.msgtype) for c, _, raw in bag.messages() if c.topic == "/joint_states"]
    assert list(states[3].name) == ["arm_joint1", "arm_joint2"]
    np.testing.assert_array_equal(states[3].position, motion()[1][3, :2])
    assert len(states[3].effort) == 0
    assert states[3].header.stamp.nanosec == 360_000_000


def test_a_recording_without_a_clock_is_no_bag(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Messages need a time; tables do not. Nothing is left behind."""
    whole = recording()
    write_table(replace(whole, columns={k: v for k, v in whole.columns.items() if k != "time"}), tmp_path / "table")
    for kind in ("rosbag2", "foxglove"):
        assert main(["export", str(tmp_path / "table"), str(tmp_path / "out"), "--format", kind]) == 2
        assert "has no time" in capsys.readouterr().err
    assert sorted(p.name for p in tmp_path.iterdir()) == ["table"]
    assert main(["export", str(tmp_path / "table"), str(tmp_path / "out.mat"), "--format", "mat"]) == 0
    assert main(["export", str(tmp_path / "table"), str(tmp_path / "out.mat"), "--format", "mat"]) == 2


def test_the_galen_is_named_as_a_robot_without_a_file(tmp_path: Path) -> None:
    """Of a file that says nothing of its robot; a map keeps the name."""
    _, q, _, _ = motion()
    names = ("carriage1", "carriage2", "carriage3", "roll", "tilt")
    columns = {"time": table()["time"]} | {f"joint.{n}.position": q[:, 0] for n in names}
    write_table(Recording(columns), tmp_path / "table")
    (tmp_path / "other").mkdir()
    file = (tmp_path / "table" / "recording.csv").rename(tmp_path / "other" / "log.csv")
    words = ["import", str(file), "--robot", "galen"]
    assert main([*words, "-o", str(tmp_path / "run"), "--write-map", str(tmp_path / "map.toml")]) == 0
    assert read(tmp_path / "run").info.robot == "galen"
    assert '"robot" = "galen"' in (tmp_path / "map.toml").read_text()
    assert main(["import", str(file), "--map", str(tmp_path / "map.toml"), "-o", str(tmp_path / "again")]) == 0
    assert read(tmp_path / "again").info.robot == "galen"

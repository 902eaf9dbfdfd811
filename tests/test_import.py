"""Imports: what is lost is said, what is doubtful is refused, streams meet on one clock, and a map can be edited."""

import json
import shutil
import sqlite3
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Bag2
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from galen_hw.cli import main
from galen_hw.errors import UsageError
from galen_hw.formats import import_files, read
from galen_hw.formats.contents import Stream, head_of
from galen_hw.formats.csv_table import layout_of
from galen_hw.formats.names import chosen, matches
from galen_hw.formats.table import FORMATS, format_of
from galen_hw.formats.units import factor, split_unit
from galen_hw.formats.wire_layout import Gatherer
from galen_hw.premises.rotations import scaled
from tests import import_files as made
from tests.test_import_formats import held

STORE = get_typestore(Stores.ROS2_HUMBLE)


# ---------------------------------------------------------------- formats


@pytest.mark.parametrize("name", [*made.WRENCHES, *made.ARMS])
def test_a_format_is_told_by_content(name: str, tmp_path: Path) -> None:
    """Under another name the same format is found."""
    path = (made.WRENCHES | made.ARMS)[name](tmp_path)
    before = format_of(path)[0]
    other = path.with_name("recording_of_monday.dat")
    path.rename(other)
    assert format_of(other)[0] == before


def test_every_format_refuses_noise(tmp_path: Path) -> None:
    """Random bytes, an empty file, a picture, prose: one line that lists what is known."""
    rng = np.random.default_rng(0)
    texts = {
        "noise": rng.bytes(5000),
        "empty": b"",
        "png": b"\x89PNG\r\n\x1a\n" + rng.bytes(100),
        "prose": b"Dear all,\nno.\n",
    }
    for name, data in texts.items():
        (tmp_path / name).write_bytes(data)
        with pytest.raises(UsageError, match=r"not a format that is known|is empty"):
            read(tmp_path / name)
    assert len({one.module for one in FORMATS}) == len(FORMATS)


# ---------------------------------------------------------------- what is lost


@pytest.mark.parametrize("share", [0.35, 0.6, 0.9])
@pytest.mark.parametrize("name", ["ROS 1 bag", "MCAP, ROS 2 (CDR), own messages", "CSV", "candump -L", "MCAP, JSON"])
def test_a_file_that_was_cut_off_gives_what_is_whole_and_says_so(name: str, share: float, tmp_path: Path) -> None:
    """Or one line; never a traceback, never a wrong number."""
    path = made.WRENCHES[name](tmp_path)
    data = path.read_bytes()
    path.write_bytes(data[: int(share * len(data))])
    try:
        found = read(path)
    except UsageError as error:
        assert str(path) in str(error)  # noqa: PT017 - either is right, and each is looked at
        return
    n = len(found)
    assert 0 < n <= made.N
    values = found.columns["wrench.force.x"]
    rows = np.flatnonzero(np.isfinite(values))
    bound = 5e-3 if name.startswith("candump") else 1e-9
    if name != "MCAP, JSON":  # its records are shuffled
        np.testing.assert_allclose(values[rows], made.table()["wrench.force.x"][rows], atol=bound)
    said = " ".join(found.warnings)
    assert n == made.N or "cut off" in said or "not whole" in said or "no whole index" in said or "rows out" in said


@pytest.mark.parametrize(
    "name", ["Parquet", "HDF5", "MATLAB 5 to 7, struct", "MATLAB 7.3, timetable", "CAN log, .mf4", "CAN log, .blf"]
)
def test_a_file_that_needs_its_end_is_one_line(name: str, tmp_path: Path) -> None:
    """Half of it cannot be read at all, or as far as it goes."""
    path = made.WRENCHES[name](tmp_path)
    data = path.read_bytes()
    path.write_bytes(data[: len(data) // 2])
    try:
        assert len(read(path)) <= made.N
    except UsageError as error:
        assert str(error).startswith(str(path)) and "\n" not in str(error)  # noqa: PT017, PT018


def test_a_bag_without_its_metadata_is_read_and_said(tmp_path: Path) -> None:
    """Also one that counts messages which are not there, and one of which the metadata is of another bag."""
    path = made.rosbag2(tmp_path)
    text = (path / "metadata.yaml").read_text()
    (path / "metadata.yaml").unlink()
    held(read(path), "ROS 2 bag")
    (path / "metadata.yaml").write_text(text.replace("bag.db3", "other.db3"))
    found = read(path)
    held(found, "ROS 2 bag")
    assert any("metadata.yaml is of no use" in line for line in found.warnings)
    held(read(path / "bag.db3"), "ROS 2 bag")


def test_a_damaged_database_gives_what_stands_before_the_damage(tmp_path: Path) -> None:
    """A page in the middle overwritten: rows before it, and a line."""
    path = made.rosbag2(tmp_path) / "bag.db3"
    data = bytearray(path.read_bytes())
    data[len(data) // 2 : len(data) // 2 + 4096] = b"\xff" * 4096
    path.write_bytes(data)
    try:
        found = read(path.parent)
    except UsageError as error:
        assert "bag" in str(error)  # noqa: PT017
        return
    assert len(found) <= made.N
    assert any("damaged" in line or "not whole" in line for line in found.warnings)


def test_rows_that_are_not_whole_are_counted_and_named(tmp_path: Path) -> None:
    """Short rows, words among numbers, empty cells: rows in, rows out, dropped and why."""
    path = tmp_path / "a.csv"
    rows = ["time,Fx,Fy,Fz", *(f"{0.1 * i:.1f},{i},2,3" for i in range(10))]
    rows[4] = "0.3,3"
    rows[6] = "0.5,bad,2,"
    path.write_text("\n".join(rows))
    imported = import_files([path])
    assert len(imported.recording) == 9
    assert any("10 in, 9 rows out; 1 dropped: a row that is not whole" in line for line in imported.account)
    assert any("line 5 has not 4 cells" in line for line in imported.notes)
    assert any("Fx: 1 cells that are no numbers" in line for line in imported.notes)
    assert np.isnan(imported.recording.columns["wrench.force.z"]).sum() == 1


def bag(path: Path, messages: list[tuple[str, int, Any]], store: Any = STORE) -> Path:
    """A bag of (topic, log time in ms, message)."""
    with Bag2(path, version=9, storage_plugin=StoragePlugin.MCAP) as out:
        connections: dict[str, Any] = {}
        for topic, ms, message in messages:
            kind = message.__msgtype__
            if topic not in connections:
                connections[topic] = out.add_connection(topic, kind, typestore=store)
            out.write(connections[topic], made.EPOCH_NS + ms * 10**6, store.serialize_cdr(message, kind))
    return path


def header(ms: int | None, frame: str = "") -> Any:
    ns = 0 if ms is None else made.EPOCH_NS + ms * 10**6
    return STORE.types["std_msgs/msg/Header"](
        STORE.types["builtin_interfaces/msg/Time"](ns // 10**9, ns % 10**9), frame
    )


def wrench(ms: int | None, value: float, frame: str = "ft") -> Any:
    vector = STORE.types["geometry_msgs/msg/Vector3"]
    inner = STORE.types["geometry_msgs/msg/Wrench"](vector(value, 1.0, 2.0), vector(3.0, 4.0, 5.0))
    return STORE.types["geometry_msgs/msg/WrenchStamped"](header(ms, frame), inner)


def states(ms: int, names: list[str], positions: list[float]) -> Any:
    return STORE.types["sensor_msgs/msg/JointState"](header(ms), names, np.array(positions), np.array([]), np.array([]))


# ---------------------------------------------------------------- clocks


def test_streams_meet_on_the_wrenchs_clock_by_header_stamps(tmp_path: Path) -> None:
    """The log is late and jittered; joints at 40 Hz are interpolated, and how old they were is kept."""
    rng = np.random.default_rng(0)
    messages = [("/w", i + int(rng.integers(1, 9)), wrench(i, float(i))) for i in range(100)]
    messages += [("/joint_states", 25 * k + 3, states(25 * k, ["b", "a"], [0.1 * k, -0.1 * k])) for k in range(5)]
    found = read(bag(tmp_path / "bag", sorted(messages, key=lambda m: m[1])))
    order = np.argsort(found.columns["wrench.force.x"])
    np.testing.assert_allclose(
        found.columns["time"][order] - found.columns["time"].min(), 1e-3 * np.arange(100), atol=1e-9
    )
    np.testing.assert_allclose(found.columns["joint.b.position"][order], 0.1 * np.arange(100) / 25, atol=1e-12)
    np.testing.assert_allclose(found.columns["covariate.joint_age"][order], 1e-3 * (np.arange(100) % 25), atol=1e-9)
    assert found.epoch == pytest.approx(1.7e9, abs=0.1)


def test_joints_that_change_their_order_stay_themselves(tmp_path: Path) -> None:
    """Two nodes publish on /joint_states, in orders of their own; a joint is its name."""
    messages: list[tuple[str, int, Any]] = [("/w", i, wrench(i, 0.0)) for i in range(60)]
    for k in range(0, 60, 2):
        names = ["a", "b", "gripper"] if k % 4 else ["b", "a"]
        values = [1.0, 2.0, 3.0] if k % 4 else [2.0, 1.0]
        messages.append(("/joint_states", k, states(k, names, values)))
    found = read(bag(tmp_path / "bag", messages))
    np.testing.assert_array_equal(found.columns["joint.a.position"], 1.0)
    np.testing.assert_array_equal(found.columns["joint.b.position"], 2.0)


def test_stamps_that_are_nought_or_of_another_clock_are_said(tmp_path: Path) -> None:
    """A driver that leaves its header empty; one whose clock is a minute off."""
    found = read(bag(tmp_path / "a", [("/w", i, wrench(None, float(i))) for i in range(50)]))
    assert any("its headers bear no time" in line for line in found.warnings)
    np.testing.assert_allclose(found.columns["time"], 1e-3 * np.arange(50), atol=1e-9)
    found = read(bag(tmp_path / "b", [("/w", i + 60_000, wrench(i, float(i))) for i in range(50)]))
    assert any("headers are 60 s before the log" in line for line in found.warnings)


def test_streams_without_a_common_time_are_refused_and_an_offset_joins_them(tmp_path: Path) -> None:
    """A CSV on its own clock beside a bag: one line; with the map's offset they meet."""
    path = bag(tmp_path / "bag", [("/w", i, wrench(i, float(i))) for i in range(50)])
    rows = "\n".join(f"{0.001 * i},{0.2 * i}" for i in range(50))
    (tmp_path / "joints.csv").write_text(f"time,q1\n{rows}\n")
    with pytest.raises(UsageError, match="counts from a moment of its own") as error:
        import_files([path, tmp_path / "joints.csv"])
    assert "offset_s" in str(error.value)
    (tmp_path / "m.toml").write_text(f'[offset_s]\n"joints.csv" = {made.EPOCH_NS / 1e9}\n')
    found = import_files([path, tmp_path / "joints.csv"], tmp_path / "m.toml").recording
    np.testing.assert_allclose(found.columns["joint.joint_1.position"], 0.2 * np.arange(50), atol=1e-3)


@pytest.mark.parametrize(("unit", "per_second"), [("ns", 1e9), ("us", 1e6), ("ms", 1e3), ("s", 1.0)])
def test_stamps_of_the_calendar_say_their_unit_by_their_size(unit: str, per_second: float, tmp_path: Path) -> None:
    """Whole numbers since 1970 in any unit, in a column that names none."""
    stamps = [round((1.7e9 + 0.5 * i) * per_second) if unit != "s" else 1.7e9 + 0.5 * i for i in range(20)]
    (tmp_path / "a.csv").write_text("timestamp,fx,fy,fz\n" + "\n".join(f"{t},1,2,{i}" for i, t in enumerate(stamps)))
    found = read(tmp_path / "a.csv")
    np.testing.assert_allclose(found.columns["time"], 0.5 * np.arange(20), atol=1e-6)
    assert found.epoch == pytest.approx(1.7e9)


# ---------------------------------------------------------------- mapping


def test_two_wrenches_are_not_chosen_between_in_silence(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Refused with both names; the map that is written lists them, and decides once edited. Raw goes before filtered."""
    messages = [(topic, i, wrench(i, float(i))) for i in range(50) for topic in ("/left/ft", "/right/ft")]
    path = bag(tmp_path / "two", messages)
    for command in (["diagnose", str(path)], ["import", str(path), "-o", str(tmp_path / "out")]):
        assert main(command) == 2
        line = capsys.readouterr().err.strip().splitlines()[-1]
        assert "/left/ft" in line
        assert "/right/ft" in line
        assert "--write-map" in line
    assert not (tmp_path / "out").exists()
    file = tmp_path / "m.toml"
    assert main(["import", str(path), "--write-map", str(file)]) == 0
    text = file.read_text()
    assert "#   /left/ft" in text
    lines = [
        f'"wrench.{k}.{a}" = {{ stream = "/right/ft", column = "wrench.{k}.{a}", unit = "{unit}", scale = -2.0 }}'
        for k, unit in (("force", "N"), ("torque", "Nm"))
        for a in "xyz"
    ]
    file.write_text(text + "\n".join(lines) + "\n")
    assert main(["import", str(path), "--map", str(file), "-o", str(tmp_path / "out")]) == 0
    np.testing.assert_array_equal(read(tmp_path / "out").columns["wrench.force.x"], -2.0 * np.arange(50))
    both = [
        (topic, i, wrench(i, float(i) if topic == "/ft/raw" else 0.0))
        for i in range(9)
        for topic in ("/ft/filtered", "/ft/raw")
    ]
    assert read(bag(tmp_path / "raw", both)).columns["wrench.force.x"][3] == 3.0


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("[colums]\n", "colums: not a key of a map"),
        ('[columns]\n"wrench.forc.x" = { column = "a" }\n', "wrench.forc.x: not a column of a recording"),
        ('[columns]\n"wrench.force.x" = { stream = "", column = "a", unit = "mm" }\n', "'mm' is no unit of force"),
        ('[columns]\n"wrench.force.x" = { stream = "/x", column = "a" }\n', "there is no stream '/x'"),
        ('[columns]\n"wrench.force.x" = { column = "Fq" }\n', "there is no column 'Fq'; there are 'Fx'"),
        ('stamps = "best"\n', "'best' is no clock"),
        ('[offset_s]\n"a" = "b"\n', "not a number of seconds"),
        ("rows = [\n", "line 1: not TOML"),
    ],
)
def test_a_map_that_does_not_fit_is_one_line(text: str, says: str, tmp_path: Path) -> None:
    """File, key, what is wrong, what there is instead."""
    (tmp_path / "a.csv").write_text("time,Fx,Fy,Fz\n0,1,2,3\n1,1,2,3\n")
    (tmp_path / "m.toml").write_text(text)
    with pytest.raises(UsageError) as error:
        import_files([tmp_path / "a.csv"], tmp_path / "m.toml")
    assert says in str(error.value)
    assert str(tmp_path / "m.toml") in str(error.value)


def test_the_map_that_is_written_gives_the_same_import(tmp_path: Path) -> None:
    """Written out and given back unedited: the same columns, bit for bit."""
    path = made.german_csv(tmp_path)
    assert main(["import", str(path), "--write-map", str(tmp_path / "m.toml"), "-o", str(tmp_path / "one")]) == 0
    assert main(["import", str(path), "--map", str(tmp_path / "m.toml"), "-o", str(tmp_path / "two")]) == 0
    one, two = read(tmp_path / "one"), read(tmp_path / "two")
    assert list(one.columns) == list(two.columns)
    for name, values in one.columns.items():
        np.testing.assert_array_equal(values, two.columns[name])
    assert one.info == two.info


@pytest.mark.parametrize(
    ("columns", "expected"),
    [
        ("fx fy fz tx ty tz", {"wrench.force.x": "fx", "wrench.torque.z": "tz"}),
        ("tx ty tz qx qy qz qw", {"pose.position.x": "tx", "pose.orientation.w": "qw"}),
        ("Tx Ty Tz Q0 Qx Qy Qz", {"pose.position.z": "Tz", "pose.orientation.w": "Q0"}),
        ("q_0 q_1 q_2 dq_0 dq_1 dq_2", {"joint.joint_0.position": "q_0", "joint.joint_2.velocity": "dq_2"}),
        ("joint1_pos joint1_vel joint2_pos", {"joint.joint_2.position": "joint2_pos", "joint.joint_1.velocity": "joint1_vel"}),
        ("force_x force_y force_z torque_x torque_y torque_z", {"wrench.force.y": "force_y", "wrench.torque.y": "torque_y"}),
        ("FT.Fx FT.Fy FT.Fz FT.Mx FT.My FT.Mz", {"wrench.force.x": "FT.Fx", "wrench.torque.x": "FT.Mx"}),
        ("fx fy", {}),
        ("a b c", {}),
    ],
)  # fmt: skip
def test_columns_are_known_by_their_usual_names(columns: str, expected: dict[str, str]) -> None:
    """Whole vectors only; tx is a torque beside forces and a translation beside a quaternion."""
    stream = Stream("", {name: np.zeros(3) for name in columns.split()})
    found = {match.target: match.column for match in chosen(matches(stream))[0]}
    assert found.items() >= expected.items()
    assert bool(found) == bool(expected)


@pytest.mark.parametrize(
    ("heading", "name", "unit", "quantity", "size"),
    [
        ("Fx [N]", "Fx", "N", "force", 1.0),
        ("Tz (N mm)", "Tz", "N mm", "torque", 1e-3),
        ("Mx[N·m]", "Mx", "N·m", "torque", 1.0),
        ("q1_deg", "q1", "deg", "joint position", np.pi / 180),
        ("pos_x_mm", "pos_x", "mm", "position", 1e-3),
        ("Fx (lbf)", "Fx", "lbf", "force", 4.4482216152605),
        ("t [ms]", "t", "ms", "time", 1e-3),
        ("q[0]", "q[0]", "", "joint position", None),
    ],
)
def test_units_in_headings(heading: str, name: str, unit: str, quantity: str, size: float | None) -> None:
    """Behind the name, in brackets or after an underscore."""
    assert split_unit(heading) == (name, unit)
    assert factor(unit, quantity) == (pytest.approx(size) if size is not None else None)


def test_what_a_controller_estimates_from_the_wrench_is_no_covariate(tmp_path: Path) -> None:
    """A filtered or compensated copy would be found to explain the raw one."""
    head = "time,Fx,Fy,Fz,Fx_filtered,Fy_filtered,Fz_filtered,motor_temp,load"
    (tmp_path / "a.csv").write_text(head + "\n" + "\n".join(f"{i},{i},2,3,{i},2,3,20,7" for i in range(9)))
    imported = import_files([tmp_path / "a.csv"])
    assert "covariate.load" in imported.recording.columns
    assert not any("filtered" in name for name in imported.recording.columns)
    assert any("not taken" in line and "Fx_filtered" in line for line in imported.account)


# ---------------------------------------------------------------- the robot


def test_the_robot_of_the_bag_and_the_frame_of_the_wrench_are_taken(tmp_path: Path) -> None:
    """/robot_description and frame_id: nothing needs to be named."""
    text = STORE.types["std_msgs/msg/String"](made.arm())
    names = [f"arm_joint{i + 1}" for i in range(made.JOINTS)]
    messages = [("/robot_description", 0, text), *(("/w", i, wrench(i, float(i), "flange")) for i in range(40))]
    messages += [("/joint_states", i, states(i, names, [0.01 * i] * made.JOINTS)) for i in range(40)]
    found = read(bag(tmp_path / "bag", messages))
    assert (found.info.robot, found.info.sensor_link, found.info.predict) == ("robot.urdf", "flange", "wrench")
    assert found.urdf == made.arm()


def test_numbered_joints_get_the_robots_names(tmp_path: Path) -> None:
    """By their order from the base on, and that is said."""
    (tmp_path / "arm.urdf").write_text(made.arm())
    head = ",".join(f"q{i}" for i in range(made.JOINTS))
    (tmp_path / "a.csv").write_text(
        f"time,{head}\n" + "\n".join(f"{i}," + ",".join(map(str, range(made.JOINTS))) for i in range(5))
    )
    imported = import_files([tmp_path / "a.csv"])
    assert imported.recording.columns["joint.arm_joint7.position"][0] == 6.0
    assert any("joint_0 is arm_joint1" in line for line in imported.notes)


# ---------------------------------------------------------------- the command


def test_import_writes_a_folder_and_accounts_for_every_row(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A table of what was taken for what; then rows in and out."""
    path = made.rosbag2(tmp_path)
    assert main(["import", str(path), "-o", str(tmp_path / "out")]) == 0
    said = capsys.readouterr().out
    assert "wrench.torque.z       <- /ft/raw: wrench.torque.z" in said
    assert "100 in, 100 rows out" in said
    assert json.loads((tmp_path / "out" / "recording.json").read_text())["predict"] == "wrench"
    held(read(tmp_path / "out"), "ROS 2 bag")
    assert main(["import", str(path), "-o", str(tmp_path / "out")]) == 2
    assert main(["import", str(path), "-o", str(tmp_path / "run.mcap")]) == 0
    held(read(tmp_path / "run.mcap"), "ROS 2 bag")
    assert main(["import", str(path), str(tmp_path / "new.mcap")]) == 2
    assert f"-o {tmp_path / 'new.mcap'}" in capsys.readouterr().err


@pytest.mark.parametrize("command", [["calibrate", "--from"], ["export"]])
def test_other_commands_take_such_files(command: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """`calibrate --from` fits the tool that was felt in poses without a clock."""
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    path = tmp_path / "poses.csv"
    made.frame().drop(columns="time").iloc[::6].to_csv(path, index=False)
    more = [str(tmp_path / "out")] if command == ["export"] else ["--tool", "hook", "--json", "--yes"]
    assert main([*command, str(path), *more]) == 0


def test_a_can_log_without_a_matrix_wants_one(tmp_path: Path) -> None:
    """Logged after the daemon had started: one line; the map's matrix decodes it. Lost halves are counted."""
    path = made.can_log(tmp_path, "log", made.ati_frames(start=False))
    with pytest.raises(UsageError, match=r"no calibration matrix.*can.matrix"):
        read(path)
    rows = ", ".join(f"[{', '.join(map(repr, row))}]" for row in made.MATRIX.tolist())
    also = path.with_name(path.name + ".map.toml")
    also.write_text(f'also = ["poses.csv"]\n[can]\ndriver = "ati_netcanoem"\nmatrix = [{rows}]\n')
    held(read(path), "candump -L")
    frames = made.ati_frames()
    del frames[-7]  # one half of a sample
    found = read(made.can_log(tmp_path, "log", frames))
    assert any("dropped: a sample of which one frame is missing" in line for line in found.warnings)
    held(read(made.can_log(tmp_path, "log", made.ati_frames(asked=False))), "candump -L")


def test_a_can_log_of_an_iit_sensor_wants_its_full_scales(tmp_path: Path) -> None:
    """Of the log, else of the map. A channel at its limit is left empty; a lost half and other nodes' frames are no sample."""
    path = made.can_log(tmp_path, "log", made.strain_frames(start=False))
    with pytest.raises(UsageError, match=r"does not hold the sensor's full scales.*can.full_scales"):
        read(path)
    also = path.with_name(path.name + ".map.toml")
    also.write_text('also = ["poses.csv"]\n[can]\nfull_scales = [300, 300, 400, 10, 10]\n')
    with pytest.raises(UsageError, match=r"not 6 positive numbers"):
        read(path)
    also.write_text('also = ["poses.csv"]\n[can]\nfull_scales = [300, 300, 400, 10, 10, 8]\n')
    scaled = read(path)
    frames = made.strain_frames()
    for half in frames[-10:-8]:
        half.data, half.dlc = bytes([*half.data, 0b101]), 7
    del frames[-5]
    found = read(made.can_log(tmp_path, "log", frames))
    force = "wrench.force.x"
    np.testing.assert_array_equal(scaled.columns[force][:20], found.columns[force][:20])
    said = " ".join(found.warnings)
    assert "1 samples: a channel at its limit (left empty)" in said
    assert "dropped: a sample of which one frame is missing" in said


def test_a_log_of_another_bus_names_its_identifiers(tmp_path: Path) -> None:
    """And what is known."""
    (tmp_path / "a.log").write_text("".join(f"({i}.0) can0 7A{i % 3}#0102\n" for i in range(30)))
    with pytest.raises(UsageError, match=r"no driver knows its frames \(identifiers 7A0, 7A1, 7A2\).*ati_netcanoem"):
        read(tmp_path / "a.log")


def test_a_missing_reader_is_a_plain_word(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Which package, and the extra that brings it."""
    paths = {"rosbags": made.rosbag2(tmp_path), "h5py": made.hdf5(tmp_path), "mat-io": made.matlab5(tmp_path)}
    for package, path in paths.items():
        for module in ("rosbags.rosbag2", "h5py", "matio"):
            monkeypatch.setitem(__import__("sys").modules, module, None)
        with pytest.raises(UsageError, match=rf"needs the package {package}.*galen-hw\[import\]"):
            read(path)


# ---------------------------------------------------------------- the wire

OWN = """std_msgs/Header header
string[] name
float64[] value
float32 gain
my/Part[2] part
uint8 flag
int64 count
================================================================================
MSG: my/Part
bool on
float64 x
"""


@settings(max_examples=25, deadline=None)
@example([(["a", "b", ""], [0.0, 0.0], False)])
@example([(["1"], [], False), (["1", "1"], [2.0, 3.0], True)])
@given(
    st.lists(
        st.tuples(
            st.lists(st.text(max_size=5), max_size=3), st.lists(st.floats(allow_nan=False), max_size=4), st.booleans()
        ),
        max_size=6,
    )
)
def test_shapes_read_what_rosbags_reads(rows: list[tuple[list[str], list[float], bool]]) -> None:
    """Any message of any shape, little-endian CDR and ROS 1: every number is the one that rosbags reads."""
    for ros1 in (False, True):
        store = get_typestore(Stores.ROS1_NOETIC if ros1 else Stores.ROS2_HUMBLE)
        store.register(get_types_from_msg(OWN, "my/msg/Whole"))
        kinds, kind = store.types, "my/msg/Whole"
        gatherer = Gatherer(store.fielddefs, kind, cdr=not ros1)
        messages = []
        for i, (names, values, flag) in enumerate(rows):
            stamp = kinds["builtin_interfaces/msg/Time"](i, 5)
            head = kinds["std_msgs/msg/Header"](*((i,) if ros1 else ()), stamp, "".join(names))
            parts = [kinds["my/msg/Part"](flag, 1.5 * i), kinds["my/msg/Part"](not flag, -2.5)]
            message = kinds[kind](head, [n.replace("\0", "") for n in names], np.array(values), 0.5, parts, 7, -i)
            message.header.frame_id = message.header.frame_id.replace("\0", "")
            messages.append(message)
            gatherer.add(bytes(store.serialize_ros1(message, kind) if ros1 else store.serialize_cdr(message, kind)), i)
        columns, logged, stamps = gatherer.columns()
        assert not gatherer.lost
        assert len(logged) == len(rows)
        for i, message in enumerate(messages):
            assert stamps is not None
            assert stamps[i] == i * 10**9 + 5
            assert columns["part[0].x"][i] == 1.5 * i
            assert columns["part[1].on"][i] == float(not rows[i][2])
            assert (columns["gain"][i], columns["flag"][i], columns["count"][i]) == (0.5, 7.0, -i)
            named = {f"value[{k}]": v for k, v in enumerate(message.value.tolist())}
            texts = list(message.name)
            if all(texts) and len(set(texts)) == len(texts) == len(message.value):
                named = {f"value[{text}]": v for text, v in zip(texts, message.value.tolist(), strict=True)}
            for name, value in named.items():
                assert columns[name][i] == value


@settings(max_examples=25, deadline=None)
@given(
    st.sampled_from([",", ";", "\t", "|"]),
    st.sampled_from([".", ","]),
    st.lists(st.lists(st.floats(-1e6, 1e6), min_size=3, max_size=3), min_size=2, max_size=8),
    st.booleans(),
)
def test_any_separator_and_decimal_sign(separator: str, decimal: str, rows: list[list[float]], units: bool) -> None:
    """Where the two differ the layout is found: separator, sign, header and first row."""
    if separator == decimal:
        return
    lines = [separator.join(["alpha", "beta", "gamma"])] + ([separator.join(["[s]", "[N]", "[mm]"])] if units else [])
    lines += [separator.join(f"{x:.3f}".replace(".", decimal) for x in row) for row in rows]
    layout = layout_of(lines)
    assert layout is not None
    assert (layout.separator, layout.decimal, layout.header, layout.first) == (separator, decimal, 0, 1 + units)
    assert layout.names == ("alpha", "beta", "gamma")


def test_a_constant_force_turns_nothing() -> None:
    """Readings that never change say nothing of axes: the identity, not no axes at all."""
    found = scaled(np.random.default_rng(0).normal(size=(20, 3)), np.ones((20, 3)))
    np.testing.assert_array_equal(found.Q, np.eye(3))


def test_a_split_bag_is_one_recording(tmp_path: Path) -> None:
    """Two storage files without metadata follow one another."""
    whole = made.rosbag2(tmp_path)
    (whole / "metadata.yaml").unlink()
    second = whole / "bag_1.db3"
    shutil.copy(whole / "bag.db3", second)
    for file, cut in ((whole / "bag.db3", ">="), (second, "<")):
        with sqlite3.connect(file) as database:
            database.execute(f"DELETE FROM messages WHERE timestamp {cut} {int(made.NS[40])}")
    found = read(whole)
    held(found, "ROS 2 bag")
    assert head_of(whole).data == b""

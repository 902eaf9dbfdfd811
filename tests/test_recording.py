"""Tables: what is written is read back bit for bit, what is wrong is one clear line, what is odd is a warning."""

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from galen_hw.errors import UsageError
from galen_hw.formats.parquet import read as import_parquet
from galen_hw.recording import Recording, RecordingInfo, read_recording, write_table
from galen_hw.recording.observations import observations_of
from galen_hw.recording.recording import group_of, joint_column
from galen_hw.recording.to_mcap import write_mcap

DATA = Path(__file__).resolve().parents[2] / "shared" / "data"
finite = st.floats(allow_nan=False, allow_infinity=False)
cells = st.one_of(finite, st.just(float("nan")))
names = st.sampled_from(
    [
        "joint.roll.position",
        "joint.roll.velocity",
        "joint.a.b.position",
        "joint.roll.command",
        "wrench.force.x",
        "wrench.torque.z",
        "sensor.orientation.w",
        "pose.position.x",
        "target.7.position.y",
        "applied.force.z",
        "imu.acceleration.x",
        "temperature.motor",
        "covariate.humidity",
        "something, else",
    ]
)


def same(a: Recording, b: Recording) -> bool:
    """Same columns in the same order, bit for bit (a NaN is a NaN)."""
    return list(a.columns) == list(b.columns) and all(
        np.array_equal(a.columns[n].view(np.uint64), b.columns[n].view(np.uint64))
        or (
            np.array_equal(a.columns[n], b.columns[n], equal_nan=True)
            and np.array_equal(np.signbit(a.columns[n]), np.signbit(b.columns[n]))
        )
        for n in a.columns
    )


@st.composite
def recordings(draw: st.DrawFn) -> Recording:
    rows = draw(st.integers(1, 6))
    chosen = draw(st.lists(names, min_size=1, max_size=6, unique=True))
    columns = {n: np.array(draw(st.lists(cells, min_size=rows, max_size=rows))) for n in chosen}
    columns = {n: np.where(np.isnan(v), np.nan, v) for n, v in columns.items() if not np.isnan(v).all()}
    if draw(st.booleans()) or not columns:
        columns["covariate.full"] = np.array(draw(st.lists(finite, min_size=rows, max_size=rows)))
    if draw(st.booleans()):
        steps = draw(st.lists(st.floats(0, 1e3), min_size=rows, max_size=rows))
        columns = {"time": np.cumsum(steps), "segment": np.arange(rows) // 3.0} | columns
    return Recording(columns, RecordingInfo(robot="galen", predict="wrench"))


@settings(max_examples=60)
@given(recordings(), st.sampled_from(["csv", "parquet", "json", "msgpack"]))
def test_what_is_written_is_read_back_bit_for_bit(
    tmp_path_factory: pytest.TempPathFactory, recording: Recording, form: Any
) -> None:
    """As CSV, as Parquet, and as MCAP in either encoding: names, order, digits, minus zero, empty cells."""
    folder = tmp_path_factory.mktemp("r")
    if form in {"csv", "parquet"}:
        write_table(recording, folder / "out", form)
        back = read_recording(folder / "out")
    else:
        write_mcap(recording, folder / "out.mcap", encoding=form)
        back = read_recording(folder / "out.mcap")
    assert same(recording, back)
    assert back.info == recording.info


FULL: dict[str, Any] = {
    "schema": 1,
    "robot": "arm.urdf",
    "base_link": "base",
    "sensor_link": "ft",
    "tip_link": "tip",
    "distal_bodies": ["gripper"],
    "tool": {"name": "t", "mass": 0.3, "com": [0, 0, 0.1], "inertia": [1e-4, 2e-4, 3e-4], "tip": [0, 0, 0.2]},
    "bias_body": {"mass": 0.08, "com": [0, 0, 0.01]},
    "zeroed_at": [0.1, 0.2],
    "gravity": [0, 0, -9.8],
    "predict": "pose",
    "model": {"bias": "free", "dynamics": "static", "compliance": {"joint": {"one": 1e-5}}},
    "ranges": {"joint.one.position": [-1, 1]},
    "notes": "a note",
}


def table(folder: Path, csv: str, info: Any = None) -> Path:
    """A table folder with this text."""
    folder.mkdir(exist_ok=True)
    (folder / "recording.csv").write_text(csv)
    text = info if isinstance(info, str) else json.dumps({"schema": 1} if info is None else info)
    (folder / "recording.json").write_text(text)
    return folder


def test_every_key_of_the_specification_is_read_and_written(tmp_path: Path) -> None:
    """And the file that they name goes along."""
    folder = table(tmp_path / "a", "joint.one.position,joint.two.position\n1,2\n2,3\n", FULL)
    (folder / "arm.urdf").write_text("<robot/>")
    recording = read_recording(folder)
    info = recording.info
    assert info.tool is not None
    assert info.tool.inertia == ((1e-4, 0, 0), (0, 2e-4, 0), (0, 0, 3e-4)), "three moments stand for a diagonal"
    assert info.zeroed_joints(recording.joint_names) == (0.1, 0.2)
    assert (info.model.bias, info.model.dynamics) == ("free", "static")
    assert info.model.compliance is not None
    assert info.model.compliance.joint == {"one": 1e-5}
    assert recording.urdf == folder / "arm.urdf"
    assert [w for w in recording.warnings if "recording.json" in w] == []
    write_table(recording, tmp_path / "b", "parquet")
    again = read_recording(tmp_path / "b")
    assert (again.info, (tmp_path / "b" / "arm.urdf").read_text()) == (info, "<robot/>")
    write_mcap(recording, tmp_path / "c.mcap")
    assert read_recording(tmp_path / "c.mcap").urdf == "<robot/>"


def test_a_quaternion_and_joints_can_both_say_where_it_was_zeroed() -> None:
    """Four numbers for a robot of five joints are a quaternion; a wrong number of them is an error."""
    five = tuple("abcde")
    quaternion = RecordingInfo(zeroed_at=(0, 0, 0, 1))
    assert quaternion.zeroed_joints(five) is None
    assert quaternion.zeroed_quaternion(five) == (0, 0, 0, 1)
    assert RecordingInfo(zeroed_at=dict.fromkeys(five, 0.5)).zeroed_joints(five) == (0.5,) * 5
    named = RecordingInfo(zeroed_at={"x": 0.0, "y": 0.6, "z": 0.0, "w": 0.8})
    assert named.zeroed_joints(five) is None
    assert named.zeroed_quaternion(five) == (0.0, 0.6, 0.0, 0.8)
    assert named.zeroed_joints(("x", "y", "z", "w")) == (0.0, 0.6, 0.0, 0.8), "joints that are called so"
    with pytest.raises(UsageError, match="3 values for 5 joints"):
        RecordingInfo(zeroed_at=(0, 0, 0)).zeroed_joints(five)
    with pytest.raises(UsageError, match="no value for joint 'e'"):
        RecordingInfo(zeroed_at=dict.fromkeys("abcd", 0.5)).zeroed_joints(five)


def test_columns_fall_into_groups_and_nothing_is_dropped(tmp_path: Path) -> None:
    """Joints in the order in which they appear, names with dots, unknown columns as covariates with a warning."""
    text = "time,joint.b.c.position,joint.a.velocity,humidity,temperature.x,wrench.force.w,target.1.position.x\n"
    recording = read_recording(table(tmp_path / "a", text + "0,1,2,3,4,5,6\n1,2,3,4,5,6,7\n"))
    assert recording.joint_names == ("b.c", "a")
    assert list(recording.group("covariate")) == ["humidity", "wrench.force.w"]
    assert list(recording.group("targets")) == ["target.1.position.x"]
    assert recording.has("targets", "time", "velocity")
    assert not recording.has("effort")
    assert recording.joints("velocity").tolist()[0][1] == 2.0
    assert np.isnan(recording.joints("velocity")[:, 0]).all(), "a joint without a velocity has none"
    assert any("not known columns, kept as covariates: humidity, wrench.force.w" in w for w in recording.warnings)
    assert joint_column("joint.x") is None
    assert group_of("time") is None


GOOD = "time,joint.a.position\n0,1\n1,2\n"


@pytest.mark.parametrize(
    ("csv", "info", "line"),
    [
        ("", None, "there are no columns"),
        ("time,a\n", None, "there are no rows"),
        ("time,a,a\n1,2,3\n", None, "column 'a' is there twice"),
        ("time,,a\n1,2,3\n", None, "column 2: a column has no name"),
        ("1,2\n3,4\n", None, "there is no header"),
        ("time;a\n1;2\n", None, "not separated by commas"),
        ("time,a\n0,1\n1,x7\n", None, "column 'a', row 2: 'x7' is not a number"),
        ("time,a\n0,1\n1\n", None, "line 3: 1 cells where the header has 2"),
        ("time,a\n0,1\n1,2,3\n", None, "line 3: 3 cells where the header has 2"),
        ("time,a\n0,1\n,2\n", None, "column 'time', row 2: the cell is empty"),
        ("segment,a\n0.5,1\n1,2\n", None, "column 'segment': not whole numbers"),
        ("time,a\n0,\n1,NaN\n", None, "every column is empty"),
        (GOOD, "{", "recording.json, line 1, column 2: not JSON"),
        (GOOD, "[1]", "not a JSON object"),
        (GOOD, {"schema": 2}, "recording.json: schema: input should be 1, found '2'"),
        (GOOD, {"predict": "wrenches"}, "recording.json: predict: input should be 'wrench', 'pose'"),
        (GOOD, {"tool": {"mass": -1}}, "recording.json: tool.mass: input should be greater than or equal to 0"),
        (GOOD, {"tool": {"com": [1, 2]}}, "recording.json: tool.com"),
        (GOOD, {"gravity": [0, 0, "down"]}, "recording.json: gravity.2: input should be a valid number"),
        (GOOD, {"model": {"dynamics": "magic"}}, "recording.json: model.dynamics"),
    ],
)
def test_what_cannot_be_read_is_one_line_with_its_place(tmp_path: Path, csv: str, info: Any, line: str) -> None:
    """File, column and row, and what to do; no traceback of a library."""
    folder = table(tmp_path / "a", csv, info)
    with pytest.raises(UsageError) as error:
        read_recording(folder)
    assert line in str(error.value)
    assert str(folder) in str(error.value)
    assert "\n" not in str(error.value)
    assert error.value.todo


def test_what_is_not_there_is_said(tmp_path: Path) -> None:
    """A folder, a table, the JSON beside it; a file that is no recording."""
    with pytest.raises(UsageError, match="no such recording"):
        read_recording(tmp_path / "nowhere")
    with pytest.raises(UsageError, match=r"no recording\.csv or recording\.parquet"):
        read_recording(tmp_path)
    (tmp_path / "recording.csv").write_text(GOOD)
    with pytest.raises(UsageError, match=r"no recording\.json"):
        read_recording(tmp_path)
    (tmp_path / "x.mcap").write_bytes(b"not one")
    with pytest.raises(UsageError, match="not an MCAP file"):
        read_recording(tmp_path / "x.mcap")
    (tmp_path / "recording.csv").unlink()
    (tmp_path / "recording.parquet").write_bytes(b"PAR1 not one")
    (tmp_path / "recording.json").write_text("{}")
    with pytest.raises(UsageError, match="not readable as Parquet"):
        read_recording(tmp_path)


@pytest.mark.parametrize(
    ("whole", "damaged"), [(b"force.x", b"f\xc0rce.x"), (b"\x16\x04\x19", b"\x16\x06\x19"), (b"\x16\x04", b"\x16\x06")]
)
def test_a_damaged_parquet_file_is_one_line(tmp_path: Path, whole: bytes, damaged: bytes) -> None:
    """A byte of a column's name, and the number of its rows, of which it has fewer, in its head alone and in every part."""
    import pyarrow as pa
    from pyarrow import parquet

    file = tmp_path / "recording.parquet"
    parquet.write_table(pa.table({"time": [0.0, 1.0], "force.x": [1.0, 2.0]}), file)
    assert whole in file.read_bytes()
    file.write_bytes(file.read_bytes().replace(whole, damaged))
    (tmp_path / "recording.json").write_text('{"schema": 1, "robot": null}')
    with pytest.raises(UsageError, match="not readable as Parquet"):
        read_recording(file)
    with pytest.raises(UsageError, match=r"recording\.parquet"):
        import_parquet(file)


ODD = [
    ("time,a\n0,1\n1,2\n1,3\n2,4\n", None, "time: repeats at 1 places, first at row 3"),
    ("time,a\n0,1\n1,2\n0.5,3\n2,4\n", None, "time: runs backwards at 1 places, first at row 3"),
    ("time,a\n0,1\n1,2\n2,3\n30,4\n", None, "time: has gaps of more than 5 times the median step of 1 s at 1 places"),
    ("time,a\n0,1\n1,2\n2,\n", None, "a: 1 of 3 cells are empty"),
    ("time,a,b\n0,1,\n1,2,\n", None, "b: every cell is empty; the column is left out"),
    ("time,a\n0,1\n1,inf\n", None, "a: 1 infinite values are taken as not measured"),
    ("time,a\n0,5\n1,5\n2,5\n", None, "a: constant at 5"),
    ("time,a,b,c,d,e\n" + "".join(f"{t},0,0,7,0,0\n" for t in range(3)), None, "a, b, d and 1 more: constant at 0"),
    ("joint.a.position,x\n10,1\n90,2\n", None, "joint.a.position: reaches 90: is it in degrees or mm?"),
    ("pose.position.x,x\n10,1\n90,2\n", None, "pose.position.x: reaches 90 m: is it in mm?"),
    ("temperature.x,x\n290,1\n300,2\n", None, "is it in kelvin?"),
    ("wrench.force.x,a\n1,1\n2,2\n", None, "wrench.force.x is there but wrench.force.y is not"),
    ("joint.a.position,joint.b.effort\n1,1\n2,2\n", None, "joint position is there for 1 joints but not for b"),
    (
        ",".join(f"sensor.orientation.{k}" for k in "xyzw") + "\n0,0,0,1\n0,0,0,1.1\n",
        None,
        "sensor.orientation: not of length 1 in 1 rows, first 1.1 at row 2",
    ),
    (
        ",".join(f"wrench.{k}.{a}" for k in ("force", "torque") for a in "xyz")
        + "\n1,2,3,100,200,300\n3,2,1,90,50,1\n",
        None,
        "times the force: is it in N mm?",
    ),
    (GOOD, {"robbot": "galen"}, "recording.json: robbot is not a known key and is not used"),
    (GOOD, {"tool": {"weight": 3}}, "recording.json: tool.weight is not a known key"),
    (GOOD, {"tool": {"com": [0, 0, 63]}}, "tool.com reaches 63 m: is it in mm?"),
    (GOOD, {"gravity": [0, 0, -1]}, "gravity has the size 1 m/s^2"),
    (GOOD, {"ranges": {"nothing": [0, 1]}}, "ranges names nothing, which is not a column"),
]


@pytest.mark.parametrize(("csv", "info", "warning"), ODD)
def test_what_is_odd_is_a_warning_and_no_more(tmp_path: Path, csv: str, info: Any, warning: str) -> None:
    """The recording is read all the same."""
    recording = read_recording(table(tmp_path / "a", csv, info))
    assert any(warning in w for w in recording.warnings), recording.warnings
    assert len(recording) >= 2


def test_a_plain_recording_has_no_warnings(tmp_path: Path) -> None:
    """They would mean nothing otherwise; segments start their own clock."""
    text = "time,segment,joint.a.position\n0,0,1\n1,0,2\n2,0,3\n0,1,4\n1,1,5\n2,1,7\n"
    recording = read_recording(table(tmp_path / "a", text))
    assert recording.warnings == ()
    assert recording.segments == [slice(0, 3), slice(3, 6)]
    assert recording.segment.tolist() == [0, 0, 0, 1, 1, 1]


def test_a_simulation_beside_the_recording_is_found_and_matched(tmp_path: Path) -> None:
    """The sub-folder unasked, another by name, with what does not match as a warning; it may do without JSON."""
    folder = table(tmp_path / "a", GOOD)
    (folder / "simulation").mkdir()
    (folder / "simulation" / "recording.csv").write_text("time,joint.a.position\n0,1\n0.5,2\n")
    recording = read_recording(folder)
    assert recording.simulation is not None
    assert "simulation: 1 samples of the recording lie outside its time" in recording.warnings
    other = table(tmp_path / "b", "joint.a.position\n1\n2\n3\n")
    replaced = read_recording(folder, simulation=other)
    assert replaced.simulation is not None
    assert len(replaced.simulation) == 3
    assert "simulation: 3 rows beside 2 and no common clock to match them by" in replaced.warnings
    assert not [w for w in replaced.warnings if "outside its time" in w]
    write_table(recording, tmp_path / "c")
    back = read_recording(tmp_path / "c").simulation
    assert back is not None
    assert same(back, recording.simulation)


def test_a_simulation_is_laid_beside_each_segment_by_its_own_clock(tmp_path: Path) -> None:
    """Without segments a clock that was set back says of two rows that they are the same moment."""
    t = np.tile(np.arange(40) / 10.0, 2)
    x = np.arange(80.0)
    rows = "".join(f"{a},{k // 40},{b}\n" for k, (a, b) in enumerate(zip(t, x, strict=True)))
    folder = table(tmp_path / "a", "time,segment,joint.a.position\n" + rows, {"schema": 1, "predict": "position"})
    every_other = "".join(f"{t[k]},{k // 40},{x[k]}\n" for k in range(0, 80, 2))
    (folder / "simulation").mkdir()
    (folder / "simulation" / "recording.csv").write_text("time,segment,joint.a.position\n" + every_other)
    simulated = observations_of(read_recording(folder)).simulation
    assert simulated is not None
    known = np.arange(80) % 40 < 39
    assert simulated["joint.a.position"][known] == pytest.approx(x[known])
    assert np.isnan(simulated["joint.a.position"][~known]).all()
    (folder / "simulation" / "recording.csv").write_text(
        "time,joint.a.position\n" + "".join(f"{k / 10.0},{k}\n" for k in range(80))
    )
    with pytest.raises(UsageError, match="the clock of the recording is set back at row 41: no time tells"):
        observations_of(read_recording(folder))
    again = [f"{t[k % 20]},{k // 40},{x[k]}\n" if k >= 40 else f"{t[k]},0,{x[k]}\n" for k in range(80)]
    (folder / "simulation" / "recording.csv").write_text("time,segment,joint.a.position\n" + "".join(again))
    with pytest.raises(UsageError, match=r"simulation: the clock of the simulation is set back at row 61: "):
        observations_of(read_recording(folder))


def test_nothing_is_overwritten_or_left_half_written(tmp_path: Path) -> None:
    """A folder that is there stays; a failure leaves neither a folder nor a scrap beside it."""
    recording = read_recording(table(tmp_path / "a", GOOD))
    write_table(recording, tmp_path / "b")
    with pytest.raises(UsageError, match="is there already"):
        write_table(recording, tmp_path / "b")
    write_table(recording, tmp_path / "b", "parquet", overwrite=True)
    assert sorted(p.name for p in (tmp_path / "b").iterdir()) == ["recording.json", "recording.parquet"]
    broken = Recording({"a": np.zeros(2), "b": np.zeros(3)}, recording.info)
    with pytest.raises(ValueError, match=r"zip\(\)"):
        write_table(broken, tmp_path / "d")
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a", "b"]
    (tmp_path / "file").write_text("")
    with pytest.raises(UsageError, match="cannot be written"):
        write_table(recording, tmp_path / "file" / "below")


@pytest.mark.skipif(not DATA.is_dir(), reason="recordings of real machines are not here")
def test_recordings_of_real_machines_are_read_and_kept(tmp_path: Path) -> None:
    """Every development recording, there and back."""
    found = [p.parent for p in DATA.glob("**/recording.json") if p.parent.name != "simulation"]
    assert len(found) >= 15
    for i, folder in enumerate(found):
        recording = read_recording(folder)
        write_table(recording, tmp_path / str(i), "parquet" if i % 2 else "csv")
        assert same(recording, read_recording(tmp_path / str(i)))


@pytest.mark.parametrize("format", ["csv", "parquet"])
def test_empty_cells_of_a_long_table_stay_where_they_are(tmp_path: Path, format: Any) -> None:  # noqa: A002
    """Over several of arrow's chunks."""
    values = np.arange(400_000.0)
    values[::7] = np.nan
    folder = write_table(Recording({"covariate.a": values}, RecordingInfo()), tmp_path / "run", format=format)
    found = read_recording(folder).columns["covariate.a"]
    np.testing.assert_array_equal(found, values)
    assert found.flags.writeable


def test_a_table_is_read_without_pandas(tmp_path: Path) -> None:
    """pyarrow's to_numpy loads it, for a third of a second in which a Ctrl-C was lost."""
    folder = write_table(Recording({"covariate.a": np.arange(4.0)}, RecordingInfo()), tmp_path / "run")
    code = (
        "import sys; from galen_hw.recording import read_recording as r; r(sys.argv[1]); print('pandas' in sys.modules)"
    )
    done = subprocess.run([sys.executable, "-c", code, str(folder)], capture_output=True, text=True, check=True)
    assert done.stdout == "False\n"

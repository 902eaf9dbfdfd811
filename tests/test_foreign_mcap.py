"""MCAP files of other programs, and files that are out of order, overfull or hostile: read rightly, or one line that helps."""

import io
import json
import tracemalloc
from pathlib import Path
from typing import Any

import lz4.frame
import numpy as np
import pytest
import zstandard
from mcap.data_stream import RecordBuilder
from mcap.records import Chunk
from mcap.writer import CompressionType, Writer

from galen_hw.cli import main
from galen_hw.errors import UsageError
from galen_hw.messages import encode
from galen_hw.recording import read_recording
from galen_hw.recording.mcap_reader import McapFile
from galen_hw.recording.mcap_unpack import MAX_RECORD_BYTES, unpacked
from galen_hw.recording.to_mcap import write_mcap
from tests.compensation_parts import MS, joints, raw
from tests.test_recording_mcap import recorded, stream

NOW = 1_700_000_000_000_000_000


def foreign(path: Path, channels: dict[str, tuple[str, str]], data: bytes = b"\0" * 64, profile: str = "ros2") -> Path:
    """100 messages on each channel (topic: schema and encoding)."""
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start(profile=profile, library="rosbag2")
        ids = [
            writer.register_channel(topic, encoding, writer.register_schema(schema, "ros2msg", b"x") if schema else 0)
            for topic, (schema, encoding) in channels.items()
        ]
        for i in range(100):
            for channel in ids:
                writer.add_message(channel, NOW + i, data, NOW + i)
        writer.finish()
    return path


def test_messages_come_by_the_time_of_their_record(tmp_path: Path) -> None:
    """Several chunks, their messages shuffled: the format promises no order, every reader sorts by log_time."""
    rng = np.random.default_rng(3)
    with (tmp_path / "shuffled.mcap").open("wb") as out:
        writer = Writer(out, chunk_size=4096)
        writer.start()
        ids = {t: writer.register_channel(t, "msgpack", 0) for t in ("wrench/raw", "joints/state")}
        messages = [("wrench/raw", raw(i * MS, [0.1 * i, 1, 2, 3, 4, 5], seq=i)) for i in range(400)]
        messages += [("joints/state", joints(25 * i * MS, np.full(5, 0.01 * i), seq=i)) for i in range(16)]
        for k in rng.permutation(len(messages)):
            topic, message = messages[k]
            writer.add_message(ids[topic], NOW + message.t_ns, encode(message), 0)
        writer.finish()

    logged = McapFile(tmp_path / "shuffled.mcap").read()
    assert len(logged) == 416
    assert [item.log_ns for item in logged] == sorted(item.log_ns for item in logged)
    recording = read_recording(tmp_path / "shuffled.mcap")
    assert not [w for w in recording.warnings if w.startswith("time")]
    np.testing.assert_allclose(recording.time, np.arange(400) * 1e-3, atol=1e-12)
    np.testing.assert_array_equal(recording.columns["wrench.force.x"], 0.1 * np.arange(400))
    roll = recording.columns["joint.roll.position"]
    np.testing.assert_allclose(roll[:376], 0.01 * np.arange(376) / 25, atol=1e-12)


def test_a_table_whose_clock_runs_backwards_keeps_its_rows(tmp_path: Path) -> None:
    """As MCAP and back: the order of a table is its own, and stays odd rather than mended."""
    folder = tmp_path / "table"
    folder.mkdir()
    (folder / "recording.csv").write_text("time,covariate.a\n0,1\n2,2\n1,3\n1,4\n3,5\n")
    (folder / "recording.json").write_text('{"schema": 1}')
    write_mcap(read_recording(folder), tmp_path / "a.mcap")
    recording = read_recording(tmp_path / "a.mcap")
    assert recording.columns["time"].tolist() == [0, 2, 1, 1, 3]
    assert recording.columns["covariate.a"].tolist() == [1, 2, 3, 4, 5]


@pytest.mark.parametrize("command", [["diagnose"], ["export"], ["replay"], ["calibrate", "--from"]])
def test_a_ros_2_recording_that_is_damaged_says_what_it_is_and_what_to_do(
    command: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Its topics and types; what cannot be read; what to do; no word of a recording.json that is not there."""
    channels = {
        "/ft/wrench": ("geometry_msgs/msg/WrenchStamped", "cdr"),
        "/joint_states": ("sensor_msgs/msg/JointState", "cdr"),
    }
    path = foreign(tmp_path / "bag.mcap", channels)
    assert main([*command, str(path), *(["out"] if command == ["export"] else [])]) == 2
    line = capsys.readouterr().err.strip().splitlines()[-1]
    assert str(path) in line
    assert "/ft/wrench (geometry_msgs/msg/WrenchStamped" in line
    assert "/joint_states (sensor_msgs/msg/JointState" in line
    assert "galen-hw import" in line
    assert "recording.json" not in line


def test_topics_of_ours_in_another_encoding_or_shape_are_said(tmp_path: Path) -> None:
    """What the reader had noticed is in the error: an encoding, messages that do not fit."""
    path = foreign(tmp_path / "a.mcap", {"wrench/raw": ("", "protobuf")}, profile="")
    with pytest.raises(UsageError, match=r"no wrench.*its topics are wrench/raw \(protobuf\)"):
        read_recording(path)
    path = foreign(tmp_path / "b.mcap", {"wrench/raw": ("", "json")}, data=b'{"fx": 1}', profile="")
    with pytest.raises(UsageError, match=r"no wrench.*100 messages could not be read"):
        read_recording(path)


def chunk_of(compression: str, data: bytes, size: int) -> bytes:
    """The content of a chunk record that claims `size`."""
    builder = RecordBuilder()
    Chunk(compression, data, 0, 0, 0, size).write(builder)
    return builder.end()[9:]


@pytest.mark.parametrize("compression", ["zstd", "lz4"])
@pytest.mark.parametrize("claimed", [1000, 2**50])
def test_a_chunk_is_unpacked_within_bounds(compression: str, claimed: int) -> None:
    """64 MiB of zeros in some kilobytes, which claim to be fewer or to be a petabyte: refused, and never reserved."""
    zeros = bytes(64 * 2**20)
    data = zstandard.compress(zeros) if compression == "zstd" else lz4.frame.compress(zeros)
    del zeros
    body = chunk_of(compression, data, claimed)
    tracemalloc.start()
    with pytest.raises(ValueError, match=r"others|at most"):
        unpacked(body)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 4 * 2**20


def test_a_frame_that_claims_a_petabyte_reserves_nothing() -> None:
    """zstandard.decompress() believes the frame's own head."""
    frame = zstandard.ZstdCompressor(write_content_size=True).compress(b"x")
    head = frame[:4] + bytes([0xE0]) + (2**50).to_bytes(8, "little") + frame[6:]
    with pytest.raises(Exception, match=r".") as error:
        unpacked(chunk_of("zstd", head, 1000))
    assert not isinstance(error.value, MemoryError)


def test_a_record_that_is_too_large_is_left_out_and_the_rest_read(tmp_path: Path) -> None:
    """A hole in the file stands for a huge attachment: it is not loaded, and said."""
    data = recorded(stream())
    hole = tmp_path / "a.mcap"
    with hole.open("wb") as out:
        out.write(data[:8])
        out.write(bytes([9]) + (MAX_RECORD_BYTES + 1).to_bytes(8, "little"))
        out.seek(MAX_RECORD_BYTES + 1, io.SEEK_CUR)
        out.write(data[8:])
    file = McapFile(hole)
    assert len(file.read()) == len(stream())
    assert [w for w in file.warnings if "is left out; at most" in w]


NESTED = "[" * 100_000 + "]" * 100_000
HUGE = "9" * 5000


@pytest.mark.parametrize("value", [NESTED, HUGE, '"text"', "[1]", '{"a": 1'])
def test_nested_and_huge_values_anywhere_are_typed(value: str, tmp_path: Path) -> None:
    """In messages of the bus, in rows of a table, in metadata and in attachments: left out, or one line."""

    def file(name: str, *, topic: str = "table/row", data: str = "", **more: Any) -> Path:
        with (tmp_path / name).open("wb") as out:
            writer = Writer(out, compression=CompressionType.NONE)
            writer.start()
            channel = writer.register_channel(topic, "json", 0)
            good = '{"timestamp": 0, "columns": {"covariate.a": 1}}'
            for i, text in enumerate((data or good, good)):
                writer.add_message(channel, NOW + i, text.encode(), NOW)
            for key, content in more.items():
                if key == "info":
                    writer.add_attachment(0, 0, "recording.json", "", content.encode())
                else:
                    writer.add_metadata("galen-hw", {key: content})
            writer.finish()
        return tmp_path / name

    assert len(read_recording(file("good.mcap"))) == 2
    assert len(read_recording(file("row.mcap", data=value))) == 1
    assert len(read_recording(file("cell.mcap", data='{"columns": {"covariate.a": %s}}' % value))) == 1  # noqa: UP031
    for bad in (
        file("metadata.mcap", columns=value),
        file("info.mcap", info=value),
        file("key.mcap", info='{"schema": 1, "gravity": %s}' % value),  # noqa: UP031
        file("message.mcap", topic="wrench/raw", data=value),
    ):
        with pytest.raises(UsageError) as error:
            read_recording(bad)
        assert str(error.value).startswith(str(bad))
        assert "\n" not in str(error.value)


def test_a_tools_file_in_a_recording_that_is_none_is_one_line(tmp_path: Path) -> None:
    """It comes from outside as everything in the recording does."""
    messages = stream(20)
    state = messages[0][1]
    for i, text in enumerate((NESTED, "[]", '{"bias_body": 3}', '{"mass": "much"}')):
        damaged = [("compensation/state", type(state)(**(_fields(state) | {"tool_file": text}))), *messages[1:]]
        path = tmp_path / f"{i}.mcap"
        path.write_bytes(recorded(damaged))
        with pytest.raises(UsageError) as error:
            read_recording(path)
        assert str(error.value).startswith(str(path))
        assert main(["replay", str(path)]) == 2


def _fields(message: Any) -> dict[str, Any]:
    return {name: getattr(message, name) for name in message.__struct_fields__}


def test_diagnose_names_the_file_that_was_given(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """What an MCAP file lacks is said of that file: no recording.json beside it, nor just "recording"."""
    path = tmp_path / "run.mcap"
    path.write_bytes(recorded([(t, m) for t, m in stream() if t == "wrench/raw"]))
    assert main(["diagnose", str(path)]) == 2
    (line,) = [x for x in capsys.readouterr().err.splitlines() if x.startswith("galen-hw diagnose: ")]
    assert line.startswith(f"galen-hw diagnose: {path}: ")
    table = tmp_path / "table"
    table.mkdir()
    (table / "recording.csv").write_text("time,covariate.a\n0,1\n1,2\n")
    (table / "recording.json").write_text(json.dumps({"schema": 1}))
    for given, where in ((table, table / "recording.json"), (tmp_path / "t.mcap", None)):
        if where is None:
            write_mcap(read_recording(table), given)
        assert main(["diagnose", str(given)]) == 2
        err = capsys.readouterr().err
        assert (f"{where}: predict" if where else f"{given}: recording.json: predict") in err


@pytest.mark.parametrize(
    ("csv", "info", "says"),
    [
        ("x" * 200_000 + ",b\n1,2\n", "{}", "recording.csv: the header cannot be read"),
        ("a,b\n1,2\n1," + "x" * 200_000 + "\n", "{}", "recording.csv: not a table of numbers"),
        ("a,b\n1,2\n1,[[[[\n", "{}", "column 'b', row 2: '[[[[' is not a number"),
        ("a,b\n1,2\n", '{"schema": 1, "notes": ' + NESTED + "}", "recording.json: nested more than 64 deep"),
        (
            "a,b\n1,2\n",
            '{"schema": 1,\n"gravity": [0, 0, -' + HUGE + "]}",
            "recording.json, line 2: an integer of 5000",
        ),
        (
            "a,b\n1,2\n",
            '{"schema": 1, "gravity": [0, 0, -1e999]}',
            "recording.json: gravity.2: input should be a finite",
        ),
    ],
)
def test_a_table_with_huge_or_nested_cells_is_one_line(csv: str, info: str, says: str, tmp_path: Path) -> None:
    """In the header, in a cell, in what it belongs to."""
    (tmp_path / "recording.csv").write_text(csv)
    (tmp_path / "recording.json").write_text(info)
    with pytest.raises(UsageError) as error:
        read_recording(tmp_path)
    assert says in str(error.value)
    assert "\n" not in str(error.value)
    assert len(str(error.value)) < 400

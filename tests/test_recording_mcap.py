"""MCAP: readable by any viewer, complete however it ends, and a table at the times of the wrench."""

import io
import json
import socket
import threading
import time
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader

from galen_hw.bus import Publisher
from galen_hw.cli import main
from galen_hw.config.paths import DEFAULT_CONFIG
from galen_hw.errors import CommandRejectedError, UsageError
from galen_hw.messages import TOPICS, CompensationState, Message, Quaternion, Request, TrackedPose, Vector3
from galen_hw.recording import Recording, read_recording
from galen_hw.recording.from_mcap import at_times
from galen_hw.recording.mcap_reader import McapFile
from galen_hw.recording.mcap_writer import message_schema
from galen_hw.recording.session import Session
from galen_hw.recording.to_mcap import write_mcap
from galen_hw.services.recorder import RecorderService, RecorderSettings, chosen_topics
from galen_hw.services.service import ServiceContext
from tests.compensation_parts import BASE, MS, ROBOT, joints, raw, tool_file

NOW = 1_700_000_000_000_000_000


def stream(samples: int = 300) -> list[tuple[str, Message]]:
    """Wrenches at 1 kHz, joints at 40 Hz without efforts, one state with a tool."""
    tool = tool_file()
    state = CompensationState(
        timestamp=1.0,
        t_ns=0,
        seq=0,
        valid=True,
        tool="retractor",
        calibration="retractor/0001-abc",
        tool_file=tool.to_json(),
    )
    found: list[tuple[str, Message]] = [("compensation/state", state)]
    for i in range(samples):
        if i % 25 == 0:
            q = np.array([0.0, 0.0, 0.0, 0.01, -0.02]) * i
            found.append(("joints/state", joints(i * MS, q, np.array([0, 0, 0, 10.0, -20.0]), seq=i // 25)))
        wrench = [0.1 * i, 1 / 3, -0.0, 1e-300, 2.0, 3.0]
        found.append(("wrench/raw", raw(i * MS, wrench, seq=i, serial_number="FT1" if i > 5 else "")))
    return found


def recorded(messages: list[tuple[str, Message]], flush_every: int = 50, **options: Any) -> bytes:
    """An MCAP file of them, flushed now and then."""
    memory = io.BytesIO()
    session = Session(memory, **({"robot": "galen", "config": "[robot]\n"} | options))
    for i, (topic, message) in enumerate(messages):
        session.add(topic, message, NOW + i)
        if i % flush_every == flush_every - 1:
            session.flush()
    session.finish()
    return memory.getvalue()


def read(path: Path, data: bytes) -> McapFile:
    """A file of these bytes."""
    path.write_bytes(data)
    return McapFile(path)


@pytest.mark.parametrize("encoding", ["json", "msgpack"])
def test_what_is_recorded_is_read_in_order_and_bit_for_bit(tmp_path: Path, encoding: str) -> None:
    """NaN, minus zero and the smallest numbers too."""
    messages = stream()
    found = read(tmp_path / "a.mcap", recorded(messages, encoding=encoding)).read()
    assert [item.topic for item in found] == [topic for topic, _ in messages]
    assert [repr(item.message) for item in found] == [repr(message) for _, message in messages]
    assert [item.log_ns for item in found] == [NOW + i for i in range(len(messages))]


def test_any_mcap_reader_can_read_it(tmp_path: Path) -> None:
    """The reference reader: both times, schemas, attachments, metadata, sequence numbers."""
    (tmp_path / "a.mcap").write_bytes(recorded(stream()))
    with (tmp_path / "a.mcap").open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        summary = reader.get_summary()
        assert summary is not None
        assert summary.statistics is not None
        assert summary.statistics.message_count == len(stream())
        for schema, channel, message in reader.iter_messages():
            assert schema is not None
            assert (schema.encoding, channel.message_encoding) == ("jsonschema", "json")
            assert json.loads(schema.data)["type"] == "object", "viewers want an object at the top"
            body = json.loads(message.data)
            assert message.publish_time == round(body["timestamp"] * 1e9)
            assert message.log_time >= NOW
            assert message.sequence == body["seq"]
        names = {a.name for a in reader.iter_attachments()}
        assert names == {"galen.toml", "tool/retractor/0001-abc.json"}
        metadata: dict[str, str] = {}
        for record in reader.iter_metadata():
            metadata |= record.metadata
    assert metadata["robot"] == "galen"
    assert metadata["serial_number"] == "FT1"
    assert metadata["tool"] == "retractor"
    assert metadata["software"].startswith("galen-hw ")


@pytest.mark.parametrize("topic", list(TOPICS))
def test_every_topic_has_a_schema_that_refers_to_nothing(topic: str) -> None:
    """PlotJuggler passes over channels without a schema, and viewers differ in what they resolve."""
    schema = message_schema(TOPICS[topic].message)
    assert "$ref" not in json.dumps(schema)
    assert next(iter(schema["properties"])) == "timestamp"
    assert schema["properties"]["timestamp"] == {"type": "number"}


def test_a_file_cut_off_anywhere_gives_every_whole_chunk(tmp_path: Path) -> None:
    """At every byte: a beginning of what was recorded, never less than what had been flushed by then."""
    messages = stream(12)
    memory = io.BytesIO()
    session = Session(memory)
    flushed = [(0, 0)]
    for i, (topic, message) in enumerate(messages):
        session.add(topic, message, NOW + i)
        if i % 3 == 2:
            session.flush()
            flushed.append((memory.tell(), i + 1))
    session.finish()
    data = memory.getvalue()
    for end in range(8, len(data) - 8):
        file = read(tmp_path / "cut.mcap", data[:end])
        found = [repr(item.message) for item in file]
        assert found == [repr(message) for _, message in messages[: len(found)]]
        assert len(found) >= max(count for place, count in flushed if place <= end)
        assert any(w.startswith("cut off") for w in file.warnings)


def test_a_recording_that_was_cut_off_is_a_recording(tmp_path: Path) -> None:
    """With a warning; robot and tool are known although the end is missing."""
    (tmp_path / "cut.mcap").write_bytes(recorded(stream())[:-3000])
    recording = read_recording(tmp_path / "cut.mcap")
    assert len(recording) > 200
    assert recording.info.robot == "galen"
    assert recording.info.tool is not None
    assert recording.info.tool.mass == 0.3
    assert any("cut off" in w for w in recording.warnings)


def test_a_damaged_name_in_the_index_makes_no_message_another_topics(tmp_path: Path) -> None:
    """The chunks name their channels themselves."""
    messages = stream(60)
    clean = bytearray(recorded(messages, flush_every=10))
    place = clean.rindex(b"compensation/state\x04\x00\x00\x00json")
    clean[place] ^= 1
    found = read(tmp_path / "a.mcap", bytes(clean)).read()
    assert [repr(item.message) for item in found] == [repr(message) for _, message in messages]


@settings(max_examples=60)
@given(st.data())
def test_damage_costs_the_damaged_part_and_never_more_than_a_message(
    tmp_path_factory: pytest.TempPathFactory, data: st.DataObject
) -> None:
    """Any byte changed: what is still read was recorded so, or the file is refused."""
    messages = stream(60)
    clean = bytearray(recorded(messages, flush_every=10))
    for _ in range(data.draw(st.integers(1, 4))):
        place = data.draw(st.integers(0, len(clean) - 1))
        clean[place] ^= data.draw(st.integers(1, 255))
    folder = tmp_path_factory.mktemp("d")
    known = {repr(message) for _, message in messages}
    with suppress(UsageError):  # the first eight bytes say what it is
        file = read(folder / "a.mcap", bytes(clean))
        found = file.read()
        assert {repr(item.message) for item in found} <= known
        assert len(found) == len(messages) or file.warnings, "nothing is lost in silence"


def test_a_chunk_that_is_no_longer_known_as_one_is_missed(tmp_path: Path) -> None:
    """The index at the end says how many messages there were."""
    data = bytearray(recorded(stream(60), flush_every=20))
    place = 8
    while data[place] != 6:  # the opcode of a chunk
        place += 9 + int.from_bytes(data[place + 1 : place + 9], "little")
    data[place] = 7
    file = read(tmp_path / "a.mcap", bytes(data))
    assert len(file.read()) == len(stream(60)) - 20
    assert file.warnings == [f"{len(stream(60)) - 20} messages are there of {len(stream(60))} that were recorded"]


def test_a_recording_is_a_table_at_the_times_of_the_wrench(tmp_path: Path) -> None:
    """Joints between their states, carried a little beyond the last one; what was not valid is empty."""
    messages = stream(400)[:-100]
    bad = raw(1000 * MS, [9.0] * 6, seq=1000, valid=False)
    (tmp_path / "a.mcap").write_bytes(recorded([*messages, ("wrench/raw", bad)]))
    recording = read_recording(tmp_path / "a.mcap")
    assert recording.time is not None
    assert recording.time[:3].tolist() == [0.0, 0.001, 0.002]
    assert recording.joint_names == ROBOT.joint_names
    n = len(recording) - 1
    expected = 10.0 * np.arange(n) * 1e-3
    assert recording.columns["joint.roll.position"][:n] == pytest.approx(expected, abs=1e-12)
    assert recording.columns["wrench.force.x"][:n] == pytest.approx(0.1 * np.arange(n), abs=0.0)
    assert not recording.has("effort"), "a column without a number is none"
    assert np.isnan(recording.wrench[n]).all()
    assert np.isnan(recording.columns["joint.roll.position"][n]), "0.7 s after the last joint state"
    assert any("1 samples were not valid" in w for w in recording.warnings)
    assert recording.info.predict == "wrench"
    assert recording.info.zeroed_joints(ROBOT.joint_names) == (0.1,) * 5
    assert recording.info.bias_body is not None
    assert recording.info.model.bias == "free", "the tool's constant bias has no key of its own"


def test_gaps_are_not_filled() -> None:
    """Between samples further apart than the bound and five median steps nothing is known."""
    t = np.array([0.0, 0.02, 0.04, 0.5, 0.52])
    values = np.array([0.0, 2.0, 4.0, 50.0, 52.0])
    out = at_times(np.array([-0.1, 0.01, 0.04, 0.2, 0.5, 0.51, 0.55, 0.7]), t, values, bound=0.08)
    assert out == pytest.approx([np.nan, 1.0, 4.0, np.nan, 50.0, 51.0, 52.0, np.nan], nan_ok=True)


def test_the_tracker_becomes_a_tracked_point(tmp_path: Path) -> None:
    """Its frame is not registered to the base, so that it is a target and not a pose; missing frames are gaps."""
    messages: list[tuple[str, Message]] = []
    for i in range(30):
        head = {"timestamp": 1.0, "t_ns": i * 16 * MS, "seq": i, "valid": True, "handle": "0A", "frame": i}
        pose = TrackedPose(**head, position=Vector3(i * 1.0, 2.0, 3.0), orientation=Quaternion(), missing=i == 7)
        messages.append(("tracker/tool", pose))
    (tmp_path / "a.mcap").write_bytes(recorded(messages))
    recording = read_recording(tmp_path / "a.mcap")
    assert recording.names("targets") == tuple(f"target.1.position.{a}" for a in "xyz")
    assert recording.columns["target.1.position.x"][[6, 7, 8]] == pytest.approx([6.0, 7.0, 8.0])


def test_losses_are_counted() -> None:
    """By gaps of the sequence numbers, a topic and source at a time."""
    session = Session(io.BytesIO())
    for seq in (5, 6, 9, 10, 10, 3):
        session.add("wrench/raw", raw(seq * MS, np.zeros(6), seq=seq), NOW)
    assert (session.messages, session.lost) == (6, 2)


def test_topics_are_chosen_by_their_beginning() -> None:
    """With the state that says which tool it was; a misspelt one is refused."""
    assert chosen_topics(["wrench/"]) == {"wrench/raw", "wrench/compensated", "wrench/contact", "compensation/state"}
    assert chosen_topics([]) == set(TOPICS)
    with pytest.raises(UsageError, match="no topic begins with 'wrensh'"):
        chosen_topics(["wrensh"])


def test_the_service_records_between_start_and_stop(tmp_path: Path) -> None:
    """And says where; it starts once, and never overwrites."""
    service = RecorderService("recorder", RecorderSettings(directory=tmp_path), ServiceContext(ROBOT, BASE, tmp_path))
    service.handle(*stream(1)[1], 0)
    path = tmp_path / "run.mcap"
    start = Request(id="1", target="recorder", name="start", args={"file": str(path), "topics": ["wrench/raw"]})
    service.request(start, 0)
    with pytest.raises(CommandRejectedError, match="recording already"):
        service.request(start, 0)
    for topic, message in stream(20):
        service.handle(topic, message, message.t_ns)
    (status,) = service.tick(10**9)
    assert isinstance(status, tuple)
    assert status[1].counters["messages"] == 21  # type: ignore[attr-defined]
    assert len(list(McapFile(path))) == 21, "what was flushed is on the disk already"
    stop = Request(id="2", target="recorder", name="stop")
    assert service.request(stop, 0)[0].result["messages"] == 21  # type: ignore[union-attr]
    file = McapFile(path)
    assert {item.topic for item in file} == {"wrench/raw", "compensation/state"}
    assert file.warnings == []
    with pytest.raises(UsageError, match="is there already"):
        service.request(start, 0)
    with pytest.raises(CommandRejectedError, match="nothing is being recorded"):
        service.request(stop, 0)


def test_the_command_records_a_bus(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Over real ZeroMQ: a publisher in a thread, the command for half a second, a readable file at the end."""
    done = threading.Event()

    def publish() -> None:
        with Publisher(f"ipc://{tmp_path / 'bus.pub'}") as bus:
            seq = 0
            while not done.is_set():
                bus.publish("wrench/raw", raw(time.monotonic_ns(), [1, 2, 3, 4, 5, 6], seq=seq))
                seq += 1
                done.wait(0.002)

    thread = threading.Thread(target=publish)
    thread.start()
    path = tmp_path / "run.mcap"
    try:
        words = ["record", "-o", str(path), "--seconds", "0.5", "--dir", str(tmp_path)]
        with socket.socket(socket.AF_UNIX) as daemon:
            daemon.bind(str(tmp_path / "command"))
            daemon.listen()
            assert main([*words, "--config", str(DEFAULT_CONFIG)]) == 0
            assert main(words) == 2
    finally:
        done.set()
        thread.join()
    out, err = capsys.readouterr()
    assert f"{path}: " in out
    assert "is there already" in err
    file = McapFile(path)
    assert len(file.read()) > 50
    assert file.warnings == []
    assert "galen.toml" in file.attachments
    assert main(["export", str(path), str(tmp_path / "table")]) == 0
    assert len(read_recording(tmp_path / "table")) > 50


def test_without_a_daemon_the_command_says_so(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """One line, how to start one, and no file."""
    assert main(["record", "-o", str(tmp_path / "x.mcap"), "--dir", str(tmp_path)]) == 3
    assert "galen-hw run" in capsys.readouterr().err
    assert not (tmp_path / "x.mcap").exists()


def test_an_export_that_is_interrupted_leaves_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A Ctrl-C in the middle of the writing had left the hidden file that becomes the recording."""

    def interrupted(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("galen_hw.recording.to_mcap.McapWriter.finish", interrupted)
    with pytest.raises(KeyboardInterrupt):
        write_mcap(Recording({"time": np.arange(3.0)}), tmp_path / "x.mcap")
    assert list(tmp_path.iterdir()) == []

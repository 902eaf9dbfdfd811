"""The recorder where the disk, the folder or its own process fails it."""

import os
import resource
import signal
import socket
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import msgspec
import pytest
from mcap.reader import make_reader

from galen_hw.bus import Publisher
from galen_hw.cli import main
from galen_hw.clock import NS_PER_S, TimeBase
from galen_hw.config.paths import DEFAULT_CONFIG
from galen_hw.errors import CommandRejectedError, HardwareError, UsageError
from galen_hw.kinematics import GalenRobot
from galen_hw.messages import Fault, JointsState, Reply, Request, Status, Vector3, WrenchRaw
from galen_hw.recording.mcap_reader import McapFile
from galen_hw.recording.session import Session
from galen_hw.services.recorder import RecorderService, RecorderSettings
from galen_hw.services.service import Output, ServiceContext
from tests import daemon_tree as trees
from tests.daemon_tree import daemon_tree, within

ROBOT = GalenRobot()


@contextmanager
def full_disk(room: int) -> Iterator[None]:
    """No file of this process grows beyond `room` bytes: as on a full disk, a write takes what fits, the next fails."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (room, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


def recorder(folder: Path, daemon: int = 7, **settings: Any) -> RecorderService:
    context = ServiceContext(ROBOT, TimeBase(daemon), folder / "state")
    return RecorderService("recorder", RecorderSettings(directory=folder / "rec", **settings), context)


def ask(service: RecorderService, name: str, **args: Any) -> dict[str, Any]:
    (reply,) = service.request(Request(id="1", target="recorder", name=name, args=args), 0)
    assert isinstance(reply, Reply)
    return reply.result


def told(outputs: list[Output]) -> tuple[Status, list[Fault]]:
    """The status and the faults of a tick."""
    messages = [output[1] for output in outputs if isinstance(output, tuple)]
    (status,) = [m for m in messages if isinstance(m, Status)]
    return status, [m for m in messages if isinstance(m, Fault)]


def wrench(seq: int) -> WrenchRaw:
    force = Vector3(*(float((seq * 7919 * k) % 104729) / 977.0 for k in (3, 5, 7)))  # hard to compress
    return WrenchRaw(timestamp=0.0, t_ns=seq, seq=seq, valid=True, source="ft", force=force, torque=Vector3())


def feed(service: RecorderService, first: int, count: int) -> None:
    for seq in range(first, first + count):
        service.handle("wrench/raw", wrench(seq), seq)


def seqs(path: Path) -> list[int]:
    return [item.message.seq for item in McapFile(path) if isinstance(item.message, WrenchRaw)]


def test_full_disk_ends_the_recording_whole_and_the_recorder_goes_on(tmp_path: Path) -> None:
    """What was flushed is in a file that any reader opens; it is told once, and the next recording works."""
    service = recorder(tmp_path)
    path = Path(ask(service, "start", file="run.mcap")["file"])
    feed(service, 0, 1000)
    assert told(service.tick(NS_PER_S))[0].counters["messages"] == 1000
    with full_disk(path.stat().st_size + 5000):
        feed(service, 1000, 10000)
        status, faults = told(service.tick(2 * NS_PER_S))
    assert status.state == "fault"
    assert "File too large" in status.detail
    assert "holds 1000 messages" in status.detail
    assert [fault.where for fault in faults] == [str(path)]
    assert told(service.tick(3 * NS_PER_S))[1] == []
    assert seqs(path) == list(range(1000))
    assert McapFile(path).warnings == []
    with path.open("rb") as stream:
        assert sum(1 for _ in make_reader(stream).iter_messages()) == 1000
    assert service.snapshot()["recording"] == {}

    ask(service, "start", file="next.mcap")
    feed(service, 0, 10)
    assert told(service.tick(4 * NS_PER_S))[0].state == "ready"
    assert ask(service, "stop")["messages"] == 10


def test_disk_that_fills_at_the_end_or_at_the_beginning(tmp_path: Path) -> None:
    """No room for the last second: `stop` fails typed and the rest is whole. None for the first byte: no file stays."""
    service = recorder(tmp_path)
    path = Path(ask(service, "start", file="run.mcap")["file"])
    feed(service, 0, 100)
    service.tick(NS_PER_S)
    feed(service, 100, 500)
    with full_disk(path.stat().st_size + 100), pytest.raises(HardwareError, match="holds 100 messages"):
        ask(service, "stop")
    assert seqs(path) == list(range(100))
    with full_disk(10), pytest.raises(HardwareError, match="cannot be written any further"):
        ask(service, "start", file="other.mcap")
    assert [p.name for p in path.parent.iterdir()] == ["run.mcap"]
    with pytest.raises(CommandRejectedError, match="nothing is being recorded"):
        ask(service, "stop")


def test_session_on_a_full_disk_raises_one_typed_error_and_ends_the_file(tmp_path: Path) -> None:
    """As `galen-hw record` meets it: message, place and what to do; `finish` afterwards is harmless."""
    path = tmp_path / "run.mcap"
    with path.open("xb") as stream:
        session = Session(stream)
        for seq in range(50):
            session.add("wrench/raw", wrench(seq), seq)
        session.flush()
        with full_disk(path.stat().st_size + 100), pytest.raises(HardwareError) as caught:
            _add(session, range(50, 20000))
        session.finish()
    assert caught.value.where == str(path)
    assert session.messages == 50
    assert seqs(path) == list(range(50))


def _add(session: Session, numbers: range) -> None:
    for seq in numbers:
        session.add("wrench/raw", wrench(seq), seq)


def test_record_on_a_full_disk_is_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """`galen-hw record` ends with status 3, says how much it has, and leaves a file that is whole."""
    done, path = threading.Event(), tmp_path / "run.mcap"

    def publish() -> None:
        with Publisher(f"ipc://{tmp_path / 'bus.pub'}") as bus:
            seq = 0
            while not done.wait(0.001):
                for _ in range(20):
                    seq += 1
                    bus.publish("wrench/raw", wrench(seq))

    thread = threading.Thread(target=publish)
    thread.start()
    try:
        with socket.socket(socket.AF_UNIX) as daemon:
            daemon.bind(str(tmp_path / "command"))
            daemon.listen()
            words = ["record", "-o", str(path), "--seconds", "60", "--dir", str(tmp_path)]
            with full_disk(200_000):
                assert main([*words, "--config", str(DEFAULT_CONFIG)]) == 3
    finally:
        done.set()
        thread.join()
    (line,) = capsys.readouterr().err.splitlines()
    assert "cannot be written any further (File too large)" in line
    assert f"it holds {len(seqs(path)) if path.exists() else 0} messages" in line


def test_room_is_left_on_the_disk(tmp_path: Path) -> None:
    """A recording is not begun where less is free than is to be kept, and the file is not left behind."""
    service = recorder(tmp_path, keep_free_mb=1e9)
    with pytest.raises(HardwareError, match="are kept free"):
        ask(service, "start", file="run.mcap")
    assert list((tmp_path / "rec").iterdir()) == []


def test_start_at_once_never_keeps_the_recorder_from_starting(tmp_path: Path) -> None:
    """It says what is wrong and tries again; once there is a place it records, and `stop` ends the trying."""
    (tmp_path / "rec").write_text("a file where the folder should be")
    service = recorder(tmp_path, start_at_once=True)
    status, faults = told(service.tick(NS_PER_S))
    assert (status.state, len(faults)) == ("fault", 1)
    assert "tried again every 10 s" in status.detail
    assert status.todo == faults[0].todo != ""
    assert told(service.tick(5 * NS_PER_S))[1] == []
    (tmp_path / "rec").unlink()
    assert told(service.tick(12 * NS_PER_S))[0].detail.startswith("recording to ")
    ask(service, "stop")
    assert told(service.tick(40 * NS_PER_S))[0].detail == "not recording"


@pytest.mark.parametrize(
    "file", ["../run.mcap", "/tmp/run.mcap", "a/../../run.mcap", "out/run.mcap", "gone.mcap", ".", "round/x", 7, "a\0b"]
)
def test_files_are_made_below_the_folder_only(tmp_path: Path, file: object) -> None:
    """Neither `..`, nor another absolute path, nor a link leads out of it; nothing is made anywhere."""
    service, outside = recorder(tmp_path), tmp_path / "outside"
    outside.mkdir()
    (tmp_path / "rec").mkdir()
    (tmp_path / "rec" / "out").symlink_to(outside)
    (tmp_path / "rec" / "gone.mcap").symlink_to(outside / "run.mcap")
    (tmp_path / "rec" / "round").symlink_to(tmp_path / "rec" / "round")
    before = sorted(tmp_path.rglob("*"))
    with pytest.raises(UsageError):
        ask(service, "start", file=file)
    assert sorted(tmp_path.rglob("*")) == before
    assert told(service.tick(NS_PER_S))[0].detail == "not recording"


def test_files_below_the_folder_are_made(tmp_path: Path) -> None:
    """By name, in a folder of their own, or by their absolute path; what is there is never overwritten."""
    service = recorder(tmp_path)
    for file in ("a.mcap", "day/b.mcap", str(tmp_path / "rec" / "c.mcap")):
        path = Path(ask(service, "start", file=file)["file"])
        assert path.is_relative_to(tmp_path / "rec")
        ask(service, "stop")
        with pytest.raises(UsageError, match="is there already"):
            ask(service, "start", file=file)


@pytest.mark.parametrize("args", [{"topic": ["wrench/"]}, {"topics": "wrench/"}, {"topics": [1]}, {"topics": {"a": 1}}])
def test_arguments_of_start_are_checked(tmp_path: Path, args: dict[str, Any]) -> None:
    """Unknown keys and wrong types begin nothing."""
    with pytest.raises((CommandRejectedError, UsageError)):
        ask(recorder(tmp_path), "start", **args)
    assert not (tmp_path / "rec").exists()


def test_recording_of_a_killed_recorder_goes_on_within_the_same_daemon_only(tmp_path: Path) -> None:
    """The next process is told by the snapshot; another daemon's recording is not taken up. Both say that it was cut off."""
    first = recorder(tmp_path)
    path = ask(first, "start", file="run.mcap", topics=["wrench/"])["file"]
    assert first.keep_now
    kept = msgspec.json.decode(msgspec.json.encode(first.snapshot()))

    second = recorder(tmp_path)
    assert second.restore(kept)
    status, (fault,) = told(second.tick(NS_PER_S))
    assert status.detail.startswith("recording to ")
    assert (fault.where, "goes on in" in fault.what) == (path, True)
    assert second.snapshot()["recording"]["topics"] == kept["recording"]["topics"]
    second.close()
    assert second.snapshot()["recording"] == {}

    third = recorder(tmp_path, daemon=8)
    assert third.restore(kept)
    status, (fault,) = told(third.tick(NS_PER_S))
    assert status.detail == "not recording"
    assert "nothing is being recorded" in fault.what
    first.close()


def test_daemon_starts_without_a_place_to_record_and_a_killed_recorder_goes_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """`start_at_once` where no file can be made: ready all the same. Then a recording outlives a SIGKILL."""
    services = trees.TABLES["services"] | {"recorder": "galen_hw.services.recorder:RecorderService"}
    monkeypatch.setitem(trees.TABLES, "services", services)
    folder = tmp_path / "rec"
    folder.write_text("a file where the folder should be")
    with daemon_tree(tmp_path) as tree:
        tree.write_config(f'[services.recorder]\ndirectory = "{folder}"\nstart_at_once = true\nkeep_free_mb = 0')
        tree.start_ready()
        assert tree.call("recorder", "stop") == {"file": "", "messages": 0}
        folder.unlink()
        first = Path(tree.call("recorder", "start", file="run.mcap", topics=["joints/"])["file"])
        kept = tree.folder / "state" / "services" / "recorder.json"
        assert within(10.0, lambda: kept.exists() and b"run.mcap" in kept.read_bytes())
        assert within(10.0, lambda: first.stat().st_size > 2000)
        with tree.subscriber("fault") as faults:
            os.kill(tree.call("daemon", "info")["processes"]["recorder"], signal.SIGKILL)
            fault = (faults.receive(20.0) or ("", None))[1]
        assert isinstance(fault, Fault)
        assert "was killed" in fault.what
        second = Path(fault.what.rpartition("goes on in ")[2])
        assert within(10.0, lambda: second.stat().st_size > 2000)
        assert tree.call("recorder", "stop")["file"] == str(second)
        for path in (first, second):
            assert any(isinstance(item.message, JointsState) for item in McapFile(path))

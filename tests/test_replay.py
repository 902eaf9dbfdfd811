"""Replay: what the services made of the recorded messages is made again, bit for bit, and what differs is found."""

import random
import re
import socket
from collections.abc import Iterator
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

from galen_hw.cli import main
from galen_hw.messages import Message, WrenchCompensated
from galen_hw.recording import read_recording, write_table
from galen_hw.recording.mcap_reader import McapFile
from galen_hw.recording.session import Session
from galen_hw.recording.to_mcap import write_mcap
from galen_hw.services.compensation.replay import Recorded, service_for, verify
from tests.compensation_parts import (
    BASE,
    MS,
    ROBOT,
    ask,
    feed,
    joints,
    messages,
    raw,
    service_at,
    six,
    tool_file,
    true_wrench,
)


def live(folder: Path, seconds: float = 1.2, **settings: Any) -> Iterator[tuple[str, Message]]:
    """Messages of a live run as a recorder sees them, with commands on the way and messages overtaking each other."""
    tool = tool_file()
    service = service_at(folder, tool, tool_file(name="pointer", mass=0.15), tare_samples=20, blend_s=0.1, **settings)
    rng, chance = np.random.default_rng(5), random.Random(5)
    requests = {
        150: ask("tare"),
        300: ask("set_enabled", enabled=False),
        330: ask("set_enabled", enabled=True),
        500: ask("select_tool", tool="pointer"),
        700: ask("set_contact", x=0.01, y=0.02, z=0.03),
        800: ask("reload"),
        900: ask("untare"),
    }
    held: list[tuple[str, Message]] = []
    for t_ms in range(1, round(seconds * 1000)):
        q, dq = 0.4 * np.sin(t_ms * 2e-3 + np.arange(5)), 0.8 * np.cos(t_ms * 2e-3 + np.arange(5))
        passing: list[tuple[str, Message]] = []
        if t_ms % 25 == 1:
            state = joints((t_ms - 1) * MS + 300_000, q, dq, seq=t_ms // 25)
            passing += [o for o in feed(service, state) if isinstance(o, tuple)]
            passing.append(("joints/state", state))
        if t_ms in requests:
            service.request(requests[t_ms], t_ms * MS)
        sample = raw(t_ms * MS + chance.randrange(1000), true_wrench(tool, q) + rng.normal(0, 0.01, 6), seq=t_ms)
        passing += [o for o in feed(service, sample) if isinstance(o, tuple)]
        passing += [("wrench/raw", sample)]
        passing += [o for o in service.tick(t_ms * MS) if isinstance(o, tuple)]
        held += passing
        # Different processes publish: joints overtake wrenches and the other way round.
        chance.shuffle(held)
        held.sort(key=lambda item: item[1].t_ns + chance.randrange(4 * MS) * (item[0] == "joints/state"))
        keep = 6
        yield from held[:-keep]
        held = held[-keep:]
    yield from held


def record(path: Path, stream: Iterator[tuple[str, Message]], encoding: Any = "json") -> Path:
    """Write messages as the recorder does."""
    with path.open("wb") as file:
        session = Session(file, robot="galen", encoding=encoding)
        for i, (topic, message) in enumerate(stream):
            session.add(topic, message, BASE.wall_minus_monotonic_ns + i * MS)
        session.finish()
    return path


def recorded(path: Path) -> Recorded:
    """What a replay needs of a file."""
    return Recorded((item.topic, item.message) for item in McapFile(path))


@pytest.mark.parametrize("encoding", ["json", "msgpack"])
@pytest.mark.parametrize("settings", [{}, {"alignment": "interpolate"}, {"dynamic": True, "dynamic_window": 3}])
def test_a_replay_repeats_every_bit(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], encoding: str, settings: dict[str, Any]
) -> None:
    """Tool, toggle, tare, contact and reload change on the way, and messages arrive in another order than they had."""
    path = record(tmp_path / "run.mcap", live(tmp_path / "state", **settings), encoding)
    assert main(["replay", str(path), "--verify"]) == 0
    (line,) = capsys.readouterr().out.splitlines()
    count = len(recorded(path).compensated)
    assert count > 1100
    assert line == f"{count} samples are equal, bit for bit"


def test_one_bit_is_a_difference(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The last bit of one torque of one sample is found, named, and makes the command fail."""

    def tampered() -> Iterator[tuple[str, Message]]:
        for topic, message in live(tmp_path / "state"):
            if isinstance(message, WrenchCompensated) and message.seq == 555 and topic == "wrench/compensated":
                bent = msgspec.structs.replace(message.torque, y=float(np.nextafter(message.torque.y, 1.0)))
                yield topic, msgspec.structs.replace(message, torque=bent)
            else:
                yield topic, message

    path = record(tmp_path / "run.mcap", tampered())
    assert main(["replay", str(path), "--verify"]) == 1
    (line,) = capsys.readouterr().out.splitlines()
    assert line.startswith("differs after 555 equal samples: sample 555 ")
    assert ": torque was Vector3(" in line


def test_a_recording_that_begins_in_the_middle_is_compared_where_it_can_be(tmp_path: Path) -> None:
    """Without the service's beginning the first second may be missing, with its count and reason; the rest is equal."""
    stream = [item for item in live(tmp_path / "state", seconds=3.0) if item[1].t_ns > 1_000 * MS]
    everything = recorded(record(tmp_path / "run.mcap", iter(stream)))
    verdict = verify(everything, service_for(everything, ROBOT, tmp_path / "none"))
    assert verdict.difference is None
    assert verdict.compared > 1000
    assert sum(verdict.skipped.values()) + verdict.compared == len(everything.compensated)
    assert "the compensation's state was not recorded yet" in verdict.skipped


def test_lost_messages_are_named_and_not_taken_for_differences(tmp_path: Path) -> None:
    """A raw wrench or a joint state that the recorder lost makes some samples incomparable, no more."""
    stream = [
        item
        for item in live(tmp_path / "state")
        if not (item[0] == "wrench/raw" and item[1].seq in {400, 401})
        and not (item[0] == "joints/state" and item[1].seq == 20)
    ]
    everything = recorded(record(tmp_path / "run.mcap", iter(stream)))
    verdict = verify(everything, service_for(everything, ROBOT, tmp_path / "none"))
    assert verdict.difference is None
    assert verdict.skipped["their raw wrench was not recorded"] == 2
    assert 20 <= verdict.skipped["its joint state was not recorded"] <= 30


def without(stream: Iterator[tuple[str, Message]], first_ms: int, last_ms: int) -> Iterator[tuple[str, Message]]:
    """What a reader gets of a file with a damaged chunk: nothing of any topic for a while."""
    return (item for item in stream if not first_ms * MS <= item[1].t_ns < last_ms * MS)


@pytest.mark.parametrize("settings", [{}, {"alignment": "interpolate"}, {"dynamic": True, "dynamic_window": 3}])
@pytest.mark.parametrize(("first", "last"), [(400, 460), (480, 560), (560, 810), (140, 420), (880, 960)])
def test_a_damaged_recording_is_equal_where_it_can_be_compared(
    tmp_path: Path, first: int, last: int, settings: dict[str, Any]
) -> None:
    """All topics are lost for a while, with and without a change of tool, tare or contact in it: what is missing and what
    depends on it is counted with the reason, the rest is equal; one bit of it is still a difference."""
    messages_ = list(live(tmp_path / "state", seconds=2.4, **settings))
    everything = recorded(record(tmp_path / "run.mcap", without(iter(messages_), first, last)))
    verdict = verify(everything, service_for(everything, ROBOT, tmp_path / "none"))
    assert verdict.difference is None
    assert verdict.skipped["they are missing from the recording"] == pytest.approx(last - first, abs=3)
    total = sum(topic == "wrench/compensated" for topic, _ in messages_)
    assert sum(verdict.skipped.values()) + verdict.compared == total
    assert verdict.compared > total - (last - first) - 1050

    at = next(i for i, m in enumerate(everything.compensated) if m.seq == 2300)
    right = everything.compensated[at]
    bent = msgspec.structs.replace(right.force, x=float(np.nextafter(right.force.x, np.inf)))
    everything.compensated[at] = msgspec.structs.replace(right, force=bent)
    again_ = verify(everything, service_for(everything, ROBOT, tmp_path / "none"))
    assert again_.difference is not None
    assert (again_.difference.seq, again_.difference.field) == (2300, "force")


def test_only_raw_samples_are_missing_and_nothing_differs(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Wrenches of both kinds are lost: status 0, and the count with its reason; a number that comes twice differs."""
    kept = [
        item
        for item in live(tmp_path / "state")
        if not (item[0].startswith("wrench/") and 400 <= item[1].seq % 2000 < 440)
    ]
    path = record(tmp_path / "run.mcap", iter(kept))
    assert main(["replay", str(path), "--verify"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert any(line.endswith("samples cannot be compared: they are missing from the recording") for line in lines)
    assert lines[-1].endswith("samples are equal, bit for bit")

    everything = recorded(path)
    twice = everything.compensated[700]
    everything.compensated[700] = msgspec.structs.replace(twice, seq=twice.seq - 1)
    verdict = verify(everything, service_for(everything, ROBOT, tmp_path / "none"))
    assert verdict.difference is not None
    assert verdict.difference.field == "seq"


def test_another_tool_can_be_tried_on_a_recording(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """--tool compensates an imported table with a stored calibration and prints what is left: here next to nothing."""
    tool = tool_file()
    service_at(tmp_path / "state", tool)
    monkeypatch.setenv("GALEN_HW_STATE", str(tmp_path / "state"))
    q = np.random.default_rng(0).uniform(-0.8, 0.8, (50, 5))
    wrench = np.array([true_wrench(tool, row) for row in q])
    from galen_hw.recording import WRENCH, Recording, RecordingInfo

    columns = {f"joint.{n}.position": q[:, i] for i, n in enumerate(ROBOT.joint_names)}
    table = Recording(columns | dict(zip(WRENCH, wrench.T, strict=True)), RecordingInfo(robot="galen"))
    write_table(table, tmp_path / "table")
    assert main(["import", str(tmp_path / "table"), "-o", str(tmp_path / "table.mcap")]) == 0
    capsys.readouterr()
    assert main(["replay", str(tmp_path / "table.mcap"), "--tool", "retractor"]) == 0
    head, _, raw_line, left_line, _ = capsys.readouterr().out.splitlines()
    assert head.startswith("50 of 50 samples, compensated with retractor/0001-")
    assert max(float(x) for x in left_line.split()[2:]) < 1e-4 < 1.0 < max(float(x) for x in raw_line.split()[2:])
    assert main(["replay", str(tmp_path / "table.mcap"), "--verify"]) == 2
    assert "nothing to verify" in capsys.readouterr().err


def test_the_live_compensated_wrench_can_be_exported_beside_the_raw_one(tmp_path: Path) -> None:
    """--compensated adds it as covariates, sample by sample; without it nothing but measurements is in the table."""
    path = record(tmp_path / "run.mcap", live(tmp_path / "state", seconds=0.3))
    assert main(["export", str(path), str(tmp_path / "out"), "--compensated"]) == 0
    table = read_recording(tmp_path / "out")
    live_ = {m.t_ns: six(m) for m in recorded(path).compensated}
    first = next(iter(recorded(path).raw))
    names = [f"covariate.compensated.{k}.{a}" for k in ("force", "torque") for a in "xyz"]
    assert table.matrix(*names)[5] == pytest.approx(live_[sorted(live_)[5]], abs=0.0)
    assert first in live_
    assert not [n for n in read_recording(path).columns if "compensated" in n]


def test_a_replay_survives_going_through_a_table(tmp_path: Path) -> None:
    """MCAP to table to MCAP: the raw wrenches are the same bits."""
    path = record(tmp_path / "run.mcap", live(tmp_path / "state", seconds=0.3))
    first = read_recording(path)
    write_table(first, tmp_path / "table")
    second = read_recording(write_mcap(read_recording(tmp_path / "table"), tmp_path / "again.mcap"))
    assert list(first.columns) == list(second.columns)
    for name, values in first.columns.items():
        assert np.array_equal(values, second.columns[name], equal_nan=True), name


def test_messages_of_the_service_are_what_the_tests_feed(tmp_path: Path) -> None:
    """The live run is a real one: it is valid and compensated to the noise."""
    out = [m for _, m in live(tmp_path, seconds=0.14) if isinstance(m, WrenchCompensated)]
    assert all(m.valid for m in out[2:])
    assert np.abs([six(m) for m in out if m.source == "compensation"][4:]).max() < 0.3
    assert messages([]) == []


def test_a_replay_beside_a_daemon_is_published_at_a_free_port(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The viewers' usual port is taken, by this test or by a daemon of this machine: another one is, and it is printed."""
    path = record(tmp_path / "run.mcap", live(tmp_path / "state", seconds=0.05))
    capsys.readouterr()
    with ExitStack() as stack:
        with suppress(OSError):
            stack.enter_context(socket.create_server(("127.0.0.1", 9872)))
        assert main(["replay", str(path), "--publish", "--speed", "100", "--dir", str(tmp_path / "bus")]) == 0

    found = re.search(r" and tcp://127\.0\.0\.1:(\d+); Ctrl-C ends it", capsys.readouterr().out)
    assert found is not None
    assert int(found[1]) not in (0, 9872)


def test_a_replay_is_published_where_the_settings_say(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The port of --config, and another one, printed, where it is taken."""
    with socket.socket() as taken, socket.socket() as free:
        for one in (taken, free):
            one.bind(("127.0.0.1", 0))
        taken.listen()
        ports = [one.getsockname()[1] for one in (taken, free)]
        free.close()
        path = tmp_path / "run.mcap"
        with path.open("wb") as stream:
            session = Session(stream)
            session.add("wrench/raw", raw(0, [1.0] * 6, seq=0), 1)
            session.finish()
        files = [tmp_path / f"{port}.toml" for port in ports]
        for file, port in zip(files, ports, strict=True):
            file.write_text(f'[bus]\nviewers = "tcp://127.0.0.1:{port}"\n')
        publish = ["replay", str(path), "--publish", "--dir", str(tmp_path / "rt"), "--config"]
        assert main([*publish, str(files[0])]) == 0
        said = capsys.readouterr().out
        assert "tcp://127.0.0.1:" in said
        assert f":{ports[0]};" not in said
        assert main([*publish, str(files[1])]) == 0
        assert f"tcp://127.0.0.1:{ports[1]}" in capsys.readouterr().out
    files[0].write_text('[bus]\nviewers = "tcp://0.0.0.0:9"\n')
    assert main([*publish, str(files[0])]) == 2
    assert f"{files[0].name}:2: bus.viewers" in capsys.readouterr().err

"""Recordings by their URL: an S3 server of this machine, memory and files through fsspec; what is not there is one line."""

import importlib.util
import json
import shutil
import socket
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from galen_hw.cli import main
from galen_hw.errors import UsageError
from galen_hw.extras import MissingExtraError
from galen_hw.formats.remote import Remote, at_hand, place, recordings_in
from tests import diagnosis_parts as parts
from tests import import_files as made

fsspec = pytest.importorskip("fsspec", reason="fsspec is not installed: pip install 'galen-hw[remote]'")
S3 = all(importlib.util.find_spec(name) for name in ("s3fs", "moto", "flask"))
SERVER = """
import sys
from moto.server import ThreadedMotoServer
server = ThreadedMotoServer(ip_address="127.0.0.1", port=0, verbose=False)
server.start()
print(server.get_host_and_port()[1], flush=True)
sys.stdin.read()
server.stop()
"""
# botocore's own warnings are none of ours.
pytestmark = pytest.mark.filterwarnings("default")


@pytest.fixture(scope="module")
def endpoint() -> Iterator[str]:
    """The address of an S3 server, a process of its own, that ends with its standard input."""
    with subprocess.Popen(
        [sys.executable, "-c", SERVER],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
    ) as server:
        assert server.stdout is not None
        port = server.stdout.readline().strip()
        try:
            yield f"http://127.0.0.1:{port}"
        finally:
            server.communicate(timeout=20)


@pytest.fixture
def s3(endpoint: str, monkeypatch: pytest.MonkeyPatch, request: pytest.FixtureRequest) -> tuple[Any, str]:
    """A file system, and a bucket of the test's own."""
    for name, value in (
        ("AWS_ENDPOINT_URL", endpoint),
        ("AWS_ACCESS_KEY_ID", "key"),
        ("AWS_SECRET_ACCESS_KEY", "word"),
        ("AWS_DEFAULT_REGION", "us-east-1"),
    ):
        monkeypatch.setenv(name, value)
    # A file system of an earlier test knows an earlier server.
    fsspec.get_filesystem_class("s3").clear_instance_cache()
    system = fsspec.filesystem("s3")
    bucket = f"lab{abs(hash(request.node.name)) % 10**8}"
    system.mkdir(bucket)
    return system, bucket


needs_s3 = pytest.mark.skipif(not S3, reason="an S3 server is not installed: pip install 's3fs' 'moto[server]'")


@pytest.fixture
def memory() -> Iterator[Any]:
    system = fsspec.filesystem("memory")
    yield system
    system.rm("/", recursive=True)


def answer_to(*words: str, out: Path, status: int = 1) -> Any:
    assert main([*words, "-o", str(out)]) == status
    return json.loads(out.read_text())


@needs_s3
def test_a_file_in_object_storage_is_diagnosed_in_one_command(s3: tuple[Any, str], tmp_path: Path) -> None:
    """With the map and the robot that lie beside it; the answer names the URL, and nothing that was fetched is left."""
    system, bucket = s3
    (tmp_path / "log").mkdir()
    made.libfranka(tmp_path / "log")
    system.put(str(tmp_path / "log"), f"{bucket}/franka", recursive=True)
    url = f"s3://{bucket}/franka/log.csv"
    found = answer_to("diagnose", url, out=tmp_path / "a.json")
    here = answer_to("diagnose", str(tmp_path / "log" / "log.csv"), out=tmp_path / "b.json")
    assert found.pop("recording") == url
    assert here.pop("recording") == str(tmp_path / "log" / "log.csv")
    assert found["findings"] == here["findings"]
    assert found["findings"][0]["effect"] == "payload"
    assert main(["import", url, "-o", str(tmp_path / "run")]) == 0
    assert (tmp_path / "run" / "arm.urdf").is_file()


@needs_s3
def test_a_folder_of_recordings_in_object_storage(
    s3: tuple[Any, str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Table folders and MCAP files, each on its own, as in a folder of this machine; a bag is one recording."""
    system, bucket = s3
    run = parts.write_table(parts.late(0.02), tmp_path / "late")
    assert main(["import", str(run), "-o", str(tmp_path / "late.mcap")]) == 0
    system.put(str(run), f"{bucket}/day/late", recursive=True)
    system.put(str(tmp_path / "late.mcap"), f"{bucket}/day/late.mcap")
    system.put(str(made.rosbag2(tmp_path)), f"{bucket}/bag", recursive=True)
    urls = [f"s3://{bucket}/day/late", f"s3://{bucket}/day/late.mcap"]
    assert [str(one) for one in recordings_in(place(f"s3://{bucket}/day/"))] == urls
    assert recordings_in(place(f"s3://{bucket}/bag")) == [Remote(f"s3://{bucket}/bag")]
    capsys.readouterr()
    assert main(["check", "--json", f"s3://{bucket}/day", f"s3://{bucket}/bag"]) == 0
    told = json.loads(capsys.readouterr().out)["recordings"]
    assert [one["recording"] for one in told] == [*urls, f"s3://{bucket}/bag"]
    assert [one["rows"] for one in told] == [parts.ROWS, parts.ROWS, made.N]


@needs_s3
def test_many_recordings_in_object_storage_are_worked_on_side_by_side(s3: tuple[Any, str], tmp_path: Path) -> None:
    """Each process fetches its own; judged on another recording there."""
    from joblib.externals.loky import get_reusable_executor

    system, bucket = s3
    assert main(["import", str(made.plain_csv(tmp_path)), "-o", str(tmp_path / "run")]) == 0
    for name in ("day/one", "day/two", "judge"):
        system.put(str(tmp_path / "run"), f"{bucket}/{name}", recursive=True)
    get_reusable_executor().shutdown(wait=True)  # processes of an earlier test know another server
    words = ["--holdout", f"s3://{bucket}/judge"]
    found = answer_to("diagnose", f"s3://{bucket}/day", *words, out=tmp_path / "a.json")
    get_reusable_executor().shutdown(wait=True)
    assert [one["recording"] for one in found] == [f"s3://{bucket}/day/{name}" for name in ("one", "two")]
    assert [one["holdout"] for one in found] == [f"s3://{bucket}/judge"] * 2
    assert [one["findings"][0]["effect"] for one in found] == ["payload"] * 2


@needs_s3
@pytest.mark.parametrize(
    ("url", "said"),
    [
        ("s3://BUCKET/none.mcap", "s3://BUCKET/none.mcap: there is no such recording; check the URL"),
        ("s3://no-such-bucket/run", "there is no such recording"),
        ("s3://BUCKET/bad.csv", "s3://BUCKET/bad.csv"),
    ],
)
def test_what_is_not_there_or_no_recording_is_one_line(
    url: str, said: str, s3: tuple[Any, str], capsys: pytest.CaptureFixture[str]
) -> None:
    system, bucket = s3
    system.pipe(f"{bucket}/bad.csv", b"Dear all,\nno.\n")
    for command in ("diagnose", "check"):
        assert main([command, url.replace("BUCKET", bucket)]) == 2
        (line,) = capsys.readouterr().err.splitlines()
        assert said.replace("BUCKET", bucket) in line
        assert "galen-hw-fetched" not in line


@needs_s3
def test_a_storage_that_does_not_answer_is_one_line(
    monkeypatch: pytest.MonkeyPatch, s3: tuple[Any, str], capsys: pytest.CaptureFixture[str]
) -> None:
    """A port on which nothing listens; no credentials."""
    with socket.create_server(("127.0.0.1", 0)) as held:
        port = held.getsockname()[1]
    monkeypatch.setenv("AWS_ENDPOINT_URL", f"http://127.0.0.1:{port}")
    monkeypatch.setenv("AWS_MAX_ATTEMPTS", "1")
    fsspec.get_filesystem_class("s3").clear_instance_cache()
    assert main(["check", "s3://lab/run.mcap"]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("galen-hw check: s3://lab/run.mcap: cannot be fetched (")


def test_memory_and_file_are_places_too(memory: Any, tmp_path: Path) -> None:
    """A shared path is a path: nothing is copied; of memory all is, and removed."""
    path = made.plain_csv(tmp_path)
    assert place(f"file://{path}") == path
    memory.put(str(path), "/lab/run.csv")
    with at_hand([place("memory://lab/run.csv"), place(str(path))]) as (fetched, same):
        assert same == path
        assert fetched.name == "run.csv"
        assert fetched.read_bytes() == path.read_bytes()
    assert not fetched.exists()
    answer = answer_to("diagnose", "memory://lab/run.csv", out=tmp_path / "a.json")
    assert answer["recording"] == "memory://lab/run.csv"
    assert answer["findings"][0]["effect"] == "payload"


def test_a_name_that_leads_elsewhere_is_refused(memory: Any) -> None:
    """Keys of object storage may hold anything."""
    memory.store["/lab/run/../../../outside.csv"] = fsspec.get_filesystem_class("memory")().open("/lab/x", "wb")
    memory.pipe("/lab/run/recording.csv", b"time\n0\n")
    memory.pseudo_dirs.append("/lab/run")
    with pytest.raises(UsageError, match=r"a name with '\.\.' in it"), at_hand([Remote("memory://lab/run")]):
        pass


def test_what_has_no_room_is_not_begun(memory: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    memory.pipe("/lab/run.csv", b"x" * 2_000_000)
    seen = shutil.disk_usage("/")._replace(free=1_000_000)
    monkeypatch.setattr(shutil, "disk_usage", lambda _: seen)
    with pytest.raises(UsageError, match="2 MB, where 1 MB are free"), at_hand([Remote("memory://lab/run.csv")]):
        pass


@pytest.mark.parametrize(
    ("url", "said"),
    [("nonsense://a/b", "cannot be fetched"), ("gs://lab/run.mcap", "this storage needs a package")],
)
def test_other_storages_say_what_they_need(url: str, said: str) -> None:
    if url.startswith("gs") and importlib.util.find_spec("gcsfs"):
        pytest.skip("gcsfs is installed")
    with pytest.raises(UsageError, match=said):
        recordings_in(place(url))


def test_without_fsspec_it_is_said_what_to_type(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "fsspec", None)
    with pytest.raises(MissingExtraError, match=r"fsspec is not installed; pip install 'galen-hw\[remote\]'"):
        recordings_in(place("s3://lab/run.mcap"))

"""Many recordings on many processes: who does the work, and what is said of one that cannot be done."""

import os
import pickle
import signal
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from galen_hw.cli import main
from galen_hw.config.problems import ConfigError, Problem
from galen_hw.errors import CommandRejectedError, GalenError, HardwareError, UsageError
from galen_hw.extras import MissingExtraError
from galen_hw.tools.clusters import on_cluster
from tests import diagnosis_parts as parts

pytestmark = [pytest.mark.slow, pytest.mark.timeout(300)]


@pytest.fixture
def scheduler() -> Iterator[str]:
    """The address of a cluster of one process with one thread."""
    distributed = pytest.importorskip("distributed", reason="dask is not installed: pip install 'galen-hw[dask]'")
    made: Any = distributed.LocalCluster
    with made(n_workers=1, threads_per_worker=1, processes=True, dashboard_address=None) as cluster:
        yield cluster.scheduler_address


def process_of(item: int) -> tuple[int, int]:
    return item, os.getpid()


def deadly(item: str) -> str:
    os.kill(os.getpid(), signal.SIGKILL)
    return item


@pytest.mark.filterwarnings("default")
def test_one_worker_works_and_the_client_does_not(scheduler: str) -> None:
    """A client may be a laptop: with joblib's back-end it did the work itself where the cluster had one thread."""
    found = dict(on_cluster(scheduler, process_of, range(5)))
    assert sorted(found) == list(range(5))
    assert len(set(found.values())) == 1
    assert os.getpid() not in found.values()


@pytest.mark.filterwarnings("default")
def test_what_kills_each_worker_is_named(scheduler: str) -> None:
    """Not given to workers for ever, and no traceback of Dask's: one line with the recording's name."""
    with pytest.raises(UsageError, match=r"run7: every worker that took it up has died; see the workers' logs"):
        list(on_cluster(scheduler, deadly, ["run7"]))


@pytest.mark.parametrize("kind", [GalenError, UsageError, HardwareError, CommandRejectedError, MissingExtraError])
def test_an_error_is_the_same_from_another_process(kind: type[GalenError]) -> None:
    """Its kind, its three parts, its line and its status."""
    error = kind("no such column", where="run/recording.csv", todo="name it")
    again = pickle.loads(pickle.dumps(error))
    assert type(again) is kind
    assert (str(again), again.what, again.where, again.todo) == (str(error), error.what, error.where, error.todo)


def test_settings_keep_all_their_problems_from_another_process() -> None:
    """Not only the first."""
    error = ConfigError([Problem("a.toml:1: x", "no number"), Problem("a.toml:2: y", "no number", "give one")])
    assert str(pickle.loads(pickle.dumps(error))) == str(error)


def test_one_recording_of_a_folder_that_cannot_be_read_is_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Status 2 and one line with its name; it was an internal error of the process pool."""
    for name in ("good", "bad"):
        parts.write_table(parts.late(0.02), tmp_path / name)
    (tmp_path / "bad/recording.json").write_text("{")
    assert main(["diagnose", str(tmp_path)]) == 2
    said = capsys.readouterr().err
    assert "bad/recording.json" in said
    assert "internal error" not in said

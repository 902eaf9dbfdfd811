"""A folder of recordings on a Dask cluster of processes: the answers of this machine, and a worker that dies loses nothing."""

import json
import os
import signal
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from galen_hw.cli import main
from tests import diagnosis_parts as parts

distributed = pytest.importorskip("distributed", reason="dask is not installed: pip install 'galen-hw[dask]'")

pytestmark = [pytest.mark.long, pytest.mark.timeout(900), pytest.mark.filterwarnings("default")]
DELAYS_S = (0.02, 0.04)
DRIFTS_N = (0.06, 0.1)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Four recordings side by side."""
    out = tmp_path_factory.mktemp("many")
    for i, (delay, drift) in enumerate(zip(DELAYS_S, DRIFTS_N, strict=True)):
        parts.write_table(parts.late(delay), out / f"late{i}")
        parts.write_table(parts.drifting(drift), out / f"drifting{i}")
    return out


def answers(folder: Path, out: Path, *words: str) -> list[dict[str, Any]]:
    """What `diagnose` says of each, without the moment when it was said."""
    assert main(["diagnose", str(folder), "-o", str(out), *words]) == 1
    found: list[dict[str, Any]] = json.loads(out.read_text())
    return [{key: value for key, value in answer.items() if key != "date"} for answer in found]


@pytest.fixture(scope="module")
def here(folder: Path, tmp_path_factory: pytest.TempPathFactory) -> list[dict[str, Any]]:
    """The answers of this machine's own processes."""
    return answers(folder, tmp_path_factory.mktemp("here") / "a.json")


@pytest.fixture
def cluster() -> Iterator[Any]:
    """Two workers, each a process with a thread and a nanny that starts it again."""
    with distributed.LocalCluster(n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None) as found:
        yield found


def test_processes_give_the_same_answers(
    folder: Path, here: list[dict[str, Any]], cluster: Any, tmp_path: Path
) -> None:
    """Every key of every answer, in the order of the folder, bit for bit."""
    assert [Path(a["recording"]).name for a in here] == sorted(p.name for p in folder.iterdir())
    assert [a["findings"][0]["effect"] for a in here] == ["drift"] * 2 + ["time_delay"] * 2
    assert answers(folder, tmp_path / "a.json", "--dask", cluster.scheduler_address) == here


def test_a_worker_that_is_killed_loses_nothing(
    folder: Path, here: list[dict[str, Any]], cluster: Any, tmp_path: Path
) -> None:
    """SIGKILL while it works on a recording: another takes that up, and all answers are those of this machine."""
    killed: list[int] = []
    ended = threading.Event()

    def kill_one_at_work() -> None:
        with distributed.Client(cluster.scheduler_address) as client:
            while not killed and not ended.wait(0.05):
                pids = client.run(os.getpid)
                busy = [address for address, tasks in client.call_stack().items() if tasks and address in pids]
                for address in busy[:1]:
                    os.kill(pids[address], signal.SIGKILL)
                    killed.append(pids[address])

    killer = threading.Thread(target=kill_one_at_work)
    killer.start()
    try:
        found = answers(folder, tmp_path / "a.json", "--dask", cluster.scheduler_address)
    finally:
        ended.set()
        killer.join()
    assert killed, "no worker was at work"
    assert found == here
    with distributed.Client(cluster.scheduler_address) as client:
        assert killed[0] not in client.run(os.getpid).values()

"""Processes that begin with everything loaded, and what becomes of them when the process that forks them is gone."""

import os
import re
import signal
import subprocess
import sys
from collections import Counter
from pathlib import Path

import pytest

from galen_hw.config.paths import DEFAULT_CONFIG
from tests.daemon_tree import Tree, alive, daemon_tree, within
from tests.test_daemon_virtual import environ

PARTS = """
import os, signal, sys, time

def main():
    word, *more = sys.argv[1:]
    if word == "look":
        print(sys.stdin.read(), sorted(int(n) for n in os.listdir("/proc/self/fd") if int(n) < 1000), *more, flush=True)
        print(open("/proc/self/comm").read().strip(), signal.getsignal(signal.SIGTERM) is signal.SIG_DFL, flush=True)
    if word == "fail":
        raise ValueError("on purpose")
    if word == "leave":
        sys.exit(7)
    if word == "stay":
        sys.stdin.read()
    return 3
if __name__ == "__main__":
    sys.exit(main())
"""
START = """
import os, signal, sys
from galen_hw.daemon.fork_server import ForkServer
def pipe(text=b""):
    reading, writing = os.pipe()
    os.write(writing, text)
    return reading, writing
"""


def run(tmp_path: Path, code: str) -> subprocess.CompletedProcess[str]:
    """A program that starts processes, which are in `parts.py`."""
    (tmp_path / "parts.py").write_text(PARTS)
    path = os.pathsep.join([str(tmp_path), *sys.path])
    command = [sys.executable, "-c", START + code]
    return subprocess.run(
        command, env=os.environ | {"PYTHONPATH": path}, capture_output=True, text=True, check=False, timeout=60
    )


@pytest.mark.parametrize("how", ["", "os.kill(server.pid, signal.SIGKILL)", "os.kill(server.pid, signal.SIGSTOP)"])
def test_a_process_is_told_apart_by_its_status(tmp_path: Path, how: str) -> None:
    """Words, standard input, descriptors and every kind of end: the same with a server, with a killed and a stopped one."""
    done = run(
        tmp_path,
        f"""
with ForkServer() as server:
    {how or "pass"}
    reading, writing = pipe(b"read")
    os.close(writing)
    held, _ = pipe()
    one = server.start("parts", ["look", "b"], {{0: reading, held: held}})
    print(one.wait(20), one.poll(), server.start("parts", ["leave"]).wait(20), server.start("parts", ["fail"]).wait(20))
    reading, writing = pipe()
    other = server.start("parts", ["stay"], {{0: reading}})
    print(other.poll())
    other.kill()
    print(other.wait(20), held)
""",
    )
    assert done.returncode == 0, done.stderr
    seen, named, *rest = done.stdout.splitlines()
    held = rest[-1].split()[1]
    assert seen.startswith("read [0, 1, 2, ")
    assert held in seen
    assert seen.endswith(" b")
    if not how:
        assert named == "galen-look True"
    assert rest == ["3 3 7 70" if not how else "3 3 7 1", "None", f"-9 {held}"]
    assert done.stderr.count("ValueError: on purpose") == 1


def test_what_was_forked_outlives_the_server(tmp_path: Path) -> None:
    """Its end is seen all the same; only the status is not known."""
    done = run(
        tmp_path,
        """
with ForkServer() as server:
    reading, writing = pipe()
    one = server.start("parts", ["stay"], {0: reading})
    os.close(reading)
    os.kill(server.pid, signal.SIGKILL)
    print(one.poll())
    os.close(writing)
    print(one.wait(20))
""",
    )
    assert done.stdout.split() == ["None", "255"], done.stderr


def test_the_server_ends_with_its_maker(tmp_path: Path) -> None:
    """Also when that is killed; the whole group's SIGTERM is not for it to judge."""
    done = run(
        tmp_path,
        """
server = ForkServer()
os.kill(server.pid, signal.SIGTERM)
print(server.pid, server.start("parts", ["leave"]).wait(20), flush=True)
os.kill(os.getpid(), signal.SIGKILL)
""",
    )
    pid, status = done.stdout.split()
    assert status == "7", done.stderr
    assert within(5.0, lambda: not alive(int(pid)))


def test_the_daemon_loads_everything_once(tmp_path: Path) -> None:
    """What the start costs, told without a clock: six processes, and each library is loaded for all of them together.

    Those that read logs and fit models are not loaded at all, nor is what a real CAN bus needs on a virtual one.
    """
    config = tmp_path / "galen.toml"
    config.write_text(DEFAULT_CONFIG.read_text().replace('# viewers = "tcp://127.0.0.1:9872"', 'viewers = ""'))
    command = [sys.executable, "-m", "galen_hw.cli", "run", "--virtual", "--config", str(config)]
    with (tmp_path / "said").open("w") as said:
        process = subprocess.Popen(
            command,
            env=environ(tmp_path) | {"PYTHONPROFILEIMPORTTIME": "1"},
            text=True,
            stdout=subprocess.PIPE,
            stderr=said,
        )
        assert process.stdout is not None
        ready = process.stdout.readline()
        process.terminate()
        assert process.wait(30) == 0
        process.stdout.close()
    assert ready.startswith("ready")
    lines = (tmp_path / "said").read_text().splitlines()
    loaded = Counter(m[1] for line in lines if (m := re.match(r"import time: +\d+ \| +\d+ \| +(\S+)$", line)))
    assert loaded["galen_hw.daemon.host"] == loaded["galen_hw.drivers.virtual.world"] == 1
    assert loaded["pinocchio"] == loaded["numpy"] == loaded["pydantic"] == 1
    assert not {"scipy", "pandas", "asammdf", "can", "matplotlib", "sklearn"} & loaded.keys()


def server_of(pid: int) -> int:
    """The fork server of a daemon: its child of that name."""
    children = Path(f"/proc/{pid}/task/{pid}/children").read_text().split()
    return next(int(c) for c in children if Path(f"/proc/{c}/comm").read_text().strip() == "galen-fork")


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGSTOP])
def test_a_daemon_without_its_fork_server(tmp_path: Path, number: signal.Signals) -> None:
    """Nothing ends, and a process that dies is still started again."""
    with daemon_tree(tmp_path) as tree:
        tree.write_config()
        process = tree.start_ready()
        os.kill(server_of(process.pid), number)
        before = pids(tree)
        os.kill(before["core"], signal.SIGKILL)
        with tree.subscriber("wrench/raw") as bus:
            assert within(20.0, lambda: (heard := bus.receive(0.1)) is not None and heard[1].valid)
        after = pids(tree)
        assert after["core"] != before["core"]
        assert {n: p for n, p in after.items() if n != "core"} == {n: p for n, p in before.items() if n != "core"}
        status, said = tree.end()
        assert status == 0
        assert said.count("the fork server is gone") == 1


def pids(tree: Tree) -> dict[str, int]:
    found: dict[str, int] = tree.call("daemon", "info")["processes"]
    return found

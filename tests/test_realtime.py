"""Real time: the core's loop and ZeroMQ's thread on one core, the thread above, where that is permitted."""

import json
import os
import subprocess
import sys

import pytest

SHOW = """
import json, os, time, zmq
from pathlib import Path
from galen_hw.daemon.realtime import raise_priority, share_one_core
permitted = raise_priority({priority})
if permitted:
    share_one_core({priority})
socket = zmq.Context.instance().socket(zmq.PUB)
threads = {{}}
until = time.monotonic() + 30.0
tasks = Path("/proc/self/task")  # a thread gives itself its name once it runs
while not any("IO" in (t / "comm").read_text() for t in tasks.iterdir()) and time.monotonic() < until:
    time.sleep(0.01)
for task in tasks.iterdir():
    name, number = (task / "comm").read_text().strip(), int(task.name)
    level = os.sched_getparam(number).sched_priority
    threads[name] = [os.sched_getscheduler(number), level, sorted(os.sched_getaffinity(number))]
print(json.dumps([permitted, threads]))
"""


def threads(priority: int) -> dict[str, list[object]]:
    """Return policy, priority and cores of the loop ("loop") and of ZeroMQ's thread ("zmq") in a process of its own."""
    command = [sys.executable, "-c", SHOW.format(priority=priority)]
    done = subprocess.run(command, capture_output=True, text=True, check=True, timeout=60)
    permitted, found = json.loads(done.stdout)
    if not permitted:
        pytest.skip("SCHED_FIFO is not permitted here")
    return {
        "zmq" if name.startswith("ZMQbg/IO") else "loop" if "ZMQ" not in name else name: x for name, x in found.items()
    }


def test_sender_runs_above_the_loop_on_its_core() -> None:
    cores = os.sched_getaffinity(0)
    if len(cores) < 2:
        pytest.skip("one core alone")
    found = threads(20)
    assert found["loop"] == [os.SCHED_FIFO, 19, [max(cores)]]
    assert found["zmq"] == [os.SCHED_FIFO, 20, [max(cores)]]


def test_without_room_for_two_priorities_all_stays_as_it_was() -> None:
    found = threads(1)
    assert found["loop"] == found["zmq"] == [os.SCHED_FIFO, 1, sorted(os.sched_getaffinity(0))]

"""Faults in a running daemon: processes that stop or die at any stage, subscribers that do harm, a disk, a wall clock."""

import os
import signal
import socket
import time
from collections.abc import Iterator
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import Any

import pytest
import zmq

from galen_hw import clock
from galen_hw.bus import LARGEST_SUBSCRIPTION
from galen_hw.clock import NS_PER_S, TimeBase
from galen_hw.messages import WrenchCompensated
from tests.daemon_tree import Tree, alive, daemon_tree, within

BACK_S = 20.0
"""What a busy machine that tests is given; docs/faults.md has what was measured on a quiet one."""


@pytest.fixture
def tree(tmp_path: Path) -> Iterator[Tree]:
    with daemon_tree(tmp_path) as own:
        config = own.write_config()
        config.write_text(config.read_text().replace('viewers = ""', 'viewers = "tcp://127.0.0.1:0"'))
        yield own


def flows(tree: Tree) -> bool:
    """Whether valid compensated samples come that were made after now."""
    begun = time.monotonic_ns()
    with tree.subscriber("wrench/compensated") as subscriber:
        received = subscriber.receive(2.0)
        while received is not None and received[1].t_ns < begun:
            received = subscriber.receive(2.0)
        return received is not None and received[1].valid


@pytest.mark.parametrize("victim", ["core", "motion", "viewers"])
def test_a_process_that_stands_still_for_a_moment_harms_no_other(tree: Tree, victim: str) -> None:
    """SIGSTOP for 0.4 s, then SIGCONT: the same processes go on, samples flow, and commands are answered."""
    tree.start_ready()
    pids = tree.call("daemon", "info")["processes"]
    os.kill(pids[victim], signal.SIGSTOP)
    within(0.4, lambda: False)
    os.kill(pids[victim], signal.SIGCONT)
    assert within(BACK_S, lambda: flows(tree))
    assert tree.call("daemon", "info")["processes"] == pids
    assert tree.call("motors", "say", text="0.25") is not None


def test_a_supervisor_that_stands_still_costs_no_sample(tree: Tree) -> None:
    """SIGSTOP of the supervisor: samples flow on without a gap; SIGCONT: commands are answered again."""
    process = tree.start_ready()
    pids = tree.call("daemon", "info")["processes"]
    with tree.subscriber("wrench/compensated") as subscriber:
        os.kill(process.pid, signal.SIGSTOP)
        try:
            begun = time.monotonic_ns()
            heard: list[WrenchCompensated] = []
            while not heard or heard[-1].t_ns < begun + NS_PER_S:
                received = subscriber.receive(BACK_S)
                assert received is not None
                assert isinstance(received[1], WrenchCompensated)
                heard.append(received[1])
        finally:
            os.kill(process.pid, signal.SIGCONT)
        assert subscriber.lost == {}
    assert tree.call("daemon", "info", timeout_s=BACK_S)["processes"] == pids


@pytest.mark.parametrize("victim", ["core", "motion"])
def test_a_process_that_dies_before_the_first_sample_ends_the_start(tree: Tree, victim: str) -> None:
    """SIGKILL while the sensor has said nothing yet: one line, a status of its own, nothing left running."""
    tree.motors.chatter("0.5", every_s=0.02)
    process = tree.start()
    found: dict[str, int] = {}

    def up() -> bool:
        with suppress(Exception):
            found.update(tree.call("daemon", "info", timeout_s=1.0)["processes"])
        return all(found.get(name) for name in ("core", "motion"))

    assert within(BACK_S, up)
    os.kill(found[victim], signal.SIGKILL)
    _, stderr = process.communicate(timeout=30)
    assert process.returncode == 1
    assert f"{victim}: ended with status -9; giving up" in stderr
    assert within(BACK_S, lambda: not any(alive(pid) for pid in found.values() if pid))


def test_a_process_that_dies_again_and_again_ends_the_daemon(tree: Tree) -> None:
    """Six deaths within a minute are no accident: the motors rest, status 1; systemd decides what comes then."""
    process = tree.start_ready()
    last = 0

    def killed() -> bool:
        nonlocal last
        with suppress(Exception):
            pid = tree.call("daemon", "info", timeout_s=1.0)["processes"]["core"]
            if pid not in (0, last):
                last = pid
                os.kill(pid, signal.SIGKILL)
        return process.poll() is not None

    assert within(60.0, killed)
    assert process.returncode == 1
    assert tree.motors.hear(b"REST")


def test_stuck_slow_and_hostile_subscribers_cost_nobody_a_sample(tree: Tree) -> None:
    """Ten on the bus itself, two of which never read; wishes above the bound; bytes that are no ZeroMQ; and one that
    listens, which hears every sample."""
    tree.start_ready()
    pids = tree.call("daemon", "info")["processes"]
    context = zmq.Context.instance()
    with ExitStack() as stack:
        for number in range(10):
            one: zmq.Socket[Any] = stack.enter_context(context.socket(zmq.SUB))
            one.setsockopt(zmq.LINGER, 0)
            one.setsockopt(zmq.RCVHWM, 1 if number < 2 else 1000)
            one.connect(tree.addresses.bus)
            one.subscribe(b"")
        greedy: zmq.Socket[Any] = stack.enter_context(context.socket(zmq.XSUB))
        greedy.setsockopt(zmq.LINGER, 0)
        greedy.connect(tree.addresses.bus)
        for number in range(2000):
            greedy.send(b"\x01" + str(number).encode())
        greedy.send(b"\x01" + b"x" * (LARGEST_SUBSCRIPTION + 1))
        for noise in (b"\xff" * 64, b"\x00" * 4096, b"GET / HTTP/1.1\r\n\r\n"):
            raw = stack.enter_context(socket.socket(socket.AF_UNIX))
            raw.connect(tree.addresses.bus.removeprefix("ipc://"))
            raw.sendall(noise)
        listener = stack.enter_context(tree.subscriber("wrench/compensated"))
        heard = 0
        while heard < 300:
            assert listener.receive(BACK_S) is not None
            heard += 1
        assert listener.lost == {}
    assert tree.call("daemon", "info")["processes"] == pids


def test_a_disk_that_cannot_be_written_keeps_no_daemon_from_serving(tree: Tree) -> None:
    """A file stands where the state directory should be: samples flow, and the end is clean; what is lost is said."""
    (tree.folder / "state").write_text("in the way")
    tree.start_ready()
    tree.call("compensation", "offset", value=1.0)
    assert flows(tree)
    status, stderr = tree.end()
    assert status == 0
    assert "is not kept" in stderr


def test_a_step_of_the_wall_clock_changes_no_time_of_a_sample(monkeypatch: pytest.MonkeyPatch) -> None:
    """An hour forwards or a year backwards: stamps go on as they were; nothing here orders or ages by the wall clock."""
    wall, base = time.time_ns(), TimeBase.now()
    before = base.timestamp(time.monotonic_ns())
    for step_s in (3600, -31_536_000):
        monkeypatch.setattr(clock.time, "time_ns", lambda step_s=step_s: wall + step_s * NS_PER_S)
        assert abs(base.timestamp(time.monotonic_ns()) - before) < 60.0
    other = TimeBase.now()
    assert base.timestamp(0) - other.timestamp(0) > 31_000_000

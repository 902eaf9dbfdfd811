"""The viewers' copy: a process of its own with bounds of its own, whose end costs nobody a sample."""

import os
import signal
import socket
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import zmq

from galen_hw.bus import LARGEST_SUBSCRIPTION, Subscriber
from galen_hw.daemon.viewers import MOST_DATA, MOST_DESCRIPTORS, MOST_VIEWERS
from galen_hw.waiting import readable
from tests.daemon_tree import Tree, daemon_tree, within


@pytest.fixture(scope="module")
def running(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Tree]:
    with daemon_tree(tmp_path_factory.mktemp("d")) as tree:
        config = tree.write_config()
        config.write_text(config.read_text().replace('viewers = ""', 'viewers = "tcp://127.0.0.1:0"'))
        tree.start_ready()
        tree.viewers = str(tree.call("daemon", "info")["viewers"])
        yield tree


def pid_of(tree: Tree) -> int:
    return int(tree.call("daemon", "info")["processes"]["viewers"])


def viewer(address: str, *topics: bytes) -> "zmq.Socket[Any]":
    one: zmq.Socket[Any] = zmq.Context.instance().socket(zmq.SUB)
    one.setsockopt(zmq.LINGER, 0)
    one.setsockopt(zmq.RECONNECT_IVL, 50)
    one.setsockopt(zmq.RCVTIMEO, 10_000)
    one.connect(address)
    for topic in topics:
        one.subscribe(topic)
    return one


def connections_of(pid: int) -> int:
    """TCP connections (not the listening socket) that a process holds."""
    inodes = set()
    for fd in Path(f"/proc/{pid}/fd").iterdir():
        try:
            inodes.add(str(fd.readlink()).removeprefix("socket:[").removesuffix("]"))
        except FileNotFoundError:
            continue
    rows = [line.split() for line in Path("/proc/net/tcp").read_text().splitlines()[1:]]
    return sum(row[9] in inodes and row[3] == "01" for row in rows)


def test_a_free_port_is_taken_and_printed(running: Tree) -> None:
    """Port 0 in the settings: the port that was found is in the line `ready` and in `info`."""
    assert int(running.viewers.rpartition(":")[2]) > 0
    assert running.said.rstrip().endswith(f"viewers at {running.viewers}")


def test_the_end_of_the_copy_costs_nobody_a_sample(running: Tree) -> None:
    """Killed, it is started again at the same port; its viewers go on by themselves, and the bus has no gap."""
    before = pid_of(running)
    with Subscriber(running.viewers, ["wrench/raw"]) as looking, running.subscriber("wrench/raw") as bus:
        assert looking.receive(10.0) is not None
        assert bus.receive(10.0) is not None
        os.kill(before, signal.SIGKILL)
        assert within(10.0, lambda: bus.receive(1.0) is not None and pid_of(running) not in (0, before))
        while looking.receive(0.0) is not None:
            pass
        assert looking.receive(15.0) is not None
        while bus.receive(0.0) is not None:
            pass
        assert bus.lost == {}


def test_a_connection_above_the_bound_is_closed_and_gets_in_when_there_is_room(running: Tree) -> None:
    """As many as are allowed, and two more: the two hear nothing until others have gone; the first hear all the while."""
    pid = pid_of(running)
    first = [viewer(running.viewers, b"wrench/raw") for _ in range(MOST_VIEWERS)]
    more: list[zmq.Socket[Any]] = []
    try:
        for one in first:
            assert one.recv_multipart()[0] == b"wrench/raw"
        more = [viewer(running.viewers, b"status") for _ in range(2)]
        assert not more[0].poll(2500)
        assert within(5.0, lambda: connections_of(pid) == MOST_VIEWERS)
        assert first[-1].recv_multipart()[0] == b"wrench/raw"
        for one in first[:5]:
            one.close()
        assert more[0].recv_multipart()[0] == b"status"
    finally:
        for one in [*first, *more]:
            one.close()
    assert pid_of(running) == pid


def test_a_wish_above_the_bound_ends_that_connection_alone(running: Tree) -> None:
    """A subscription one byte too long closes its connection; others hear on, and so do long wishes that are allowed."""
    pid = pid_of(running)
    with viewer(running.viewers, b"wrench/raw") as sound, viewer(running.viewers, b"wrench/raw") as monitored:
        sound.recv_multipart()
        monitored.recv_multipart()
        events = monitored.get_monitor_socket(int(zmq.EVENT_DISCONNECTED))
        monitored.subscribe(b"x" * (LARGEST_SUBSCRIPTION - 16))
        assert not events.poll(500)
        monitored.subscribe(b"x" * (LARGEST_SUBSCRIPTION + 1))
        assert events.poll(10_000)
        assert sound.recv_multipart()[0] == b"wrench/raw"
        monitored.disable_monitor()
        events.close()
    assert pid_of(running) == pid


def test_bytes_that_are_no_zeromq_end_nothing(running: Tree) -> None:
    """A browser, a port scanner."""
    host, port = running.viewers.removeprefix("tcp://").split(":")
    pid = pid_of(running)
    for junk in (b"GET / HTTP/1.0\r\n\r\n", b"\xff" * 64, b""):
        with socket.create_connection((host, int(port))) as one:
            one.sendall(junk)
    with viewer(running.viewers, b"wrench/raw") as sound:
        assert sound.recv_multipart()[0] == b"wrench/raw"
    assert pid_of(running) == pid


def test_the_process_has_bounds_of_its_own(running: Tree) -> None:
    """Descriptors and memory, as the kernel sees them, and it goes first where memory runs out."""
    folder = Path(f"/proc/{pid_of(running)}")
    limits = {line[:26].strip(): line[26:].split()[0] for line in (folder / "limits").read_text().splitlines()}

    assert int(limits["Max open files"]) == MOST_DESCRIPTORS
    assert int(limits["Max data size"]) == MOST_DATA
    assert (folder / "oom_score_adj").read_text().strip() == "1000"


def test_no_process_has_descriptors_that_select_of_a_library_does_not_take(running: Tree) -> None:
    """pyserial and python-can wait with `select`: with a raised limit, clients could bring them to end the process."""
    pids = running.call("daemon", "info")["processes"]
    lines = [
        next(line for line in Path(f"/proc/{pids[name]}/limits").read_text().splitlines() if "open files" in line)
        for name in ("core", "motion")
    ]

    assert all(int(line[26:].split()[0]) <= 1024 for line in lines)


def test_waiting_works_above_the_descriptors_that_select_takes() -> None:
    """`select` refuses a descriptor above 1023, which many clients can bring about: the loops go on all the same."""
    import fcntl
    import resource

    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (min(2048, hard), hard))
    inlet, outlet = os.pipe()
    high = fcntl.fcntl(inlet, fcntl.F_DUPFD, 1500)
    try:
        assert readable([high], 0.0) == []
        os.write(outlet, b"x")
        assert readable([high], 5.0) == [high]
    finally:
        for fd in (inlet, outlet, high):
            os.close(fd)
        resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))

"""Age: each topic has a limit, nothing older than it is `valid` anywhere, and backlogs are dropped."""

import os
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from msgspec.structs import replace

from galen_hw.bus import Publisher, Subscriber
from galen_hw.daemon.links import not_older
from galen_hw.decoding import decode_message
from galen_hw.messages import MAX_AGE_NS, STREAMS, TOPICS, Fault, WrenchRaw, encode
from tests.daemon_tree import daemon_tree, within
from tests.test_bus import publish_until_heard, wrench

S = 1_000_000_000
READER_S = 1.0
"""How late the reader of a starved machine may be itself."""


@pytest.mark.parametrize("name", TOPICS)
def test_every_topic_has_a_limit(name: str) -> None:
    """A stream lives as long as a velocity drives the motors; what comes once a second, or as an event, two seconds."""
    assert MAX_AGE_NS[name] == round((0.25 if name in STREAMS else 2.0) * S)
    assert (name in STREAMS) == (TOPICS[name].rate_hz > 1.0)


def test_what_a_stream_has_left_from_before_the_start_is_dropped() -> None:
    """A sample read 1 ns before the process began is nobody's; a fault of that time is told; both go by their own age."""
    sample = encode(replace(wrench(1), t_ns=S - 1))
    fault = encode(Fault(timestamp=0.0, t_ns=S - 1, seq=1, valid=True, source="ft", what="hot"))
    assert not_older(b"wrench/raw", sample, S, begun_ns=S) is None
    assert not_older(b"wrench/raw", sample, S, begun_ns=S - 1) is sample
    assert not_older(b"fault", fault, S, begun_ns=S) is fault
    late = not_older(b"fault", fault, 3 * S, begun_ns=S)
    assert late is not None
    assert not decode_message(b"fault", late)[1].valid


def test_what_waits_in_a_subscribers_queue_is_not_valid(tmp_path: Path) -> None:
    """On time when it was published, 0.3 s in the queue: not valid for who reads it; a recorder reads it as published."""
    bus = f"ipc://{tmp_path}/bus"
    with Publisher(bus) as publisher, Subscriber(bus) as slow, Subscriber(bus, as_published=True) as recorder:
        publish_until_heard(publisher, slow)
        publish_until_heard(publisher, recorder)
        while slow.receive(0.05) or recorder.receive(0.05):
            pass
        publisher.publish("wrench/raw", replace(wrench(7), t_ns=time.monotonic_ns()))
        within(0.3, lambda: False)
        late, kept = slow.receive(5.0), recorder.receive(5.0)
        assert late is not None
        assert kept is not None
        assert (late[1].valid, kept[1].valid) == (False, True)
        assert late[1] == replace(kept[1], valid=False)
        publisher.publish("wrench/raw", replace(wrench(8), t_ns=time.monotonic_ns() + S))
        assert within(5.0, lambda: bool((m := slow.receive(1.0)) and m[1].valid and isinstance(m[1], WrenchRaw)))


@contextmanager
def starved(cores: set[int], hogs: int) -> Iterator[set[int]]:
    """Processes that take all that they get of these cores, as whoever is started here has; yields the cores of before."""
    before = os.sched_getaffinity(0)
    os.sched_setaffinity(0, cores)
    busy = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(hogs)]
    try:
        yield before
    finally:
        os.sched_setaffinity(0, before)
        for one in busy:
            one.kill()
            one.wait()


@pytest.mark.live
def test_a_starved_daemon_vouches_for_nothing_old(tmp_path: Path) -> None:
    """The whole tree on one core with three busy programs, from its start on: whatever says `valid` was young when it was
    published, on every topic; and young samples do come."""
    with daemon_tree(tmp_path) as tree:
        tree.write_config("start_timeout_s = 60.0\noptional_wait_s = 1.0")
        tree.sensor.chatter(lambda n: str(float(n)))
        tree.motors.chatter("0.5", every_s=0.02)
        core = min(os.sched_getaffinity(0))
        with starved({core}, 3) as before:
            process = tree.start()
            os.sched_setaffinity(0, before)
            assert within(60.0, (tree.addresses.runtime / "bus.pub").exists)
            oldest: dict[str, float] = {}
            valid = 0
            with Subscriber(tree.addresses.bus, as_published=True) as everything:
                until = time.monotonic() + 20.0
                while time.monotonic() < until and valid < 2000:
                    received = everything.receive(1.0)
                    if received is not None and received[1].valid:
                        age_s = (time.monotonic_ns() - received[1].t_ns) / S
                        oldest[received[0]] = max(age_s, oldest.get(received[0], 0.0))
                        valid += 1
        assert process.poll() is None
    assert {"wrench/raw", "wrench/compensated", "joints/state"} <= oldest.keys()
    assert {topic: age for topic, age in oldest.items() if age > MAX_AGE_NS[topic] / S + READER_S} == {}

"""Processes that the arm does not hang on, of a whole virtual robot: they die or stand still, and the wrench goes on."""

import os
import signal
import time
from pathlib import Path

import pytest

from galen_hw.bus import CommandClient, Subscriber
from galen_hw.config.paths import DEFAULT_CONFIG, Addresses
from tests.daemon_tree import within
from tests.test_daemon_virtual import galen

VICTIMS = {"tracking": "tracker/tool", "health": "health"}
"""What each publishes."""
BACK_S = 40.0
"""Eight seconds until one that stands still is replaced, and what a busy machine takes to start it."""


@pytest.mark.live
@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGSTOP])
def test_tracking_and_health_come_back_and_the_wrench_never_misses_them(tmp_path: Path, number: signal.Signals) -> None:
    """SIGKILL and SIGSTOP of both: another process in their place, what they publish flows again, core and motion are the
    same, and no compensated sample is lost."""
    config = tmp_path / "galen.toml"
    text = DEFAULT_CONFIG.read_text().replace('# viewers = "tcp://127.0.0.1:9872"', 'viewers = ""')
    config.write_text(text.replace("[daemon]\n", "[daemon]\nblind_after_s = 2.0\n"))
    process = galen(tmp_path, "run", "--virtual", "--config", str(config))
    bus = Addresses(tmp_path / "run")
    try:
        assert process.stdout is not None
        assert process.stdout.readline().startswith("ready: ft ready, motors ready, tracker ready")
        with (
            CommandClient(bus.command) as client,
            Subscriber(bus.bus, ["wrench/compensated"]) as wrench,
            Subscriber(bus.bus, list(VICTIMS.values())) as beside,
        ):
            before = client.call("daemon", "info")["processes"]
            assert wrench.receive(5.0)
            for name in VICTIMS:
                os.kill(before[name], number)

            def replaced() -> bool:
                while wrench.receive(0.0):
                    pass
                now = client.call("daemon", "info")["processes"]
                return all(now[name] not in (0, before[name]) for name in VICTIMS)

            assert within(BACK_S, replaced)
            begun, heard = time.monotonic_ns(), set[str]()

            def flows() -> bool:
                while wrench.receive(0.0):
                    pass
                if (found := beside.receive(0.1)) and found[1].t_ns > begun:
                    heard.add(found[0])
                return heard == set(VICTIMS.values())

            assert within(BACK_S, flows), heard
            after = client.call("daemon", "info")["processes"]
            assert {name: after[name] for name in ("core", "motion")} == {n: before[n] for n in ("core", "motion")}
            assert wrench.lost == {}
    finally:
        process.terminate()
        process.communicate(timeout=30)
    assert process.returncode == 0

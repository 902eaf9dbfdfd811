"""A sweep whose client or whose daemon ends: real processes on a virtual robot."""

import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator

import pytest
from rich.console import Console

from galen_hw.bus import Subscriber
from galen_hw.messages import CalibrationProgress
from galen_hw.tools.calibration.sweep import Operator, run_sweep
from tests.arm import Arm, running_arm
from tests.daemon_tree import within

pytestmark = pytest.mark.live

CLIENT_WITHIN_S = 1.0
NOTICED_WITHIN_S = 1.0
SLACK_S = 0.5
"""What a busy machine that tests may add."""


@pytest.fixture
def arm(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Arm]:
    patient = {"daemon": "blind_after_s = 2.0\n", "motors_settings": "watchdog_s = 2.0"}  # a busy machine may test
    with running_arm(tmp_path_factory.mktemp("sweep"), **patient) as own:
        yield own


def await_state(subscriber: Subscriber, state: str, seconds: float = 60.0) -> CalibrationProgress:
    """The first progress message that shows this state, in the first pose or later."""
    until, seen = time.monotonic() + seconds, ""
    while time.monotonic() < until:
        received = subscriber.receive(1.0)
        if received is None or not isinstance(message := received[1], CalibrationProgress):
            continue
        seen = f"{message.state} {message.detail}"
        if message.state == state and (message.pose > 0 or state == "stopped"):
            return message
        assert message.state != "stopped", seen
    raise AssertionError(f"never {state}, but {seen or 'nothing'}")


def test_client_and_daemon_of_a_sweep_may_end_at_any_time(arm: Arm) -> None:
    """SIGKILL of the client: the arm stops within a second. SIGTERM of the daemon: the client knows within a second."""
    words = ["calibrate", "--tool", "pointer", "--yes", "--dir", str(arm.folder / "run"), "--samples", "80"]
    with Subscriber(arm.addresses.bus, ("calibration/progress",)) as progress:
        client = subprocess.Popen(
            [sys.executable, "-m", "galen_hw.cli", *words], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
        )
        await_state(progress, "moving")
        killed_ns = time.monotonic_ns()
        client.kill()
        client.wait()
        stopped = await_state(progress, "stopped")
        assert "the client that started the sweep is gone" in stopped.detail
        assert (stopped.t_ns - killed_ns) * 1e-9 < CLIENT_WITHIN_S + SLACK_S
        assert arm.seconds_to_rest(stopped.t_ns) < 0.2 + SLACK_S

        # The controller says so itself: its other axes come to rest when they do.
        assert within(10.0, lambda: not arm.refusal("enable"))
        told: list[tuple[str, int]] = []

        def sweep() -> None:
            nobody = Operator(lambda: None, lambda: None)
            told.append((run_sweep(arm.addresses, "pointer", {}, nobody, Console(quiet=True))[1], time.monotonic_ns()))

        thread = threading.Thread(target=sweep)
        thread.start()
        await_state(progress, "moving")
        ended_ns = time.monotonic_ns()
        os.kill(arm.process.pid, signal.SIGTERM)
        thread.join(timeout=30.0)
    assert told
    assert told[0][0].startswith("the daemon ends")
    assert (told[0][1] - ended_ns) * 1e-9 < NOTICED_WITHIN_S + SLACK_S

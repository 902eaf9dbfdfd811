"""Blind in the middle of a move: the arm comes to rest, stays there until an operator clears it, and it is said."""

import os
import signal
import time
from collections.abc import Iterator

import pytest

from tests.arm import Arm, running_arm
from tests.daemon_tree import within

pytestmark = pytest.mark.live
WITHIN_S = 2.5
"""What a busy machine that tests leaves of 0.25 s and 0.4 s, which tests/test_guard.py and test_galil_watch.py show."""
PATIENT = {"daemon": "blind_after_s = 1.0\n", "motors_settings": "watchdog_s = 1.2"}
"""A machine that tests stalls for half a second (seen in CI): that must not pass for the fault that is injected."""


@pytest.fixture(scope="module")
def arm(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Arm]:
    with running_arm(tmp_path_factory.mktemp("blind"), **PATIENT) as own:
        yield own


def refused_until_cleared(arm: Arm, words: str) -> None:
    """A motion is refused, with the command that clears it; after that command it is carried out."""
    assert within(20.0, arm.in_order)
    assert within(30.0, lambda: "clear_fault" in arm.refusal("servo_jv", velocity={"roll": 0.1}))
    assert words in arm.refusal("servo_jv", velocity={"roll": 0.1})
    assert arm.speed()[1] == 0.0
    back = 0.1 if arm.control.state()["joints"]["roll"] < 0 else -0.1
    assert within(30.0, lambda: arm.cleared("servo_jv", velocity={"roll": back}))
    arm.ask("motors", "stop")


def test_a_core_that_is_stopped_stops_the_arm(arm: Arm) -> None:
    """SIGSTOP: at rest at once; nothing moves while core stands still, nor after it goes on, before clear_fault."""
    arm.begin()
    core = arm.pid("core")
    with arm.stopped(core) as begun:
        assert arm.seconds_to_rest(begun) < WITHIN_S
        assert "no sign of life from the process core" in arm.refusal("servo_jv", velocity={"roll": 0.1})
        assert arm.systemd.hears_in("STATUS=", "motors held at rest", "process core does not run")
    refused_until_cleared(arm, "no sign of life from the process core")
    assert "motors: stopped, for nobody feels what the arm does: no sign of life from the process core" in arm.log()


def test_a_core_that_dies_stops_the_arm(arm: Arm) -> None:
    """SIGKILL: at rest, started again, and the stop stays."""
    arm.begin()
    begun = time.monotonic_ns()
    os.kill(arm.pid("core"), signal.SIGKILL)
    assert arm.seconds_to_rest(begun) < WITHIN_S
    refused_until_cleared(arm, "nobody feels what the arm does")


def test_a_wrench_that_falls_silent_stops_the_arm(arm: Arm) -> None:
    """The sensor answers nothing more: at rest, said in a fault and in the motors' status."""
    arm.begin()
    with arm.subscriber("fault", "status") as subscriber:
        begun = time.monotonic_ns()
        arm.control.fault("ft.silent")
        try:
            assert arm.seconds_to_rest(begun) < WITHIN_S
            said = []
            assert within(5.0, lambda: arm.hear(subscriber, said, "fault", "no wrench for"))
            assert within(5.0, lambda: arm.hear(subscriber, said, "status", "no wrench for"))
        finally:
            arm.control.fault("ft.silent", on=False)
    refused_until_cleared(arm, "no wrench for")


def test_a_motion_process_that_is_stopped_is_replaced_by_the_controllers_own_time_out(arm: Arm) -> None:
    """SIGSTOP of the motors' process: the controller stops the axes; the watchdog starves, and the status says why."""
    arm.begin()
    motion = arm.pid("motion")
    with arm.subscriber("status") as subscriber, arm.stopped(motion) as begun:
        assert arm.seconds_to_rest(begun) < WITHIN_S
        assert arm.systemd.hears_in("STATUS=", "motors silent", "process motion does not run")
        arm.systemd.heard.clear()
        said: list[str] = []
        assert within(5.0, lambda: arm.hear(subscriber, said, "status", "the process motion has not run for"))
        arm.systemd.listen()
        assert "WATCHDOG=1" not in arm.systemd.heard
    refused_until_cleared(arm, "the controller heard nothing for 1.2 s and stopped the axes")


def test_a_motion_process_that_dies_is_replaced_by_the_controllers_own_time_out(arm: Arm) -> None:
    """SIGKILL of the motors' process in a move: axes at rest, and the stop outlives the process."""
    arm.begin()
    begun = time.monotonic_ns()
    os.kill(arm.pid("motion"), signal.SIGKILL)
    assert arm.seconds_to_rest(begun) < WITHIN_S
    refused_until_cleared(arm, "the controller heard nothing for 1.2 s and stopped the axes")

"""The guard beside the motors, in simulated time: what it takes for blindness, and how soon the arm is at rest."""

import pytest

from galen_hw.config.schema import DaemonSection
from galen_hw.daemon.guard import Guard
from galen_hw.drivers.galil_dmc import GalilDmc
from galen_hw.drivers.virtual.galil_dmc import VirtualGalilDmc
from galen_hw.drivers.virtual.world import World
from tests.serial_pair import TIME_BASE, Pair

MS = 1_000_000


class Signs:
    """Signs of life that a test gives, and a guard that is told of a joint state every 20 ms."""

    def __init__(self, **guard):
        self.core = self.wrench = self.now = 0
        signs = {"no core": lambda: self.core, "no wrench": lambda: self.wrench}
        self.guard = Guard(signs, DaemonSection().blind_after_s, **guard)

    def run(self, ms, *, core=True, wrench=True, step_ms=20):
        end = self.now + ms * MS
        while self.now < end:
            self.now += step_ms * MS
            self.core = self.now if core else self.core
            self.wrench = self.now if wrench else self.wrench
            self.guard.heard(self.now)


def test_what_was_there_and_is_not_is_missed_within_a_tenth_of_a_second():
    """Each of the signs, and no longer than it is missing."""
    for what in ("core", "wrench"):
        signs = Signs()
        signs.run(1000)
        signs.run(60, **{what: False})
        assert signs.guard.blind == ""
        signs.run(40, **{what: False})
        assert signs.guard.blind.startswith(f"no {what} for 0.1 s")
        signs.run(20)
        assert signs.guard.blind == ""


def test_what_was_never_there_forbids_motion_but_is_not_blindness():
    """At the start: nothing may begin, nothing is latched; an optional sensor is not waited for, but missed later."""
    signs = Signs()
    signs.run(500, wrench=False)
    assert (signs.guard.blind, signs.guard.missing) == ("", "no wrench yet")
    signs = Signs(optional={"no wrench"})
    signs.run(500, wrench=False)
    assert (signs.guard.blind, signs.guard.missing) == ("", "")
    signs.run(100)
    signs.run(120, wrench=False)
    assert signs.guard.missing.startswith("no wrench for")


def test_a_stall_of_the_whole_machine_is_nobodys_silence():
    """Half a second in which the motors were not heard either counts as one step."""
    signs = Signs()
    signs.run(1000)
    signs.now += 500 * MS
    signs.guard.heard(signs.now)
    assert signs.guard.blind == ""
    signs.run(100)
    assert signs.guard.blind == ""


def test_on_a_machine_that_hears_the_motors_late_four_joint_states_without_a_sign_are_blindness():
    """Each late one counts as 25 ms, however late: at gaps just below the controller's own time-out that is a second."""
    for gap_ms in (60, 240):
        signs = Signs()
        signs.run(10 * gap_ms, step_ms=gap_ms)
        signs.run(3 * gap_ms, core=False, step_ms=gap_ms)
        assert signs.guard.blind == ""
        signs.run(gap_ms, core=False, step_ms=gap_ms)
        assert signs.guard.blind.startswith("no core for 0.1 s")


def test_a_process_that_was_started_again_is_missed_until_it_speaks():
    """Its old signs are forgotten, which is no sign of life."""
    signs = Signs()
    signs.run(1000)
    signs.core = 0
    signs.run(120, core=False)
    assert signs.guard.blind.startswith("no core for")


@pytest.mark.parametrize("phase", range(3))
@pytest.mark.parametrize(("joint", "goal", "speed"), [("roll", 1.5, 1.0), ("carriage1", 0.2, 0.1)])
def test_a_blind_arm_rests_within_a_quarter_of_a_second(joint, goal, speed, phase):
    """From the last wrench to rest in the world, over a line of 115200 baud, at several phases of the line."""
    driver = GalilDmc("motors", GalilDmc.Settings(), TIME_BASE)
    pair = Pair(driver, VirtualGalilDmc(VirtualGalilDmc.Settings(), World()))
    assert pair.run(5.0, lambda: driver.ready)
    wrench_ns, heard = pair.now_ns, 0
    guard = Guard({"no wrench": lambda: wrench_ns}, DaemonSection().blind_after_s)
    assert pair.call("enable").error is None
    assert pair.call("move_jp", {"position": {joint: goal}, "velocity": {joint: speed}}).error is None
    pair.run(0.6 + 0.007 * phase)
    guard.heard(pair.now_ns)
    wrench_ns = pair.now_ns
    while max(abs(pair.device.world.joints(pair.now_ns)[1])) > 0.0 and pair.now_ns - wrench_ns < 10**9:
        pair.run(0.0005)
        if len(pair.of("joints/state")) != heard:
            heard = len(pair.of("joints/state"))
            guard.heard(pair.now_ns)
        if guard.blind and not driver.held:
            driver.trip(guard.blind, pair.now_ns)
    assert (pair.now_ns - wrench_ns) * 1e-9 < 0.25
    assert "no wrench" in driver.held

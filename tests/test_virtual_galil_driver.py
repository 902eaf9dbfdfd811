"""The real motor driver against the virtual controller, byte for byte over a line of real speed, in simulated time."""

import pytest

from galen_hw.drivers.galil_dmc import GalilDmc
from galen_hw.drivers.virtual.galil_dmc import VirtualGalilDmc
from galen_hw.drivers.virtual.world import World
from galen_hw.kinematics import GALEN_JOINTS
from tests.serial_pair import TIME_BASE, Pair


def axis(letter, joint, scale, lower, upper):
    speeds = {"velocity": 0.025, "max_velocity": 0.2, "acceleration": 0.25, "max_acceleration": 2.0}
    limits = {"lower": lower, "upper": upper, "unit": "m" if scale == 1e6 else "rad"}
    return {"axis": letter, "joint": joint, "counts_per_unit": scale, **limits, **speeds}


@pytest.fixture
def pair():
    world = World()
    scales = [1e6, 1e6, 1e6, 41721.64, 41721.64]
    lower, upper = world.limits
    rows = zip("ABCDE", GALEN_JOINTS, scales, lower.tolist(), upper.tolist(), strict=True)
    driver = GalilDmc("motors", GalilDmc.Settings(axes=[axis(*row) for row in rows]), TIME_BASE)
    pair = Pair(driver, VirtualGalilDmc(VirtualGalilDmc.Settings(), world))
    pair.world = world
    assert pair.run(5.0, lambda: driver.ready), pair.said
    return pair


def test_it_connects_and_joint_states_flow_at_the_pace_of_the_line(pair):
    """From power-up with echo on to joint states; 5 axes at 115200 allow some 40 to 60 a second."""
    before = len(pair.of("joints/state"))
    pair.run(2.0)

    assert 60 <= len(pair.of("joints/state")) - before <= 140
    assert not pair.of("fault")


def test_a_move_arrives_and_the_states_are_those_of_the_world(pair):
    """enable, move_jp: motion, then the target within a count, seen alike by driver and world."""
    assert pair.call("enable").error is None
    assert pair.call("move_jp", {"position": {"tilt": 0.3, "carriage1": 0.01}}).error is None
    pair.run(0.3)
    assert pair.of("joints/state")[-1].moving["tilt"]
    assert pair.run(30.0, lambda: not any(pair.of("joints/state")[-1].moving.values()))
    pair.run(0.2)
    state = pair.of("joints/state")[-1]

    assert state.position["tilt"] == pytest.approx(0.3, abs=2 / 41721.64)
    assert state.position["carriage1"] == pytest.approx(0.01, abs=2e-6)
    assert pair.world.joints(pair.now_ns)[0][4] == pytest.approx(0.3, abs=2 / 41721.64)
    assert state.stop_code["tilt"] == 1


def test_the_emergency_stop_is_seen_and_motion_ends(pair):
    """ELO while jogging: motors off, estop true, a fault; after release clear_fault and enable bring it back."""
    assert pair.call("enable").error is None
    assert pair.call("servo_jv", {"velocity": {"roll": 0.1}}).error is None
    pair.run(0.1)
    pair.world.faults.add("elo")
    assert pair.run(2.0, lambda: pair.of("joints/state")[-1].estop)
    pair.run(0.5)
    state = pair.of("joints/state")[-1]
    assert not any(state.enabled.values())
    assert not any(state.moving.values())
    assert pair.of("fault")
    pair.world.faults.discard("elo")
    pair.run(1.0)
    assert pair.call("clear_fault").error is None
    assert pair.call("enable").error is None
    pair.run(0.2)
    assert all(pair.of("joints/state")[-1].enabled.values())


def test_a_silent_controller_is_noticed_and_found_again(pair):
    """Silence makes joint states invalid and a fault; the driver comes back by itself."""
    pair.world.faults.add("motors.silent")
    assert pair.run(10.0, lambda: not pair.of("joints/state")[-1].valid)
    pair.world.faults.discard("motors.silent")
    assert pair.run(20.0, lambda: pair.of("joints/state")[-1].valid)


def test_late_answers_never_pair_with_the_wrong_question(pair):
    """Answers a second late for a while: no joint state is wrong, and afterwards everything is as before."""
    pair.call("enable")
    pair.world.faults.add("motors.late")
    pair.run(4.0)
    pair.world.faults.discard("motors.late")
    assert pair.run(20.0, lambda: pair.of("joints/state")[-1].valid)
    assert pair.call("move_jp", {"position": {"carriage2": 0.005}}, seconds=10.0).error is None
    pair.run(2.0)

    assert pair.of("joints/state")[-1].position["carriage2"] == pytest.approx(0.005, abs=2e-6)
    assert all(abs(m.position["carriage2"]) <= 0.0051 for m in pair.of("joints/state") if m.valid)

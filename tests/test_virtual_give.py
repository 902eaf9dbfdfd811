"""The virtual arm's give beyond springs: what a push at the tip does to the true pose, in simulated time."""

import numpy as np
import pytest

from galen_hw.clock import NS_PER_S
from galen_hw.drivers.virtual.commands import Commands
from galen_hw.drivers.virtual.give import STEP_NS, Compliance
from galen_hw.drivers.virtual.world import World
from galen_hw.kinematics import GalenRobot

TILT = 4
GIVE = 5e-3
T0 = 10 * NS_PER_S


class Arm:
    """A world whose tilt alone gives, pushed at the tip along x, 0.165 m below the axis; no weight."""

    def __init__(self, **tilt: float) -> None:
        self.world = World(GalenRobot(gravity=np.zeros(3)), inertial=False)
        creep_s = tilt.pop("creep_s", 3.0)
        vectors = {name: np.eye(5)[TILT] * value for name, value in ({"joint": GIVE} | tilt).items()}
        rest = {"play": np.zeros(5), "structure": np.zeros(6)}
        self.world.attach({"name": "rod", "mass": 1e-9, "com": [0, 0, 0], "tip": [0.0, 0.0, -0.165]})
        self.world.compliance = Compliance(**(rest | vectors), creep_s=creep_s)
        self.now_ns = T0
        self.world.advance(T0)
        self.zero = self.turn()

    def turn(self) -> float:
        """Extra tilt now, rad."""
        R = self.world.sensor_pose(self.now_ns)[:3, :3]
        return float(np.arctan2(R[0, 2], R[0, 0]))

    def push(self, newtons: float, seconds: float = 0.2) -> float:
        """Extra tilt after a force that stays for so long."""
        self.world.hand.release()
        self.world.push([newtons, 0.0, 0.0], seconds=1e9)
        self.now_ns += round(seconds * NS_PER_S)
        self.world.advance(self.now_ns)
        return self.turn() - self.zero


def spring(newtons: float, give: float = GIVE) -> float:
    """Turn of a straight spring: the push's lever about the tilt axis, which turns with it."""
    x = 0.0
    for _ in range(20):
        # The tip lies 0.055 m before and 0.165 m below the axis; with the turn x it swings about it.
        x = give * newtons * (-0.055 * np.sin(x) - 0.165 * np.cos(x))
    return x


def test_friction_holds_the_arm_on_the_way_back():
    """Load, unload and reverse: the arm stands off at zero force by no more than what the friction bears, both ways."""
    arm = Arm(friction=0.2)
    for newtons in np.linspace(0.0, 8.0, 50):
        up = arm.push(newtons, 0.01)
    for newtons in np.linspace(8.0, 0.0, 50):
        left = arm.push(newtons, 0.01)
    assert abs(up) < abs(spring(8.0)), "friction bears a part of the load"
    assert 0.3 * GIVE * 0.2 < -left < GIVE * 0.2
    for newtons in [*np.linspace(0.0, -8.0, 50), *np.linspace(-8.0, 0.0, 50)]:
        right = arm.push(newtons, 0.01)
    assert 0.3 * GIVE * 0.2 < right < GIVE * 0.2


def test_a_stiffening_spring_gives_less_than_in_proportion():
    """Where the give is as large as `hardening`, the load is twice that of the straight spring."""
    arm = Arm(hardening=2e-3)
    turn = arm.push(4.0)
    torque = abs(spring(4.0)) / GIVE
    assert abs(turn) * (1.0 + (turn / 2e-3) ** 2) == pytest.approx(GIVE * torque, rel=5e-3)
    assert abs(arm.push(8.0)) < 1.6 * abs(turn)


def test_a_loose_bearing_falls_to_the_side_of_the_load():
    """A small load moves it farther than the spring; a large one by the spring and the half width."""
    arm = Arm(bearing=1e-3)
    assert abs(arm.push(0.1)) > 3.0 * abs(spring(0.1))
    large = arm.push(8.0)
    assert abs(large) == pytest.approx(abs(spring(8.0)) + 1e-3, rel=2e-2)
    assert arm.push(-8.0) == pytest.approx(-large, rel=5e-2), "to the other side"


def test_creep_goes_on_under_load_and_back_after_it():
    """At first the spring alone; after many time constants its share more; at rest it comes back."""
    arm = Arm(creep=0.2, creep_s=2.0)
    at_once, later = arm.push(5.0, 0.005), arm.push(5.0, 400.0)
    assert at_once == pytest.approx(spring(5.0), rel=1e-2)
    assert later == pytest.approx(spring(5.0, 1.2 * GIVE), rel=1e-2)
    after = arm.push(0.0, 0.01)
    assert after == pytest.approx(later - at_once, rel=0.1)
    assert abs(arm.push(0.0, 100.0)) < 0.05 * abs(after)


def test_the_give_grows_along_a_joint():
    """A slope of 1 per rad makes it half as much again at half a radian."""
    arm = Arm(slope=1.0, creep=0.0)
    there = np.array([0.0, 0.0, 0.0, 0.0, 0.5])
    arm.world.set_joints(there, np.zeros(5), np.zeros(5), arm.now_ns)
    arm.now_ns += STEP_NS
    arm.zero = arm.turn()
    gave = arm.push(0.5)
    lever = abs(
        arm.world.robot.sensor_jacobian(there)[0, 0, TILT]
        + (arm.world.tip_pose(arm.now_ns) - arm.world.sensor_pose(arm.now_ns))[2, 3]
    )
    assert abs(gave) == pytest.approx(1.5 * GIVE * 0.5 * lever, rel=2e-2)


def test_what_was_is_told_the_same_later():
    """A tracker asks for a moment that has passed, twice: the same pose, whatever was asked between."""
    arm = Arm(friction=0.1, creep=0.1, bearing=2e-4, hardening=0.01)
    arm.push(3.0, 0.5)
    past = arm.now_ns - 18_000_000
    before = arm.world.sensor_pose(past)
    arm.push(-6.0, 0.3)
    np.testing.assert_allclose(arm.world.sensor_pose(past)[:3, 3], before[:3, 3], atol=1e-6)


@pytest.mark.parametrize(
    "wrong", [{"friction": [-1.0] * 5}, {"rust": [0.0] * 5}, {"creep": [0.1]}, {"joint": [0.0] * 5, "creep_s": 0.0}]
)
def test_impossible_gives_are_refused_in_one_line(wrong):
    """Negative friction, unknown words, wrong lengths, no time: the arm stays as it was."""
    world = World()
    reply = Commands(world, {}, {}, lambda: 5).carry_out({"do": "compliance"} | wrong)
    assert "\n" not in reply["error"]
    assert world.compliance is None

"""The world of the virtual robot: what is true must follow from mechanics alone."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from galen_hw.clock import NS_PER_S
from galen_hw.drivers.virtual.effects import Cable, Drift, Thermal
from galen_hw.drivers.virtual.give import Compliance
from galen_hw.drivers.virtual.motion import JointHistory, SensorMotion, motion_function
from galen_hw.drivers.virtual.truth import BIAS_BODY, NOISE_SIGMA, TOOLS, Body
from galen_hw.drivers.virtual.world import World
from galen_hw.errors import UsageError
from galen_hw.kinematics import GalenRobot

T0 = 5_000_000_000_000
ZERO = np.zeros(5)
ANGLES = st.floats(-0.9, 0.9)
SMALL = st.floats(-0.1, 0.1)


def world_at(q, tool="retractor", seed=0):
    world = World(seed=seed)
    world.noise_scale = 0.0
    world.attach(tool)
    world.advance(T0)
    world.set_joints(q, ZERO, ZERO, T0)
    return world


@given(ANGLES, ANGLES, st.sampled_from([None, "pointer", "retractor"]))
def test_a_tool_at_rest_reads_its_weight_by_the_convention_of_recordings(roll, tilt, tool):
    """force = R^T w, torque = c x R^T w, summed over bias body and tool."""
    q = np.array([0.0, 0.0, 0.0, roll, tilt])
    R = GalenRobot().sensor_rotation(q)[0]
    expected = np.zeros(6)
    for body in [BIAS_BODY] + ([TOOLS[tool]] if tool else []):
        f = R.T @ np.array([0.0, 0.0, -9.80665 * body.mass])
        expected += np.concatenate([f, np.cross(body.com, f)])
    np.testing.assert_allclose(world_at(q, tool).wrench(T0), expected, atol=1e-12)


def dumbbells(body):
    """Six point masses with the body's mass, centre and diagonal inertia: pairs on each axis at +-d_k."""
    total = sum(body.inertia)
    m = body.mass / 6.0
    d = [np.sqrt((total / 2.0 - i) / (2.0 * m)) for i in body.inertia]
    return m, [np.asarray(body.com) + s * d[k] * np.eye(3)[k] for k in range(3) for s in (-1.0, 1.0)]


def test_a_moving_tool_reads_what_newton_says_of_its_points():
    """The wrench of a tool in motion is the sum over point masses of m (g - a), a by differences of their positions."""
    robot, tool = GalenRobot(), TOOLS["retractor"]
    rng = np.random.default_rng(3)
    A, w, phase = rng.uniform(0.03, 0.08, 5) * [1, 1, 1, 6, 6], rng.uniform(2.0, 6.0, 5), rng.uniform(0.0, 6.0, 5)
    h, t = 1e-4, 0.3

    def q(t):
        return A * np.sin(w * t + phase)

    world = world_at(q(0.0))
    world.set_joints(q(t), A * w * np.cos(w * t + phase), -A * w**2 * np.sin(w * t + phase), T0 + 300)
    poses = robot.sensor_pose(np.stack([q(t - h), q(t), q(t + h)]))
    force, torque = np.zeros(3), np.zeros(3)
    for m, points in (dumbbells(tool), (BIAS_BODY.mass, [np.asarray(BIAS_BODY.com)])):
        for c in points:
            x = poses[:, :3, :3] @ c + poses[:, :3, 3]
            f = poses[1, :3, :3].T @ (m * (robot.gravity - (x[2] - 2.0 * x[1] + x[0]) / h**2))
            force, torque = force + f, torque + np.cross(c, f)
    measured = world.wrench(T0 + 300)
    np.testing.assert_allclose(measured, np.concatenate([force, torque]), rtol=1e-5, atol=1e-6)
    world.inertial = False
    assert np.abs(world.wrench(T0 + 300) - measured).max() > 0.1, "the motion must be brisk enough to tell"


@given(st.lists(SMALL, min_size=15, max_size=15))
@settings(max_examples=50)
def test_the_quick_kinematics_are_the_robots(numbers):
    """The scalar motion of the sensor agrees with `GalenRobot.sensor_motion` to rounding."""
    q, dq, ddq = np.array(numbers[:5]), 5.0 * np.array(numbers[5:10]), 30.0 * np.array(numbers[10:])
    robot = GalenRobot()
    quick: SensorMotion = motion_function(robot)((q, dq, ddq))
    exact = robot.sensor_motion(q, dq, ddq)
    np.testing.assert_allclose(quick.R, exact.T[0, :3, :3], atol=1e-12)
    np.testing.assert_allclose(quick.p, exact.T[0, :3, 3], atol=1e-12)
    np.testing.assert_allclose(quick.v, robot.sensor_jacobian(q)[0, :3] @ dq, atol=1e-11)
    np.testing.assert_allclose(quick.a, exact.acceleration[0], atol=1e-10)
    np.testing.assert_allclose(quick.omega, exact.omega[0], atol=1e-12)
    np.testing.assert_allclose(quick.alpha, exact.alpha[0], atol=1e-12)


def test_a_delta_out_of_reach_still_has_numbers():
    """Carriages that no platform can join give a stretched arm, not NaN: the virtual process must live on."""
    assert np.isfinite(world_at([0.263, -0.272, 0.254, 0, 0]).wrench(T0)).all()
    assert np.isfinite(world_at([5.0, -5.0, 5.0, 0, 0]).wrench(T0)).all()


def test_joints_are_known_between_and_a_little_beyond_what_was_said():
    """A cubic between two states; 0.1 s of constant acceleration after the last one; then at rest."""
    world = World()
    dt = NS_PER_S // 100
    motion = [np.full(5, x) for x in (0.02, 0.3, 4.0)]

    def truth(t):
        return motion[0] + motion[1] * t + 0.5 * motion[2] * t**2

    for k in range(3):
        t = k * dt / NS_PER_S
        world.set_joints(truth(t), motion[1] + motion[2] * t, motion[2], T0 + k * dt)
    np.testing.assert_allclose(world.joints(T0 + dt // 2)[0], truth(0.005), atol=1e-12)
    np.testing.assert_allclose(world.joints(T0 + dt // 2)[1], motion[1] + motion[2] * 0.005, atol=1e-9)
    np.testing.assert_allclose(world.joints(T0 + 5 * dt)[0], truth(0.05), atol=1e-12)
    q, dq, _ = world.joints(T0 + 100 * dt)
    np.testing.assert_allclose(q, truth(0.12), atol=1e-12)
    assert not dq.any()


def test_joints_said_again_replace_what_was_said_of_later():
    """A state for an earlier time wins over later ones, and resting states are one object, so caches hold."""
    world = World()
    world.set_joints(np.ones(5), ZERO, ZERO, T0)
    world.set_joints(2 * np.ones(5), ZERO, ZERO, T0 + 10)
    world.set_joints(3 * np.ones(5), ZERO, ZERO, T0 + 5)
    assert world.joints(T0 + 20)[0][0] == 3.0
    world.set_joints(3 * np.ones(5), ZERO, ZERO, T0 + 30)
    assert world.joints(T0 + 20) is world.joints(T0 + 1_000_000_000)


def test_long_running_history_stays_small_and_right():
    """Ten thousand moving states do not grow without bound, and the newest are exact."""
    world = World()
    for k in range(10_000):
        world.set_joints(np.full(5, 1e-5 * k), np.full(5, 1e-2), ZERO, T0 + k * 1_000_000)
    assert len(world._joints._times) <= 8192
    np.testing.assert_allclose(world.joints(T0 + 9_998_500_000)[0], 0.099985, atol=1e-12)


def test_a_push_rises_holds_and_ends_and_acts_at_the_contact_point():
    """A base-frame force at the tip reads R^T F and tip x R^T F; half of it half way up; nothing afterwards."""
    q = np.array([0, 0, 0, 0.4, -0.3])
    world = world_at(q)
    rest = world.load(T0)
    world.push([1.0, 2.0, -3.0], [0.01, 0.0, 0.02], seconds=2.0, rise_s=0.5)
    R = world.motion(T0).R
    f, t = R.T @ [1.0, 2.0, -3.0], R.T @ [0.01, 0.0, 0.02]
    full = np.concatenate([f, t + np.cross(TOOLS["retractor"].tip, f)])
    for seconds, share in ((0.0, 0.0), (0.25, 0.5), (1.0, 1.0), (2.4, 1.0), (2.75, 0.5), (3.0, 0.0)):
        np.testing.assert_allclose(world.load(T0 + round(seconds * NS_PER_S)) - rest, share * full, atol=1e-9)
    world.advance(T0 + 4 * NS_PER_S)
    assert world.hand.idle


def test_a_guiding_hand_pulls_smoothly_towards_its_aim_and_lets_go():
    """No jerk at the start; with the tool held fast the force grows to stiffness x distance; a moved tool brakes it."""
    world = world_at(ZERO)
    rest = world.load(T0)
    world.guide(by=[0.02, 0.0, 0.0], turn=[0.1, 0, 0], move_s=1.0, seconds=3.0)
    np.testing.assert_allclose(world.load(T0), rest, atol=1e-12)
    pull = world.load(T0 + 2 * NS_PER_S) - rest
    np.testing.assert_allclose(pull[:3], [300.0 * 0.02, 0.0, 0.0], atol=1e-9)
    tip = np.asarray(TOOLS["retractor"].tip)
    np.testing.assert_allclose(pull[3:] - np.cross(tip, pull[:3]), [3.0 * 0.1, 0.0, 0.0], atol=1e-9)
    world.set_joints(ZERO, [0.1, 0.1, 0.1, 0, 0], ZERO, T0 + 2 * NS_PER_S)
    assert (world.load(T0 + 2 * NS_PER_S) - rest)[2] == pytest.approx(-2.0)
    world.set_joints(ZERO, ZERO, ZERO, T0 + 2 * NS_PER_S)
    np.testing.assert_allclose(world.load(T0 + 3 * NS_PER_S), rest, atol=1e-12)


def test_a_guiding_hand_never_pulls_harder_than_it_can():
    """Force and torque are limited in size, with their direction kept."""
    world = world_at(ZERO, None)
    rest = world.load(T0)
    world.guide(by=[3.0, 4.0, 0.0], turn=[0, 2.0, 0], move_s=0.1, limit_n=10.0, limit_nm=0.5)
    np.testing.assert_allclose(world.load(T0 + NS_PER_S) - rest, [6.0, 8.0, 0.0, 0.0, 0.5, 0.0], atol=1e-9)


def test_noise_is_as_large_as_stated_and_belongs_to_the_seed():
    """One sigma of each axis within 3 %; the same seed gives the same samples."""
    world, again, other = World(seed=4), World(seed=4), World(seed=5)
    samples = np.array([world.wrench(T0 + k) for k in range(20_000)])
    np.testing.assert_allclose(samples.std(axis=0), NOISE_SIGMA, rtol=0.03)
    assert (again.wrench(T0) == samples[0]).all()
    assert (other.wrench(T0) != samples[0]).all()


def test_drift_is_linear_warms_up_and_walks():
    """The rate and the warm-up are exact; the walk spreads as the root of time and repeats when asked again."""
    drift = Drift(T0, rate=np.full(6, 0.01), warm_up=np.full(6, 0.5), warm_up_s=10.0)
    np.testing.assert_allclose(drift.wrench(T0 + 10 * NS_PER_S), 0.1 + 0.5 * (1.0 - np.exp(-1.0)))
    assert not drift.wrench(T0 - 5).any()
    ends = np.array([Drift(T0, walk=np.ones(6), seed=s).wrench(T0 + 4 * NS_PER_S) for s in range(150)])
    assert ends.std() == pytest.approx(2.0, rel=0.1)
    walk = Drift(T0, walk=np.ones(6), seed=1)
    late, early = walk.wrench(T0 + 3 * NS_PER_S), walk.wrench(T0 + 7_000_000)
    assert (walk.wrench(T0 + 3 * NS_PER_S) == late).all()
    assert (walk.wrench(T0 + 7_000_000) == early).all()


def test_drift_and_temperature_are_the_sensors_not_the_loads():
    """They change the reading and leave the true load alone."""
    world = world_at(ZERO)
    load = world.load(T0)
    world.drift = Drift(T0, rate=np.full(6, 0.01))
    world.thermal = Thermal(T0, start_c=22.0, rate=0.5, gain=np.full(6, 0.002))
    t = T0 + 10 * NS_PER_S
    np.testing.assert_allclose(world.wrench(t) - load, np.full(6, 0.1 + 0.01))
    np.testing.assert_allclose(world.load(t), load)
    world.advance(t)
    assert world.temperature == pytest.approx(27.0)


def test_a_cable_pulls_only_when_taut_and_remembers_its_way():
    """Slack: nothing. Taut: towards its anchor. There and back at the same place: two friction forces."""
    cable = Cable(np.array([0.0, 0.0, 1.0]), np.zeros(3), stiffness=10.0, rest_length=0.5, friction=0.3)
    assert not cable.force(np.array([0.0, 0.0, 0.6])).any()
    cable.friction = 0.0
    np.testing.assert_allclose(cable.force(np.zeros(3)), [0.0, 0.0, 5.0])
    cable.friction = 0.3
    way = np.concatenate([np.linspace(0, 0.1, 50), np.linspace(0.1, 0, 50)])
    pulls = [cable.force(np.array([0.0, 0.0, -x]))[2] for x in way]
    assert pulls[25] - pulls[74] == pytest.approx(0.6, abs=0.02)


def test_a_cable_acts_on_the_sensor_with_its_moment():
    """Force at the attached point, moved to the sensor's origin."""
    world = world_at(ZERO, None)
    rest = world.load(T0)
    attached = np.array([0.0, 0.0, -0.1])
    world.cable = Cable(world.motion(T0).p + attached + [1.0, 0, 0], attached, stiffness=2.0)
    np.testing.assert_allclose(world.load(T0) - rest, [2.0, 0, 0, 0, -0.2, 0], atol=1e-12)


def test_the_arm_is_rigid_unless_told_otherwise():
    """Sensor and tip poses are the kinematics' when nothing gives."""
    q = np.array([0.01, -0.02, 0.03, 0.5, -0.4])
    world = world_at(q)
    T = GalenRobot().sensor_pose(q)[0]
    np.testing.assert_allclose(world.sensor_pose(T0), T, atol=1e-12)
    np.testing.assert_allclose(world.tip_pose(T0)[:3, 3], T[:3, :3] @ TOOLS["retractor"].tip + T[:3, 3], atol=1e-12)


def test_the_arm_gives_under_load_in_joints_and_structure():
    """A heavy tool sags: each tilt radian per N m of its moment about the tilt axis; the structure adds its own."""
    world = world_at(ZERO, Body("weight", 2.0, (0.0, 0.0, 0.0)))
    rigid = world.sensor_pose(T0)
    give = 1e-3
    world.compliance = Compliance(np.array([0, 0, 0, 0, give]), np.zeros(6), ZERO.copy())
    load = world.load(T0)
    torque = 0.055 * -load[2] + load[4]  # About y through the tilt axis, 0.055 m behind the sensor.
    turn = rigid[:3, :3].T @ world.sensor_pose(T0)[:3, :3]
    assert turn[0, 2] == pytest.approx(give * torque, rel=2e-3)
    world.compliance = Compliance(ZERO.copy(), np.array([0, 0, 1e-5, 0, 0, 0]), ZERO.copy())
    world.sensor_pose(T0)
    sag = world.sensor_pose(T0)[2, 3] - rigid[2, 3]
    assert sag == pytest.approx(1e-5 * load[2], rel=1e-3)


def test_a_bent_sensor_feels_gravity_where_it_really_points():
    """With give in the roll, the force along y is the weight times the extra roll."""
    world = world_at(ZERO, Body("weight", 1.0, (0.0, 0.1, 0.0)))
    world.compliance = Compliance(np.array([0, 0, 0, 0.01, 0.0]), np.zeros(6), ZERO.copy())
    for _ in range(3):
        pose = world.sensor_pose(T0)
    np.testing.assert_allclose(world.load(T0)[:3], pose[:3, :3].T @ [0, 0, -9.80665 * 1.085], atol=1e-9)
    assert world.load(T0)[1] == pytest.approx(9.80665 * 1.085 * 0.01 * 0.1 * 9.80665, rel=0.02)


def test_play_leaves_the_tool_behind_on_either_side():
    """Up to a roll and back down to it: two true poses, apart by the play."""
    world = World()
    world.attach("pointer")
    world.compliance = Compliance(ZERO.copy(), np.zeros(6), np.array([0, 0, 0, 0.004, 0]))
    rolls, t = [], T0
    for roll in (0.0, 0.1, 0.2, 0.1):
        t += 10_000_000
        world.set_joints([0, 0, 0, roll, 0], ZERO, ZERO, t)
        R = world.sensor_pose(t)[:3, :3]
        rolls.append(np.arctan2(R[2, 1], R[1, 1]))
    np.testing.assert_allclose(rolls, [0.0, 0.098, 0.198, 0.102], atol=1e-9)


def test_impossible_tools_are_refused():
    """Unknown names, missing numbers, negative mass."""
    world = World()
    for tool in ("scalpel", {"mass": 1.0}, {"mass": -1.0, "com": [0, 0, 0]}, {"mass": 1, "com": [0, 0], "colour": 1}):
        with pytest.raises(UsageError):
            world.attach(tool)
    world.attach({"name": "block", "mass": 0.5, "com": [0, 0, -0.01]})
    assert world.tool.name == "block"


def test_guiding_turns_about_base_axes():
    """The torque of a hand that turns about base z is along base z whatever the sensor's own attitude."""
    q = np.array([0, 0, 0, 0.7, 0.5])
    world = world_at(q, None)
    rest = world.load(T0)
    world.guide(turn=[0, 0, 0.2], move_s=0.5)
    torque = world.motion(T0).R @ (world.load(T0 + NS_PER_S) - rest)[3:]
    np.testing.assert_allclose(torque, [0, 0, 0.6], atol=1e-9)


def test_states_said_microseconds_apart_make_no_forces():
    """A controller that is asked twice within 10 us says the same motion: the acceleration stays the true one."""
    history, t_ns, gaps = JointHistory(1), 0, np.random.default_rng(4).integers(1_000, 3_000_000, 400)
    for gap in gaps:
        t_ns += int(gap)
        t = t_ns * 1e-9
        history.set([0.15 * t * t], [0.3 * t], [0.3], t_ns)
    asked = np.linspace(0.1 * t_ns, t_ns, 2000).astype(int)
    found = np.array([history.at(int(t))[2][0] for t in asked])
    np.testing.assert_allclose(found, 0.3, atol=0.01)

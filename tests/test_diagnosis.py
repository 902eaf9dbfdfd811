"""The diagnosis against concealed effects: each by itself, nulls, pairs, what has no name, and a tilted axis in a sweep."""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

sys.path.insert(0, str(Path(__file__).parent))

import diagnosis_cases as cases
from diagnosis_cases import IN_EFFORT, IN_POSITION, IN_WRENCH, SIGMA, Beam, Bench, Servo

from galen_hw.diagnosis.noise.spectrum import followed
from galen_hw.diagnosis.pipeline import diagnose
from galen_hw.diagnosis.result import Diagnosis
from galen_hw.kinematics import GalenRobot
from galen_hw.physics.effects.registry import scene_of
from galen_hw.physics.observations import Belief, Observations


def answer(observations: Observations) -> Diagnosis:
    """What the program says of a recording."""
    return diagnose(scene_of(observations)).diagnosis


def named(d: Diagnosis) -> list[str]:
    """The effects found, first things first."""
    return [finding.effect for finding in d.findings]


def parameter(d: Diagnosis, effect: str, name: str) -> float:
    """One number of a finding; where a finding has several places, of the first."""
    found = next(f.parameters for f in d.findings if f.effect == effect)
    return next(v.value for k, v in found.items() if k == name or k.endswith(f": {name}"))


CHANNELS = {
    "bias": "wrench.force.x",
    "step": "wrench.force.y",
    "drift": "wrench.force.x",
    "temperature": "wrench.force.z",
    "gain": "wrench.force.x",
    "cross_talk": "wrench.torque.y",
    "saturation": "wrench.force.y",
    "creep": "wrench.force.x",
    "hysteresis": "wrench.force.y",
    "vibration": "wrench.force.z",
    "glitches": "wrench.force.x",
}
NUMBERS = {
    "bias": ("offset", 0.1),
    "step": ("jump_wrench.force.y", 0.08),
    "drift": ("change", 0.15),
    "temperature": ("coefficient", 0.03),
    "gain": ("gain_error", 0.08),
    "cross_talk": ("leak", 2e-3),
    "saturation": ("limit", 0.7),
    "time_delay": ("delay", 0.12),
    "lag": ("constant", 0.6),
    "creep": ("share", 0.15),
    "vibration": ("frequency", 3.7),
    "payload": ("mass", 0.02),
    "inertial": ("share", 1.0),
    "joint_offset": ("offset", 0.03),
    "joint_scale": ("scale_error", 0.05),
    "sensor_mounting": ("turn_z", 0.04),
    "cable_drag": ("stiffness", 2.0),
}


ALIKE = ("lag", "inertial")
"""At 20 rows a second a lag of a sample looks like the sensor's creep, and inertia is not sampled well enough to be all."""


@pytest.mark.parametrize("key", [k for k in IN_WRENCH if k not in ALIKE])
def test_an_effect_in_a_wrench_is_named_alone_with_its_number_and_place(key):
    """One finding, the right one; its number within 8 % (five standard deviations of all of them at this size), its channel
    first; everything explained."""
    bench = Bench()
    IN_WRENCH[key](bench)
    d = answer(bench.observations())
    assert named(d) == [key]
    assert d.verdict == "explained"
    if key in NUMBERS:
        name, value = NUMBERS[key]
        assert parameter(d, key, name) == pytest.approx(value, rel=0.08)
    if key in CHANNELS:
        assert d.findings[0].channels[0] == CHANNELS[key]


@pytest.mark.parametrize("name", IN_EFFORT)
def test_an_effect_in_an_effort_is_named_alone(name):
    """One finding, in the joint where it sits."""
    key, conceal = IN_EFFORT[name]
    beam = Beam()
    conceal(beam)
    d = answer(beam.observations())
    assert (named(d), d.verdict) == ([key], "explained")
    assert d.findings[0].channels == ["joint.shoulder.effort"]


@pytest.mark.parametrize("name", IN_POSITION)
def test_an_effect_in_a_position_is_named_alone(name):
    """One finding, in the joint where it sits, or in both where the whole stream is late."""
    key, conceal = IN_POSITION[name]
    servo = Servo()
    conceal(servo)
    d = answer(servo.observations())
    assert (named(d), d.verdict) == ([key], "explained")


@pytest.mark.parametrize(("compliance", "cubic"), [(2e-3, 0.0), (0.0, 1e-3), (4e-3, 5e-4)])
def test_give_of_a_joint_under_a_known_force_is_named_with_its_number(compliance, cubic):
    """A spring, a spring that softens, or both, from the tracked tip."""
    d = answer(cases.tracked(compliance, cubic))
    expected = {"compliance": compliance, "hardening": cubic}
    assert set(named(d)) == {k for k, v in expected.items() if v}
    for key, value in expected.items():
        if value:
            name = "compliance" if key == "compliance" else "coefficient"
            assert parameter(d, key, name) == pytest.approx(value, rel=0.08)


@pytest.mark.parametrize(("axis", "error"), [((0.03, 1.0, 0.0), "axis_tilt.z"), ((0.0, 1.0, 0.03), "axis_tilt.x")])
def test_a_tilt_axis_that_points_elsewhere_shows_in_one_sweep_of_56_poses(axis, error):
    """`link_geometry` by name, the size to 3 %, and nothing beside it; the right axis agrees."""
    d = answer(cases.sweep(np.array(axis)))
    assert named(d) == ["link_geometry"]
    assert abs(parameter(d, "link_geometry", error)) == pytest.approx(0.03, rel=0.03)
    assert d.verdict == "explained"
    assert answer(cases.sweep(np.array([0.0, 1.0, 0.0]))).verdict == "agrees"


def coloured() -> Observations:
    """With a memory of a second, settled before the recording begins: its start would be a warm-up."""
    bench = Bench(3)
    rows, before = len(bench.t), bench.t - bench.t[-1] - bench.t[1]
    whole = [cases.lagged(np.r_[before, bench.t], np.r_[c[::-1], c], 1.0)[rows:] for c in bench.noise.T]
    bench.noise = 4.0 * np.stack(whole, axis=1)
    return bench.observations()


def unclocked(seen: Observations) -> Observations:
    """The rows in their order alone."""
    return replace(seen, columns={k: v for k, v in seen.columns.items() if k != "time"})


def quantised() -> Observations:
    bench = Bench(4)
    step = 3.0 * SIGMA
    bench.wrench, bench.noise = np.round((bench.wrench + bench.noise) / step) * step, 0.0 * bench.noise
    return bench.observations()


NULLS = {
    "white": lambda: Bench(2).observations(),
    "coloured": coloured,
    "quantised": quantised,
    "effort": lambda: Beam(1).observations(),
    "position": lambda: Servo(1).observations(),
    "pose": cases.tracked,
    "poses without a clock": lambda: cases.tracked(clock=False),
    "coloured without a clock": lambda: unclocked(coloured()),
    "sweep without a clock": lambda: cases.sweep(np.array([0.0, 1.0, 0.0]), seed=2),
}


@pytest.mark.parametrize("name", NULLS)
def test_where_nothing_is_concealed_nothing_is_found(name):
    """`agrees`, no finding, and the smallest effect that would have been seen is said."""
    d = answer(NULLS[name]())
    assert (d.verdict, named(d)) == ("agrees", [])
    assert any("would have been seen" in note for note in d.notes)


def test_pairs_are_named_together_and_nothing_else():
    """Two effects at once: scale and drift in one channel, hysteresis under a heavier tool, a leak and a step, friction
    and ripple."""
    both = Bench(5)
    cases.drift(both)
    cases.gain(both)
    assert set(named(answer(both.observations()))) == {"drift", "gain"}
    both = Bench(5)
    cases.hysteresis(both)
    both.wrench = both.wrench + cases.hanging(both.R, 0.02, np.zeros(3))
    assert set(named(answer(both.observations()))) == {"hysteresis", "payload"}
    both = Bench(6)
    cases.step(both)
    cases.cross_talk(both)
    assert set(named(answer(both.observations()))) == {"step", "cross_talk"}
    beam = Beam(2)
    cases.friction(beam)
    cases.torque_ripple(beam)
    assert set(named(answer(beam.observations()))) == {"friction", "torque_ripple"}


@pytest.mark.parametrize(
    ("key", "again"),
    [
        ("drift", lambda b: b.wrench[:, 0].__iadd__(-0.1 * (b.t / b.t[-1]) ** 2)),
        ("step", lambda b: b.wrench[:, 1].__iadd__(-0.06 * (b.t > 21.7))),
        ("vibration", lambda b: b.wrench[:, 2].__iadd__(0.04 * np.sin(2 * np.pi * 3.7 * b.t + 1.9))),
    ],
)
def test_what_belongs_to_moments_is_another_in_the_recording_that_is_judged_on(key, again):
    """A drift another way, a jump at another time, a hum of another phase: still explained, and the fit is down at the noise."""
    first, second = Bench(5), Bench(6)
    getattr(cases, key)(first)
    again(second)
    d = diagnose(scene_of(first.observations()), holdout=scene_of(second.observations())).diagnosis
    assert (named(d), d.verdict) == ([key], "explained")
    assert all(d.fit["rmse_after"][c] < 1.1 * d.fit["noise_floor"][c] for c in d.fit["rmse_after"])
    assert d.findings[0].evidence["heldout_gain"] > 0.8


def test_structure_without_a_name_is_not_given_one():
    """An offset that flips to and fro by itself: `unknown` in its channel; a torque of acceleration and place: partly."""
    bench = Bench(7)
    bench.wrench[:, 0] += 0.05 * np.sign(np.sin(2.0 * np.pi * bench.t / 9.7))
    d = answer(bench.observations())
    assert (named(d), d.verdict) == (["unknown"], "unexplained")
    assert d.findings[0].channels == ["wrench.force.x"]
    beam = Beam(7)
    beam.effort = beam.effort + 0.15 * np.tanh(3.0 * beam.ddq) * np.cos(5.0 * beam.q)
    assert answer(beam.observations()).verdict in ("partly_explained", "unexplained")


def test_a_clock_offset_is_a_delay_or_worse_and_nothing_else():
    """The wrench was stamped 1.7 s early: never a tool, a tilt or a cable."""
    bench = Bench(8)
    bench.wrench = np.stack([np.interp(bench.t + 1.7, bench.t, c) for c in bench.wrench.T], axis=1)
    d = answer(bench.observations())
    assert d.verdict == "unexplained" or named(d)[0] == "time_delay"


def test_weight_turns_with_the_sensor():
    """A check of the generator: upside down the weight reads the other way."""
    over = cases.turned(np.array([1.0, 0.0, 0.0]), np.array([0.0, np.pi]))
    up, down = cases.hanging(over)
    np.testing.assert_allclose(up[2], -down[2])
    assert up[2] < 0.0


@pytest.mark.parametrize("share", [0.1, 0.25, 0.4, 0.8])
def test_what_of_a_rounding_error_follows_its_signal(share):
    """Against rounding itself: the mean error over one step, noise before it, by averaging many readings."""
    rng, x = np.random.default_rng(3), np.linspace(0.0, 1.0, 50, endpoint=False)
    readings = np.round(x[:, None] + share * rng.normal(size=(50, 40000)))
    error = readings.mean(axis=1) - x
    sigma = float(np.sqrt(share**2 + 1.0 / 12.0))
    fine, none = followed(np.array([1.0, 0.0]), np.array([sigma, sigma]))
    assert fine <= 0.2 / 12.0
    assert min(np.var(error), 0.2 / 12.0) == pytest.approx(fine, rel=0.05, abs=2e-5)
    assert none == 0.0


@pytest.mark.parametrize("seed", [1, 2])
@pytest.mark.parametrize("group", ["pose", "targets"])
def test_noise_of_the_joints_is_no_physics_of_a_tracked_pose(group, seed):
    """Carriages at rest jitter by their encoders' noise in all channels at once; an orientation is no difference of columns."""
    rng = np.random.default_rng(seed)
    t = np.arange(2400) / 40.0
    slides = 0.03 * (seed - 1)
    q = np.stack([cases.sines(rng, t, s) for s in (slides, slides, slides, 0.4, 0.3)], axis=1)
    T = GalenRobot().sensor_pose(q)
    seen = q + np.array([1e-5, 1e-5, 1e-5, 2e-5, 2e-5]) * rng.normal(size=q.shape)
    columns = {"time": t} | {f"joint.{n}.position": seen[:, i] for i, n in enumerate(cases.JOINTS)}
    tip = np.array([0.045, 0.0, -0.14])
    if group == "pose":
        at = T[:, :3, 3] + T[:, :3, :3] @ tip + 1e-4 * rng.normal(size=(len(t), 3))
        turned = Rotation.from_rotvec(5e-4 * rng.normal(size=(len(t), 3))) * Rotation.from_matrix(T[:, :3, :3])
        columns |= {f"pose.position.{a}": at[:, i] for i, a in enumerate("xyz")}
        columns |= {f"pose.orientation.{a}": turned.as_quat()[:, i] for i, a in enumerate("xyzw")}
    else:
        R, shift = Rotation.from_rotvec([0.3, -0.2, 0.5]).as_matrix(), np.array([0.4, -1.2, 0.3])
        for k, point in enumerate(([0.05, 0.0, -0.1], [-0.04, 0.06, -0.12], [0.0, -0.05, -0.2])):
            y = (T[:, :3, 3] + T[:, :3, :3] @ point) @ R.T + shift + 1e-4 * rng.normal(size=(len(t), 3))
            columns |= {f"target.{k + 1}.position.{a}": y[:, i] for i, a in enumerate("xyz")}
    work = diagnose(scene_of(Observations(group, columns, None, Belief(robot=GalenRobot(), tip=tip, bias_free=True))))
    assert [f.effect for f in work.diagnosis.findings] == []
    assert work.diagnosis.verdict == "agrees"

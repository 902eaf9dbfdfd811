"""Rivals in each other's place: clocks against filters, a limit seen once, play that motion alone turns over."""

import dataclasses
import sys
from functools import partialmethod
from pathlib import Path

import numpy as np
import pytest
from scipy.signal import lfilter

sys.path.insert(0, str(Path(__file__).parent))

import diagnosis_cases as cases
from diagnosis_cases import WRENCH, Beam, Bench, Servo

from galen_hw.diagnosis.estimation.normal_equations import Scorer
from galen_hw.diagnosis.identifiability import rivals
from galen_hw.diagnosis.pipeline import diagnose
from galen_hw.diagnosis.selection.acceptance import pays
from galen_hw.diagnosis.selection.comparison import in_place, vuong_statistic
from galen_hw.diagnosis.selection.proposals import sought
from galen_hw.diagnosis.stats.paired_test import paired
from galen_hw.diagnosis.validation.holdout import judge
from galen_hw.diagnosis.work import Work
from galen_hw.kinematics import GalenRobot, UrdfRobot
from galen_hw.physics.effects.backlash import Backlash
from galen_hw.physics.effects.compliance import Hardening
from galen_hw.physics.effects.geometry import JointOffset
from galen_hw.physics.effects.hysteresis import Hysteresis
from galen_hw.physics.effects.registry import scene_of
from galen_hw.physics.effects.timing import Lag, TimeDelay
from galen_hw.physics.observations import Belief, Observations
from galen_hw.physics.rigid import Body


def work_of(bench: Bench | Servo) -> Work:
    """All that a diagnosis went through."""
    return diagnose(scene_of(bench.observations()))


def named(work: Work) -> list[str]:
    """The effects found, first things first."""
    return [finding.effect for finding in work.diagnosis.findings]


@pytest.mark.parametrize("filtered", [False, True])
def test_a_delay_and_a_filter_state_each_other_where_motion_is_slow(filtered: bool) -> None:
    """Below half a sample nothing tells them apart: whichever stands first, the other is in its class."""
    servo = Servo()
    late = [np.interp(servo.t - 0.005, servo.t, x) for x in servo.command.T]
    slow = [cases.lagged(servo.t, x, 0.01) for x in servo.command.T]
    servo.position = np.stack(slow if filtered else late, axis=1)
    servo.sigma = 2e-3
    first = work_of(servo).diagnosis.findings[0]
    assert {first.effect, *(c.effect for c in first.confounded_with)} >= {"time_delay", "lag"}


@pytest.mark.parametrize("filtered", [False, True])
def test_a_filter_that_the_blocks_agree_on_is_no_delay(filtered: bool) -> None:
    """Quick motion tells them apart by a few thousandths of what either explains, and every block says the same."""
    servo = Servo()
    command = servo.command + 0.03 * np.sin(2.0 * np.pi * 1.5 * servo.t)[:, None]
    late = [np.interp(servo.t - 0.05, servo.t, x) for x in command.T]
    slow = [cases.lagged(servo.t, x, 0.05) for x in command.T]
    servo.command, servo.position = command, np.stack(slow if filtered else late, axis=1)
    servo.sigma = 2e-3
    assert named(work_of(servo)) == ["lag" if filtered else "time_delay"]


@pytest.mark.inject
@pytest.mark.parametrize(("pan", "lift"), [(0.05, 0.05), (0.09, 0.13), (0.05, 0.15)])
def test_joints_have_lags_of_their_own_only_where_they_differ(pan: float, lift: float) -> None:
    """One number for all is found first; it stays unless what it leaves in one joint is the opposite of the other's."""
    servo = Servo()
    servo.command = servo.command + 0.03 * np.sin(2.0 * np.pi * 1.5 * servo.t)[:, None]
    servo.position = np.stack(
        [cases.lagged(servo.t, x, T) for x, T in zip(servo.command.T, (pan, lift), strict=True)], 1
    )
    servo.sigma = 2e-3
    work = work_of(servo)
    assert named(work) == ["lag"]
    found = {h.effect.joint: h.effect.constant for h in work.model.effects if isinstance(h.effect, Lag)}
    expected = {"": pan} if pan == lift else {"pan": pan, "lift": lift}
    assert found == {joint: pytest.approx(T, rel=0.03) for joint, T in expected.items()}


def test_a_lag_explains_what_all_of_the_stream_in_it_does() -> None:
    """Twice the change of a lag of half the delay is the delay to second order: a fitted share would take that for a lag."""
    servo = Servo()
    servo.position = np.stack([np.interp(servo.t - 0.04, servo.t, x) for x in servo.command.T], axis=1)
    work = work_of(servo)
    scorer = Scorer(work.bench, [work.bench.hypothesis(Lag(c)) for c in (0.02, 0.04)])
    first = len(scorer.base)
    scores = scorer.scores([])[0]
    own = scorer.solve([first])[0][-1]
    assert own > 1.5, "a fitted share passes for a delay"
    assert scores[first].gain < 0.8 * (scorer.solve([])[2] - scorer.solve([first])[2])
    assert scores[first].count == 1
    assert scores[first + 1].gain > scores[first].gain
    assert vuong_statistic(work.bench, scorer, [], first + 1, first) > 3.0


def test_a_filter_behind_a_delay_is_the_two_after_one_another() -> None:
    """The delay's change and the filter's columns behind it add up to the filtered signal, late."""
    work = work_of(Servo())
    bench, scene = work.bench, work.bench.scene
    late, slow, seconds = TimeDelay(), Lag(0.12), np.array([0.08])
    expected = [cases.lagged(scene.time, x, 0.12) for x in scene.simulated.T]
    expected = [np.interp(scene.time - 0.08, scene.time, x) for x in expected]
    bench.update_state(timing=[(late, seconds)])
    change = late.exact(scene, seconds)
    assert change is not None
    both = bench.rows.average(scene.simulated + change) + bench.raw(slow).values[:, :, 0]
    far = scene.time > 2.0
    assert np.abs(both - np.stack(expected, axis=1))[far].max() < 2e-4 * np.ptp(scene.simulated)
    alone = bench.rows.average(scene.simulated + change) + slow.columns(scene).values[:, :, 0]
    assert np.abs(alone - np.stack(expected, axis=1))[far].max() > 5e-3 * np.ptp(scene.simulated)


@pytest.mark.inject
def test_every_place_of_an_effect_earns_its_own() -> None:
    """Play in both joints when it was learnt, in one of them on another day: that one keeps its name, the other does not."""
    learnt, other = Servo(seed=1), Servo(seed=2)
    for servo, joints in ((learnt, (0, 1)), (other, (0,))):
        for j in joints:
            servo.position[:, j] = cases.played(servo.command[:, j], 0.01)
    work = diagnose(scene_of(learnt.observations()), holdout=scene_of(other.observations()))
    assert work.diagnosis.findings[0].effect == "backlash"
    assert work.diagnosis.findings[0].joints == ["pan"]
    alone = diagnose(scene_of(learnt.observations()), holdout=scene_of(Servo(seed=3).observations()))
    assert "backlash" not in named(alone)


def test_smaller_models_are_judged_on_the_same_rows_of_another_recording() -> None:
    """What a poorer model misses must not be set apart as an outside force."""
    learnt, other = Servo(seed=1), Servo(seed=2)
    for servo in (learnt, other):
        servo.position = np.stack([np.interp(servo.t - 0.06, servo.t, x) for x in servo.command.T], axis=1)
    model, holdout = work_of(learnt).model, scene_of(other.observations())
    first = judge(model, holdout)
    assert first.good is not None
    assert 0.89 < first.good.mean() < 1.0, "the ends of the recording alone"
    marked = dataclasses.replace(first, good=first.good & (np.arange(len(first.good)) % 2 == 0), episodes=((1.0, 2.0),))
    again = judge(model.without(model.effects), holdout, marked)
    assert again.good is marked.good
    assert again.episodes == marked.episodes
    assert np.all(again.after > first.after)


def test_a_rival_in_place_of_a_bent_effect_meets_the_whole_residual() -> None:
    """A link's large error left out and put back: its own score is what it was, and the scorer is as before."""
    bench = Bench()
    cases.joint_offset(bench)
    work = work_of(bench)
    scorer, chosen = work.selection.scorer, work.selection.chosen
    i = next(i for i in chosen if scorer.library[i].nonlinear is not None)
    b, white = scorer.b.copy(), scorer.white.copy()
    gain = scorer.solve([j for j in chosen if j != i])[2] - scorer.solve(chosen)[2]
    scores = in_place(work.bench, scorer, chosen, i)
    assert np.array_equal(scorer.b[: len(b)], b)
    assert np.array_equal(scorer.white, white)
    assert scores[i].gain == pytest.approx(gain, rel=0.05)
    assert scores[i].rank >= max(s.rank for j, s in scores.items() if j != i) - 6.0


def test_a_limit_that_was_reached_once_is_a_limit_and_no_contact() -> None:
    """One swing is cut off below the noise's size of a pile; no reading stands exactly on the limit."""
    bench = Bench(seed=5, rows=4000)
    x = bench.wrench[:, 1].copy()
    top = int(np.argmax(x))
    once = np.abs(np.arange(len(x)) - top) < 100
    limit = float(x[top]) - 0.12
    assert np.max(x[~once]) < limit
    bench.wrench[:, 1] = np.minimum(x, limit)
    work = work_of(bench)
    assert named(work) == ["saturation"]
    effect, share = work.model.effects[0].effect, work.model.final[-1]
    beyond = np.maximum(x - effect.limit, 0.0) * share
    assert beyond.max() == pytest.approx(0.12, abs=0.03)


def test_the_ends_of_a_recording_hide_no_limit() -> None:
    """No fit sees the first rows, in which it is reached most: there nothing is known, not that nothing was clipped."""
    bench = Bench(seed=5, rows=4000)
    work = work_of(bench)
    ends = work.bench.scene.ends
    assert ends.any()
    x = work.bench.scene.simulated.copy()
    x[ends, 1] = x[:, 1].max() + 2.0
    limit = float(np.sort(x[~ends, 1])[-30])
    rest = np.minimum(x, np.where(np.arange(6) == 1, limit, np.inf)) - x
    work.bench.whole = np.where(ends[:, None], 0.0, rest)
    work.bench.scene.simulated[:] = x
    found = [s.effect for s in sought(work.bench, work.selection.scorer, []) if s.effect.KEY == "saturation"]
    (mine,) = (effect for effect in found if effect.channel == WRENCH[1] and effect.upper)
    assert mine.limit == pytest.approx(limit, abs=0.01)


def test_play_that_motion_turns_over_is_backlash() -> None:
    """An arm whose weight is balanced lies in its play on the side that its acceleration says."""
    beam = Beam(rows=4000)
    torque = (0.05 + 2.0 * 0.25**2) * beam.ddq
    noisy = beam.q - 1e-3 * np.tanh(torque / 0.005) + 1e-3 * beam.rng.normal(size=len(beam.t))
    columns = {"time": beam.t, "joint.shoulder.position": noisy, "joint.shoulder.command": beam.q}
    observations = Observations("position", columns, None, Belief(robot=UrdfRobot(cases.ARM), bias_free=True))
    scene = scene_of(observations)
    load = scene.inertia_load("shoulder")
    assert load == pytest.approx(-torque, abs=0.02 * np.max(np.abs(torque))), "the link hangs back"
    work = diagnose(scene)
    assert named(work) == ["backlash"]
    assert isinstance(work.model.effects[0].effect, Backlash)
    assert work.model.effects[0].effect.balanced
    assert work.diagnosis.findings[0].parameters["half_play"].value == pytest.approx(1e-3, rel=0.1)


def test_an_effect_that_acts_seldom_is_as_sure_as_its_noise_allows() -> None:
    """Two pieces of forty hold all of it; noise that was fitted to noise is not sure."""
    rng = np.random.default_rng(5)
    noise = rng.normal(size=(4000, 2))
    seldom = np.zeros_like(noise)
    seldom[:200] = 1.0
    found = paired(noise + seldom, noise, np.zeros(2))
    assert found.fall > 10.0 * found.error
    fitted = 0.2 * rng.normal(size=(4000, 2))
    assert not paired(noise, noise - fitted, np.zeros(2)).credible()


def test_stiffness_that_grows_with_load_and_friction_beside_a_spring() -> None:
    """The knee's law between a square and a line; slip elements through a joint's port against their definition."""
    law = Hardening("tilt", 2, 0.5).law
    assert law(np.array([-1e-3, 0.0, 0.5, 1e3])) == pytest.approx([-2e-6 / 1.002, 0.0, 0.25, 1e3 - 0.5], rel=1e-3)
    observations = cases.tracked(0.0, 0.0)
    scene = scene_of(observations)
    port, load = scene.joint_port("tilt"), scene.load("tilt")
    held = cases.played(load, 0.1) - load
    columns = Hysteresis.of_load("tilt", (0.1,)).columns(scene).full(len(scene.channels))
    assert columns[:, :, 0] == pytest.approx(port * held[:, None], abs=1e-12)


def scaled_servo() -> Servo:
    """One encoder's scale is off by a small part of the noise's size."""
    servo = Servo()
    servo.position[:, 0] = 1.001 * servo.command[:, 0]
    return servo


def test_a_lead_that_the_blocks_do_not_agree_on_is_none(monkeypatch: pytest.MonkeyPatch) -> None:
    """Whatever the likelihood says: the same rival is stated or not by what the blocks make of it."""
    work = work_of(scaled_servo())
    finding = work.diagnosis.findings[0]
    assert finding.effect == "joint_scale"
    near = [r for r in rivals.rivals(work.selection, finding, everyone=True) if np.isfinite(r.agreed)]
    assert near, "some rival is so near that the blocks are asked"
    key = max(near, key=lambda r: r.agreed).key
    asked = rivals.Rival.undecided
    for clear, stated in ((-10.0, False), (100.0, True)):
        monkeypatch.setattr(rivals.Rival, "undecided", partialmethod(asked, clear=clear))
        assert (key in [c.effect for c in rivals.confusions(work.model, work.selection, finding)]) == stated


def test_a_play_wider_than_the_motion_is_no_rival_of_a_scale() -> None:
    """A thousandth of it would make the same signal, but a play is seen whole: as such it is far away and far behind."""
    work = work_of(scaled_servo())
    finding = work.diagnosis.findings[0]
    everyone = rivals.rivals(work.selection, finding, everyone=True)
    assert everyone, "creep and a lag are near"
    assert all(r.angle > rivals.NEAR and r.lead > rivals.CLOSE for r in everyone if r.key == "backlash")
    assert "backlash" not in [c.effect for c in finding.confounded_with]


@pytest.mark.inject
@pytest.mark.parametrize("offset", [0.0, 0.8])
def test_a_limit_clips_all_that_is_carried(offset: float) -> None:
    """Under a heavier tool and an offset the reading stands at the limit; both are named alone, here and on another day."""
    bench = Bench(seed=4, rows=3000)
    cases.payload(bench)
    bench.wrench[:, 1] += offset
    limit = float(np.quantile(bench.wrench[:, 1], 0.93))
    bench.wrench[:, 1] = np.minimum(bench.wrench[:, 1], limit)
    work = work_of(bench)
    assert sorted(named(work)) == ["payload", "saturation"]
    found = next(f for f in work.diagnosis.findings if f.effect == "saturation")
    assert found.parameters["limit"].value == pytest.approx(limit, abs=0.005)
    assert found.parameters["share"].value == pytest.approx(1.0, abs=0.1)
    assert work.model.residual(white=True)[work.bench.judged].std() < 1.06
    other = Bench(seed=5, rows=3000)
    cases.payload(other)
    other.wrench[:, 1] = np.minimum(other.wrench[:, 1] + offset, limit)
    judged = judge(work.model, scene_of(other.observations()))
    assert np.all(np.sqrt(judged.after / judged.floor) < 1.1)


@pytest.mark.inject
def test_no_bias_beside_a_compliance_that_accounts_for_it() -> None:
    """A bent lift under the tool's weight is lower all along: a bias with less compliance is as good, with a number more."""
    rng, robot, rate = np.random.default_rng(1), GalenRobot(), 60.0
    t = np.arange(4000) / rate
    stations = int(t[-1] / 10.0) + 2
    at = 10.0 * np.repeat(np.arange(stations), 2) + np.tile([0.0, 8.5], stations)
    rests = np.c_[rng.uniform(-0.01, 0.01, (stations, 3)), rng.uniform(-0.6, 0.6, (stations, 2))]
    joints = np.stack([np.interp(t, at, rest.repeat(2)) for rest in rests.T], axis=1)
    waves = zip((0.11, 0.17, 0.23), rng.uniform(0.0, 1.0, 3), strict=True)
    force = np.stack([8.0 * np.sin(2.0 * np.pi * (f * t + phase)) for f, phase in waves], axis=1)
    tool, tip = Body(0.25, np.array([0.03, 0.0, -0.06])), np.array([0.045, 0.0, -0.14])
    pose = robot.sensor_pose(joints)
    position = pose[:, :3, 3] + pose[:, :3, :3] @ tip
    position[:, 2] += 1.5e-5 * (force[:, 2] - tool.mass * 9.80665)
    late = np.stack([np.interp(t - 0.003, t, x) for x in position.T], axis=1)
    columns = {"time": t}
    columns |= {f"joint.{name}.position": q for name, q in zip(robot.joint_names, joints.T, strict=True)}
    columns |= {f"applied.force.{axis}": f for axis, f in zip("xyz", force.T, strict=True)}
    seen = late + 7e-5 * rng.normal(size=late.shape)
    columns |= {f"pose.position.{axis}": x for axis, x in zip("xyz", seen.T, strict=True)}
    belief = Belief(robot=robot, tool=tool, tip=tip, bias_free=False)
    work = diagnose(scene_of(Observations("pose", columns, None, belief)))
    assert set(named(work)) == {"time_delay", "compliance"}


@pytest.mark.inject
@pytest.mark.parametrize(("size", "there"), [(2e-3, True), (0.0, False)])
def test_a_small_effect_is_not_lost_in_large_slow_noise(size: float, there: bool) -> None:
    """Raw errors on blocks left out are the slow noise's; whitened ones show a joint's zero of a fifth of the noise."""
    bench = Bench(31, rows=6000, rate=50.0)
    wander = lfilter([1.0], [1.0, -0.995], bench.rng.normal(size=bench.noise.shape), axis=0) * np.sqrt(1 - 0.995**2)
    bench.noise = (0.9 * wander + 0.44 * bench.rng.normal(size=bench.noise.shape)) * cases.SIGMA
    bench.wrench = cases.hanging(cases.rotation(bench.q[:, 3] + size, bench.q[:, 4]))
    work = diagnose(scene_of(bench.observations()))
    selection = work.selection
    scorer, selection.chosen = selection.scorer, []
    place = next(i for i, h in enumerate(scorer.library) if h.effect == JointOffset("roll"))
    assert pays(selection, [place], place)[0] is there


PLANAR = """<robot name="planar"><link name="base"/><link name="upper"/><link name="fore"/>
<joint name="shoulder" type="revolute"><parent link="base"/><child link="upper"/><axis xyz="0 1 0"/>
<limit lower="-3" upper="3" velocity="5" effort="100"/></joint>
<joint name="elbow" type="revolute"><parent link="upper"/><child link="fore"/><origin xyz="0.3 0 0"/><axis xyz="0 1 0"/>
<limit lower="-3" upper="3" velocity="5" effort="100"/></joint></robot>"""


@pytest.mark.inject
def test_a_zero_that_may_be_another_joint_s_is_told_so() -> None:
    """Two joints about parallel axes turn gravity alike: no wrench tells whose zero is off."""
    rng = np.random.default_rng(3)
    t = np.arange(3000) / 25.0
    q = np.stack([cases.sines(rng, t, size) for size in (0.4, 0.6)], axis=1)
    tilt = q.sum(axis=1) + 0.01
    wrench = cases.hanging(cases.rotation(np.zeros(len(t)), tilt)) + rng.normal(size=(len(t), 6)) * cases.SIGMA
    columns = {"time": t, "joint.shoulder.position": q[:, 0], "joint.elbow.position": q[:, 1]}
    belief = Belief(robot=UrdfRobot(PLANAR), tool=Body(cases.MASS, cases.COM), dynamic=False, bias_free=True)
    seen = Observations("wrench", columns | dict(zip(WRENCH, wrench.T, strict=True)), None, belief)
    (finding,) = diagnose(scene_of(seen)).diagnosis.findings
    assert finding.effect == "joint_offset"
    (other,) = {"shoulder", "elbow"} - set(finding.joints)
    assert [f"in {other} instead of" in c.why for c in finding.confounded_with if c.effect == "joint_offset"] == [True]
    assert "joint_offset" not in [c.effect for c in finding.rivals]

"""The elastic arm: finds what gives on generated robots, serves the same numbers sample by sample."""

import dataclasses
import json

import numpy as np
import pytest

from galen_hw.identification.deflection.blocks import Blocks, Rows
from galen_hw.identification.deflection.compare import counted, first_rest, judged, residual_give
from galen_hw.identification.deflection.data import DeflectionSet
from galen_hw.identification.deflection.elastic import ElasticArm
from galen_hw.identification.deflection.elastic_stream import Jitter
from galen_hw.identification.deflection.elastic_terms import Term, Weight
from galen_hw.identification.deflection.stream import Place
from galen_hw.physics.effects.compliance import Compliance
from galen_hw.physics.effects.hysteresis import Hysteresis
from galen_hw.physics.scenes.elastic_arm import RestingLoad
from galen_hw.tools.deflection import robots
from galen_hw.tools.deflection.robots import NOISE_M, GivingRobot

FULL = {"hysteresis": True, "creep": True, "hardening": True, "play": True}


@pytest.fixture(scope="module")
def robot() -> GivingRobot:
    """A robot with everything."""
    seed = next(s for s in range(200) if GivingRobot.drawn(s).present == FULL)
    return GivingRobot.drawn(seed)


@pytest.fixture(scope="module")
def arm(robot: GivingRobot) -> ElasticArm:
    """Fitted on four configurations."""
    return ElasticArm().fit(robot.sets(4, each=1))


def test_the_right_effects_are_found_on_a_generated_robot(arm: ElasticArm) -> None:
    """Friction, creep, hardening and play of the MuJoCo arm are all kept, and the springs sit in the right places."""
    assert set(arm.kept) == {kind for kind, on in FULL.items() if on}
    assert {t.port for t in arm.terms if t.kind == "compliance"} == {"roll", "tilt", "structure.z"}


def test_the_tip_is_predicted_at_a_configuration_never_seen(robot: GivingRobot, arm: ElasticArm) -> None:
    """Held-out error within 1.2 of the tracker's noise."""
    (new,) = robot.sets(1, each=1, first=5)
    error = counted(new, new.give - arm.predict(new))[judged(new)]
    assert np.sqrt(np.mean(error**2)) < 1.2 * NOISE_M


def test_what_the_learnt_sets_never_show_stays_out_of_the_others() -> None:
    """A column that is rounding in all sets but one has no parameter there: the held-out error is what it was without it."""
    rng = np.random.default_rng(5)
    load, y, edges = rng.normal(size=(3, 60)), rng.normal(size=(3, 60)), [0, 30, 60]
    late = np.array([1e-8 * rng.normal(size=60), 1e-8 * rng.normal(size=60), rng.normal(size=60)])
    rows = [Rows(np.arange(60), np.zeros((60, 0)), edges, y[s]) for s in range(3)]
    blocks = Blocks.of(rows, {"load": list(load), "late": list(late)}, [0, 1, 2])
    with_it, without = blocks.held_out(["load", "late"]), blocks.held_out(["load"])
    assert with_it[-2:] == pytest.approx(without[-2:])
    assert np.isfinite(blocks.gain(without, with_it)).all()


def test_an_arm_in_which_nothing_gives_has_no_terms_and_predicts_nothing(robot: GivingRobot) -> None:
    """Of noise alone nothing is kept; that is an answer, and no stack of no columns."""
    rng = np.random.default_rng(4)
    sets = [dataclasses.replace(s, give=NOISE_M * rng.normal(size=s.give.shape)) for s in robot.sets(3, each=1)]
    stiff = ElasticArm().fit(sets)
    assert stiff.terms == ()
    assert np.all(stiff.predict(sets[0]) == 0.0)
    assert np.all(stiff.variance(sets[0]) > 0.0)


def test_a_soft_arm_bends_as_in_mujoco(monkeypatch: pytest.MonkeyPatch) -> None:
    """With the true springs and friction of an arm that gives by some millimetres, loads and motions of the bent arm are MuJoCo's
    to 4 um, at configurations far from zero."""
    monkeypatch.setattr(robots, "FORCE_NOISE_N", 0.0)
    soft = dataclasses.replace(GivingRobot.drawn(500), comes_from_afar=False)
    assert soft.present == {"hysteresis": True, "creep": False, "hardening": False, "play": False}
    springs = dict(zip(("structure.z", "roll", "tilt"), soft.give.compliance.tolist(), strict=True))
    slips = {p: [(float(f), 1.0)] for p, f in zip(springs, soft.give.friction, strict=True)}
    terms = [Term("compliance", p, Compliance("joint", p)) for p in springs]
    terms += [Term("hysteresis", p, Hysteresis.of_load(p, (slips[p][0][0],))) for p in springs]
    values = np.array([*springs.values()] * 2)
    for data in soft.sets(2, each=1, first=5):
        arm = ElasticArm(tuple(terms), values, np.zeros((6, 6)), slips, Weight.of(data))
        true = np.stack([data.observations.columns[f"covariate.true.{a}"] for a in "xyz"], axis=1)
        error = (true - true[0]) - (arm.predict(data) - arm.predict(data)[0])
        assert np.linalg.norm(true - true[0], axis=1).max() > 3e-3
        assert np.linalg.norm(error, axis=1).max() < 4e-6


def test_the_stream_gives_the_numbers_of_the_batch(robot: GivingRobot, arm: ElasticArm) -> None:
    """Sample by sample, with friction, creep and play, from a file's text: equal to rounding."""
    data = robot.sets(1, each=1, first=6)[0].rows(slice(0, 1500))
    belief = data.observations.belief
    assert belief.robot is not None
    stream = ElasticArm.from_json(json.loads(json.dumps(arm.to_json()))).stream()
    tip = tuple(belief.tip.tolist())
    place = Place.of(belief.robot, tip, data.q[0], np.zeros(5))
    stream.place(place)
    rows = [
        stream.step(t, tuple(f.tolist()), tuple(np.cross(place.tip, f).tolist()))
        for t, f in zip(data.time, data.force, strict=True)
    ]
    assert np.abs(np.array(rows)[:, :3] - arm.predict(data)).max() < 1e-15
    variance = np.diag(np.reshape(stream.covariance(), (6, 6)))[:3]
    assert variance == pytest.approx(arm.variance(data)[-1], rel=1e-2), "the levers' bend alone is left out"


def test_one_noisy_sample_at_rest_does_not_stay_in_all_that_follows(robot: GivingRobot, arm: ElasticArm) -> None:
    """Friction begins at the mean of a load that rests; beginning at the first sample, the tip would be off by 10 um."""
    data = robot.sets(1, each=1, first=6)[0].rows(slice(0, 1200))
    columns = data.observations.columns
    spoilt = {k: np.r_[v[0] + 0.06, v[1:]] if k.startswith("applied.force.") else v for k, v in columns.items()}
    other = DeflectionSet.of("spoilt", dataclasses.replace(data.observations, columns=spoilt), tool=data.tool)
    moved = np.linalg.norm((arm.predict(other) - arm.predict(data))[300:], axis=1)
    assert moved.max() < 4e-6
    start, loads = RestingLoad(), [1.0, 1.1, 0.9] * 10 + [5.0, 1.0]
    assert [start.take(load, 3.0) for load in loads] == [True] * 30 + [False, True]
    assert start.mean == pytest.approx(1.0), "a load that moves is no part of it"


def test_the_interval_grows_where_noise_of_the_force_moves_the_give() -> None:
    """White noise's own variance, at any rate above that of the differences; slow motion and a gap are none."""
    rng = np.random.default_rng(4)
    for rate in (60.0, 1000.0):
        jitter, t = Jitter(2), np.arange(int(40 * rate)) / rate
        gives = np.stack([1e-4 * np.sin(t), 1e-4 * np.sin(t) + 3e-6 * rng.normal(size=len(t))], axis=1)
        found = np.array([jitter.take(give, 1.0 / rate) for give in gives.tolist()])[len(t) // 10 :]
        assert np.mean(found[:, 1]) == pytest.approx(9e-12, rel=0.15)
        assert np.max(found[:, 0]) < 1e-3 * 9e-12
        before = list(jitter.variance)
        jitter.gap()
        assert jitter.take([1.0, 1.0], 1.0 / rate) == before
        assert jitter.take([1.0, 1.0], 0.1) == before


def test_after_a_reset_nothing_is_left_of_what_the_noise_did(arm: ElasticArm, robot: GivingRobot) -> None:
    """The interval after a reset is that of a stream that has just begun."""
    belief, rng, fresh = robot.belief, np.random.default_rng(7), arm.stream()
    used = arm.stream()
    assert belief.robot is not None
    place = Place.of(belief.robot, tuple(belief.tip.tolist()), np.zeros(5), np.zeros(5))
    fresh.place(place)
    used.place(place)
    force, moment = (3.0, 2.0, 5.0), tuple(np.cross(place.tip, (3.0, 2.0, 5.0)).tolist())
    for k in range(200):
        used.step(0.02 * k, tuple((np.array(force) + rng.normal(size=3)).tolist()), moment)
    used.reset()
    for stream in (fresh, used):
        stream.step(5.0, force, moment)
    assert used.covariance() == fresh.covariance()


def test_a_gap_keeps_the_memory_and_makes_it_unsure_until_the_load_moves(arm: ElasticArm, robot: GivingRobot) -> None:
    """At the start, and after a gap, the covariance is larger; when the load has crossed the friction's band it is small."""
    stream = arm.stream()
    belief = robot.belief
    assert belief.robot is not None
    place = Place.of(belief.robot, tuple(belief.tip.tolist()), np.zeros(5), np.zeros(5))
    stream.place(place)

    def push(t: float, f: tuple[float, float, float]) -> tuple[float, ...]:
        return stream.step(t, f, tuple(np.cross(place.tip, f).tolist()))

    def exercised(t: float) -> tuple[float, ...]:
        """Pushes both ways, then one that is held."""
        for k in range(4000):
            size = np.sin(2 * np.pi * k / 2000) * 14.0
            push(t + 0.025 * k, (size, size, size))
        return [push(t + 100.1 + 0.025 * k, (3.0, 2.0, 5.0)) for k in range(400)][-1]

    def spread() -> float:
        return float(np.trace(np.reshape(stream.covariance(), (6, 6))))

    push(0.0, (3.0, 2.0, 5.0))
    begun = spread()
    before = exercised(0.1)
    sure = spread()
    assert begun > 1.2 * sure, "what the arm remembers at the start is not known"
    stream.gap()
    assert push(110.2, (3.0, 2.0, 5.0)) == pytest.approx(before, abs=1e-5)
    unsure = spread()
    assert unsure > 1.2 * sure
    exercised(110.3)
    assert spread() < 0.5 * (sure + unsure)


def test_an_arm_that_comes_from_afar_is_known_to_be_unsure_until_it_is_pushed(
    robot: GivingRobot, arm: ElasticArm
) -> None:
    """At the first rest the friction's memory is nobody's knowledge: the tip is off by far more than noise, within the interval;
    after the pushes the same set is predicted to the tracker's noise, and its residual give to a fifth."""
    wide, off, late = [], [], []
    for number in range(6):
        data = robot.sets(1, each=1, first=2 + number)[0]
        error = counted(data, data.give - arm.predict(data))
        first, sigma = np.asarray(first_rest(data)), np.sqrt(arm.variance(data))
        off.append(error[first].mean(axis=0))
        wide.append(np.abs(off[-1]) < 1.96 * sigma[first].max(axis=0))
        late.append(np.sqrt(np.mean(error[judged(data)] ** 2)))
        assert sigma[-1].max() < 0.5 * sigma[first].max(), "the pushes wipe it out"
        left = residual_give(data, arm.predict(data))
        assert np.linalg.norm(left[:, 0] - left[:, 1]) < 0.2 * np.linalg.norm(left[:, 0])
    assert np.linalg.norm(off, axis=1).max() > 5.0 * NOISE_M / np.sqrt(60)
    assert np.mean(wide) > 0.75
    assert np.median(late) < 1.1 * NOISE_M

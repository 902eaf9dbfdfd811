"""Effects far above the noise, where what a law misses of what it is the law of shows as well."""

import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parent))

from diagnosis_cases import Array, Bench, Servo, cable_drag, lagged

from galen_hw.diagnosis.estimation.model import Model
from galen_hw.diagnosis.lack_of_fit.structure_test import Structure
from galen_hw.diagnosis.pipeline import diagnose
from galen_hw.diagnosis.stats.criteria import CRITERIA
from galen_hw.diagnosis.validation.judgement import Judged
from galen_hw.diagnosis.validation.support import HoldoutTest
from galen_hw.diagnosis.validation.verdict import strong, tolerated
from galen_hw.physics.effects.registry import scene_of
from galen_hw.physics.effects.sensor import Gain
from galen_hw.physics.observations import Observations


def wandering(rng: np.random.Generator, t: Array, frequency: float) -> Array:
    """A hum whose phase walks at random, a quarter of a radian rms over the recording."""
    walk = np.cumsum(rng.normal(size=len(t)))
    return np.sin(2.0 * np.pi * frequency * t + 0.25 * (walk - walk.mean()) / walk.std())


@pytest.mark.inject
def test_a_loud_hum_is_one_vibration_and_leaves_nothing() -> None:
    run = Bench(rows=6000, rate=50.0)
    run.wrench[:, 1] += 30.0 * 0.01 * np.sqrt(2.0) * wandering(run.rng, run.t, 11.3)
    work = diagnose(scene_of(run.observations()))
    assert [f.effect for f in work.diagnosis.findings] == ["vibration"]
    assert work.diagnosis.verdict == "explained"
    told = work.diagnosis.findings[0].parameters
    assert told["frequency"].value == pytest.approx(11.3, abs=0.02)
    assert told["rms_signal"].std is not None
    assert told["rms_signal"].std < 0.02 * told["rms_signal"].value


def test_what_answers_a_simulated_servo_does_not_answer_steps() -> None:
    """A filter of the readings behind a servo that somebody simulated: one lag, with its constant, and no delay beside it."""
    servo = Servo(rate=100.0)
    servo.position = np.stack([lagged(servo.t, c, 0.013, straight=True) for c in servo.command.T], axis=1)
    servo.sigma = 1e-4
    given = servo.observations()
    simulated = {f"joint.{n}.position": servo.command[:, i] for i, n in enumerate(("pan", "lift"))}
    work = diagnose(scene_of(Observations("position", given.columns, simulated, given.belief)))
    assert [f.effect for f in work.diagnosis.findings] == ["lag"]
    assert work.diagnosis.findings[0].parameters["constant"].value == pytest.approx(0.013, rel=0.02)


def modelled(*placed: tuple[object, float]) -> Model:
    """Effects of given rms in one channel, in newtons, of a run without anything else: as they would be found."""
    run = Bench()
    bench = diagnose(scene_of(run.observations())).bench
    hypotheses = [bench.hypothesis(effect) for effect, _ in placed]  # type: ignore[arg-type]
    model = Model(bench, [], hypotheses, bench.whitened(bench.whole))
    for h, s, (_, rms) in zip(hypotheses, model.slices(), placed, strict=True):
        one = np.ones(h.count)
        model.final[s] = one * rms / np.sqrt(np.mean(h.contribution(one) ** 2))
    return model


def test_laws_may_miss_a_part_of_what_they_speak_of() -> None:
    """A seventh of the size of what was missed at first, above the noise."""
    judged = Judged("", np.array([4.0, 1.0]), np.ones(2), {}, np.ones(2))
    np.testing.assert_allclose(tolerated(judged), [3.0 * CRITERIA.least_share, 0.0])


def hums(run: Bench, seed: int) -> None:
    run.wrench[:, 0] += 0.03 * np.sin(2.0 * np.pi * 3.3 * run.t + seed)


def jumps(run: Bench, seed: int) -> None:
    run.wrench[:, 1] += 0.06 * (run.t > 40.0 + seed)


@pytest.mark.inject
@pytest.mark.parametrize(("concealed", "name"), [(hums, "vibration"), (jumps, "step")])
def test_what_completes_a_loud_recording_is_named_though_it_belongs_to_moments(
    concealed: Callable[[Bench, int], None], name: str
) -> None:
    """A cable of thirty times the noise, and beside it a hundredth of that which is all that else would be left."""
    runs = [Bench(seed, rows=4000) for seed in (115, 315)]
    for seed, run in enumerate(runs):
        cable_drag(run)
        concealed(run, seed)
    work = diagnose(scene_of(runs[0].observations()), holdout=scene_of(runs[1].observations()))
    assert work.diagnosis.verdict == "explained"
    assert {f.effect for f in work.diagnosis.findings} == {"cable_drag", name}


@pytest.mark.parametrize(
    ("before", "size", "worth_saying"), [(1.0, 0.2, True), (1.0, 0.1, False), (10.0, 0.4, False), (10.0, 0.5, True)]
)
def test_structure_is_said_that_is_large_enough_to_matter(before: float, size: float, *, worth_saying: bool) -> None:
    """A seventh of the noise's size, or of what there was at first above it if that is more."""
    work = diagnose(scene_of(Bench().observations()))
    sigma = work.bench.noise.sigma
    judged = replace(work.judged, before=(1.0 + before) * sigma**2)
    left = [Structure(0, "speeds", 9.0, 0.5, size * float(sigma[0]), np.zeros((1, 1)))]
    assert strong(left, judged, work.bench) == left * worth_saying


def test_nothing_supports_what_makes_raw_errors_larger() -> None:
    """Weights of the noise may want what raw errors refuse: then it has no support, however sure it seems."""
    model = modelled((Gain("wrench.force.x"), 0.02))
    rng = np.random.default_rng(0)
    quiet, slow = rng.normal(size=(4000, 6)), np.zeros((4000, 6))
    slow[:, 0] = 2.0 * np.sin(np.arange(4000) / 300.0)
    other = model.without(list(model.effects))
    white = {True: quiet, False: quiet + 0.5 * np.roll(quiet, 1, axis=0)}
    for raw, supported in ((quiet, True), (quiet + slow, False)):
        rests = {True: raw, False: quiet + 0.5 * np.roll(quiet, 1, axis=0)}
        test = HoldoutTest(
            np.ones(6), lambda m, r=rests: r[bool(m.effects)], lambda m: white[bool(m.effects)], model, other
        )
        assert any(one.credible() for one in test.gains(other)) == supported

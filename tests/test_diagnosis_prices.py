"""What a hypothesis owes beside what it gains: its numbers, the places of its kind, and its choice among others."""

import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parent))

from diagnosis_cases import SIGMA, Bench, hanging, payload, rotation, sines

from galen_hw.diagnosis.estimation.normal_equations import Scorer
from galen_hw.diagnosis.pipeline import diagnose
from galen_hw.diagnosis.work import Work
from galen_hw.physics.effects.cable import CableDrag
from galen_hw.physics.effects.registry import scene_of
from galen_hw.physics.effects.sensor import CrossTalk, Gain


def diagnosed(bench: Bench) -> Work:
    """A diagnosis."""
    return diagnose(scene_of(bench.observations()))


@pytest.fixture(scope="module")
def leaking() -> Work:
    """One channel leaks into another."""
    bench = Bench(4)
    bench.wrench[:, 1] += 0.02 * bench.wrench[:, 2]
    return diagnosed(bench)


def test_the_best_of_many_places_pays_for_all_of_them(leaking: Work) -> None:
    """Thirty leaks, six gains: beyond the numbers each owes twice the log of how many of its kind there are."""
    bench = leaking.bench
    effects = [*CrossTalk.propose(bench.scene), *Gain.propose(bench.scene)]
    scorer = Scorer(bench, [bench.hypothesis(effect) for effect in effects])
    scores, _ = scorer.scores([])
    for i, score in scores.items():
        many = sum(type(effect) is type(scorer.library[i].effect) for effect in effects)
        owed = score.count * np.log(bench.noise.effective) + 2.0 * np.log(many)
        assert score.gain - score.rank == pytest.approx(owed)
    assert {sum(type(e) is kind for e in effects) for kind in (CrossTalk, Gain)} == {30, 6}


def test_what_was_sought_in_the_residual_pays_for_where_it_was_sought(leaking: Work) -> None:
    """And not for the places of its kind besides."""
    bench = leaking.bench
    effects = list(CrossTalk.propose(bench.scene))
    scorer = Scorer(bench, [bench.hypothesis(effect) for effect in effects])
    scorer.append([bench.hypothesis(effects[0], 1000)])
    score = scorer.scores([], [len(scorer.library) - 1])[0].popitem()[1]
    assert score.gain - score.rank == pytest.approx(np.log(bench.noise.effective) + 2.0 * np.log(1000))


def test_a_spring_that_no_tendon_replaced_owes_all_of_its_numbers(leaking: Work) -> None:
    """Sixteen, not the seven of the cable that was to be sought from it; a tendon has no more than it owes."""
    bench = leaking.bench
    scorer = Scorer(bench, [bench.hypothesis(effect) for effect in (CableDrag("spring"), CableDrag("tendon"))])
    scores, _ = scorer.scores([])
    spring, tendon = sorted(scores)
    less = scores[spring].rank - scorer.in_full(spring, scores[spring]).rank
    assert less == pytest.approx((scores[spring].count - 7) * np.log(bench.noise.effective))
    assert less > 0.0
    assert scorer.in_full(tendon, scores[tendon]) == scores[tendon]


def test_merit_for_foretelling_asks_two_for_a_number_that_lasts(leaking: Work) -> None:
    """Akaike's price beside what is judged on blocks left out, Schwarz's for being the truth."""
    model = leaking.model
    assert [h.effect for h in model.effects] == [CrossTalk("wrench.force.y", "wrench.force.z")]
    asked = model.penalised_gain(predictive=True) - model.penalised_gain()
    assert asked == pytest.approx(np.log(model.bench.noise.effective) - 2.0)


@pytest.mark.inject
@pytest.mark.parametrize("seed", [5, 6, 7])
def test_a_small_payload_under_slow_noise_is_no_cable(seed: int) -> None:
    """The spring has four times its numbers and follows slow noise with them."""
    bench = Bench(seed, rows=4000)
    payload(bench)
    part = 0.1 * (bench.wrench - hanging(bench.R))
    bench.wrench = hanging(bench.R) + part
    rng = np.random.default_rng(seed)
    slow = np.cumsum(rng.normal(size=bench.wrench.shape), axis=0)
    slow -= np.stack([np.convolve(x, np.ones(801) / 801.0, mode="same") for x in slow.T], axis=1)
    bench.wrench += 0.5 * SIGMA * slow / slow.std(axis=0)
    found = [finding.effect for finding in diagnosed(bench).diagnosis.findings]
    assert found[0] == "payload"
    assert "cable_drag" not in found


def test_a_small_body_has_no_inertia_of_its_own() -> None:
    """Where its place says what the motion tells badly, that is believed: on another motion it would be wrong by much."""
    bench = Bench(6)
    bench.belief = {"dynamic": True}
    bench.q = np.stack([sines(bench.rng, bench.t, s, 0.05, 0.5) for s in (0.02, 0.02, 0.02, 0.45, 0.35)], axis=1)
    bench.R = rotation(bench.q[:, 3], bench.q[:, 4])
    mass, c = 0.02, np.array([0.02, -0.01, -0.12])
    scene = scene_of(bench.observations())
    port = scene.body_port()
    assert port is not None
    inertia = mass * (c @ c * np.eye(3) - np.outer(c, c))
    whole = np.concatenate([[mass], mass * c, inertia[[0, 0, 1, 0, 1, 2], [0, 1, 1, 2, 2, 2]]])
    bench.wrench = scene.simulated + port @ whole
    work = diagnosed(bench)
    assert [h.effect.KEY for h in work.model.effects] == ["payload"]
    effect = work.model.effects[0].effect
    assert effect.part == "point"
    np.testing.assert_allclose(effect.at, c, atol=2e-3)
    assert work.model.theta[work.model.slices()[-1]][0] == pytest.approx(mass, rel=0.03)

"""Where the excess sits, what cannot be told apart, and the recording that would settle it."""

import itertools
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.linalg import subspace_angles

from galen_hw.diagnosis.estimation.dataset import Bench
from galen_hw.diagnosis.findings.localisation import baseline_residual, organised, regions
from galen_hw.diagnosis.findings.variables import Variable, variables
from galen_hw.diagnosis.identifiability.experiment import Pair, best_of, next_experiment, options_of
from galen_hw.diagnosis.identifiability.motions import recipes
from galen_hw.diagnosis.identifiability.rivals import rivals
from galen_hw.diagnosis.identifiability.simulate import NoiseMetric, projected_out, stage
from galen_hw.diagnosis.selection.comparison import without_timing
from galen_hw.physics.effects.base import Effect
from galen_hw.physics.effects.columns import Columns
from galen_hw.physics.effects.drift import Drift, Temperature
from galen_hw.physics.effects.load import Payload
from galen_hw.physics.effects.registry import effect_class, kinds
from galen_hw.physics.effects.sensor import Gain
from tests import diagnosis_parts as parts
from tests import physics_scenes


def bench_of(rows: int = 3000) -> Bench:
    """A bench without a noise model yet."""
    scene = parts.nominal(rows=rows)
    return Bench(parts.recorded(scene, scene.simulated))


def test_a_region_that_held_out_rows_confirm_is_found_and_chance_makes_none() -> None:
    """Excess where tilt is from 0.1 to 0.4 rad is located with an overlap of 0.6 and more; white noise has no region."""
    bench, rng = bench_of(), np.random.default_rng(5)
    known = variables(bench)
    tilt = next(v for v in known if v.name == "joint.tilt.position")
    inside = (tilt.values > 0.1) & (tilt.values < 0.4)
    energy = 6.0 * (rng.normal(size=len(inside)) ** 2 - 1.0) + 20.0 * inside
    found = regions(bench, known, energy)[0]
    assert found.parts[0][0].name == "joint.tilt.position"
    assert (found.mask & inside).sum() / (found.mask | inside).sum() > 0.6
    assert found.share > 0.8
    nothing = [regions(bench, known, rng.normal(size=len(inside)) ** 2 - 1.0) for _ in range(20)]
    assert sum(map(len, nothing)) == 0


def test_a_loud_moment_is_no_region_of_joint_space() -> None:
    """One block of excess, wherever the arm was then, is not confirmed by the other blocks."""
    bench = bench_of()
    energy = np.random.default_rng(6).normal(size=len(bench.rows)) ** 2 - 1.0
    energy[bench.block == 7] += 50.0
    assert regions(bench, variables(bench), energy) == []


def test_the_variable_that_organises_the_excess_comes_first() -> None:
    """A residual that is a function of roll is said to be one, with its share."""
    work = parts.diagnosed("nothing")
    bench = work.bench
    roll = next(v for v in variables(bench) if v.name == "joint.roll.position")
    rest = np.random.default_rng(7).normal(size=(len(bench.rows), 6)) * bench.noise.sigma
    rest[:, 1] += 4.0 * bench.noise.sigma[1] * np.sin(3.0 * roll.values)
    best, share, channel = organised(bench, variables(bench), rest)[0]
    assert best.name == "joint.roll.position"
    assert channel == "wrench.force.y"
    assert share > 0.9


@pytest.mark.parametrize(
    ("low", "high", "said"),
    [
        (0.0, 1.0, "elbow moves forward"),
        (-0.5, 0.25, "joint.elbow.velocity is from -0.5 to 0.25 rad/s"),
        (-1.0, 0.5, "joint.elbow.velocity is below 0.5 rad/s"),
    ],
)
def test_ranges_are_told_as_directions_and_limits(low: float, high: float, said: str) -> None:
    """A range of one sign is a direction, one that reaches an end is open there."""
    v = Variable("joint.elbow.velocity", "rad/s", "elbow", np.linspace(-1.0, 1.0, 501))
    assert v.span(low, high) == said


def test_angles_are_those_between_the_whitened_spans_beside_the_model() -> None:
    """Against scipy's subspace angles on the training rows, nuisances projected out of both."""
    work = parts.diagnosed("late")
    finding, scorer, train = work.diagnosis.findings[0], work.selection.scorer, work.bench.train
    near = rivals(work.selection, finding, everyone=True)
    assert "lag" in [one.key for one in near]
    rest = [i for i in work.selection.chosen if i != near[0].instead]
    base = stacked(scorer, [*range(len(scorer.base)), *rest], train)
    for one in near[:3]:
        # A rival may stand between two points of its grid: its columns are those of its own searched value.
        with without_timing(scorer, one.instead):  # beside no delay but in its place
            full = work.bench.hypothesis(one.effect).white.full(work.bench.width)[train]
        A, B = (
            projected_out(X, base) for X in (stacked(scorer, [one.instead], train), full.reshape(-1, full.shape[2]))
        )
        assert np.degrees(subspace_angles(A, B)).min() == pytest.approx(one.nearest, abs=0.05)
        signal = A @ one.own
        nonlinear = scorer.library[one.instead].nonlinear
        if nonlinear is not None:
            signal = signal + projected_out(scorer.bench.whitened(nonlinear)[train].reshape(-1, 1), base)[:, 0]
        pinned = one.effect.pinned(work.bench.scene)
        missed = projected_out(signal[:, None], B)[:, 0] if pinned is None else signal - B @ pinned
        share = np.sum(missed**2) / np.sum(signal**2)
        assert one.angle == pytest.approx(np.degrees(np.arcsin(np.sqrt(share))), abs=0.05)


def stacked(scorer, places, train) -> np.ndarray:
    """Whitened columns of hypotheses on the training rows, all channels."""
    full = [scorer.library[i].white.full(scorer.bench.width)[train] for i in places]
    return np.concatenate([x.reshape(-1, x.shape[2]) for x in full], axis=1)


def test_what_cannot_be_told_apart_is_named_with_the_number() -> None:
    """Slow motion: a lag would do as well as the delay; nobody logged a temperature: it would do as well as the drift."""
    late, drifting = (parts.diagnosed(kind).diagnosis.findings[0] for kind in ("late", "drifting"))
    lag = next(c for c in late.confounded_with if c.effect == "lag")
    assert "deg apart" in lag.why
    assert "temperature" in [c.effect for c in drifting.confounded_with]


def test_the_recording_that_would_settle_a_delay_has_quick_starts() -> None:
    """Quick starts part a delay from a lag; slow motion and rest do not."""
    work = parts.diagnosed("late")
    said = next_experiment(work.model, work.selection, work.diagnosis.findings[:1], [])
    assert said == work.diagnosis.next_experiment
    assert said.startswith("To tell time delay from lag: move ")
    assert "quick starts" in said
    options = options_of(work.model, work.selection, work.diagnosis.findings)
    assert all(a.minutes <= b.minutes or a.angle >= 15.0 > b.angle for a, b in itertools.pairwise(options))


def test_a_drift_without_a_thermometer_wants_one() -> None:
    """No motion can part drift and temperature; a log of the temperature can."""
    assert "log the temperature" in parts.diagnosed("drifting").diagnosis.next_experiment


def test_a_recipe_is_named_only_if_it_settles_the_question() -> None:
    """A payload of 20 g against a gain of 7 %: odds of a thousand to one with its repeats; against itself there is none."""
    work = parts.diagnosed("nothing")
    pair = Pair(Payload("mass"), np.array([0.02]), Gain("wrench.force.z"), np.array([0.07]), (), 1.0)
    advice = best_of(work.model, replace(pair, kin=(pair.rival,)))
    assert advice is not None
    assert advice.distance * max(1.0, advice.minutes / advice.recipe.minutes) > 2.0 * np.log(1000.0)
    same = Pair(pair.rival, pair.rival_theta, pair.rival, pair.rival_theta, (), 0.0)
    assert best_of(work.model, same) is None


@pytest.mark.parametrize("group", ["wrench", "pose", "effort", "position"])
def test_every_recipe_can_be_staged_for_every_robot(group: str) -> None:
    """Scenes of the right channels within the range that the recording has shown, in the order of time."""
    scene = physics_scenes.scene(group, np.random.default_rng(8))
    low, high = scene.q.min(axis=0) - 1e-9, scene.q.max(axis=0) + 1e-9
    made = list(recipes(scene, 0.05, ()))
    assert {"two payloads"} <= {r.name for r in made} or group != "wrench"
    assert any("speed staircase" in r.name for r in made)
    for recipe in made:
        staged = stage(scene, recipe)
        times = np.concatenate([part.time for part in recipe.parts])
        assert (np.diff(times) > 0.0).all()
        for one, part in zip(staged.scenes, recipe.parts, strict=True):
            assert one.channels == scene.channels
            assert ((part.q >= low) & (part.q <= high)).all()
            assert np.isfinite(one.simulated).all()


def test_effects_do_on_the_stage_what_they_do_in_a_recording() -> None:
    """Columns of a staged effect are the effect's own on that motion; a drift goes on at its rate."""
    scene = parts.nominal()
    recipe = next(r for r in recipes(scene, 0.05, ()) if r.name == "two payloads")
    staged = stage(scene, recipe)
    whole = staged.columns(Gain("wrench.force.z"), 6)
    assert whole is not None
    n = len(recipe.parts[0].time)
    assert_allclose(whole[:n, 2, 0], staged.scenes[0].simulated[:, 2])
    heavier = np.ptp(whole[n:, 2, 0]) / np.ptp(whole[:n, 2, 0])
    tool, bias = scene.belief.tool.mass, scene.belief.bias_body
    assert bias is not None
    assert heavier == pytest.approx(1.0 + 0.2 / (tool + bias.mass), rel=0.2)
    drift = Drift("wrench.force.z", "linear", None, 0.0, 10.0)
    assert staged.scale(drift) == pytest.approx((recipe.parts[1].time[-1] - recipe.parts[0].time[0]) / 10.0)
    warm = staged.columns(Temperature("wrench.force.z", "temperature.sensor"), 6)
    assert warm is not None
    assert not warm.any()


def test_a_recipes_worth_is_the_squared_distance_in_units_of_the_noise() -> None:
    """White noise: whitened columns have the norm of the columns over sigma, once for every row of a recording."""
    work = parts.diagnosed("nothing")
    scene = work.bench.scene
    recipe = next(r for r in recipes(scene, 0.05, ()) if r.name == "same poses in reverse order")
    eye = NoiseMetric(work.bench, stage(scene, recipe))
    rows = sum(len(p.time) for p in recipe.parts)
    x = np.random.default_rng(9).normal(size=(rows, 6, 1))
    level = work.bench.noise.sigma
    expected = eye.ratio * np.sum((x[:, :, 0] / level) ** 2)
    assert np.sum(eye.whiten(x) ** 2) == pytest.approx(expected, rel=0.15)


def test_all_words_are_of_the_vocabulary() -> None:
    """Every key that is confused, settled or drawn is a word of the vocabulary."""
    pairs = [(kind.KEY, key) for kind in kinds() for key in (*kind.ALIKE, *kind.TOLD_APART)]
    assert pairs
    assert all(effect_class(key) for pair in pairs for key in pair)
    told = {kind.KEY for kind in kinds() if kind.KNOWN_BY != Effect.KNOWN_BY}
    assert all(kind.SAYS for kind in kinds())
    assert told | {"unknown", "glitches"} == {kind.KEY for kind in kinds()}


def test_what_fades_at_a_beginning_is_not_told_of_rows_that_no_fit_uses() -> None:
    """Before the first row in use it would grow without bound."""
    rows = np.arange(60)
    whole, used = np.ones((60, 1)), rows >= 5
    faded = SimpleNamespace(raw=Columns((0,), np.exp(-2.0 * rows)[:, None, None]))
    bench = SimpleNamespace(whole=whole, width=1, train=used, excluded_rows=~used)
    residual = baseline_residual(SimpleNamespace(bench=bench, nuisances=[faded]))  # type: ignore[arg-type]
    assert abs(residual[5, 0]) < 0.2  # one number is free, and that row has most of it
    assert_allclose(residual[:5], np.tile(residual[5], (5, 1)))
    assert_allclose(residual[12:], 1.0, atol=1e-5)

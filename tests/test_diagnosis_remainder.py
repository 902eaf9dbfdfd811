"""What has no name: predicted by generic functions where that holds, never under a name, never saved."""

import sys
from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from scipy.signal import lfilter

sys.path.insert(0, str(Path(__file__).parent))

from diagnosis_cases import SIGMA, WRENCH, Bench, contact, creep, lagged

from galen_hw.diagnosis.detection.outliers import spikes
from galen_hw.diagnosis.estimation.model import Model
from galen_hw.diagnosis.findings.from_model import dependence
from galen_hw.diagnosis.lack_of_fit import structure_test
from galen_hw.diagnosis.lack_of_fit.basis_functions import PLAIN, WARM, Inputs, dictionaries, factors
from galen_hw.diagnosis.lack_of_fit.gram import Functions, by_name
from galen_hw.diagnosis.lack_of_fit.pursuit import Pursuit
from galen_hw.diagnosis.lack_of_fit.regression import Blend
from galen_hw.diagnosis.lack_of_fit.residual_model import RIDGES, Ridge, learn
from galen_hw.diagnosis.lack_of_fit.trees import blended
from galen_hw.diagnosis.pipeline import diagnose
from galen_hw.diagnosis.stats.paired_test import paired
from galen_hw.diagnosis.stats.sampling import Rows
from galen_hw.diagnosis.validation.contact_or_place import predicted_by_place
from galen_hw.diagnosis.validation.flexible_effects import _finished
from galen_hw.diagnosis.validation.holdout import judge_remainder
from galen_hw.diagnosis.work import Work
from galen_hw.physics.effects.events import Contact
from galen_hw.physics.effects.registry import scene_of


def judged(learnt: Bench, other: Bench | None = None) -> Work:
    """A diagnosis, judged on another recording."""
    holdout = None if other is None else scene_of(other.observations())
    return diagnose(scene_of(learnt.observations()), holdout=holdout)


def named(work: Work) -> list[str]:
    """The effects found, first things first."""
    return [finding.effect for finding in work.diagnosis.findings]


def stray(bench: Bench, size: float = 2.0) -> Bench:
    """A reading that goes with the product of two joints' speeds: no word is for it."""
    roll, tilt = (np.gradient(bench.q[:, k], bench.t) for k in (3, 4))
    bench.wrench[:, 0] += size * SIGMA[0] * roll * tilt / 0.2
    return bench


@cache
def of_stray() -> Work:
    """The diagnosis of one recording of that, which several tests ask and none changes."""
    return judged(stray(Bench(1, rows=4000)))


def rotor(bench: Bench) -> Bench:
    """A spinning body resists being turned: a torque across its axis and the turning, in proportion to the speed."""
    roll, tilt = (np.gradient(bench.q[:, k], bench.t) for k in (3, 4))
    angle = bench.q[:, 4]
    omega = np.stack([roll * np.cos(angle), tilt, roll * np.sin(angle)], axis=1)
    bench.wrench[:, 3:] -= 1e-3 * np.cross(omega, [0.6, 0.64, 0.48])
    return bench


@pytest.mark.inject
def test_what_has_no_name_is_predicted_without_one_on_another_recording() -> None:
    """Learnt on one motion it holds on the next; the answer keeps apart what names explain, and nothing of it is saved."""
    work = judged(stray(Bench(1, rows=4000)), stray(Bench(2, rows=4000)))
    d = work.diagnosis
    assert (d.verdict, named(work)) == ("unexplained", ["unknown"])
    name = "wrench.force.x"
    by_names = d.findings[0].parameters[f"rmse_named_{name}"]
    assert by_names.value == pytest.approx(d.fit["rmse_before"][name], rel=1e-6)
    assert by_names.unit == "N"
    assert d.fit["rmse_before"][name] > 1.3 * SIGMA[0]
    assert d.fit["rmse_after"][name] < 1.05 * SIGMA[0]
    assert d.fit["ceiling"][name] <= d.fit["rmse_after"][name]
    assert d.findings[0].evidence["heldout_gain"] > 0.8
    assert "without a name" in d.findings[0].says
    assert d.terms == []


@pytest.mark.inject
def test_what_is_found_in_one_channel_is_asked_of_the_others_too() -> None:
    """The same product of speeds in two: in the second it is too small to be found by itself, and foretold all the same."""
    runs = [stray(Bench(seed, rows=4000)) for seed in (1, 2)]
    for run in runs:
        roll, tilt = (np.gradient(run.q[:, k], run.t) for k in (3, 4))
        run.wrench[:, 4] += 0.5 * SIGMA[4] * roll * tilt / 0.2
    work = judged(*runs)
    found = [one for one in work.structures if one.channel == 0]
    assert found
    scene = scene_of(runs[1].observations())
    functions, remainder = Functions(work.bench), learn(work.model, {0: {"products of speeds"}})
    assert remainder is not None
    alone = judge_remainder(work.model, scene, work.judged, blended(remainder, work.model, functions)).reached
    wider = _finished(work.model, scene, work.judged, remainder, found, functions).reached
    assert wider[4] < 0.9 * alone[4]
    np.testing.assert_array_equal(wider[[1, 2, 3, 5]], alone[[1, 2, 3, 5]])
    assert _finished(work.model, scene, work.judged, None, found, functions) is work.judged


@pytest.mark.inject
def test_what_does_not_hold_elsewhere_is_not_counted() -> None:
    """The stray reading is there in the first recording only: nothing is predicted of the second."""
    work = judged(stray(Bench(1, rows=4000)), Bench(2, rows=4000))
    d = work.diagnosis
    assert d.fit["rmse_after"]["wrench.force.x"] == pytest.approx(d.fit["rmse_before"]["wrench.force.x"], rel=1e-6)
    assert "unknown" not in named(work) or d.findings[-1].evidence["heldout_gain"] == 0.0
    assert not [name for f in d.findings for name in f.parameters if name.startswith("rmse_named")]


@pytest.mark.inject
@pytest.mark.parametrize("seeds", [(1, 2), (3, 4)])
def test_what_has_no_name_has_its_own_constant(seeds: tuple[int, int]) -> None:
    """A gauge that is not straight: the scale and the zero that were fitted before it was known take their part of it back.

    Nor is it an offset, a compliance and a hardening of one joint, each of which takes off what another has too much.
    """
    runs = [Bench(seed, rows=4000) for seed in seeds]
    own = runs[0].wrench[:, 4]
    null, span = float(own.mean()) - 0.5 * float(own.std()), float(own.std())
    for run in runs:
        run.wrench[:, 4] += SIGMA[4] * ((run.wrench[:, 4] - null) / span) ** 2
    work = judged(*runs)
    assert set(named(work)) <= {"gain", "unknown"}
    assert "unknown" in named(work)
    assert work.diagnosis.fit["rmse_before"]["wrench.torque.y"] > 1.3 * SIGMA[4]
    assert work.diagnosis.fit["rmse_after"]["wrench.torque.y"] < 1.03 * SIGMA[4]


@pytest.mark.inject
def test_what_only_another_recording_shows_is_said_of_it() -> None:
    """It is in the second alone, where the model does not hold: no function of the first can tell, and those of the second do."""
    work = judged(Bench(1, rows=4000), stray(Bench(2, rows=4000), 4.0))
    assert (work.diagnosis.verdict, named(work)) == ("unexplained", ["unknown"])
    assert "wrench.force.x of another recording" in work.diagnosis.findings[0].says
    assert "speeds" in work.diagnosis.findings[0].says


@pytest.mark.inject
@pytest.mark.parametrize("concealed", [creep, contact])
@pytest.mark.parametrize(("size", "verdict"), [(0.7, "partly_explained"), (0.0, "explained")])
def test_what_a_flexible_name_leaves_of_another_recording_is_said_of_it(
    concealed: Callable[[Bench], None], size: float, verdict: str
) -> None:
    """It is there, and leaves nothing of the first recording; what the second has besides is too small to stand out."""
    learnt, other = Bench(23, rows=4000), Bench(24, rows=4000)
    concealed(learnt)
    concealed(other)
    work = judged(learnt, stray(other, size))
    d = work.diagnosis
    assert d.verdict == verdict
    assert named(work) == [concealed.__name__, "unknown"][: 1 + (size > 0.0)]
    assert d.findings[0].evidence["heldout_gain"] > 0.1
    assert all("wrench.force.x of another recording" in f.says for f in d.findings if f.effect == "unknown")


@pytest.mark.inject
@pytest.mark.parametrize(("channel", "share", "constant"), [(0, 0.15, 6.0), (4, 0.1, 3.0)])
def test_creep_under_a_load_that_came_on_at_the_start(channel: int, share: float, constant: float) -> None:
    """Nothing has settled when the recording begins: all that creeps is still to come."""
    runs = [Bench(seed, rows=6000) for seed in (5, 6)]
    for run in runs:
        load = run.wrench[:, channel]
        run.wrench[:, channel] = load + share * lagged(
            run.t, np.concatenate([[0.0], load[1:]]), constant, straight=True
        )
    work = judged(*runs)
    assert (work.diagnosis.verdict, named(work)) == ("explained", ["creep"])
    (finding,) = work.diagnosis.findings
    assert finding.parameters["share"].value == pytest.approx(share, rel=0.05)
    assert finding.parameters["constant"].value == pytest.approx(constant, rel=0.1)
    assert "nothing had settled" in finding.says


@pytest.mark.inject
def test_flexible_names_yield_to_what_explains_better_without_one() -> None:
    """A torque that follows the speed is no creep, hysteresis or cable, though each of them takes a part of it."""
    work = judged(rotor(Bench(3, rows=4000)), rotor(Bench(4, rows=4000)))
    assert work.diagnosis.verdict == "unexplained"
    assert named(work) == ["unknown"]
    fit = work.diagnosis.fit
    assert fit["rmse_after"]["wrench.torque.x"] < 1.1 * SIGMA[3]


@pytest.mark.inject
def test_a_remainder_speaks_only_of_recordings_like_its_own() -> None:
    """Another rate, or a joint that is not there, and it says nothing; the same recording again, the same values."""
    work = of_stray()
    remainder = learn(work.model, {0: {"products of speeds"}})
    assert remainder is not None
    rows = work.bench.rows
    again = remainder.predict(work.bench.scene, rows, 6)
    assert again is not None
    np.testing.assert_allclose(again, remainder.own(6), atol=1e-12)
    assert np.std(again[:, 0]) > 0.5 * SIGMA[0]
    assert not again[:, 1:].any()
    quicker = scene_of(Bench(2, rows=4000, rate=50.0).observations())
    assert remainder.predict(quicker, Rows(tuple(quicker.segments), rows.stride), 6) is None
    short = scene_of(Bench(2, rows=150).observations())
    assert remainder.predict(short, Rows(tuple(short.segments), rows.stride), 6) is None


def test_inner_products_say_what_the_predictions_do() -> None:
    """Coefficients solve the ridge's normal equations, and the gain is that of predicting each fold from the others."""
    work = of_stray()
    bench, names = work.bench, ["products of speeds", "speeds and accelerations"]
    functions = Functions(bench)
    sums, y = functions.plain(names, 0), work.model.residual()[functions.rows, 0] / bench.noise.sigma[0]
    ridge = Ridge(sums, functions.white(names, 0), y, work.model.residual(white=True)[functions.rows, 0], weighed=False)
    assert ridge.chosen == ["products of speeds"]
    X, out = functions.columns[ridge.chosen[0]][functions.rows] / bench.noise.sigma[0], np.zeros(len(y))
    X /= np.linalg.norm(X, axis=0)
    for rows in functions.folds:
        others = np.setdiff1d(np.arange(len(y)), np.arange(len(y))[rows])
        G, b = X[others].T @ X[others], X[others].T @ y[others]
        gains = {r: X[rows] @ np.linalg.solve(G + r * np.eye(len(G)), b) for r in RIDGES}
        out[rows] = min(gains.values(), key=lambda p, rows=rows: np.sum((ridge.cross_validated()[rows] - p) ** 2))  # type: ignore[misc]
    assert ridge.cross_validated() == pytest.approx(out, abs=1e-9)
    assert ridge.reached == pytest.approx(float(np.sum(out * (2.0 * y - out))), rel=1e-9)


def test_models_asked_together_leave_what_each_leaves_alone() -> None:
    """The generic functions are whitened once for all; the answers are those of asking one by one."""
    work = of_stray()
    generic, white = structure_test.families(work.bench), [h.white for h in work.model.parts]
    some = [
        structure_test.Fitted(parts, work.model.residual(), work.model.residual(white=True))
        for parts in (white, white[:1])
    ]
    together = structure_test.leftovers(work.bench, generic, some)
    for mine, one in zip(together, some, strict=True):
        (alone,) = structure_test.leftovers(work.bench, generic, [one])
        assert [(x.channel, x.kind, x.z) for x in mine] == [(x.channel, x.kind, x.z) for x in alone]
    assert together[1]


def test_inputs_of_another_recording_are_in_the_units_of_the_first() -> None:
    """The same families and columns, whatever the other one's spread."""
    first, other = (scene_of(Bench(seed, rows=900).observations()) for seed in (1, 2))
    mine = Inputs.of(first, Rows(tuple(first.segments)))
    theirs = Inputs.of(other, Rows(tuple(other.segments)), like=mine)
    np.testing.assert_allclose(mine.position.std(axis=0), 1.0)
    np.testing.assert_allclose(theirs.position * mine.scales[0].spread + mine.scales[0].centre, other.q)
    # A family that is renamed must not lose the factors of its products unseen.
    assert set(factors(mine)) <= set(PLAIN) & set(by_name(mine))
    shapes = [(name, X.shape) for name, X in dictionaries(mine)]
    assert shapes == [(name, X.shape) for name, X in dictionaries(theirs)]


@pytest.mark.inject
@pytest.mark.parametrize("frequency", [6.6197376, 7.3331, 3.0179])
def test_a_line_between_the_lines_of_the_spectrum_is_found_to_its_error(frequency: float) -> None:
    """Its frequency is known far better than a line is wide, and what it leaves is no structure."""
    bench = Bench(5, rows=6000, rate=50.0)
    bench.wrench[:, 2] += 2.0 * SIGMA[2] * np.sin(2.0 * np.pi * frequency * bench.t + 0.7)
    work = judged(bench)
    assert (work.diagnosis.verdict, named(work)) == ("explained", ["vibration"])
    found = work.diagnosis.findings[0].parameters["frequency"]
    assert 0.0 < found.std < 1e-3
    assert abs(found.value - frequency) < 4.0 * found.std


def test_support_allows_for_what_is_known_of_the_noise() -> None:
    """An effect that takes all that is there, but little beside the error of the noise's level, is not refused for that."""
    effect_only = np.array([1.01**2 - 1.0])
    rng = np.random.default_rng(2)
    noise = 1.01 * rng.normal(size=(50000, 1))
    effect = 0.1 * np.sin(np.arange(50000) / 30.0)[:, None]
    assert paired(noise + effect, noise, effect_only).credible()
    assert not paired(3.0 * noise + effect, 3.0 * noise, np.array([8.0])).credible()


@pytest.mark.inject
def test_a_touch_beside_what_has_no_name_is_judged_by_its_own_moments() -> None:
    """Three seconds of 200 are little of a recording in which much is missing, and yet they stand out from all of it."""
    touched = stray(Bench(1, rows=4000), 6.0)
    start = 0.55 * touched.t[-1]
    inside = (touched.t > start) & (touched.t < start + 1.5)
    touched.wrench[inside] += 12.0 * SIGMA * np.array([1.0, -0.5, 1.0, 0.3, 0.6, -0.2])
    work = judged(touched)
    assert set(named(work)) == {"contact", "unknown"}
    (contact,) = [h.effect for h in work.model.effects if isinstance(h.effect, Contact)]
    ((begin, end),) = contact.episodes
    assert begin <= start < start + 1.5 <= end
    assert end - begin < 5.0


def test_what_warms_up_moves_several_zeros_with_one_constant() -> None:
    """One drift of three channels, each with its own amplitude, and nothing in the other three."""
    bench = Bench(2, rows=4000)
    warm = 1.0 - np.exp(-bench.t / 40.0)
    truth = {"wrench.force.x": 1.5 * SIGMA[0], "wrench.force.z": -1.5 * SIGMA[2], "wrench.torque.y": SIGMA[4]}
    for name, size in truth.items():
        bench.wrench[:, WRENCH.index(name)] += size * warm
    work = judged(bench)
    assert (work.diagnosis.verdict, named(work)) == ("explained", ["drift"])
    (finding,) = work.diagnosis.findings
    assert set(finding.channels) == set(truth)
    constant = finding.parameters["constant"]
    assert abs(constant.value - 40.0) < 3.0 * constant.std
    for name, size in truth.items():
        value = finding.parameters[f"amplitude_{name}"]
        assert abs(value.value - size) < 3.0 * value.std


@pytest.mark.inject
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_force_that_is_there_all_along_is_no_contact(seed: int) -> None:
    """It is loud where the arm goes far, and functions of the motion foretell it: nobody pushes by the arm's position."""
    bench = Bench(seed, rows=4000)
    bench.wrench[:, 2] += 4.0 * SIGMA[2] * (bench.q[:, 3] * bench.q[:, 4] / 0.16) ** 2
    work = judged(bench)
    assert "contact" not in named(work)
    assert "unknown" in named(work)


@pytest.mark.inject
def test_a_force_in_a_corner_of_the_motion_is_neither_slow_noise_nor_a_touch() -> None:
    """It is there whenever roll and tilt go far to the same side: seldom, loud, and foretold by where the joints are."""
    bench = Bench(2, rows=6000, rate=50.0)
    roll, tilt = (bench.q[:, k] / bench.q[:, k].std() for k in (3, 4))
    corner = np.maximum(roll * tilt, 0.0) ** 2
    bench.wrench[:, 2] += 3.0 * SIGMA[2] * corner / corner.std()
    work = judged(bench)
    assert (work.diagnosis.verdict, named(work)) == ("unexplained", ["unknown"])
    assert "roll and tilt together" in dependence(
        "input 4 and input 5 together", Inputs.of(work.bench.scene, work.bench.rows).names
    )


@pytest.mark.inject
@pytest.mark.parametrize(("motion", "expected"), [(1, ["unknown"]), (2, ["contact"])])
def test_a_pull_at_a_place_is_no_touch_and_the_same_pull_at_any_place_is(motion: int, expected: list[str]) -> None:
    """A drape is tight where roll and tilt go far to one side: with that motion it is no event, with another it is one."""
    roll, tilt = (x / np.abs(x).max() for x in Bench(1, rows=4000).q[:, [3, 4]].T)
    pull = np.maximum(roll + tilt - 1.0, 0.0) ** 1.5
    bench = Bench(motion, rows=4000)
    bench.wrench[:, 3] += 1.2 * SIGMA[3] * pull / np.sqrt(np.mean(pull**2))
    assert named(judged(bench)) == expected


@pytest.mark.inject
def test_what_touches_in_a_place_is_told_in_the_channel_and_size_that_it_has() -> None:
    """Of two pushes of one kind at one place each follows from the other; of one push alone nothing does."""
    corner = Bench(1, rows=4000)
    roll, tilt = (x / np.abs(x).max() for x in corner.q[:, [3, 4]].T)
    pull = np.maximum(roll + tilt - 1.0, 0.0) ** 1.5
    pull *= 1.2 * SIGMA[3] / np.sqrt(np.mean(pull**2))
    corner.wrench[:, 3] += pull
    work = judged(corner)
    on = np.flatnonzero(np.diff(np.concatenate([[0], pull > 0.1 * pull.max(), [0]])))
    episodes = tuple((float(corner.t[a]) - 0.3, float(corner.t[b - 1]) + 0.3) for a, b in on.reshape(-1, 2))
    assert len(episodes) >= 3

    def found(episodes: tuple[tuple[float, float], ...]) -> list[structure_test.Structure]:
        touches = work.bench.hypothesis(Contact(("wrench.torque.x",), episodes))
        whole = Model(work.bench, work.model.nuisances, [touches], work.model.white)
        return predicted_by_place(whole, whole.without([touches]))

    (one,) = found(episodes)
    assert WRENCH[one.channel] == "wrench.torque.x"
    assert one.size == pytest.approx(1.2 * SIGMA[3], rel=0.5)
    assert 0.0 < one.share < 1.0
    assert found(episodes[-1:]) == []


@pytest.mark.inject
def test_noise_with_heavy_tails_has_no_glitches() -> None:
    """Far samples that are but the end of a tail of nearer ones; as far ones out of nothing are glitches."""
    bench = Bench(12, rows=6000, rate=50.0)
    heavy = np.random.default_rng(12).standard_t(4, size=bench.noise.shape)
    bench.noise = heavy / heavy.std(axis=0) * SIGMA
    assert spikes(scene_of(bench.observations()).raw_residual, (slice(0, 6000),)).any()
    work = judged(bench)
    assert (work.diagnosis.verdict, named(work)) == ("agrees", [])
    other = Bench(12, rows=6000, rate=50.0)
    other.wrench[[900, 2500, 4400], 1] += 12.0 * SIGMA[1]
    assert named(judged(other)) == ["glitches"]


@pytest.mark.inject
def test_noise_that_grows_ever_slower_is_not_what_a_model_leaves() -> None:
    """Flicker noise moves the held-out blocks by more than what a recording can measure of its spectrum."""
    bench = Bench(14, rows=6000, rate=50.0)
    frequency = np.fft.rfftfreq(6000)
    frequency[0] = frequency[1]
    flicker = np.fft.irfft(
        np.fft.rfft(bench.rng.normal(size=(6000, 6)), axis=0) / np.sqrt(frequency)[:, None], n=6000, axis=0
    )
    bench.noise = flicker / flicker.std(axis=0) * SIGMA
    work = judged(bench)
    assert work.diagnosis.verdict == "agrees"
    assert np.all(work.bench.noise.slow_power_ratio > 1.1)


def test_one_function_of_many_is_taken_alone_and_holds_on_another_motion_better_than_its_family() -> None:
    """The rest is one product of two speeds: all forty of them, each a little, predict another motion less well."""
    work = of_stray()
    bench, names = work.bench, ["products of speeds", "positions times speeds"]
    functions = Functions(bench)
    sums = functions.plain(names, 0), functions.white(names, 0)
    residuals = (
        work.model.residual()[functions.rows, 0] / bench.noise.sigma[0],
        work.model.residual(white=True)[functions.rows, 0],
    )
    alone, family = (of(*sums, *residuals, weighed=True) for of in (Pursuit, Ridge))
    assert alone.chosen == ["products of speeds"]
    assert np.count_nonzero(alone.coefficients()["products of speeds"]) == 1
    assert alone.reached > family.reached
    other = stray(Bench(2, rows=4000))
    scene = scene_of(other.observations())
    rows = Rows(tuple(scene.segments), bench.rows.stride)
    inputs = Inputs.of(scene, rows, like=functions.inputs)
    residual = rows.average(scene.residual)[:, 0]

    def error(parts: dict[str, np.ndarray]) -> float:
        told = sum(by_name(inputs)[n] @ t - functions.means[n] @ t for n, t in parts.items())
        return float(np.std(residual - told))

    assert error(alone.coefficients()) < error(family.coefficients())
    assert error(alone.coefficients()) < 1.01 * SIGMA[0] / np.sqrt(bench.rows.stride)


@pytest.mark.inject
def test_low_powers_alone_stand_where_no_function_does_much_better() -> None:
    """Torques of a rotor go with speeds, and with these times positions: the past would say a trifle more of this motion."""
    work = judged(rotor(Bench(1, rows=4000)))
    functions = Functions(work.bench)
    assert set(PLAIN) - set(WARM) <= set(functions.columns)
    learnt = learn(work.model, {c: set(functions.columns) for c in (3, 4, 5)}, functions)
    assert learnt is not None
    assert set(learnt.parts) == {3, 4, 5}
    for families in learnt.parts.values():
        assert set(families) <= set(PLAIN)
        assert sum(np.count_nonzero(theta) for theta in families.values()) <= Pursuit.most


def test_what_predicts_a_row_was_not_fitted_on_it() -> None:
    """The prediction of each fold is that of least squares on the others; nothing is taken of a rest that is noise."""
    work = of_stray()
    bench, names = work.bench, ["products of speeds"]
    functions = Functions(bench)
    sums, y = functions.plain(names, 0), work.model.residual()[functions.rows, 0] / bench.noise.sigma[0]
    alone = Pursuit(
        sums, functions.white(names, 0), y, work.model.residual(white=True)[functions.rows, 0], weighed=False
    )
    at = int(np.flatnonzero(alone.coefficients()[names[0]])[0])
    x = functions.columns[names[0]][functions.rows, at]
    out = np.zeros(len(y))
    for rows in functions.folds:
        others = np.delete(np.arange(len(y)), rows)
        out[rows] = x[rows] * (x[others] @ y[others]) / (x[others] @ x[others])
    assert alone.cross_validated() == pytest.approx(out, abs=1e-9)
    noise = np.random.default_rng(5).normal(size=(2, len(y)))
    assert not Pursuit(sums, functions.white(names, 0), *noise, weighed=True).chosen


def test_a_mean_of_two_regressions_is_judged_as_each_of_them_is() -> None:
    """Its predictions of blocks left out, its gain and its coefficients are the means that it says it is."""
    work = of_stray()
    bench, names = work.bench, ["products of speeds", "positions times speeds"]
    functions = Functions(bench)
    sums = functions.plain(names, 0), functions.white(names, 0)
    y = work.model.residual()[functions.rows, 0] / bench.noise.sigma[0]
    one, other = (
        of(*sums, y, work.model.residual(white=True)[functions.rows, 0], weighed=False) for of in (Pursuit, Ridge)
    )
    both = Blend.between(one, other)
    mean = 0.5 * (one.cross_validated() + other.cross_validated())
    assert both.cross_validated() == pytest.approx(mean)
    assert both.reached == pytest.approx(float(y @ y - (y - mean) @ (y - mean)))
    # The mean of two errs no more than they do on the average.
    assert both.reached >= 0.5 * (one.reached + other.reached)
    told = {n: one.coefficients().get(n, 0.0) + other.coefficients().get(n, 0.0) for n in both.chosen}
    for name, theta in both.coefficients().items():
        assert theta == pytest.approx(0.5 * told[name])


def edge(bench: Bench) -> Bench:
    """A force that is there wherever roll is beyond an edge, with a ripple along tilt: no family has such a bend."""
    roll, tilt = bench.q[:, 3], bench.q[:, 4]
    bench.wrench[:, 0] += 3.0 * SIGMA[0] * ((roll > 0.1) * np.sign(tilt) - 0.5 * (np.abs(tilt) > 0.15))
    return bench


@pytest.mark.inject
def test_trees_stand_beside_functions_where_they_say_more_of_blocks_left_out_and_hold_on_another_motion() -> None:
    """Edges in joint space are theirs; one smooth product of two speeds is not, and they stay away from it."""
    learnt, other = (scene_of(edge(Bench(seed, rows=6000)).observations()) for seed in (1, 2))
    work = diagnose(learnt, holdout=other)
    kinds = {0: {"the joint positions, finely"}}
    functions = Functions(work.bench)
    alone = learn(work.model, kinds, functions)
    assert alone is not None
    both = blended(alone, work.model, functions)
    assert list(both.trees) == [0]
    rows = Rows(tuple(other.segments), work.bench.rows.stride)
    residual = rows.average(other.residual)

    def error(told: np.ndarray | None) -> float:
        assert told is not None
        return float(np.std((residual - told)[:, 0]))

    assert error(both.predict(other, rows, 6)) < 0.95 * error(alone.predict(other, rows, 6))
    smooth = of_stray()
    functions = Functions(smooth.bench)
    single = learn(smooth.model, {0: {"products of speeds"}}, functions)
    assert single is not None
    assert blended(single, smooth.model, functions).trees == {}


def slow(bench: Bench) -> Bench:
    """The same noise with a memory of half a second in two thirds of its power."""
    wander = lfilter([1.0], [1.0, -0.97], bench.rng.normal(size=bench.noise.shape), axis=0) * np.sqrt(1.0 - 0.97**2)
    bench.noise = (0.8 * wander + 0.6 * bench.rng.normal(size=bench.noise.shape)) * SIGMA
    return bench


def spinning(bench: Bench) -> Bench:
    """A torque in proportion to a joint's speed, as a spinning body gives it: no word is for it."""
    bench.wrench[:, 5] += SIGMA[5] * np.gradient(bench.q[:, 3], bench.t) / 0.4
    return bench


@pytest.mark.inject
def test_flexible_names_yield_where_they_leave_nothing() -> None:
    """Creep with a leak between channels comes so near that nothing else is left; what foretells it better has no name."""
    other = spinning(slow(Bench(22, rows=6000, rate=50.0)))
    work = judged(spinning(slow(Bench(21, rows=6000, rate=50.0))), other)
    assert (work.diagnosis.verdict, named(work)) == ("unexplained", ["unknown"])
    noise = float(np.sqrt(np.mean(other.noise[:, 5] ** 2)))
    assert work.diagnosis.fit["rmse_after"]["wrench.torque.z"] < 1.01 * noise

"""How large what was found is: sizes and their intervals where several effects meet, and where the noise is scattered."""

import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parent))

from diagnosis_cases import COM, WRENCH, Bench, hanging, lagged, rotation, sines

from galen_hw.diagnosis.estimation import signal_chain
from galen_hw.diagnosis.estimation.interactions import settle_together
from galen_hw.diagnosis.estimation.model import Model, with_interactions
from galen_hw.diagnosis.estimation.normal_equations import Scorer
from galen_hw.diagnosis.noise.low_frequency import smoothed
from galen_hw.diagnosis.pipeline import diagnose
from galen_hw.physics.effects.creep import Creep
from galen_hw.physics.effects.drift import Drift
from galen_hw.physics.effects.load import Payload
from galen_hw.physics.effects.registry import scene_of
from galen_hw.physics.effects.sensor import Gain
from galen_hw.physics.rigid import Body


def slowly(seed: int) -> Bench:
    """An arm that moves so slowly that nothing has inertia."""
    case = Bench(seed, rows=6000, rate=5.0)
    case.q = np.stack([sines(case.rng, case.t, size, 0.003, 0.03) for size in (0.02, 0.02, 0.02, 0.45, 0.35)], axis=1)
    return case


def told(case: Bench) -> dict[str, dict[str, tuple[float, float]]]:
    """Found effects with values and standard deviations."""
    answer = diagnose(scene_of(case.observations())).diagnosis
    return {f.effect: {name: (v.value, v.std) for name, v in f.parameters.items()} for f in answer.findings}


@pytest.mark.inject
def test_a_new_load_on_a_wrong_joint_read_by_a_wrong_gain_is_told_in_its_own_size() -> None:
    """Each alone they would be a tenth off: ten to thirty standard deviations."""
    case = slowly(4)
    gain, scale = 1.09, 0.02
    heavier, moment = 0.287 + 0.03, 0.287 * COM + 0.03 * np.array([0.01, 0.0, -0.08])
    R = rotation(case.q[:, 3], case.q[:, 4] * (1.0 + scale))
    case.wrench = hanging(R, heavier, moment / heavier)
    case.wrench[:, 2] *= gain
    found = told(case)
    assert set(found) == {"payload", "joint_scale", "gain"}
    for effect, name, true in [
        ("payload", "mass", 0.03),
        ("joint_scale", "scale_error", scale),
        ("gain", "gain_error", gain - 1.0),
    ]:
        value, std = found[effect][name]
        assert abs(value - true) < 3.0 * std, (effect, value, std)
        assert std < 0.05 * true


def test_a_joint_that_is_read_wrong_moves_otherwise_too() -> None:
    """In quick motion the scale is told by the inertia of the tool as well as by its weight."""
    case = Bench(2, rows=6000, rate=50.0)
    case.belief = {"dynamic": True, "tool": Body(0.6, np.array([0.0, 0.0, -0.2]))}
    scale = 0.02
    case.q[:] = 0.0
    quick, slow = 2.0 * np.pi * 0.5, 2.0 * np.pi * 0.13
    case.q[:, 4] = 0.4 * np.sin(quick * case.t) + 0.2 * np.sin(slow * case.t)
    tilt = (1.0 + scale) * case.q[:, 4]
    rate = (1.0 + scale) * (0.4 * quick * np.cos(quick * case.t) + 0.2 * slow * np.cos(slow * case.t))
    ahead = -(1.0 + scale) * (0.4 * quick**2 * np.sin(quick * case.t) + 0.2 * slow**2 * np.sin(slow * case.t))
    # A body at (x, 0, z) in the axes of the tilting link, by Newton.
    x, _, z = case.observations().belief.robot.tilt_to_sensor
    z -= 0.2
    fx = 0.6 * (9.80665 * np.sin(tilt) - (ahead * z - rate**2 * x))
    fz = 0.6 * (-9.80665 * np.cos(tilt) - (-ahead * x - rate**2 * z))
    zero = np.zeros_like(fx)
    case.wrench = np.stack([fx, zero, fz, zero, -0.2 * fx, zero], axis=1)
    found = told(case)
    assert set(found) == {"joint_scale"}
    value, std = found["joint_scale"]["scale_error"]
    assert abs(value - scale) < 4.0 * std
    assert abs(value - scale) < 0.01 * scale


@pytest.mark.inject
def test_a_wrong_joint_on_a_late_stream_is_told_in_its_own_size() -> None:
    """What it does beyond its slope is late too: on time it had moved the scale by several standard deviations."""
    case = Bench(5, rows=6000, rate=20.0)
    scale, late = 0.06, 0.25
    on_time = hanging(rotation(case.q[:, 3], case.q[:, 4] * (1.0 + scale)))
    case.wrench = np.stack([np.interp(case.t - late, case.t, c) for c in on_time.T], axis=1)
    case.noise *= 0.3
    found = told(case)
    assert set(found) == {"joint_scale", "time_delay"}
    for effect, name, true in [("joint_scale", "scale_error", scale), ("time_delay", "delay", late)]:
        value, std = found[effect][name]
        assert abs(value - true) < 3.5 * std, (effect, value, std)
        assert std < 0.01 * true


@pytest.mark.inject
def test_what_is_searched_is_as_unknown_as_what_is_linear() -> None:
    """Standard deviations of all at once are those of the Jacobian of the whole model, searched constants included."""
    case = slowly(3)
    bench = diagnose(scene_of(case.observations())).bench
    known = [(Payload("mass"), [0.01]), (Drift(WRENCH[2], "warm_up", 2000.0, 0.0, 1200.0), [0.5]), (Creep(40.0), None)]
    effects = [(e, np.full(len(e.parameters(bench.scene)), 0.1) if t is None else np.array(t)) for e, t in known]

    def whole(linear: np.ndarray, searched: np.ndarray) -> np.ndarray:
        out, done, sought = np.zeros_like(bench.whole), 0, iter(searched)
        for effect, theta in effects:
            here = effect.with_searched({name: next(sought) for name in effect.searched()})
            out += bench.rows.average(here.change(bench.scene, linear[done : done + len(theta)]))
            done += len(theta)
        return bench.whitened(out).reshape(-1)

    linear = np.concatenate([theta for _, theta in effects])
    searched = np.array([value for effect, _ in effects for value in effect.searched().values()])
    J = [whole(linear + 1e-4 * e, searched) - whole(linear - 1e-4 * e, searched) for e in np.eye(len(linear))]
    J = [j / 2e-4 for j in J]
    J += [
        (whole(linear, searched + step) - whole(linear, searched - step)) / (2.0 * step[k])
        for k, step in enumerate(np.diag(1e-3 * searched))
    ]
    hypotheses = [bench.hypothesis(effect) for effect, _ in effects]
    constants = [bench.hypothesis_of(None, c) for c in bench.constants()]
    ones = [np.zeros((len(bench.rows), bench.width)) for _ in constants]
    for one, h in zip(ones, constants, strict=True):
        one[:, h.white.channels] = h.white.values[:, :, 0]
    X = np.stack([*J, *(one.reshape(-1) for one in ones)], axis=1)
    X = X[np.repeat(~bench.excluded_rows, bench.width)]
    size = np.linalg.norm(X, axis=0)
    required = (np.sqrt(np.diag(np.linalg.inv(X.T @ X / np.outer(size, size)))) / size)[: len(J)]
    y = whole(linear, searched).reshape(bench.whole.shape) + bench.whitened(bench.rows.average(case.noise))
    model = Model(bench, constants, hypotheses, y)
    places = np.concatenate([np.arange(s.start, s.stop) for s in model.slices()[len(constants) :]])
    told = np.concatenate(
        [np.sqrt(np.diag(model.parameter_errors.covariance)[places]), list(model.parameter_errors.searched.values())]
    )
    assert len(told) == len(required)
    # The sandwich of forty blocks is never below, and errs by a tenth or two.
    assert np.all(told > 0.95 * required)
    assert np.all(told < 1.5 * required)
    alone = np.sqrt(np.diag(model.covariance)[places])
    assert np.max(told[: len(alone)] / alone) > 1.3


@pytest.mark.inject
def test_a_hum_whose_phase_walks_is_one_vibration_of_its_mean_frequency() -> None:
    """Two lines within each other's breadth would be each other's wander, with amplitudes that mean nothing."""
    case = Bench(6, rows=12000, rate=100.0)
    rng = np.random.default_rng(5)
    walk = np.cumsum(rng.normal(size=len(case.t))) * 0.02
    case.wrench[:, 0] += 0.03 * np.sin(2.0 * np.pi * 11.3 * case.t + walk - walk.mean())
    found = told(case)
    assert list(found) == ["vibration"]
    frequencies = [v for name, v in found["vibration"].items() if name.endswith("frequency")]
    (frequency,) = frequencies
    slope = np.polyfit(case.t, walk, 1)[0] / (2.0 * np.pi)
    assert abs(frequency[0] - 11.3 - slope) < 2e-3
    assert 0.0 < frequency[1] < 0.02
    amplitude, spread = found["vibration"]["rms_signal"]
    assert amplitude == pytest.approx(0.03 / np.sqrt(2.0), rel=0.1)
    assert spread < 0.1 * amplitude


def test_what_creeps_and_a_load_that_was_wrong_all_along_say_how_little_is_known_of_the_load() -> None:
    """More in the end, or less at first: what a load makes of the difference is part of its uncertainty."""
    case = slowly(8)
    R = rotation(case.q[:, 3], case.q[:, 4])
    case.wrench = hanging(R)
    bench = diagnose(scene_of(case.observations())).bench
    heavier = hanging(R, 0.287 + 0.004, COM)
    crept = heavier + 0.01 * (np.stack([lagged(case.t, c, 40.0) for c in heavier.T], axis=1) - heavier)
    y = bench.rows.average(crept - hanging(R) + case.noise)
    bench.whole = y
    nuisances = [bench.hypothesis_of(None, c) for c in bench.constants()]
    for form in ("more", "less"):
        effects = [bench.hypothesis(Payload("body")), bench.hypothesis(Creep(40.0, form=form))]
        model = Model(bench, nuisances, effects, bench.whitened(y))
        at = model.slices()[len(nuisances)].start
        assert abs(model.final[at] - 0.004) < 2.0 * np.sqrt(model.variance[at])
        alone = np.sqrt(model.covariance[at, at])
        assert alone < 0.2 * np.sqrt(model.variance[at])
        if form == "more":
            assert abs(model.final[at] - 0.004) > 5.0 * alone


@pytest.mark.inject
def test_a_small_body_is_told_anew_where_it_sits_beside_another_convention() -> None:
    """A law between parameters goes with them: placed where the other convention had it, that one would be refused."""
    case = slowly(8)
    bench = diagnose(scene_of(case.observations())).bench
    at = np.array([0.05, 0.01, -0.12])
    y = bench.rows.average(hanging(rotation(case.q[:, 3], case.q[:, 4]), 0.002, at))
    nuisances = [bench.hypothesis_of(None, c) for c in bench.constants()]
    model = Model(bench, nuisances, [bench.hypothesis(Payload("point", (0.0, 0.1, 0.0)))], bench.whitened(y))
    told = model.with_updated_laws().effects[0].effect
    assert isinstance(told, Payload)
    assert told.at is not None
    np.testing.assert_allclose(told.at, at, atol=1e-4)
    free = Model(bench, nuisances, [bench.hypothesis(Payload("body"))], bench.whitened(y))
    assert free.with_updated_laws() is free


@pytest.mark.parametrize(("growth", "rounds"), [(10.0, 2), (np.nan, 1)])
def test_what_does_not_come_to_rest_is_left_as_if_alone(
    monkeypatch: pytest.MonkeyPatch, growth: float, rounds: int
) -> None:
    """Shares of several hundred per cent undo each other ever more; a clock that is seconds off had made numbers without end."""
    case = Bench(8)
    bench = diagnose(scene_of(case.observations())).bench
    effects = [bench.hypothesis(Gain(WRENCH[0])), bench.hypothesis(Creep(4.0, WRENCH[0]))]
    model = Model(
        bench, [bench.hypothesis_of(None, c) for c in bench.constants()], effects, bench.whitened(bench.whole)
    )
    calls = []

    def growing(scene: Any, placed: Any, timing: Any) -> list[np.ndarray]:
        calls.append(1)
        return [growth ** len(calls) * np.ones((len(scene), 6)) for _ in placed]

    monkeypatch.setattr(signal_chain, "interaction_terms", growing)
    assert with_interactions(model) is model
    assert len(calls) == rounds
    scorer = Scorer(bench, effects)
    chosen = [len(scorer.base), len(scorer.base) + 1]
    settle_together(bench, scorer, chosen)
    assert np.max(np.abs(bench.state.interaction)) == 0.0
    assert np.isfinite(scorer.solve(chosen)[0]).all()


@pytest.mark.parametrize("kind", ["white", "flicker", "corner"])
def test_a_smooth_spectrum_is_nearer_to_the_true_one_than_its_bands_are(kind: str) -> None:
    """The scatter of bands with few lines goes, power laws and bends stay."""
    rng = np.random.default_rng(2)
    edges = np.geomspace(6e-4, 0.5, 18)
    centres, lines = np.sqrt(edges[1:] * edges[:-1]), np.maximum(12000.0 * np.diff(edges), 18.0)
    true = {
        "white": np.ones_like(centres),
        "flicker": 0.01 / centres,
        "corner": 0.2 + 5.0 / (1.0 + (centres / 0.01) ** 2),
    }[kind]
    freedom = 2.0 * lines / 1.94
    raw = true[:, None] * rng.chisquare(freedom[:, None], size=(len(centres), 200)) / freedom[:, None]
    found = smoothed(centres, raw, lines)
    before, after = (np.sqrt(np.mean(np.log(x / true[:, None]) ** 2)) for x in (raw, found))
    assert after < (0.5 if kind == "white" else 0.75) * before
    bias = np.mean(np.log(found / true[:, None]), axis=1)
    assert np.max(np.abs(bias)) < 0.15

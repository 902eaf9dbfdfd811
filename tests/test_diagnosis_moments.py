"""What belongs to moments is learnt where it is; the rest of the model is learnt beside it as it is."""

import sys
from pathlib import Path

import numpy as np
import pytest
from scipy.signal import lfilter

sys.path.insert(0, str(Path(__file__).parent))

from diagnosis_cases import SIGMA, WRENCH, Bench

from galen_hw.diagnosis.estimation.cross_validation import cross_validated
from galen_hw.diagnosis.estimation.dataset import Bench as DiagnosisBench
from galen_hw.diagnosis.estimation.model import Model
from galen_hw.diagnosis.estimation.normal_equations import Scorer
from galen_hw.diagnosis.pipeline import diagnose
from galen_hw.diagnosis.selection.moves.step_times import steps_relocated
from galen_hw.diagnosis.selection.search_state import Selection
from galen_hw.diagnosis.stats import paired_test
from galen_hw.diagnosis.validation.holdout import backward_eliminated
from galen_hw.diagnosis.validation.judgement import Judged
from galen_hw.physics.effects.drift import Drift
from galen_hw.physics.effects.events import Contact, Step, Vibration
from galen_hw.physics.effects.registry import scene_of
from galen_hw.physics.effects.sensor import Gain, Saturation


def test_offsets_are_learnt_beside_the_drift_that_is_told() -> None:
    """A line and a wander share what they do on few blocks: an offset that was learnt beside others of them fits none."""
    case = Bench(3)
    period, length = 41.0, float(case.t[-1])
    case.wrench[:, 1] += 0.015 * np.sin(2.0 * np.pi * case.t / period) + 0.02 * np.sin(0.7 * np.pi * case.t / period)
    work = diagnose(scene_of(case.observations()))
    bench, nuisances = work.bench, work.model.nuisances
    forms = [Drift(WRENCH[1], form, None, 0.0, length) for form in ("wander", "linear")]
    model = Model(bench, nuisances, [bench.hypothesis(form) for form in forms], bench.whitened(bench.whole))
    rest = model.residual()[bench.train, 1]
    assert abs(float(rest.mean())) < 4.0 * SIGMA[1] / np.sqrt(len(rest))
    for h, s in zip(model.parts, model.slices(), strict=True):
        if h.effect is not None:
            np.testing.assert_array_equal(model.theta[s], model.final[s])


def touched(bench: DiagnosisBench, *, aside: bool) -> tuple[float, float]:
    """A moment of a second and a half that lies in the middle of one block, set aside or learnt from."""
    time = bench.time
    numbers = [b for b in np.unique(bench.block) if bench.held_out[bench.block == b].all() == aside]
    inside = time[bench.block == numbers[len(numbers) // 2]]
    middle = float(inside.mean())
    return middle - 0.75, middle + 0.75


def test_a_touch_in_a_block_left_out_decides_nothing_between_models_that_have_it() -> None:
    """It cannot be foretold from the others: what then stands there had been the larger part of both models' errors."""
    case = Bench(5, rows=4000)
    work = diagnose(scene_of(case.observations()))
    bench = work.bench
    start, end = touched(bench, aside=False)
    time = bench.time
    during = (time >= start) & (time <= end)
    y = bench.whole + 20.0 * SIGMA[0] * (during[:, None] & (np.arange(6) == 0))
    model = [
        *(bench.hypothesis_of(None, c) for c in bench.constants()),
        bench.hypothesis(Contact(WRENCH[:1], ((start, end),))),
    ]
    white, before = bench.whitened(y), bench.y
    bench.update_state(y=y)
    try:
        left, without = (np.mean(cross_validated(bench, some, white) ** 2, axis=0) for some in (model, model[:-1]))
    finally:
        bench.update_state(y=before)
    assert left[0] < 1.1 * SIGMA[0] ** 2
    assert without[0] > 1.5 * SIGMA[0] ** 2


def test_a_touch_that_is_not_learnt_from_costs_nothing() -> None:
    """Two touches of which one lies in rows set aside owe for the other alone: it had been left out, and spoilt what judges."""
    case = Bench(5, rows=4000)
    bench = diagnose(scene_of(case.observations())).bench
    seen, hidden = (touched(bench, aside=aside) for aside in (False, True))
    contacts = [Contact(WRENCH[:2], tuple(sorted(episodes))) for episodes in ((seen,), (seen, hidden))]
    scorer = Scorer(bench, [bench.hypothesis(contact) for contact in contacts])
    first = len(scorer.base)
    one, both = (scorer.scores([], [first + k])[0][first + k] for k in range(2))
    assert both.rank - both.gain == pytest.approx(one.rank - one.gain)
    # A level and a bow in two channels; one of two places.
    assert one.gain - one.rank == pytest.approx(4.0 * scorer.library[first].penalty(bench) + 2.0 * np.log(2.0))


def test_a_touch_owes_for_the_rows_that_tell_of_it() -> None:
    """A level of two seconds is learnt from these alone; what lasts is learnt from every row, and costs the more."""
    bench = diagnose(scene_of(Bench(5, rows=4000).observations())).bench
    time = bench.time
    start, end = touched(bench, aside=False)
    touch, jump = bench.hypothesis(Contact(WRENCH[:1], ((start, end),))), bench.hypothesis(Step(WRENCH[:1], start))
    lasts = touch.informative_share(bench.train)
    assert lasts == np.mean(((time >= start) & (time <= end))[bench.train])
    assert 0.0 < lasts < 0.03
    assert jump.penalty(bench) == pytest.approx(np.log(bench.noise.effective))
    assert touch.penalty(bench) == pytest.approx(np.log(bench.noise.effective * lasts))


def test_each_of_several_touches_owes_its_place() -> None:
    """It could have been anywhere; what lies where nothing is learnt was not looked for, and a jump has one place."""
    bench = diagnose(scene_of(Bench(5, rows=4000).observations())).bench
    seen, hidden = (touched(bench, aside=aside) for aside in (False, True))
    other = (seen[0] - 0.3, seen[0] - 0.1)
    for episodes, count in (((seen,), 1), ((other, seen), 2), (tuple(sorted((seen, hidden))), 1)):
        assert bench.hypothesis(Contact(WRENCH[:2], episodes), 250).log_trials(bench.train) == pytest.approx(
            count * np.log(250.0)
        )
    assert bench.hypothesis(Step(WRENCH, seen[0]), 250).log_trials(bench.train) == pytest.approx(np.log(250.0))
    assert bench.hypothesis(Contact(WRENCH[:2], (seen,))).log_trials(bench.train) == 0.0


@pytest.mark.inject
def test_a_short_touch_under_slow_noise_is_told() -> None:
    """Three touches, a level in every channel: for all rows of the recording their numbers would have cost too much."""
    case = Bench(8, rows=6000, rate=50.0)
    wander = lfilter([1.0], [1.0, -np.exp(-0.08)], case.rng.normal(size=case.noise.shape), axis=0)
    case.noise = SIGMA * (case.noise / SIGMA / np.sqrt(3.0) + np.sqrt(2.0 / 3.0) * wander / wander.std(axis=0))
    episodes = ((21.0, 22.6), (54.0, 55.2), (90.0, 91.4))
    for start, end in episodes:
        inside = (case.t >= start) & (case.t <= end)
        case.wrench[inside] += 1.8 * SIGMA * np.array([1.0, -1.0, 1.0, 1.0, -1.0, 1.0])
    work = diagnose(scene_of(case.observations()))
    assert [f.effect for f in work.diagnosis.findings] == ["contact"]
    (told,) = (h.effect for h in work.model.effects if isinstance(h.effect, Contact))
    np.testing.assert_allclose(told.episodes, episodes, atol=0.5)


def test_a_hum_that_takes_nothing_of_its_own_recording_is_not_claimed(monkeypatch: pytest.MonkeyPatch) -> None:
    """It is there all through it, and what it takes there is what speaks for it; a touch beside it stays."""
    case = Bench(7, rows=4000)
    case.wrench[:, 0] += SIGMA[0] * (3.0 * np.sin(2 * np.pi * 3.7 * case.t) + 4.0 * ((case.t > 30.0) & (case.t < 34.0)))
    bench = DiagnosisBench(scene_of(case.observations()), 0.3, 0)
    bench.learn_noise([bench.raw(Vibration(WRENCH[:1], 3.7)), bench.raw(Contact(WRENCH[:1], ((30.0, 34.0),)))])
    nuisances = [bench.hypothesis_of(None, columns) for columns in bench.constants()]
    hum, touch = bench.hypothesis(Vibration(WRENCH[:1], 3.7)), bench.hypothesis(Contact(WRENCH[:1], ((30.0, 34.0),)))
    model = Model(bench, nuisances, [hum, touch], bench.whitened(bench.whole))
    nothing, much = paired_test.Gain(0.0, 0.01, 1.0, 0.0), paired_test.Gain(0.3, 0.01, 1.0, 30.0)
    took = {"vibration": nothing, "contact": much}

    def told(asked: Model, holdout: object, first: object) -> Judged:
        del holdout, first
        keys = {h.effect.KEY for h in asked.effects if h.effect is not None}
        support = {key: gain for key, gain in took.items() if key in keys}
        floor = bench.noise.sigma**2
        tests = {key: [gain] for key, gain in support.items()}
        return Judged("", floor, floor, dict.fromkeys(support, floor), floor, support, tests)

    monkeypatch.setattr("galen_hw.diagnosis.validation.holdout.judge", told)
    assert backward_eliminated(model, None)[0].effects == [touch]
    took["vibration"] = much
    assert backward_eliminated(model, None)[0] is model


@pytest.mark.inject
def test_readings_that_clip_at_both_ends_are_limits_and_no_touch() -> None:
    """In the same episodes a level and a bow each do about what both limits do together."""
    case = Bench(6, rows=4000)
    limit = 0.6 * float(np.abs(case.wrench[:, 1]).max())
    case.wrench[:, 1] = np.clip(case.wrench[:, 1] + case.noise[:, 1], -limit, limit) - case.noise[:, 1]
    work = diagnose(scene_of(case.observations()))
    assert [f.effect for f in work.diagnosis.findings] == ["saturation"]
    told = sorted(h.effect.limit for h in work.model.effects if isinstance(h.effect, Saturation))
    near = 0.2 * SIGMA[1]
    np.testing.assert_allclose(told, [-limit, limit], atol=near)
    said = work.diagnosis.findings[0].parameters
    assert said[f"{WRENCH[1]} low: limit"].value == pytest.approx(-limit, abs=near)
    assert said[f"{WRENCH[1]} high: limit"].value == pytest.approx(limit, abs=near)


def test_a_jump_goes_to_the_moment_that_the_present_model_gives_it() -> None:
    """Told a second and a half too late it moves; where it is right it stays, and its place in the model is its own."""
    case = Bench(6)
    moment = float(case.t[700])
    case.wrench[:, :2] += 3.0 * SIGMA[:2] * (case.t >= moment)[:, None]
    bench = DiagnosisBench(scene_of(case.observations()), 0.3, 0)
    bench.learn_noise([bench.raw(Step(WRENCH[:2], moment))])
    late = bench.hypothesis(Step(WRENCH[:2], moment + 1.5), trials=500)
    scorer = Scorer(bench, [bench.hypothesis(Gain(WRENCH[5])), late])
    first = len(scorer.base)
    out = Selection(scorer, [first, first + 1])
    assert steps_relocated(out)
    assert out.chosen[0] == first
    told = scorer.library[out.chosen[1]]
    assert (told.effect, told.trials) == (Step(WRENCH[:2], moment), len(bench.rows) // 4)
    assert not steps_relocated(out)


def test_a_tool_that_slips_in_its_clamp_is_a_body_from_that_moment_on() -> None:
    """Its centre of mass moves at once and its weight stays: no step of the offsets, which do not turn with gravity."""
    case = Bench(11, rows=4000)
    late, slip = (case.t >= 22.0)[:, None], np.array([0.3e-3, -0.1e-3, 0.2e-3])
    force = scene_of(case.observations()).simulated[:, :3]
    case.wrench[:, 3:] += late * np.cross(slip, force)
    (found,) = diagnose(scene_of(case.observations())).diagnosis.findings
    assert found.effect == "payload"
    assert found.parameters["moment"].value == pytest.approx(22.0, abs=0.3)
    assert "from 22" in found.says


def test_what_rings_is_said_to_pass_for_noise() -> None:
    """A loose part swings at 3 Hz, its phase its own: no function of the motion, and no sensor's noise."""
    case, rng = Bench(12, rows=4000), np.random.default_rng(0)
    step = float(case.t[1] - case.t[0])
    turn, decay = 2.0 * np.pi * 3.0 * step, 0.97
    swing = lfilter([1.0], [1.0, -2.0 * decay * np.cos(turn), decay**2], rng.normal(size=len(case.t)))
    case.wrench[:, 4] += 6.0 * SIGMA[4] * swing / np.std(swing)
    diagnosis = diagnose(scene_of(case.observations())).diagnosis
    (note,) = (one for one in diagnosis.notes if one.startswith("what rings"))
    assert WRENCH[4] in note
    assert float(note.split("near ")[1].split(" Hz")[0]) == pytest.approx(3.0, rel=0.25)

"""What belongs to moments is learnt where it is; the rest of the model is learnt beside it as it is."""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parent))

from diagnosis_cases import SIGMA, WRENCH, Bench

from galen_hw.diagnosis.bench import Bench as DiagnosisBench
from galen_hw.diagnosis.engine import diagnose
from galen_hw.diagnosis.final import Model
from galen_hw.diagnosis.linear import left_out
from galen_hw.diagnosis.score import Scorer
from galen_hw.diagnosis.touches import slight
from galen_hw.diagnosis.verdict import beyond
from galen_hw.physics.event_effects import Contact
from galen_hw.physics.sensor_effects import Drift, Saturation
from galen_hw.physics.table import scene_of


def test_offsets_are_learnt_beside_the_drift_that_is_told() -> None:
    """A line and a wander share what they do on few blocks: an offset that was learnt beside others of them fits none."""
    case = Bench(3)
    period, length = 41.0, float(case.t[-1])
    case.wrench[:, 1] += 0.015 * np.sin(2.0 * np.pi * case.t / period) + 0.02 * np.sin(0.7 * np.pi * case.t / period)
    work = diagnose(scene_of(case.observations()))
    bench, nuisances = work.bench, work.model.nuisances
    forms = [Drift(WRENCH[1], form, None, 0.0, length) for form in ("wander", "linear")]
    model = Model(bench, nuisances, [bench.add(form) for form in forms], bench.whitened(bench.whole))
    rest = model.rest()[bench.train, 1]
    assert abs(float(rest.mean())) < 4.0 * SIGMA[1] / np.sqrt(len(rest))
    for h, s in zip(model.parts, model.slices(), strict=True):
        if h.effect is not None:
            np.testing.assert_array_equal(model.theta[s], model.final[s])


def touched(bench: DiagnosisBench, *, aside: bool) -> tuple[float, float]:
    """A moment of a second and a half that lies in the middle of one block, set aside or learnt from."""
    time = bench.rows.average(bench.scene.time)
    numbers = [b for b in np.unique(bench.block) if bench.aside[bench.block == b].all() == aside]
    inside = time[bench.block == numbers[len(numbers) // 2]]
    middle = float(inside.mean())
    return middle - 0.75, middle + 0.75


def test_a_touch_in_a_block_left_out_decides_nothing_between_models_that_have_it() -> None:
    """It cannot be foretold from the others: what then stands there had been the larger part of both models' errors."""
    case = Bench(5, rows=4000)
    work = diagnose(scene_of(case.observations()))
    bench = work.bench
    start, end = touched(bench, aside=False)
    time = bench.rows.average(bench.scene.time)
    during = (time >= start) & (time <= end)
    y = bench.whole + 20.0 * SIGMA[0] * (during[:, None] & (np.arange(6) == 0))
    model = [*(bench.made(None, c) for c in bench.constants()), bench.add(Contact(WRENCH[:1], ((start, end),)))]
    white, before = bench.whitened(y), bench.y
    bench.y = y
    try:
        left = left_out(bench, model, white)
        without = left_out(bench, model[:-1], white)
    finally:
        bench.y = before
    assert left[0] < 1.1 * SIGMA[0] ** 2
    assert without[0] > 1.5 * SIGMA[0] ** 2


def test_a_touch_that_is_not_learnt_from_costs_nothing() -> None:
    """Two touches of which one lies in rows set aside owe for the other alone: it had been left out, and spoilt what judges."""
    case = Bench(5, rows=4000)
    bench = diagnose(scene_of(case.observations())).bench
    seen, hidden = (touched(bench, aside=aside) for aside in (False, True))
    contacts = [Contact(WRENCH[:2], tuple(sorted(episodes))) for episodes in ((seen,), (seen, hidden))]
    scorer = Scorer(bench, [bench.add(contact) for contact in contacts])
    first = len(scorer.base)
    one, both = (scorer.scores([], [first + k])[0][first + k] for k in range(2))
    each = np.log(bench.noise.effective)
    assert both.rank - both.gain == pytest.approx(one.rank - one.gain, abs=0.5 * each)
    assert one.gain - one.rank > 3.5 * each


def test_readings_that_clip_at_both_ends_are_limits_and_no_touch() -> None:
    """In the same episodes a level and a bow each do about what both limits do together."""
    case = Bench(6, rows=4000)
    limit = 0.6 * float(np.abs(case.wrench[:, 1]).max())
    case.wrench[:, 1] = np.clip(case.wrench[:, 1] + case.noise[:, 1], -limit, limit) - case.noise[:, 1]
    work = diagnose(scene_of(case.observations()))
    assert [f.effect for f in work.diagnosis.findings] == ["saturation"]
    told = sorted(h.effect.limit for h in work.model.effects if isinstance(h.effect, Saturation))
    np.testing.assert_allclose(told, [-limit, limit], atol=1e-6)
    said = work.diagnosis.findings[0].parameters
    assert said[f"{WRENCH[1]} low: limit"].value == pytest.approx(-limit, abs=1e-6)
    assert said[f"{WRENCH[1]} high: limit"].value == pytest.approx(limit, abs=1e-6)


@pytest.mark.parametrize(("level", "event"), [(3.0, False), (8.0, True)])
def test_a_touch_below_what_physics_leaves_is_a_part_of_that(level: float, event: bool) -> None:
    """What hardly stands out, while it lasts, from what has no name besides is not an event that anybody could vouch for."""
    case = Bench(7, rows=4000)
    work = diagnose(scene_of(case.observations()))
    bench = work.bench
    touch = bench.add(Contact(WRENCH[:1], ((50.0, 60.0),)))
    y = bench.whole + level * SIGMA[0] * touch.raw.values[:, 0, :1] * (np.arange(6) == 0)
    bench.whole, bench.y = y, y
    model = Model(bench, work.model.nuisances, [touch], bench.whitened(y))
    more = replace(work.judged, after=work.judged.floor + 4.0 * SIGMA**2)
    assert slight(model, more, []) == []
    rest = beyond(more, model)
    assert slight(model, work.judged, rest) == []
    assert slight(model, more, rest) == ([] if event else [touch])

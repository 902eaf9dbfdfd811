"""Laws with more in them than one constant: one name for all of it, and none beside it for what the plain law misses."""

import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parent))

from diagnosis_cases import Array, Bench, lagged, sines

from galen_hw.diagnosis.pipeline import diagnose
from galen_hw.physics.effects.creep import Creep
from galen_hw.physics.effects.drift import Drift, Temperature
from galen_hw.physics.effects.registry import scene_of
from galen_hw.physics.operators.filters import lag


def in_a_room(seed: int, rows: int, rate: float) -> tuple[Bench, Array]:
    """A run beside a thermometer, and what that reads (N,), deg C: a few kelvin up and down within minutes."""
    run = Bench(seed, rows=rows, rate=rate)
    room = 25.0 + sines(run.rng, run.t, 3.0, 0.004, 0.02)
    run.columns["temperature.sensor"] = room
    return run, room


@pytest.mark.inject
def test_what_settles_in_several_times_is_one_creep() -> None:
    """A second, four and sixteen, four times the noise: a drift and a jump had stood beside a creep of one constant."""
    runs = []
    for seed in (1, 2):
        run = Bench(seed, rows=4000, rate=40.0)
        load = run.wrench.copy()
        run.wrench += sum(0.04 / 3.0 * lagged(run.t, load, T) for T in (1.0, 4.0, 16.0))
        runs.append(scene_of(run.observations()))
    work = diagnose(runs[0], holdout=runs[1])
    assert [f.effect for f in work.diagnosis.findings] == ["creep"]
    assert work.diagnosis.verdict == "explained"
    told = work.diagnosis.findings[0].parameters
    assert told["share"].value == pytest.approx(0.04, rel=0.1)
    assert told["constant"].value == pytest.approx(4.0, rel=0.3)
    assert told["spread"].value == pytest.approx(5.0, rel=0.5)


def test_two_warm_ups_are_one_drift() -> None:
    """A quick one and a slow one of the same zero, nine times the noise: a jump had stood for the quick one."""
    run = Bench(1, rows=4000, rate=40.0)
    run.wrench[:, 2] += 0.6 * (1.0 - np.exp(-run.t / 8.0)) + 0.4 * (1.0 - np.exp(-run.t / 60.0))
    work = diagnose(scene_of(run.observations()))
    assert [f.effect for f in work.diagnosis.findings] == ["drift"]
    told = work.diagnosis.findings[0].parameters
    constants = sorted(told[name].value for name in ("constant", "second"))
    assert constants[0] == pytest.approx(8.0, rel=0.15)
    assert constants[1] == pytest.approx(60.0, rel=0.4)


def test_a_body_that_warms_after_its_thermometer_follows_the_temperature() -> None:
    """By half a minute: as large as the noise it had been a drift of unknown cause, though the cause was recorded."""
    runs = []
    for seed in (1, 2):
        run, room = in_a_room(seed, 3000, 20.0)
        body = lagged(run.t, room, 25.0)
        run.wrench[:, [0, 2]] += (body - body[0])[:, None] * np.array([0.005, 0.01])
        runs.append(scene_of(run.observations()))
    work = diagnose(runs[0], holdout=runs[1])
    assert [f.effect for f in work.diagnosis.findings] == ["temperature"]
    told = work.diagnosis.findings[0].parameters
    assert told["coefficient_wrench.force.z"].value == pytest.approx(0.01, rel=0.1)
    assert told["constant"].value == pytest.approx(25.0, rel=0.2)
    assert told["constant"].unit == "s"


def test_a_sensitivity_that_warms_is_said_to_follow_the_temperature() -> None:
    """Its zero stands still; what its scale leaves is too slow for noise and motion alike, and had passed for noise."""
    rooms = [in_a_room(seed, 4000, 40.0) for seed in (1, 2)]
    cold = rooms[0][1][0]
    for run, room in rooms:
        run.wrench *= 1.0 + 0.004 * (room - cold)[:, None]
    runs = [scene_of(run.observations()) for run, _ in rooms]
    work = diagnose(runs[0], holdout=runs[1])
    assert work.diagnosis.verdict == "explained"
    (found,) = work.diagnosis.findings
    assert found.effect == "temperature"
    assert {"wrench.torque.x", "wrench.torque.y"} <= set(found.channels)
    spans = [
        float(work.model.final[s][1]) for h, s in zip(work.model.parts, work.model.slices(), strict=True) if h.effect
    ]
    assert spans == pytest.approx([0.004] * len(spans), rel=0.2)


def test_richer_forms_hold_the_plain_ones() -> None:
    """Of a spread near 1 a creep is that of its one constant; a second warm-up adds a column; at once is no lag."""
    run = Bench(3, rows=600)
    run.columns["temperature.sensor"] = 20.0 + run.q[:, 3]
    scene = scene_of(run.observations())
    plain, wide = (Creep(5.0, spread=spread).columns(scene).values for spread in (None, 1.0))
    np.testing.assert_allclose(wide, plain, atol=1e-12)
    narrow = Creep(5.0, spread=1.05).columns(scene).values
    assert np.max(np.abs(narrow - plain)) < 0.01 * np.max(np.abs(plain))
    both = Drift("wrench.force.x", "warm_up", 3.0, 0.0, 30.0, second=20.0).shapes(scene.time)
    np.testing.assert_allclose(both, 1.0 - np.exp(-scene.time[:, None] / np.array([3.0, 20.0])), atol=1e-12)
    late = Temperature("wrench.force.x", "temperature.sensor", 20.0, constant=4.0).warmth(scene)
    np.testing.assert_allclose(late, lag(scene.time, run.q[:, [3]], np.array([4.0]), None)[0][:, 0], atol=1e-12)

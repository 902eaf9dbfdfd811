"""What the search would miss: effects that hide each other, what faintly stands off its neighbours, and tangents left behind."""

import sys
from pathlib import Path

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter1d
from scipy.signal import sawtooth

sys.path.insert(0, str(Path(__file__).parent))

from diagnosis_cases import SIGMA, WRENCH, Bench, hanging, rotation
from test_tendons import pulled

from galen_hw.diagnosis.detection import outliers
from galen_hw.diagnosis.estimation.linearisation import tangent
from galen_hw.diagnosis.pipeline import diagnose
from galen_hw.diagnosis.selection.moves import swap
from galen_hw.diagnosis.selection.moves.pairs import hidden
from galen_hw.diagnosis.work import Work
from galen_hw.physics.effects.base import Effect
from galen_hw.physics.effects.cable import CableDrag
from galen_hw.physics.effects.geometry import JointOffset
from galen_hw.physics.effects.load import BaseTilt
from galen_hw.physics.effects.registry import scene_of


def diagnosed(bench: Bench) -> Work:
    return diagnose(scene_of(bench.observations()))


def place(work: Work, effect: Effect) -> int:
    return next(i for i, h in enumerate(work.selection.scorer.library) if h.effect == effect)


@pytest.mark.inject
def test_two_that_hide_each_other_are_found_together() -> None:
    """A joint that rises slowly and falls back quickly: late, it is behind by nearly a constant."""
    bench, late = Bench(6, rows=4000, rate=50.0), 0.3
    bench.q[:, 3] = gaussian_filter1d(0.5 * sawtooth(2.0 * np.pi * bench.t / 9.0, 0.92), 6)
    roll, tilt = (np.interp(bench.t - late, bench.t, bench.q[:, i]) for i in (3, 4))
    bench.wrench = hanging(rotation(roll + 0.036, tilt))
    found = {f.effect: f for f in diagnosed(bench).diagnosis.findings}
    assert set(found) == {"time_delay", "joint_offset"}
    assert found["time_delay"].parameters["delay"].value == pytest.approx(late, rel=0.02)


def test_of_nothing_no_two_are_made() -> None:
    work = diagnosed(Bench(6, rows=2000))
    work.selection.chosen = []
    work.selection.turn.able = [place(work, JointOffset("tilt")), place(work, BaseTilt("y"))]
    assert not hidden(work.selection)
    assert not work.selection.chosen


@pytest.mark.inject
def test_where_a_cable_stood_before_it_was_settled_is_no_rival_of_it() -> None:
    """Its tangent there foretells anything, beside what it was found with and is gone; the cable itself does not."""
    bench = Bench(rows=3000)
    pulled(bench, 4.0, 0.2)
    work = diagnosed(bench)
    selection, scorer = work.selection, work.selection.scorer
    (i,) = [i for i in selection.chosen if isinstance(scorer.library[i].effect, CableDrag)]
    h = scorer.library[i]
    assert h.theta is not None
    rng = np.random.default_rng(1)
    off = [h.theta * (1.0 + 0.1 * rng.normal(size=8)) for _ in range(30)]
    scorer.append([tangent(work.bench, h, theta) for theta in off])
    assert not swap.swapped(selection)
    assert selection.chosen == [i]


def coarse(size: float) -> Bench:
    """Rounded to steps of nearly two and a half standard deviations, thirty samples thrown by `size` of these."""
    bench = Bench(12, rows=6000, rate=50.0)
    if size:
        rows = np.random.default_rng(4).choice(np.arange(20, 5980, 40), 30, replace=False)
        bench.noise[rows, 1] += np.random.default_rng(5).choice([-size, size], 30) * SIGMA[1]
    step = 2.4 * SIGMA
    bench.noise = np.round((bench.wrench + bench.noise) / step) * step - bench.wrench
    return bench


@pytest.mark.inject
@pytest.mark.parametrize(("size", "told"), [(10.0, ["glitches"]), (0.0, [])])
def test_spoilt_samples_stand_off_the_model_where_their_neighbours_hide_them(size: float, told: list[str]) -> None:
    bench = coarse(size)
    work = diagnosed(bench)
    assert [f.effect for f in work.diagnosis.findings] == told
    if told:
        assert work.diagnosis.findings[0].channels == [WRENCH[1]]
        assert 20 <= work.diagnosis.findings[0].parameters["count"].value <= 30


@pytest.mark.inject
def test_what_a_model_shows_to_be_spoilt_is_isolated() -> None:
    """Three in a row at most and nothing beside them: a hump of a fifth of a second is none."""
    bench = Bench(12, rows=3000, rate=50.0)
    assert outliers.faint(diagnosed(bench).model) is None
    work = diagnosed(Bench(12, rows=3000, rate=50.0))
    bench.wrench[[500, 1600, 1601], 0] += 9.0 * SIGMA[0]
    bench.wrench[2000:2010, 0] += 9.0 * SIGMA[0]
    work.model.bench.scene = scene_of(bench.observations())
    found = outliers.faint(work.model)
    assert found is not None
    assert np.flatnonzero(found.any(axis=1)).tolist() == [500, 1600, 1601]


def test_where_the_signal_turns_quickly_half_a_sample_is_no_spoilt_one() -> None:
    """A tool that is swung round in two samples, and half a sample late on the way: one reading is far off what is simulated."""
    bench = Bench(12, rows=3000, rate=50.0)
    work = diagnosed(bench)
    bench.q[:, 4] += 0.3 * np.clip((np.arange(3000) - 1499.0) / 2.0, 0.0, 1.0)
    bench.wrench = hanging(rotation(bench.q[:, 3], bench.q[:, 4]))
    swung = bench.wrench.copy()
    bench.wrench[1500] += 0.2 * (bench.wrench[1501] - bench.wrench[1499])
    bench.wrench[700] += 0.2 * (swung[1501] - swung[1499])
    work.model.bench.scene = scene_of(bench.observations())
    found = outliers.faint(work.model)
    off = np.abs(outliers.off(work.model)) > 6.0 * work.model.bench.noise.sigma
    assert off[[700, 1500]].any(axis=1).all()
    assert found is None  # the other is one alone, and one is no finding
    bench.wrench[900] = bench.wrench[900] + bench.wrench[700] - swung[700]
    work.model.bench.scene = scene_of(bench.observations())
    found = outliers.faint(work.model)
    assert found is not None
    assert np.flatnonzero(found.any(axis=1)).tolist() == [700, 900]

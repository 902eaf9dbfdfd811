"""What the search would miss: effects that hide each other, and tangents left behind."""

import sys
from pathlib import Path

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter1d
from scipy.signal import sawtooth

sys.path.insert(0, str(Path(__file__).parent))

from diagnosis_cases import Bench, hanging, rotation
from test_tendons import pulled

from galen_hw.diagnosis.estimation.linearisation import tangent
from galen_hw.diagnosis.pipeline import diagnose
from galen_hw.diagnosis.selection.moves import swap
from galen_hw.diagnosis.selection.moves.add import hidden
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
    work.selection.turn.significant = [place(work, JointOffset("tilt")), place(work, BaseTilt("y"))]
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

"""What comes late and is averaged, at once: the same as delayed row by row and averaged then; what is kept is what it was."""

import itertools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from galen_hw.diagnosis.estimation.dataset import Bench
from galen_hw.diagnosis.estimation.linearisation import contribution
from galen_hw.diagnosis.estimation.normal_equations import Scorer
from galen_hw.diagnosis.selection.proposals import library
from galen_hw.diagnosis.stats.sampling import Rows
from galen_hw.physics.effects.friction import Friction
from galen_hw.physics.effects.registry import scene_of
from galen_hw.physics.effects.timing import Lag, TimeDelay
from galen_hw.physics.operators.filters import delay
from galen_hw.tools.benchmarks.diagnosis import recording


@given(
    st.lists(st.integers(3, 90), min_size=1, max_size=3),
    st.integers(1, 12),
    st.floats(-100.0, 100.0),
    st.booleans(),
    st.booleans(),
)
def test_late_averages_are_averages_of_what_is_late(lengths, stride, late, whole, bowed):
    """Any segments, groups, delays and advances, beyond the ends too."""
    edges, late = np.cumsum([0, *lengths]), float(round(late)) if whole else late
    parts = [slice(int(a), int(b)) for a, b in itertools.pairwise(edges)]
    x = np.random.default_rng(sum(lengths)).normal(size=(int(edges[-1]), 2, 1))
    rows, t = Rows(tuple(parts), stride), 0.01 * np.arange(len(x))
    flat = x[:, :, 0]
    expected = rows.average(np.concatenate([delay(t[p], flat[p], 0.01 * late, None, bowed=bowed)[0] for p in parts]))
    assert np.allclose(rows.late(x, [late for _ in parts], bowed=bowed)[:, :, 0], expected, rtol=0.0, atol=1e-9)


def made(*, even: bool) -> Bench:
    observations = recording(3, 4000)
    if not even:
        observations.columns["time"] += 1e-4 * np.random.default_rng(2).uniform(size=4000)
    out = Bench(scene_of(observations), most=600)
    out.learn_noise(())
    return out


@pytest.fixture(scope="module")
def bench() -> Bench:
    return made(even=True)


@pytest.mark.parametrize("even", [True, False])
@pytest.mark.parametrize("end", [TimeDelay(), TimeDelay("j1")])
def test_a_late_stream_delivers_averages(end: TimeDelay, even: bool) -> None:
    """Of one channel or all, behind a clock of one joint or of all, on an even clock or not, as by delaying every row."""
    bench, late = made(even=even), np.array([0.0037])
    bench.update_state(timing=[(end, late)])
    for effect in (Lag(0.05), Lag(0.05, "j2"), Friction("j1", "coulomb", 0.01), Friction("j0", "coulomb", 0.01)):
        through = end.delivered(bench.scene, effect.columns(bench.scene), late)
        assert np.allclose(bench.raw(effect).values, bench.averaged(through).values, rtol=0.0, atol=1e-12)
    change = bench.rows.average(end.change(bench.scene, late))
    assert np.allclose(contribution(bench, end, late), change, rtol=0.0, atol=1e-12)


def test_what_is_known_is_what_would_be_made(bench: Bench) -> None:
    """Kept columns are used where nothing delivers them otherwise, and go with the noise."""
    effect = Lag(0.05, "j2")
    known = bench.hypothesis(effect)
    bench.cache_columns([known])
    assert bench.hypothesis(effect) is known
    bench.update_state(timing=[(TimeDelay(), np.array([0.0037]))])
    assert bench.hypothesis(effect) is not known
    bench.update_state(timing=[])
    bench.learn_noise(())
    again = bench.hypothesis(effect)
    assert again is not known
    assert np.array_equal(again.raw.values, known.raw.values)


def test_inner_products_are_the_same_however_hypotheses_come(bench: Bench) -> None:
    """All at once, one by one, and after some came for a while only."""
    some = [bench.hypothesis(effect) for effect in library(bench)[:80]]
    at_once, one_by_one = Scorer(bench, some), Scorer(bench, some[:3])
    for h in some[3:]:
        with one_by_one.trying([some[-1], some[-2]]):
            pass
        one_by_one.append([h])
    every = np.arange(len(at_once.products))
    each, whole = one_by_one.products.between(every, every), at_once.products.between(every, every)
    assert np.allclose(each, whole, rtol=1e-9, atol=1e-9 * np.max(whole))
    assert np.allclose(one_by_one.b, at_once.b, rtol=1e-9, atol=1e-9 * np.max(np.abs(at_once.b)))
    at_once.retarget(2.0 * bench.y)
    assert np.allclose(at_once.b, 2.0 * one_by_one.b, rtol=1e-9, atol=1e-9 * np.max(np.abs(at_once.b)))
    scores, none = at_once.scores([])
    same, each = at_once.scores([], surrogates=True)
    assert not len(none)
    assert len(each) == at_once.fakes.shape[1]
    assert all(scores[i].rank == pytest.approx(same[i].rank, rel=1e-9) for i in same)

"""Models as values: what is tried leaves no trace, what is made of a model leaves it as it was."""

from contextlib import nullcontext
from dataclasses import FrozenInstanceError

import numpy as np
import pytest

from galen_hw.diagnosis.estimation.dataset import Bench
from galen_hw.diagnosis.estimation.interactions import settle_together
from galen_hw.diagnosis.estimation.model import Model
from galen_hw.diagnosis.estimation.normal_equations import Scorer
from galen_hw.diagnosis.selection.moves import MOVES
from galen_hw.diagnosis.selection.search_state import Selection
from galen_hw.physics.effects.sensor import Gain
from galen_hw.physics.effects.timing import TimeDelay
from tests import diagnosis_parts as parts


@pytest.fixture
def bench() -> Bench:
    """Every channel late by 30 ms, its noise learnt beside a delay."""
    made = Bench(parts.recorded(scene := parts.nominal(rows=600), scene.simulated))
    made.learn_noise([made.raw(TimeDelay())])
    return made


def test_an_attempt_that_is_not_kept_leaves_no_trace(bench: Bench) -> None:
    """Terms, residual, stream and clocks are those from before, also where it ended in an error."""
    late, gain = bench.hypothesis(TimeDelay()), bench.hypothesis(Gain(bench.scene.channels[0]))
    scorer = Scorer(bench, [late, gain])
    out, first = Selection(scorer, [len(scorer.base) + 1]), len(scorer.base)
    scorer.retarget(bench.y)
    before, b = bench.state, scorer.b.copy()
    for end in (nullcontext(), pytest.raises(ZeroDivisionError)):
        with end, out.attempt():
            out.chosen = [first]
            settle_together(bench, scorer, out.chosen)
            bench.update_state(timing=[(TimeDelay(), np.array([0.03]))], y=bench.y + 1.0)
            scorer.retarget(bench.y)
            assert isinstance(end, nullcontext) or 1 // 0
        assert bench.state is before
        assert out.chosen == [first + 1]
        assert np.allclose(scorer.b[: len(b)], b, rtol=1e-12, atol=0.0)


def test_an_attempt_that_is_kept_stays(bench: Bench) -> None:
    scorer = Scorer(bench, [bench.hypothesis(TimeDelay())])
    out, first = Selection(scorer), len(scorer.base)
    with out.attempt() as attempt:
        out.chosen = [first]
        bench.update_state(diverging=True)
        attempt.kept = True
    assert out.chosen == [first]
    assert bench.state.diverging


def test_columns_go_through_other_clocks_for_a_while_only(bench: Bench) -> None:
    plain = bench.raw(gain := Gain(bench.scene.channels[0])).values
    with bench.delivering([(TimeDelay(), np.array([0.2]))]):
        assert not np.allclose(bench.raw(gain).values, plain)
    assert np.array_equal(bench.raw(gain).values, plain)


def test_other_models_are_made_of_one_and_it_stays(bench: Bench) -> None:
    gains = [bench.hypothesis(Gain(name)) for name in bench.scene.channels[:3]]
    nuisances = [bench.hypothesis_of(None, columns) for columns in bench.constants()]
    model = Model(bench, nuisances, gains[:1], bench.whitened(bench.whole))
    final = model.final.copy()
    assert model.replacing(gains[0], gains[2]).effects == [gains[2]]
    assert model.without(gains[:1]).effects == []
    assert model.effects == gains[:1]
    assert np.array_equal(model.final, final)
    with pytest.raises(FrozenInstanceError):
        model.unweighted = True  # type: ignore[misc]
    with pytest.raises(FrozenInstanceError):
        bench.state.y = bench.whole  # type: ignore[misc]


def test_the_table_of_moves_has_every_kind_and_adds_before_it_exchanges() -> None:
    kinds = [move.kind for move in MOVES]
    assert set(kinds) == {"add", "drop", "swap", "exchange", "refine", "timing"}
    assert kinds[0] == "add"
    assert [move.kind for move in MOVES if move.tidies] == ["drop", "swap", "refine"]

"""Two searches, and held-out data that say which of them holds."""

import sys
from copy import copy
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parent))

from diagnosis_cases import SIGMA, WRENCH, Bench

from galen_hw.diagnosis.estimation.dataset import Bench as DiagnosisBench
from galen_hw.diagnosis.estimation.model import Model
from galen_hw.diagnosis.estimation.normal_equations import Scorer
from galen_hw.diagnosis.pipeline import diagnose
from galen_hw.diagnosis.searching import Search, _better, pruned
from galen_hw.diagnosis.selection.acceptance import plausible
from galen_hw.diagnosis.selection.search import settled
from galen_hw.diagnosis.selection.search_state import Selection
from galen_hw.diagnosis.stats.criteria import CRITERIA
from galen_hw.physics.effects.base import Effect
from galen_hw.physics.effects.drift import Drift
from galen_hw.physics.effects.registry import scene_of
from galen_hw.physics.effects.sensor import Bias, Gain


@pytest.fixture(scope="module")
def warming() -> DiagnosisBench:
    """A sensor that drifts by three times its noise."""
    case = Bench(7)
    case.wrench[:, 2] += 3.0 * SIGMA[2] * case.t / case.t[-1]
    return diagnose(scene_of(case.observations())).bench


def search(bench: DiagnosisBench, *effects: Effect) -> Search:
    """One that ended with these."""
    own = copy(bench)
    scorer = Scorer(own, [own.hypothesis(effect) for effect in effects])
    chosen = scorer.library[len(scorer.base) :]
    return Selection(scorer), Model(own, list(scorer.base), chosen, own.whitened(own.whole))


def test_where_a_name_is_refused_the_other_search_is_asked(warming: DiagnosisBench) -> None:
    """A gain of what does not read wrong holds on no block that was set aside; the drift does."""
    drift = Drift(WRENCH[2], "linear", None, 0.0, float(warming.scene.time[-1]))
    wrong, right = search(warming, Gain(WRENCH[0])), search(warming, drift)
    selection, chosen, model, judged = pruned([wrong, right], None, nothing=False)
    assert selection is right[0]
    assert chosen is wrong[1]
    assert [h.effect for h in model.effects] == [drift]
    assert model.bench is selection.bench
    assert judged.after[2] < judged.before[2]


def test_what_holds_is_kept_and_what_is_no_better_does_not_take_its_place(warming: DiagnosisBench) -> None:
    """The better model stays as long as no name of it is refused, and where the other has nothing that holds either."""
    drift = Drift(WRENCH[2], "linear", None, 0.0, float(warming.scene.time[-1]))
    right, wrong = search(warming, drift), search(warming, Gain(WRENCH[0]))
    assert pruned([right, wrong], None, nothing=False)[0] is right[0]
    other = search(warming, Gain(WRENCH[4]))
    selection, chosen, model, _ = pruned([wrong, other], None, nothing=False)
    assert selection is wrong[0]
    assert model is not chosen
    assert not model.effects


def test_an_offset_that_stands_at_the_end_meets_what_explains_more() -> None:
    """A constant that was always fitted was never asked beside a drift of the same channel."""
    case = Bench(7)
    case.belief["bias_free"] = False
    case.wrench[:, 2] += 3.0 * SIGMA[2] * case.t / case.t[-1]
    bench = diagnose(scene_of(case.observations())).bench
    offset, drift = Bias(WRENCH[2]), Drift(WRENCH[2], "linear", None, 0.0, float(case.t[-1]))
    kept = {}
    for rivals in (False, True):
        own = copy(bench)
        own.reset()
        scorer = Scorer(own, [own.hypothesis(offset), own.hypothesis(drift)], free=False)
        stands = settled(scorer, [(offset, np.array([SIGMA[2]]))], 10.0, rivals=rivals)
        kept[rivals] = [h.effect for h in stands.hypotheses]
    assert kept == {False: [offset], True: [drift]}


@pytest.mark.parametrize(
    ("lead", "fewer", "taken"),
    [
        (0.9, 0, True),
        (-0.9, 0, False),
        (0.9, -1, True),
        (-0.9, -1, True),
        (-1.1, -1, False),
        (0.9, 1, False),
        (1.1, 1, True),
    ],
)
def test_of_equal_models_that_with_fewer_effects_is_taken(
    warming: DiagnosisBench, monkeypatch: pytest.MonkeyPatch, lead: float, fewer: int, *, taken: bool
) -> None:
    """Whichever search found it: a weight stands for a constant and a scale that explain hardly more."""
    one = search(warming, Gain(WRENCH[0]), Gain(WRENCH[1]))
    other = search(warming, *(Gain(name) for name in WRENCH[: 2 + fewer]))
    gains = {id(one[1]): 0.0, id(other[1]): lead * CRITERIA.log_odds}
    monkeypatch.setattr(Model, "penalised_gain", lambda model: gains[id(model)])
    assert (_better(one, other) is other) is taken


def test_two_that_cancel_but_for_a_small_part_are_not_real_side_by_side(warming: DiagnosisBench) -> None:
    """A line up and nearly the same line down leave a bow: what bends so may be there, the two are not."""
    end = float(warming.scene.time[-1])
    line, bow = (Drift(WRENCH[2], *form, 0.0, end) for form in (("linear", None), ("warm_up", 5.0 * end)))
    own = copy(warming)
    scorer = Scorer(own, [own.hypothesis(line), own.hypothesis(bow), own.hypothesis(Gain(WRENCH[2]))])
    first = len(scorer.base)
    shapes = [h.raw.values[:, 0, 0] for h in scorer.library[first:]]

    def made(*sizes: float) -> np.ndarray:
        y = np.zeros_like(own.y)
        y[:, 2] = SIGMA[2] * sum(size * x / np.std(x) for size, x in zip(sizes, shapes, strict=True))
        return y

    with scorer.against(made(100.0, -100.0, 0.0)):
        assert not plausible(own, scorer, [first], first + 1)
    with scorer.against(made(3.0, 0.0, -3.0)):
        assert plausible(own, scorer, [first], first + 2)

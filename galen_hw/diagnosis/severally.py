"""Clocks joint by joint: servos answer one by one, and each with a delay or a lag of its own."""

import numpy as np

from galen_hw.diagnosis.bench import Bench, Hypothesis
from galen_hw.diagnosis.linear import crossed
from galen_hw.diagnosis.nonlinear import bent, polished, settle
from galen_hw.diagnosis.score import Scorer
from galen_hw.diagnosis.selection import Selection
from galen_hw.diagnosis.worth import taken
from galen_hw.physics.time_effects import Lag, TimeDelay, Timing
from galen_hw.spatial import Array

MARGIN = 6.0
"""Beyond the price of the parameters, in units of the log likelihood ratio."""
RICHER = 0.05
"""Share of the excess that is left in some channel, on blocks left out, that clocks of their own must take."""


def severally(bench: Bench, scorer: Scorer, out: Selection) -> bool:
    """Whether the delays and lags of a model were exchanged, all at once, for the best of each joint's own.

    The search takes one clock for all first, and a correction of one joint's next. Where joints lag by different constants
    that is wrong in every joint, and no single exchange makes it better.
    """
    clocks = [i for i in out.chosen if isinstance(scorer.library[i].effect, Timing)]
    proposed = [e for kind in (TimeDelay, Lag) for e in kind.propose(bench.scene) if e.joint]
    if not clocks or not proposed:
        return False
    before, y, errors = scorer.solve(out.chosen)[2], bench.y, crossed(bench, scorer, out.chosen)
    others = [i for i in out.chosen if i not in clocks]
    bench.y = y + sum((b for i in clocks if (b := scorer.library[i].bend) is not None), np.zeros_like(y))
    scorer.retarget(bench.y)
    own = _own(bench, scorer, others, proposed)
    scorer.append(own)
    trial = [*others, *range(len(scorer.library) - len(own), len(scorer.library))]
    settle(bench, scorer, trial)
    # Each has one parameter: a lag its constant.
    price = (len(own) - len(clocks)) * float(np.log(bench.noise.effective))
    fall = before - scorer.solve(trial)[2] - price
    if fall > MARGIN and _richer(bench, errors, crossed(bench, scorer, trial)):
        out.chosen = trial
        return True
    bench.y = y
    scorer.retarget(y)
    return False


def _own(bench: Bench, scorer: Scorer, others: list[int], proposed: list[TimeDelay | Lag]) -> list[Hypothesis]:
    """The best clock of each joint beside other effects, as if the stream had none."""
    before = bench.timing
    bench.timing = [(end, theta) for end, theta in before if not isinstance(end, Timing)]
    try:
        with scorer.trying([bench.add(effect) for effect in proposed]):
            places: dict[str, list[int]] = {}
            for i, effect in enumerate(proposed, len(scorer.library) - len(proposed)):
                places.setdefault(effect.joint, []).append(i)
            found = list[int]()
            for mine in places.values():
                found += _clock_of(bench, scorer, [*others, *found], mine)
            return [scorer.library[i] for i in found]
    finally:
        bench.timing = before


def _clock_of(bench: Bench, scorer: Scorer, others: list[int], places: list[int]) -> list[int]:
    """The best of none, a delay, a lag, and both in one joint beside other effects."""
    first = scorer.scores(others, places)[0]
    delays = [i for i in first if isinstance(scorer.library[i].effect, TimeDelay)]
    ways: list[tuple[float, list[int]]] = [(0.0, [])]
    ways += [(bent(bench, scorer, others, i, first[i]).rank, [i]) for i in delays]
    best = max((i for i in first if i not in delays), key=lambda i: first[i].rank, default=None)
    if best is not None:
        lag = polished(bench, scorer, others, best)
        rank = scorer.scores(others, [lag])[0][lag].rank
        beside = scorer.scores([*others, lag], delays)[0]
        ways.append((rank, [lag]))
        ways += [(rank + bent(bench, scorer, [*others, lag], i, s).rank - MARGIN, [lag, i]) for i, s in beside.items()]
    return max(ways)[1]


def _richer(bench: Bench, before: Array, after: Array) -> bool:
    """Whether errors (C,) on blocks left out fall, by enough of the excess in some channel."""
    most = float(np.max(taken(before, after, bench.noise.sigma**2)))
    return most >= RICHER and float(np.mean(after / before)) < 1.0

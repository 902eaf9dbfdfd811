"""The state of a search: the chosen model and how it was found."""

from collections import Counter
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field

import numpy as np

from galen_hw.diagnosis.estimation.candidate import Hypothesis, place_of
from galen_hw.diagnosis.estimation.dataset import Bench
from galen_hw.diagnosis.estimation.normal_equations import Score, Scorer
from galen_hw.physics.effects.base import Effect
from galen_hw.spatial import Array


@dataclass
class Turn:
    """What one turn of a search has found.

    Args:
        scores: of all hypotheses given the model as the turn began.
        significant: hypotheses that chance does not explain, best first.
        failed: hypotheses that were refused in this turn.
        swapped: whether the last swaps changed anything.
    """

    scores: dict[int, Score] = field(default_factory=dict)
    significant: list[int] = field(default_factory=list)
    failed: set[int] = field(default_factory=set)
    swapped: bool = False


@dataclass
class Attempt:
    """A trial model; `kept`: it replaces the present one."""

    kept: bool = False


@dataclass
class Selection:
    """The chosen model and how it came about.

    Args:
        chosen: numbers in the scorer's library.
        evidence: score of each given all others.
        first: score of every hypothesis before any was chosen, best of its family.
        needed: surprise that chance reaches.
        refused: significant effects that were not accepted, with their share of the excess.
        clocked: how often all timing effects of a model, by the families of its effects, were tested at once.
        tightened: models whose spring was already compared with a tendon.
        regrouped: models of which two effects were already compared with others in their place.
        enriched: identities of effects of which the best was brought to its optimum as a richer form.
        initial_errors: (n, C) squared cross-validated errors of the training rows before anything was chosen.
    """

    scorer: Scorer
    chosen: list[int] = field(default_factory=list)
    evidence: dict[int, Score] = field(default_factory=dict)
    first: dict[int, Score] = field(default_factory=dict)
    needed: float = 0.0
    refused: list[tuple[Effect, float]] = field(default_factory=list)
    clocked: Counter[frozenset[object]] = field(default_factory=Counter)
    tightened: set[frozenset[object]] = field(default_factory=set)
    regrouped: set[frozenset[object]] = field(default_factory=set)
    enriched: set[object] = field(default_factory=set)
    initial_errors: Array = field(default_factory=lambda: np.empty((0, 0)))
    turn: Turn = field(default_factory=Turn)

    @property
    def bench(self) -> Bench:
        """Bench of the scorer."""
        return self.scorer.bench

    @contextmanager
    def attempt(self) -> Iterator["Attempt"]:
        """Try another model while the context lasts, and restore the present one unless the attempt is kept."""
        bench, chosen, before, one = self.scorer.bench, list(self.chosen), self.scorer.bench.state, Attempt()
        try:
            yield one
        finally:
            if not one.kept:
                moved, self.chosen, bench.state = self.chosen != chosen, chosen, before
                if moved:
                    self.scorer.retarget(before.y)

    @property
    def initial_mean_square(self) -> Array:
        """Cross-validated mean squared error (C,) before anything was chosen."""
        return np.asarray(self.initial_errors.mean(axis=0))

    @property
    def families(self) -> frozenset[object]:
        """Families of the chosen effects."""
        return frozenset(h.family for h in self.hypotheses)

    @property
    def hypotheses(self) -> list[Hypothesis]:
        """Chosen hypotheses."""
        return [self.scorer.library[i] for i in self.chosen]


def elsewhere(scorer: Scorer, model: Iterable[int], candidates: Iterable[int]) -> list[int]:
    """Return the candidates, in their order, whose place is free in the model."""
    taken = {place_of(scorer.library[i].effect) for i in model}
    return [j for j in candidates if place_of(scorer.library[j].effect) not in taken]

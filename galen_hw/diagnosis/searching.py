"""The searches under one noise model, and the pruning of their models by held-out data."""

from collections.abc import Iterable
from copy import copy

import numpy as np
from joblib import Parallel, delayed

from galen_hw.diagnosis.estimation.candidate import Hypothesis
from galen_hw.diagnosis.estimation.dataset import Bench
from galen_hw.diagnosis.estimation.model import Model
from galen_hw.diagnosis.estimation.normal_equations import Scorer
from galen_hw.diagnosis.lack_of_fit import structure_test
from galen_hw.diagnosis.selection.finalise import offsets, settle_model, weighed
from galen_hw.diagnosis.selection.search import Start, select, settled
from galen_hw.diagnosis.selection.search_state import Selection
from galen_hw.diagnosis.stats.criteria import CRITERIA
from galen_hw.diagnosis.validation.flexible_effects import remaining_structures
from galen_hw.diagnosis.validation.holdout import backward_eliminated
from galen_hw.diagnosis.validation.judgement import Judged
from galen_hw.physics.effects.base import Effect
from galen_hw.physics.effects.columns import Columns
from galen_hw.physics.scenes.base import Scene

Search = tuple[Selection, Model]
"""How a model was found, and the model."""


def searched(
    bench: Bench,
    effects: list[Effect],
    columns: list[Columns],
    generic: list[structure_test.Family],
    *,
    blind: bool,
    start: Start = (),
) -> tuple[list[Search], list[structure_test.Structure]]:
    """Search under the present noise; return the models, the better one first, and the structure that it leaves.

    Args:
        start: a model that another search has found; where it is better than what was found without it, one begins there too.
    """
    # Creep that began at rest is redundant where any initial transient as quick is fitted.
    each = zip(effects, columns, strict=True)
    hypotheses = [bench.hypothesis_of(e, raw) for e, raw in each if not e.presumes(bench.scene)]
    bench.cache_columns(hypotheses)
    searches = _models(bench, hypotheses, blind=blind, start=start)
    # Of what a check has refused no structure is the machine's.
    return searches, [] if blind else remaining_structures([searches[0][1]], generic)[0]


def _models(bench: Bench, hypotheses: list[Hypothesis], *, blind: bool, start: Start) -> list[Search]:
    """Search once or twice, and return the better model first; of two each has a bench of its own.

    Once with offsets always in the model and judged at the end (so that a drift is not called an offset), once with offsets among
    the hypotheses (so that a constant error of geometry is not). Offsets that remain are compared with what explains more in
    their place. Where a start explains all and the better model does not, one more search begins there.
    """
    if blind:
        nothing = Selection(Scorer(bench, hypotheses))
        return [(nothing, settle_model(bench, nothing.scorer, nothing))]

    def scored(on: Bench, own: list[Hypothesis]) -> Scorer:
        return Scorer(on, [*own, *hypotheses], free=not own)

    def one(on: Bench, own: list[Hypothesis], begun: Start = ()) -> Search:
        selection = select(on, scored(on, own), start=begun)
        return selection, settle_model(on, selection.scorer, selection)

    def better_from(found: Search, own: list[Hypothesis]) -> Search:
        """Return what a search finds from the start, if the start is better than what was found; else that."""
        if bench.deadline.passed():
            return found
        constants = set() if own else _families(h.effect for h in offsets(bench))
        begun = [(effect, theta) for effect, theta in start if effect.family not in constants]
        if not begun or _families(effect for effect, _ in begun) == _families(h.effect for h in found[1].effects):
            return found
        on = copy(fresh)
        stands = settled(scored(on, own), begun, found[0].needed)
        if not _explains(settle_model(on, stands.scorer, stands), found[1]):
            return found
        again = one(copy(fresh), own, begun)
        return again if _explains(again[1], found[1]) else found

    def exchanged(found: Search) -> Search:
        """Return the model with what explains more than constants in their place; always fitted, these met no rivals."""
        if not (
            found[0].scorer.free and _families(h.effect for h in own) & _families(h.effect for h in found[1].effects)
        ):
            return found
        on = copy(fresh)
        stands = settled(scored(on, own), found[1].placed(), found[0].needed, rivals=True)
        return _better(found, (stands, settle_model(on, stands.scorer, stands)))

    own, fresh = offsets(bench), copy(bench)
    if not own:
        return [better_from(one(bench, own), own)]
    # Each has its own model state, and a core if there are two.
    better, other = Parallel(n_jobs=2, require="sharedmem")(
        delayed(one)(*each) for each in ((copy(bench), []), (copy(bench), own))
    )
    if _better(better, other) is other:
        better, other = other, better
    return [exchanged(better_from(better, [] if better[0].scorer.free else own)), other]


def _better(one: Search, other: Search) -> Search:
    """Return the better of two models, of equally good ones that with fewer effects; else the first."""
    fewer = len(other[1].effects) - len(one[1].effects)
    needed = CRITERIA.log_odds if fewer > 0 else 0.0 if fewer == 0 else -CRITERIA.log_odds
    return other if other[1].penalised_gain() - one[1].penalised_gain() > needed else one


def _explains(model: Model, other: Model) -> bool:
    """Return whether a model is better than another, leaves noise alone in every channel and has no more kinds of effects.

    Where physics is missing, as on most machines, a better likelihood is the missing physics' as soon as the model's.
    """
    kinds, its = ({h.effect.KEY for h in one.effects if h.effect is not None} for one in (model, other))
    square = np.mean((model.residual()[model.bench.train] / model.bench.noise.sigma) ** 2, axis=0)
    alone = bool(np.all(square <= CRITERIA.noise_alone))
    return alone and len(kinds) <= len(its) and model.penalised_gain() > other.penalised_gain() + CRITERIA.log_odds


def _families(effects: Iterable[Effect | None]) -> set[object]:
    return {effect.family for effect in effects if effect is not None}


def pruned(searches: list[Search], holdout: Scene | None, *, nothing: bool) -> tuple[Selection, Model, Model, Judged]:
    """Return selection, fitted model, model after pruning by held-out data, and its judgement.

    With `nothing` a check has refused the recording: constants too are then meaningless.

    Where held-out data refuse some names of the better model (two offsets in the place of a warm-up), the model of the other
    search is taken if it is better once pruned.
    """
    (selection, found), *others = searches
    chosen = found.without(list(found.effects)) if nothing else weighed(found)
    model, judged = backward_eliminated(chosen, holdout)
    if model is chosen or nothing:
        return selection, chosen, model, judged
    for other, rival in others:
        kept, its = backward_eliminated(weighed(rival), holdout)
        if kept.penalised_gain() > model.penalised_gain() + CRITERIA.log_odds:
            return other, chosen, kept, its
    return selection, chosen, model, judged

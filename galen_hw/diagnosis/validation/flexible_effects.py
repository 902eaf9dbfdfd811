"""Structure without a name: found, predicted, and compared with flexible effects that could hide it."""

from collections.abc import Sequence

import numpy as np

from galen_hw.diagnosis.estimation.model import Model
from galen_hw.diagnosis.lack_of_fit import structure_test, trees
from galen_hw.diagnosis.lack_of_fit.gram import Functions
from galen_hw.diagnosis.lack_of_fit.residual_model import Remainder, learn
from galen_hw.diagnosis.stats.criteria import CRITERIA
from galen_hw.diagnosis.validation.contact_or_place import predicted_by_place, touches_of
from galen_hw.diagnosis.validation.holdout import backward_eliminated, judge_remainder
from galen_hw.diagnosis.validation.judgement import Judged
from galen_hw.diagnosis.validation.other_recording import structures_elsewhere
from galen_hw.diagnosis.validation.verdict import above_noise, strong
from galen_hw.physics.scenes.base import Scene


def remaining_structures(
    models: Sequence[Model], generic: list[structure_test.Family]
) -> list[list[structure_test.Structure]]:
    """Return the structure above the noise in the residual of each of some models of one recording."""
    benches = {id(model.bench): model.bench for model in models}
    known: dict[int, list[structure_test.Structure]] = {}
    for bench in benches.values():
        mine = [model for model in models if model.bench is bench]
        fitted = [structure_test.Fitted([h.white for h in m.parts], m.residual(), m.residual(white=True)) for m in mine]
        known |= {id(m): found for m, found in zip(mine, structure_test.leftovers(bench, generic, fitted), strict=True)}
    return [known[id(model)] for model in models]


def has_flexible_effects(model: Model) -> bool:
    """Return whether the model contains flexible effects."""
    return bool(_removal_sets(model))


def structures_of_holdout(model: Model, holdout: Scene, judged: Judged) -> list[structure_test.Structure]:
    """Return structure in the held-out recording that matters, where effects are flexible or the model does not hold."""
    unexplained, bends = (
        {one.channel for one in above_noise(judged, model, outside_contacts=True)},
        has_flexible_effects(model),
    )
    if not unexplained and not bends:
        return []
    found = strong(structures_elsewhere(model, holdout, judged), judged, model.bench)
    return [one for one in found if bends or one.channel in unexplained]


def predict_unnamed(
    generic: list[structure_test.Family],
    model: Model,
    holdout: Scene | None,
    judged: Judged,
    structures: list[structure_test.Structure],
) -> tuple[Model, Judged, list[structure_test.Structure]]:
    """Predict the remaining structure without a name, where held-out data support that.

    A flexible effect keeps its name only if it explains more than generic functions do in its place. They are tested even if no
    structure is left: with enough parameters effects follow nearly anything in one recording.
    """
    functions = Functions(model.bench)
    now, remainder = _explained(model, structures, functions)
    judged = judge_remainder(model, holdout, judged, remainder)
    removal_sets = _removal_sets(model)
    smaller = [
        backward_eliminated(model.without([h for h in model.effects if id(h) in out]), holdout, judged)
        for out in removal_sets
    ]
    theirs = remaining_structures([less for less, _ in smaller], generic)
    for out, (less, plainly), found in zip(removal_sets, smaller, theirs, strict=True):
        its_structures = strong(found, judged, model.bench)
        # Tested where contacts alone are removed: other effects removed with them may be real.
        place = predicted_by_place(model, less) if {id(h) for h in touches_of(model)} == out else []
        its_structures = sorted([*its_structures, *place], key=lambda one: -one.z)
        reached, its_own = _explained(less, its_structures, functions)
        if reached > now + CRITERIA.log_odds or place:
            other = judge_remainder(less, holdout, plainly, its_own)
            # A contact is fitted to the rows that it is judged on: nothing else can do as well there.
            if place or float(np.sum(other.reached / judged.floor)) < float(np.sum(judged.reached / judged.floor)):
                return less, _finished(less, holdout, other, its_own, its_structures, functions), its_structures
    return model, _finished(model, holdout, judged, remainder, structures, functions), structures


def _finished(
    model: Model,
    holdout: Scene | None,
    judged: Judged,
    remainder: Remainder | None,
    structures: list[structure_test.Structure],
    functions: Functions,
) -> Judged:
    """Judge a remainder extended to the other channels, in which slow noise hides the same physics, and by trees."""
    if remainder is None:
        return judged
    found = {one.kind for one in structures}
    others = learn(model, {c: found for c in range(model.bench.width) if c not in remainder.parts}, functions)
    wider = remainder if others is None else remainder.joined(others)
    return judge_remainder(model, holdout, judged, trees.blended(wider, model, functions))


def _explained(
    model: Model, structures: list[structure_test.Structure], functions: Functions
) -> tuple[float, Remainder | None]:
    """Return the penalised gain of a model with the cross-validated gain of generic functions, and these.

    Each family pays for having been chosen among all: that choice was not cross-validated.
    """
    # A family found in one channel may be hidden in another by larger structure.
    every = {one.kind for one in structures}
    kinds = {one.channel: every for one in structures}
    remainder, own = learn(model, kinds, functions), model.penalised_gain(predictive=True)
    if remainder is None:
        return own, None
    chosen = sum(len(families) for families in remainder.parts.values())
    return own + remainder.gain - 2.0 * chosen * float(np.log(len(functions.columns))), remainder


def _removal_sets(model: Model) -> list[set[int]]:
    """Return the sets of flexible effects to test for removal: all of them, each kind, polynomials."""
    kinds: dict[str, set[int]] = {}
    for h in model.effects:
        if h.effect is not None and (h.effect.FLEXIBLE or h.effect.touches):
            kinds.setdefault(h.effect.KEY, set()).add(id(h))
    every = set[int]().union(*kinds.values())
    flexible = [every, *kinds.values()] if len(kinds) > 1 else list(kinds.values())
    return [*flexible, *_polynomials(model)]


def _polynomials(model: Model) -> list[set[int]]:
    """Return effects that together are a polynomial of one joint's load, joint by joint: their sum fits any curve.

    None of them is refused alone, for the others then miss what it took off them.
    """
    joints: dict[str, set[int]] = {}
    for h in model.effects:
        if h.effect is not None and h.effect.LOAD_POWER:
            for joint in h.effect.joints:
                joints.setdefault(joint, set()).add(id(h))
    return [alike for alike in joints.values() if len(alike) > 1]

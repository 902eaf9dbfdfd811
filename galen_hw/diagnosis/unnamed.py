"""What is left once everything with a name is named: found, predicted, weighed against names that bend far enough to hide it."""

from collections.abc import Sequence
from typing import Final

import numpy as np

from galen_hw.diagnosis import adequacy
from galen_hw.diagnosis.bench import Hypothesis
from galen_hw.diagnosis.final import MERIT, Model, merit
from galen_hw.diagnosis.inner_products import Functions
from galen_hw.diagnosis.judge import Judged, earned, judge_remainder
from galen_hw.diagnosis.remainder import Remainder, learn
from galen_hw.diagnosis.select import FLEXIBLE
from galen_hw.diagnosis.verdict import strong
from galen_hw.physics.event_effects import Contact
from galen_hw.physics.scene import Scene
from galen_hw.spatial import Array

_Rest = tuple[Model, Remainder | None]
"""A model, and what generic functions predict of what it leaves."""

YIELDING: Final = (*FLEXIBLE, "contact")
"""Effects that bend far enough to take part of what has no name."""
FORETOLD: Final = 0.5
"""Share of what a contact takes in its moments from which functions of the motion that foretell it make it none."""


def left_by(models: Sequence[Model], generic: list[adequacy.Family]) -> list[list[adequacy.Left]]:
    """What each of some models of one recording leaves above the noise."""
    benches = {id(model.bench): model.bench for model in models}
    known: dict[int, list[adequacy.Left]] = {}
    for bench in benches.values():
        mine = [model for model in models if model.bench is bench]
        fitted = [adequacy.Fitted([h.white for h in m.parts], m.rest(), m.rest(white=True)) for m in mine]
        known |= {id(m): left for m, left in zip(mine, adequacy.leftovers(bench, generic, fitted), strict=True)}
    return [known[id(model)] for model in models]


def touches_of(model: Model) -> list[Hypothesis]:
    """Contacts that a model believes in."""
    return [h for h in model.effects if isinstance(h.effect, Contact)]


def might_yield(model: Model) -> bool:
    """Whether a model believes in something that bends far enough to be part of what has no name."""
    return bool(_yielding(model))


def predict_unnamed(
    generic: list[adequacy.Family], model: Model, holdout: Scene | None, judged: Judged, rest: list[adequacy.Left]
) -> tuple[Model, Judged, list[adequacy.Left]]:
    """What is left predicted without a name, where held-out data support that.

    A flexible effect has a name only if it says more than generic functions do in its place: what these explain better alone
    has none. They are asked even if nothing else is left: with enough parameters they follow nearly anything in one recording.
    """
    functions = Functions(model.bench)
    now, remainder = _explained(model, rest, functions)
    judged = judge_remainder(model, holdout, judged, remainder)
    yielding = _yielding(model)
    smaller = [earned(model.without([h for h in model.effects if id(h) in out]), holdout, judged) for out in yielding]
    theirs = left_by([less for less, _ in smaller], generic)
    for out, (less, plainly), left in zip(yielding, smaller, theirs, strict=True):
        its_rest = strong(left, judged, model.bench)
        reached, its_own = _explained(less, its_rest, functions)
        touches = [h for h in touches_of(model) if id(h) in out]
        # Asked of contacts alone: what else leaves with them may have been there.
        always = len(touches) == len(out) and all(
            _is_always_there(h, (model, remainder), (less, its_own)) for h in touches
        )
        if reached > now + MERIT or always:
            other = judge_remainder(less, holdout, plainly, its_own)
            # A contact is fitted to the moments that it is judged on: nothing else can do as well there.
            if always or float(np.sum(other.reached / judged.floor)) < float(np.sum(judged.reached / judged.floor)):
                return less, other, its_rest
    return model, judged, rest


def _is_always_there(contact: Hypothesis, whole: _Rest, less: _Rest) -> bool:
    """Whether what was taken for a contact follows from the motion, as generic functions learnt on other blocks say.

    Nobody pushes by the arm's position: a force that is there all along is loud wherever the arm goes far.

    Args:
        whole: the model with the contact and what is predicted of its rest; less: the same without the contact.
    """
    bench, channels = whole[0].bench, list(contact.raw.channels)
    during = bench.train & np.asarray(contact.raw.values.any(axis=(1, 2)))

    def left(model: Model, remainder: Remainder | None) -> Array:
        rest = model.rest() if remainder is None else model.rest() - remainder.crossed
        return np.asarray(np.mean(rest[during][:, channels] ** 2, axis=0) / bench.noise.sigma[channels] ** 2)

    if not during.any():
        return False
    taken, missed = left(less[0], None) - left(*whole), left(*less) - left(*whole)
    # A touch acts in all channels at once: one in which the motion says much does not speak for the others.
    matters = taken > 1.0
    return bool(matters.any() and np.all(missed[matters] <= (1.0 - FORETOLD) * taken[matters]))


def _explained(model: Model, rest: list[adequacy.Left], functions: Functions) -> tuple[float, Remainder | None]:
    """Merit of a model together with what generic functions predict of its rest on blocks left out; and these."""
    kinds: dict[int, set[str]] = {}
    for one in rest:
        kinds.setdefault(one.channel, set()).add(one.kind)
    remainder = learn(model, kinds, functions)
    return merit(model) + (0.0 if remainder is None else remainder.gain), remainder


def _yielding(model: Model) -> list[set[int]]:
    """Sets of effects that might be no more than part of what has no name: all flexible ones together, then kind by kind."""
    kinds: dict[str, set[int]] = {}
    for h in model.effects:
        if h.effect is not None and h.effect.KEY in YIELDING:
            kinds.setdefault(h.effect.KEY, set()).add(id(h))
    every = set[int]().union(*kinds.values())
    return [every, *kinds.values()] if len(kinds) > 1 else list(kinds.values())

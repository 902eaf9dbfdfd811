"""Structure in what a model leaves of another recording: physics that names stood in for on one motion shows on the next."""

from dataclasses import replace
from typing import Final

import numpy as np

from galen_hw.diagnosis.estimation.dataset import Bench
from galen_hw.diagnosis.estimation.linearisation import tangent
from galen_hw.diagnosis.estimation.model import Model
from galen_hw.diagnosis.lack_of_fit import structure_test
from galen_hw.diagnosis.validation.holdout import Judged, apply
from galen_hw.physics.effects.base import Effect
from galen_hw.physics.effects.events import Contact
from galen_hw.physics.scenes.base import Scene

MISSED: Final = 1.1
"""Mean square of another recording over the noise's from which a channel is asked."""
LEAST: Final = 0.05
"""Share of what was there at first that must be left: a law of the right form, learnt on one motion, may err by less."""


def left_elsewhere(model: Model, scene: Scene, judged: Judged) -> list[structure_test.Left]:
    """What a model leaves above the noise of another recording, strongest first, by the noise of the first.

    To be asked of models with flexible names: these may follow one motion by what the next one does not have, and there generic
    functions find what they left out. Of other models it would mostly be told that an effect was too weak to be seen at first,
    which is worth saying only where they are far off there.
    What the model's own parameters, learnt anew, would take is no structure but their error. Nothing is asked where something
    belongs to moments and is fitted to each recording anew: what such a fit leaves proves nothing. The rows of contacts are left
    out there, and the others speak.
    """
    effects = [(h, h.effect) for h in model.effects if h.effect is not None]
    ratio, excess = judged.after / judged.floor, judged.before - judged.floor
    if ratio.max() <= MISSED or any(_anew(effect) for _, effect in effects):
        return []
    here = _bench(model, scene, judged)
    if here is None:
        return []
    rest = apply(model, scene, judged.good)
    # The second recording's noise may be larger or smaller, of the same colour.
    white = here.whitened(rest) * model.bench.noise.sigma / np.sqrt(judged.floor)
    own = [here.made(None, columns).white for columns in here.constants()]
    for h, effect in effects:
        if isinstance(effect, Contact):
            continue
        again = here.add(effect)
        own.append((again if h.theta is None else tangent(here, again, h.theta)).white)
    (left,) = structure_test.leftovers(here, structure_test.families(here), [structure_test.Fitted(own, rest, white)])
    return [
        replace(one, elsewhere=True)
        for one in left
        if ratio[one.channel] > MISSED and one.size**2 > LEAST * excess[one.channel]
    ]


def _anew(effect: Effect) -> bool:
    """Whether an effect belongs to moments, and these are not left out of what is judged."""
    return not effect.lasting() and not isinstance(effect, Contact)


def _bench(model: Model, scene: Scene, judged: Judged) -> Bench | None:
    """One for the other recording with rows as long, the first one's noise and clocks; None where its rows cannot be as long."""
    first = model.bench
    here = Bench(scene, held=0.0, most=max(-(-len(scene) // first.rows.stride), 1))
    if here.rows.stride != first.rows.stride:
        return None
    if judged.good is not None:
        here.hollow = here.dropped = ~judged.good
    here.noise, here.timing = replace(first.noise, rows=here.rows, kept={}), first.timing
    return here

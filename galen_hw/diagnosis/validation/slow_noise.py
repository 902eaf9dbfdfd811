"""Effects that follow the clock alone, against noise with a memory, which does so too."""

import numpy as np

from galen_hw.diagnosis.estimation.candidate import Hypothesis
from galen_hw.diagnosis.estimation.model import Model


def without_noise(model: Model) -> Model:
    """Return a model without those effects of the clock alone that noise with a memory explains as well.

    Noise is learnt from what a model leaves: staircases and wanders that take the slow part of it would stand out from the rest.
    Those that share channels are judged together, each model with the noise that is the likeliest beside it, at the usual
    penalty: they stay if all of them, or any one, is better than noise.
    """
    asked = [h for h in model.effects if _follows_the_clock(model, h)]
    if not len(model.bench.noise.edges):
        return model
    for group in _sharing_channels(asked):
        without = model.without(group)
        noise = _cost(without, [])
        if _cost(model, group) >= noise and all(
            _cost(model.without([h for h in group if h is not one]), [one]) >= noise for one in group
        ):
            model = without
    return model


def _sharing_channels(effects: list[Hypothesis]) -> list[list[Hypothesis]]:
    """Return the effects in groups of which no two share a channel."""
    groups: list[list[Hypothesis]] = []
    for h in effects:
        touching = [group for group in groups if any(set(h.raw.channels) & set(one.raw.channels) for one in group)]
        groups = [group for group in groups if group not in touching] + [[*(one for g in touching for one in g), h]]
    return groups


def _cost(model: Model, asked: list[Hypothesis]) -> float:
    """Return minus twice the log evidence of a model, as far as it depends on these effects of it and on its noise."""
    bench = model.bench
    residual = np.where(bench.excluded_rows[:, None], 0.0, model.residual())[:, ~bench.without_data]
    known = sum(h.effective_parameters(whole=True) * h.penalty(bench) + 2.0 * h.log_trials(bench.train) for h in asked)
    return known + bench.noise.deviance_as_noise(residual)


def _follows_the_clock(model: Model, h: Hypothesis) -> bool:
    if h.effect is None or not h.effect.EPISODIC:
        return False
    each = [h.effect.follows(model.bench.scene, c) for c in h.raw.channels]
    return all(one is not None and one.quantity == "time" and not one.period for one in each)

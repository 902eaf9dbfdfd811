"""The final model: which constants it keeps, and whether it is fitted by weighted least squares."""

from dataclasses import replace

import numpy as np

from galen_hw.diagnosis.estimation.candidate import Hypothesis
from galen_hw.diagnosis.estimation.cross_validation import cross_validated
from galen_hw.diagnosis.estimation.dataset import Bench
from galen_hw.diagnosis.estimation.model import Model, with_interactions
from galen_hw.diagnosis.estimation.normal_equations import Scorer
from galen_hw.diagnosis.selection.search_state import Selection
from galen_hw.diagnosis.stats.criteria import CRITERIA
from galen_hw.diagnosis.stats.paired_test import paired
from galen_hw.physics.effects.registry import constant_of


def settle_model(bench: Bench, scorer: Scorer, selection: Selection) -> Model:
    """Return the chosen model; constants that the baseline may not fit become effects where they are significant."""
    chosen = selection.hypotheses
    if not scorer.free:
        return with_interactions(Model(bench, list(scorer.base), chosen, scorer.white))
    allowed = [h for i, h in enumerate(scorer.base) if bench.scene.belief.bias_free or i >= bench.width]
    questioned = [h for h in scorer.base if h not in allowed]
    as_effects = [_named(bench, h) for h in questioned]
    model = Model(bench, allowed, [*as_effects, *chosen], scorer.white)
    misfit = max(1.0, float(np.mean(model.residual(white=True)[np.ix_(bench.train, ~bench.without_data)] ** 2)))
    z = np.abs(model.final) / np.sqrt(np.maximum(np.diag(model.covariance), 1e-300))
    keep = []
    for h, s in zip(model.parts, model.slices(), strict=True):
        if h not in as_effects:
            continue
        c = h.raw.channels[0]
        matters = float(model.final[s][0] ** 2) > CRITERIA.least_share * bench.noise.sigma[c] ** 2 * misfit
        if z[s][0] > np.sqrt(2.0 * selection.needed * misfit) and matters:
            keep.append(h)
    return with_interactions(Model(bench, allowed, [*keep, *chosen], scorer.white))


def weighed(model: Model) -> Model:
    """Return the model fitted by plain least squares where physics is missing and that predicts held-out blocks better.

    Generalised least squares is best for noise alone. For a residual with physics the weights of the noise favour frequencies at
    which the model is wrong.
    """
    bench = model.bench
    ours = cross_validated(bench, model.parts, model.white) / bench.noise.sigma
    # In whitened units missing physics may pass for slow noise.
    if not model.effects or np.all(np.mean(ours**2, axis=0) <= CRITERIA.noise_alone):
        return model
    gain = paired(ours, cross_validated(bench, *model.unweighted_parts()) / bench.noise.sigma, np.zeros(1))
    return replace(model, unweighted=True) if gain.fall > gain.error else model


def offsets(bench: Bench) -> list[Hypothesis]:
    """Return the constants that the baseline may not fit, as effects."""
    if bench.scene.belief.bias_free:
        return []
    constants = bench.constants()[: bench.width]
    return [_named(bench, bench.hypothesis_of(None, columns)) for columns in constants]


def _named(bench: Bench, constant: Hypothesis) -> Hypothesis:
    """Return the constant of a channel as an effect."""
    name = bench.scene.channels[constant.raw.channels[0]]
    return replace(constant, effect=constant_of(name, bench.scene.observations.predict))

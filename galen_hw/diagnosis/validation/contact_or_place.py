"""Test whether contacts are events or a function of the arm's position: nobody pushes by the arm's position."""

from collections.abc import Sequence
from typing import Final

import numpy as np
from threadpoolctl import threadpool_limits

from galen_hw.diagnosis.estimation.candidate import Hypothesis
from galen_hw.diagnosis.estimation.dataset import Bench
from galen_hw.diagnosis.estimation.model import Model
from galen_hw.diagnosis.lack_of_fit import trees
from galen_hw.diagnosis.lack_of_fit.basis_functions import POSITION, Inputs
from galen_hw.diagnosis.lack_of_fit.structure_test import Structure
from galen_hw.diagnosis.stats.criteria import CRITERIA
from galen_hw.diagnosis.stats.sampling import Mask, true_runs
from galen_hw.diagnosis.validation.judgement import touched

AROUND: Final = 0.5
"""Share of a contact's length before and after it that is left out of the training rows too."""


def touches_of(model: Model) -> list[Hypothesis]:
    """Return the contacts of a model."""
    return [h for h in model.effects if h.effect is not None and h.effect.touches]


@threadpool_limits.wrap(limits=1)  # type: ignore[untyped-decorator]
def predicted_by_place(whole: Model, less: Model) -> list[Structure]:
    """Return structure of the residual during contacts that follows from the arm's position during the others.

    By trees on the joint positions, which describe corners of a workspace that polynomials do not. It needs two contacts.

    Args:
        whole: with contacts; less: the same without them.
    """
    bench, contacts = whole.bench, touches_of(whole)
    channels = sorted({c for h in contacts for c in h.raw.channels})
    # Momentary effects are fitted on all rows, held-out ones too.
    good = ~bench.excluded_rows
    during = good & touched(whole)
    each = [rows for rows in _each(bench, contacts) if np.any(during & rows)]
    if len(each) < 2:
        return []
    sigma = bench.noise.sigma[channels]
    residual, kept = (model.residual()[:, channels] / sigma for model in (less, whole))
    position = Inputs.of(bench.scene, bench.rows).position
    predicted = np.zeros_like(residual)
    for rows in each:
        others, asked = good & ~rows, during & rows
        for c in range(len(channels)):
            predicted[asked, c] = (
                trees.boosted_trees().fit(position[others], residual[others, c]).predict(position[asked])
            )
    gain = np.sum(predicted * (2.0 * residual - predicted), axis=0)
    taken = np.sum(residual[during] ** 2 - kept[during] ** 2)
    if taken <= 0.0 or gain.sum() < CRITERIA.beside_unexplained * taken:
        return []
    share = gain / np.sum(residual[good] ** 2, axis=0)
    size = sigma * np.sqrt(np.sum(predicted**2, axis=0) / good.sum())
    found = [
        Structure(c, POSITION, float(gain[k] - 1.0) / np.sqrt(2.0), float(share[k]), float(size[k]), predicted[:, [k]])
        for k, c in enumerate(channels)
        if gain[k] > 0.0
    ]
    return sorted(found, key=lambda one: -one.z)


def _each(bench: Bench, contacts: Sequence[Hypothesis]) -> list[Mask]:
    """Return the rows (M,) of each contact with its surroundings; overlapping ones are one."""
    time = bench.time
    near = np.zeros(len(bench.rows), dtype=bool)
    for h in contacts:
        for start, end in () if h.effect is None else h.effect.touches:
            margin = AROUND * (end - start)
            near |= (time >= start - margin) & (time <= end + margin)
    at = np.arange(len(near))
    return [(at >= a) & (at < b) for a, b in true_runs(near)]

"""The library of hypotheses that a search begins with, and proposals from the residual of a model."""

import numpy as np

from galen_hw.diagnosis.detection import clipping, drift, proposal, spectral_lines, steps
from galen_hw.diagnosis.detection.contacts import contacts
from galen_hw.diagnosis.estimation.dataset import Bench
from galen_hw.diagnosis.estimation.interactions import update_stream
from galen_hw.diagnosis.estimation.least_squares import residuals
from galen_hw.diagnosis.estimation.normal_equations import Scorer
from galen_hw.physics.effects.base import Effect
from galen_hw.physics.effects.registry import kinds


def library(bench: Bench) -> list[Effect]:
    """Return every hypothesis that the scene allows; offsets are always in the model and judged at the end."""
    predict = bench.scene.observations.predict
    asked = [kind for kind in kinds() if not kind.always_fitted(predict)]
    return [effect for kind in asked for effect in kind.propose(bench.scene)]


def sought(bench: Bench, scorer: Scorer, chosen: list[int]) -> list[proposal.Sought]:
    """Return the proposals of all detectors for the residual of the present model."""
    update_stream(bench, scorer, chosen)
    residual, _ = residuals(bench, scorer, chosen)
    found = steps.steps(bench.scene, residual, bench.rows, bench.noise) + steps.staircases(
        bench.scene, residual, bench.noise
    )
    found += contacts(bench.scene, residual, bench.rows)
    found += steps.slips(bench.scene, residual, bench.rows)
    found += steps.loads(bench.scene, residual, bench.rows)
    found += drift.random_walks(bench.scene, residual, bench.noise)
    found += drift.drifts(bench.scene, residual, bench.rows)
    found += drift.temperatures(bench.scene, residual, bench.rows)
    # Limits are sought in the unclipped stream, as if none had been found.
    added = bench.rows.average(np.asarray(bench.stream.standing + bench.stream.carried))
    stream, seen = bench.simulated + added, ~bench.excluded_rows
    found += clipping.saturations(bench.scene, np.asarray(bench.whole - added)[seen], stream[seen])
    known_lines = [(h.raw.channels, line) for h in (scorer.library[i] for i in chosen) if (line := h.line(bench.scene))]
    return (
        found
        + spectral_lines.lines(bench.scene, residual, bench.rows, bench.aliases, known_lines)
        + spectral_lines.ripples(bench.scene, residual, bench.rows, bench.noise.followed_rounding)
    )


def known(bench: Bench, scorer: Scorer, effect: Effect) -> bool:
    """Return whether a hypothesis is in the library: detectors propose the same turn after turn while nothing explains it."""
    family, span = effect.family, float(np.ptp(bench.scene.time))
    return any(h.effect is not None and effect.indistinct(h.effect, span) for h in scorer.library if h.family == family)


def at_first_sight(bench: Bench) -> list[proposal.Sought]:
    """Return momentary effects that show in the residual itself: they must not pass for noise."""
    residual = bench.whole - np.median(bench.whole, axis=0)
    found = contacts(bench.scene, residual, bench.rows)
    found += spectral_lines.lines(bench.scene, residual, bench.rows, bench.aliases, narrow=np.inf)
    if bench.scene.observations.predict == "effort":
        # Of a wrench the premise `load_change` has asked before.
        found += steps.loads(bench.scene, residual, bench.rows)
    return found + steps.steps(bench.scene, residual, bench.rows)[:-1]

"""Acceptance of a hypothesis: cross-validated gain, and parameters that can be real."""

from dataclasses import replace

import numpy as np

from galen_hw.diagnosis.estimation.candidate import Hypothesis, place_of, with_parameters
from galen_hw.diagnosis.estimation.cross_validation import cross_validated
from galen_hw.diagnosis.estimation.dataset import Bench
from galen_hw.diagnosis.estimation.normal_equations import Scorer
from galen_hw.diagnosis.selection.search_state import Selection
from galen_hw.diagnosis.stats.criteria import CRITERIA
from galen_hw.diagnosis.stats.paired_test import Gain, paired
from galen_hw.diagnosis.stats.sampling import Mask
from galen_hw.spatial import Array

CANCELLED = 0.1
"""Share of either of two effects that their sum must reach: what they do is not to cancel."""


def improvement(
    out: Selection, trial: list[int], i: int | None = None, *, whitened: bool = False
) -> tuple[Gain, float]:
    """Compare a trial with the chosen model on cross-validated training blocks.

    Args:
        i: the effect in question, None: several.

    Returns:
        The gain, as a share of the excess before anything was chosen, and the share of that excess that the trial leaves
        where the effect acts: in its channels, and for an outstanding contact while it lasts. Of a kind that is chosen in
        another place both are shares of its own channels' excess: what each of many joints has is a small share of all.
    """
    bench, scorer = out.bench, out.scorer
    sigma = np.ones(bench.width) if whitened else bench.noise.sigma
    h = None if i is None else scorer.library[i]
    fine = h is not None and h.effect is not None and not h.effect.lasting()
    without, residual = (
        cross_validated(bench, scorer.parts(model), scorer.white, fine=fine, whitened=whitened) / sigma
        for model in (out.chosen, trial)
    )
    if not len(out.initial_errors):
        out.initial_errors = cross_validated(bench, scorer.parts(out.chosen), scorer.white) ** 2
    begun = (
        np.mean(cross_validated(bench, scorer.base, scorer.white, whitened=True) ** 2, axis=0)
        if whitened
        else out.initial_mean_square
    )
    own = list(range(bench.width)) if h is None else list(h.raw.channels)
    gain = paired(without, residual, begun / sigma**2 - 1.0, own=own if _is_elsewhere(out, h) else slice(None))
    rows = _moments(h, bench, without[:, own])
    square = np.mean(residual[rows][:, own] ** 2, axis=0)
    unexplained = float(np.sum(square[square > CRITERIA.noise_alone] - 1.0) * np.mean(rows))
    return gain, min(unexplained / gain.excess, 1.0) if gain.excess > 0.0 else 0.0


def _is_elsewhere(out: Selection, h: Hypothesis | None) -> bool:
    """Return whether a lasting effect's kind is chosen in another place."""
    if h is None or h.effect is None or not h.effect.lasting():
        return False
    places = {
        place_of(one.effect) for one in out.hypotheses if one.effect is not None and one.effect.KEY == h.effect.KEY
    }
    return bool(places - {place_of(h.effect)})


def _moments(h: Hypothesis | None, bench: Bench, without: Array) -> Mask:
    """Return the training rows (n,) of a contact, if errors (n, c) without it are far larger in these; else all."""
    every = np.ones(len(without), dtype=bool)
    if h is None or h.effect is None or not h.effect.touches:
        return every
    during = np.asarray(h.raw.values[bench.train].any(axis=(1, 2)))
    if during.all() or not during.any():
        return every
    inside, outside = (np.sum(np.mean(without[rows] ** 2, axis=0)) for rows in (during, ~during))
    return during if inside >= CRITERIA.outstanding * outside else every


def pays(out: Selection, trial: list[int], i: int | None = None) -> tuple[bool, float]:
    """Return whether a trial significantly lowers the cross-validated error, and its share of the excess.

    Raw errors are tested first. Where the trial leaves noise alone these are mostly slow noise, in which a small effect is lost
    that whitened errors show. A momentary effect fits nearly any noise: for it raw errors have to decide.

    Args:
        i: the effect that is asked for, None: several.
    """
    effect = None if i is None else out.scorer.library[i].effect
    lasting = effect is None or effect.lasting()
    moments = len(effect.single) or 1 if effect is not None and effect.EPISODIC and not effect.THROUGHOUT else 0
    gain, unexplained = improvement(out, trial, i)
    if gain.credible(unexplained=unexplained, moments=moments):
        return True, gain.share
    if not (lasting and gain.tolerable and out.bench.scene.clock) or out.scorer.misfit(trial) >= CRITERIA.noise_alone:
        return False, gain.share
    white, unexplained = improvement(out, trial, i, whitened=True)
    # Raw errors alone show completeness: in whitened units missing physics may pass for slow noise.
    return replace(white, completes=gain.completes).credible(unexplained=unexplained), gain.share


def improves(out: Selection, before: Array, after: Array) -> bool:
    """Return whether normalised errors (n, C) on held-out blocks fall with a trial as a finding requires."""
    gain = paired(before, after, out.initial_mean_square / out.bench.noise.sigma**2 - 1.0)
    square = np.mean(after**2, axis=0)
    unexplained = float(np.sum(square[square > CRITERIA.noise_alone] - 1.0)) / max(gain.excess, 1e-300)
    return gain.credible(unexplained=min(unexplained, 1.0))


def held_out_errors(out: Selection, model: list[int]) -> Array:
    """Return cross-validated errors (n, C) of a model on training blocks, over the noise's standard deviation."""
    return cross_validated(out.bench, out.scorer.parts(model), out.scorer.white) / out.bench.noise.sigma


def no_worse(before: Array, after: Array) -> bool:
    """Return whether errors (n, C) on held-out blocks rise by no more than one standard error."""
    return paired(before, after, np.zeros(1)).tolerable


def as_good(before: Array, after: Array) -> bool:
    """Return whether errors (n, C) on held-out blocks rise by less than model discrepancy allows."""
    square = np.mean(before**2, axis=0)
    missing = float(np.sum(square[square > CRITERIA.noise_alone] - 1.0))
    gain = paired(before, after, np.zeros(1))
    return gain.fall >= -max(gain.error, CRITERIA.beside_unexplained * missing)


def plausible(bench: Bench, scorer: Scorer, chosen: list[int], i: int) -> bool:
    """Return whether the parameters fit the effect's name."""
    h = scorer.library[i]
    assert h.effect is not None, "nuisances are never candidates"
    theta, at, _ = scorer.solve([*chosen, i], freed=i)
    misfit = scorer.misfit([*chosen, i])
    spread = scorer.spread(at)[-h.count :] * np.sqrt(misfit)
    named = list(zip(h.effect.parameters(bench.scene), theta[-h.count :], spread, strict=True))
    # A lag with a share of a twentieth is no lag. Bounds matter where physics is missing: else the shape has proved it.
    named_so = all(p.near(t, s) and (misfit < CRITERIA.noise_alone or p.plausible(t, s)) for p, t, s in named)
    real = named_so and h.effect.at_work(bench.scene) and h.effect.possible(bench.scene, theta[-h.count :], spread)
    return real and not _cancelled(bench, scorer, [*chosen, i], theta)


def _cancelled(bench: Bench, scorer: Scorer, chosen: list[int], theta: Array) -> bool:
    """Return whether the last effect is nearly cancelled by another one, but for a small part that alone is needed.

    `theta` (k,): parameters of the constants and of the chosen effects in their order.

    Two large errors that happen to cancel are less likely than none: only the difference of their nonlinear parts fits the data.
    """
    effects = list(with_parameters(scorer.parts(chosen), theta))[len(scorer.base) :]
    *others, last = (h.change(t, bench.width) / bench.noise.sigma for h, t in effects)
    return any(undo_each_other(last, other) for other in others)


def undo_each_other(one: Array, other: Array) -> bool:
    """Return whether two changes (N, C), with their means or without, cancel but for a small part of either."""
    return any(
        float(np.linalg.norm(a + b)) < CANCELLED * min(float(np.linalg.norm(a)), float(np.linalg.norm(b)))
        for a, b in ((one, other), (one - one.mean(axis=0), other - other.mean(axis=0)))
    )

"""Whether a hypothesis is worth its place: what it takes on blocks left out, and whether its parameters can be real."""

import numpy as np

from galen_hw.diagnosis.estimation.candidate import with_parameters
from galen_hw.diagnosis.estimation.cross_validation import errors
from galen_hw.diagnosis.estimation.dataset import Bench
from galen_hw.diagnosis.estimation.least_squares import PROVED, rests
from galen_hw.diagnosis.estimation.normal_equations import Scorer
from galen_hw.diagnosis.selection.search_state import Selection
from galen_hw.diagnosis.stats.paired_test import sure
from galen_hw.diagnosis.stats.sampling import Mask
from galen_hw.physics.effects.base import Effect
from galen_hw.spatial import Array

WORTH = 0.25
"""An effect must take at least this share of the excess that is left in some channel, on data it did not learn from."""
MATTERS = 0.03
"""Where the best model still misses much (real machines), an effect must take this share of the whole excess as well."""
LOUD = 400.0
"""Mean square over noise from which a recording is so loud that a hundredth of it is no matter."""
NEARLY_ALL = 0.95
"""Share of the excess that is left from which it does not matter how small a part of the whole that is."""
STAIRS = 0.9
"""Share of the excess that is left of which several jumps are worth their place together."""
MOSTLY = 0.8
"""The same where noise alone is left besides: the rest of that share is the error of a small effect."""
ALONE = 1.05
"""Whitened mean square below which it is."""
OUTSTANDING = 9.0
"""Mean square of what is left during a contact over that at all other times from which it is judged by its own moments."""
UNDONE = 0.1
"""Share of either of two effects that their sum must reach: what they do is not to cancel."""
LEAST_SIZE = 0.1
"""Rms over the noise, in the channels where it acts, from which what raw errors do not show may be believed."""
BESIDE = 5.0
"""And any of several: what joins a model was chosen among all that its rest resembles."""


def asked(bench: Bench, out: Selection, effect: Effect | None, misfit: float) -> tuple[float, float]:
    """The shares that an effect must take, of the excess that is left and of the excess at the start, see `worth`.

    What belongs to moments fits nearly anything and pays more; a staircase, which follows any slope, pays nearly all. Of the
    whole nothing is asked where noise is all that is left and the excess was small.
    """
    episodic = effect is not None and effect.EPISODIC
    stairs = effect is not None and bool(effect.single)
    loud = float(np.max(out.start / bench.noise.sigma**2)) > LOUD
    beyond = min(1.0, misfit - 1.0)
    return STAIRS if stairs else WORTH * (1.0 + beyond * episodic), MATTERS * max(beyond, 0.3 * loud)


def completes(bench: Bench, scorer: Scorer, chosen: list[int], paid: float) -> bool:
    """Whether the last of the chosen takes so much of the excess that is left that hardly any physics is missing beside it.

    What belongs to moments fits nearly anything: of it noise alone must be left, which a misfit by many names never is.
    """
    effect, misfit = scorer.library[chosen[-1]].effect, scorer.misfit(chosen)
    if effect is None or (effect.EPISODIC and misfit >= PROVED):
        return False
    if paid >= NEARLY_ALL:
        return True
    if paid < MOSTLY or misfit >= ALONE:
        return False
    # Physics that is missing passes for slow noise where it is left long enough: raw errors do not hide it.
    after = np.mean(errors(bench, scorer, chosen) ** 2, axis=0)
    return bool(np.all(after < PROVED * bench.noise.sigma**2))


def worth(bench: Bench, scorer: Scorer, out: Selection, i: int) -> tuple[float, float]:
    """What the hypothesis takes on blocks it did not learn from: share of the excess left, and of that at the start.

    The best channel counts. Five folds of contiguous blocks inside the training rows, errors in raw units, excess over the
    noise of the rich fit.
    """
    effect = scorer.library[i].effect
    # A contact of three seconds lies in one block: only pieces shorter than it can say whether it is there.
    fine = effect is not None and not effect.lasting()
    before = errors(bench, scorer, out.chosen, fine=fine) ** 2
    after = errors(bench, scorer, [*out.chosen, i], fine=fine) ** 2
    floor = bench.noise.sigma**2
    if not len(out.begun):
        out.begun = errors(bench, scorer, out.chosen) ** 2
    weight, begun = where_it_acts(scorer, out.chosen, i, bench), out.begun
    if effect is not None and effect.touches:
        during = np.asarray(scorer.library[i].raw.values[bench.train].any(axis=(1, 2)))
        if _stands_out(before, during, weight):
            before, after, begun = before[during], after[during], begun[during]
    before, after, start = (np.mean(square, axis=0) for square in (before, after, begun))
    left = taken(before, after, floor)
    whole = (before - after) / np.maximum(start - floor, 0.02 * floor)
    return float(weight @ left), float(weight @ whole)


def taken(before: Array, after: Array, floor: Array) -> Array:
    """(C,) shares of what mean squared errors have above the noise that falls away; of a fiftieth of the noise at least."""
    return np.asarray((before - after) / np.maximum(before - floor, 0.02 * floor))


def _stands_out(square: Array, during: Mask, weight: Array) -> bool:
    """Return whether squared errors (n, C) are far larger during some rows than at all others, in the channels that count."""
    if not during.any() or during.all():
        return False
    ratio = np.mean(square[during], axis=0) / np.maximum(np.mean(square[~during], axis=0), 1e-300)
    return bool(weight @ ratio >= OUTSTANDING)


def where_it_acts(scorer: Scorer, chosen: list[int], i: int, bench: Bench) -> Array:
    """(C,) shares of the energy, in units of the noise, that the hypothesis predicts in each channel."""
    h = scorer.library[i]
    theta = scorer.solve([*chosen, i])[0][-h.count :]
    energy = np.zeros(bench.width)
    size = np.mean((h.raw.values @ theta) ** 2, axis=0)
    energy[list(h.raw.channels)] = size / bench.noise.sigma[list(h.raw.channels)] ** 2
    return np.asarray(energy / max(float(energy.sum()), 1e-300))


def plausible(bench: Bench, scorer: Scorer, chosen: list[int], i: int) -> bool:
    """Return whether the parameters can be what the effect is called."""
    h = scorer.library[i]
    assert h.effect is not None, "nuisances are never candidates"
    theta, at, _ = scorer.solve([*chosen, i], asked=i)
    misfit = scorer.misfit([*chosen, i])
    spread = scorer.spread(at)[-h.count :] * np.sqrt(misfit)
    named = list(zip(h.effect.parameters(bench.scene), theta[-h.count :], spread, strict=True))
    # A lag of a twentieth is no lag. Bounds matter where physics is missing: else the shape has proved it, whatever its size.
    named_so = all(p.near(t, s) and (misfit < PROVED or p.plausible(t, s)) for p, t, s in named)
    real = named_so and h.effect.at_work(bench.scene) and h.effect.possible(bench.scene, theta[-h.count :], spread)
    return real and not _undone(bench, scorer, [*chosen, i], theta)


def _undone(bench: Bench, scorer: Scorer, chosen: list[int], theta: Array) -> bool:
    """Whether the last of the chosen and another do the same with opposite signs, but for a small part which alone is needed.

    `theta` (k,): parameters of what is always fitted, and of the chosen in their order.

    Two large errors that happen to cancel are less likely than that neither is there: their difference bends as it must.
    """
    changes = []
    for h, t in list(with_parameters(scorer.parts(chosen), theta))[len(scorer.base) :]:
        change = np.zeros_like(bench.y)
        change[:, list(h.raw.channels)] = h.does(t)
        changes.append((change - change.mean(axis=0)) / bench.noise.sigma)
    last, size = changes[-1], float(np.linalg.norm(changes[-1]))
    return any(
        float(np.linalg.norm(last + other)) < UNDONE * min(size, float(np.linalg.norm(other))) for other in changes[:-1]
    )


def shows_in_noise(bench: Bench, scorer: Scorer, out: Selection, i: int) -> bool:
    """Whether blocks left out surely want a hypothesis beside a model, in whitened units where noise alone is left with it.

    Raw errors are mostly slow noise there, in which a small effect is lost that whitened ones show. What belongs to moments
    fits nearly any noise, and a thousandth of a loud recording is no matter: of these raw errors must speak. What is smaller
    still may be the joints' own noise, which a dead band as narrow makes quieter.
    """
    effect = scorer.library[i].effect
    if effect is None or not effect.lasting() or not bench.scene.clock:
        return False
    if scorer.misfit([*out.chosen, i]) >= PROVED or float(np.max(out.start / bench.noise.sigma**2)) > LOUD:
        return False
    seen = (rests(bench, scorer, out.chosen)[0] - rests(bench, scorer, [*out.chosen, i])[0])[bench.train]
    size = np.mean(seen**2, axis=0) / bench.noise.sigma**2
    if float(size @ size) < LEAST_SIZE**2 * float(size.sum()):
        return False
    rest, without = (errors(bench, scorer, model, whitened=True) for model in ([*out.chosen, i], out.chosen))
    return sure(rest, without) >= BESIDE

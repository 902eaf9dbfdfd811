"""Whether held-out data want what was found: how much of what would be left it takes, and how surely."""

from collections.abc import Callable

import numpy as np

from galen_hw.diagnosis.estimation.dataset import Bench
from galen_hw.diagnosis.estimation.least_squares import errors, rests
from galen_hw.diagnosis.estimation.model import Model
from galen_hw.diagnosis.estimation.normal_equations import Scorer
from galen_hw.diagnosis.selection.acceptance import LOUD, PROVED
from galen_hw.diagnosis.selection.search_state import Selection
from galen_hw.diagnosis.stats.paired_test import PIECES, Gain, paired
from galen_hw.spatial import Array

LEAST_SURE = 3.5
"""Standard errors by which held-out data must want the one effect that was found."""
BESIDE = 5.0
"""And any of several: what joins a model was chosen among all that its rest resembles."""
LEAST_SIZE = 0.1
"""Rms over the noise, in the channels where it acts, from which what raw errors do not show may be believed."""
LEAST_SUPPORT = 0.05
"""An effect must take this share of what would be left above the noise of the channels in which it acts without it."""


def poor(support: float, sure: float, *, alone: bool) -> bool:
    """Whether held-out data do not support what has this share of the excess and this certainty."""
    return support < LEAST_SUPPORT or sure < (LEAST_SURE if alone else BESIDE)


ROUGHLY = 0.05
"""Share of its mean square by which the noise of held-out rows may be other than was learnt."""


AMISS = 0.1
"""Share of a channel's noise by which an effect may worsen it: its parameters are known to more than that."""


def support(without: Array, rest: Array) -> float:
    """Share of what is above the noise without an effect that it takes, from rests (n, c) in units of the noise."""
    left = np.mean(without**2, axis=0)
    lost = float(np.sum(left - np.mean(rest**2, axis=0)))
    excess = max(float(np.sum(np.maximum(left - 1.0 - ROUGHLY, 0.0))), abs(lost))
    return lost / excess if excess > 0.0 else 0.0


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


def sure(rest: Array, without: Array) -> float:
    """By how many standard errors held-out rows want an effect, in units of the noise: its match with what is there without it.

    With d the effect as learnt and r the rest, what is there without it is w = r + d, and d is wanted as far as the sum of w d
    is above what luck makes of it. A sum over neighbouring rows is one value (slow noise is one piece of luck). Luck is in r d
    alone: that an effect acts in few pieces, as a delay does where all but a few moves are rests, makes it no less sure. Where
    physics is missing r d is large, but a match in nearly every piece is no luck either: the larger of the two counts.
    """
    effect = without - rest
    luck = np.sum(rest * effect, axis=1)
    match = np.sum(effect**2, axis=1) + luck
    count = min(PIECES, len(match))
    each, lucky = (np.array([piece.sum() for piece in np.array_split(x, count)]) for x in (match, luck))
    spread = float(np.std(each, ddof=1)) * np.sqrt(count) if count > 1 else np.inf
    return float(each.sum()) / max(min(float(np.sqrt(np.sum(lucky**2))), spread), 1e-300)


def belied(rest: Array, without: Array) -> bool:
    """Whether held-out rows show in some channel that an effect does not act there as was learnt.

    Of rests (n, c) with and without it, in units of the noise. The error is larger there with it, by more than a wrong estimate
    of a right effect would make it and by more than luck: what is right in one channel and wrong in the next is the wrong
    physics.
    """
    effect, better = without - rest, without**2 - rest**2
    size = np.sum(effect**2, axis=0)
    # What is there of the effect itself is no luck.
    there = np.sum(without * effect, axis=0) / np.maximum(size, 1e-300)
    lucky = 2.0 * (without - there * effect) * effect
    luck = np.sqrt(sum(piece.sum(axis=0) ** 2 for piece in np.array_split(lucky, min(PIECES, len(lucky)))))
    return bool(np.any((better.mean(axis=0) < -AMISS) & (better.sum(axis=0) < -LEAST_SURE * luck)))


class Guard:
    """Whether held-out data want an effect: how much of what would be left it takes, and how surely.

    In raw units, weighed by the noise of each channel, where physics is left over: then the weights of the noise would favour
    frequencies at which the model is wrong. Where the model leaves noise alone, in whitened units: a small quick effect is then
    not lost in large slow noise.

    Args:
        floor: (C,) of the noise; raw, white: what a model leaves on the judged rows; model: the largest one.
    """

    def __init__(
        self, floor: Array, raw: Callable[[Model], Array], white: Callable[[Model], Array], model: Model
    ) -> None:
        self._raw, self._asked = raw, (model, raw(model))
        whitened = white(model)
        noise_alone = model.bench.scene.clock and float(np.mean(whitened**2)) < PROVED
        self._floor = floor
        self._raw_rest = self._raw_of(model)
        self._rest_of = white if noise_alone else self._raw_of
        self._rest = whitened if noise_alone else self._raw_rest

    def raw(self, part: Model) -> Array:
        """What a model leaves on the judged rows; of the one asked last it is kept."""
        if part is not self._asked[0]:
            self._asked = part, self._raw(part)
        return self._asked[1]

    def _raw_of(self, part: Model) -> Array:
        return self.raw(part) / np.sqrt(self._floor)

    def of(self, part: Model, own: list[int]) -> tuple[float, float]:
        """Support, in its own channels, and `sure` of what a smaller model has left out.

        Nothing supports what makes the raw errors there larger, or one channel's beyond luck, whatever weight the noise gives
        these: physics that is missing passes for slow noise where it is left long enough.
        """
        without = self._rest_of(part)
        wanted, certain = support(without[:, own], self._rest[:, own]), sure(self._rest, without)
        before, after = self._raw_of(part)[:, own], self._raw_rest[:, own]
        raw, plainly = (float(np.sum(np.mean(x**2, axis=0))) for x in (before, after))
        if belied(after, before):
            return min(wanted, -1.0), certain
        return (wanted if plainly <= raw * (1.0 + ROUGHLY) else min(wanted, raw / plainly - 1.0)), certain

    def gain(self, part: Model, before: Array) -> Gain:
        """What falls of the excess with what a smaller model has left out; `before`: (C,) mean squared error of the baseline."""
        return paired(self._raw_of(part), self._raw_rest, before / self._floor - 1.0)

    def could_tell(self, part: Model) -> bool:
        """Whether held-out rows would surely want what a smaller model has left out if it is there as it was learnt.

        Luck has the square of the effect itself for its variance, in units of the noise: a motion that hardly rouses an effect
        neither wants nor refuses it.
        """
        return float(np.sum((self._rest_of(part) - self._rest) ** 2)) >= BESIDE**2

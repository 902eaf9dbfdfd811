"""Whether held-out data want what was found: how much of what would be left it takes, and how surely."""

from collections.abc import Callable

import numpy as np

from galen_hw.diagnosis.estimation.least_squares import PROVED
from galen_hw.diagnosis.estimation.model import Model
from galen_hw.diagnosis.selection.acceptance import BESIDE
from galen_hw.diagnosis.stats.paired_test import PIECES, Gain, paired, sure
from galen_hw.spatial import Array

LEAST_SURE = 3.5
"""Standard errors by which held-out data must want the one effect that was found."""
LEAST_SUPPORT = 0.05
"""An effect must take this share of what would be left above the noise of the channels in which it acts without it."""


def poor(support: float, sure: float, *, alone: bool) -> bool:
    """Return whether held-out data do not support what has this share of the excess and this certainty."""
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


def belied(rest: Array, without: Array) -> bool:
    """Return whether held-out rows show in some channel that an effect does not act there as was learnt.

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
    """Return whether held-out data want an effect: how much of what would be left it takes, and how surely.

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
        """Return whether held-out rows would surely want what a smaller model has left out if it is there as it was learnt.

        Luck has the square of the effect itself for its variance, in units of the noise: a motion that hardly rouses an effect
        neither wants nor refuses it.
        """
        return float(np.sum((self._rest_of(part) - self._rest) ** 2)) >= BESIDE**2

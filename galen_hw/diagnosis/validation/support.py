"""The paired test of smaller models against a model on held-out rows."""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from galen_hw.diagnosis.estimation.model import Model
from galen_hw.diagnosis.stats.criteria import CRITERIA
from galen_hw.diagnosis.stats.paired_test import Gain, paired
from galen_hw.spatial import Array


class HoldoutTest:
    """Compare smaller models with a model on rows that neither was fitted on.

    In raw units, weighed by the noise of each channel, where physics is left over: then the weights of the noise would favour
    frequencies at which the model is wrong. Where the model leaves noise alone, in whitened units too: a quick effect that is too
    small to be sure of in large slow noise is not lost there. How much an effect explains is asked in raw units alone.

    Args:
        floor: (C,) of the noise; raw, white: what a model leaves on the judged rows; model: the largest one; baseline: the one
            without effects.
    """

    def __init__(
        self,
        floor: Array,
        raw: Callable[[Model], Array],
        white: Callable[[Model], Array],
        model: Model,
        baseline: Model,
    ) -> None:
        self._raw, self._white, self._size = raw, white, np.sqrt(floor)
        self._asked = model, raw(model)
        self._residual = self._asked[1] / self._size
        self._excess = np.mean((raw(baseline) / self._size) ** 2, axis=0) - 1.0
        self._white_residual: Array | None = None
        # In whitened units missing physics may pass for slow noise: raw errors have to exclude it.
        bench = model.bench
        if (
            bench.scene.clock
            and np.mean(self._residual[:, ~bench.without_data] ** 2) < CRITERIA.noise_alone
            and np.mean((whitened := white(model))[:, ~bench.without_data] ** 2) < CRITERIA.noise_alone
        ):
            self._white_residual = whitened
            # The baseline's plain least squares have no errors in whitened units.
            self._white_excess = np.mean(white(model.without(model.effects)) ** 2, axis=0) - 1.0

    def raw(self, part: Model) -> Array:
        """Return a model's residual on the judged rows; that of the last model is cached."""
        if part is not self._asked[0]:
            self._asked = part, self._raw(part)
        return self._asked[1]

    def gain(self, part: Model, own: Sequence[int] | None = None) -> Gain:
        """Compare raw errors; `own`: in these channels alone."""
        at = slice(None) if own is None else list(own)
        return paired(self.raw(part) / self._size, self._residual, self._excess, own=at)

    def gains(self, part: Model, own: Sequence[int] | None = None) -> list[Gain]:
        """Compare errors in each of the units that can tell: one of them has to be credible."""
        out = [self.gain(part, own)]
        enough = out[0].completes or out[0].share >= CRITERIA.least_share
        if self._white_residual is not None and out[0].tolerable and enough:
            at = slice(None) if own is None else list(own)
            white = paired(self._white(part), self._white_residual, self._white_excess, own=at)
            out.append(replace(white, completes=out[0].completes))
        return out

    def belied(self, part: Model, own: Sequence[int], questions: int) -> bool:
        """Return whether an effect makes the error of some channel larger, beyond chance."""
        without, whole = self.raw(part) / self._size, float(np.sum(np.maximum(self._excess, 0.0)))
        each = (paired(without[:, [c]], self._residual[:, [c]], np.array([whole])) for c in own)
        return any(one.contrary(questions=questions * len(own)) for one in each)

    def could_tell(self, part: Model, questions: int) -> bool:
        """Return whether the judged rows would show what a smaller model lacks, if it is there as it was learnt.

        The random part of the gain has the effect's own square for its variance, in units of the noise: a motion that hardly
        excites an effect neither supports nor contradicts it.
        """
        residual, of = (
            (self._residual, self._raw_of) if self._white_residual is None else (self._white_residual, self._white)
        )
        return float(np.sum((of(part) - residual) ** 2)) >= CRITERIA.standard_errors(questions) ** 2

    def _raw_of(self, part: Model) -> Array:
        return self.raw(part) / self._size

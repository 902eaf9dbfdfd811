"""The paired test on held-out errors, block by block: an effect's share of the excess and its significance."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from galen_hw.diagnosis.stats.criteria import CRITERIA, Criteria
from galen_hw.spatial import Array

PIECES: Final = 40
"""Pieces of held-out rows, each one value: slow noise inside a piece is one piece of luck."""


@dataclass(frozen=True)
class Gain:
    """Gain of an effect in the held-out excess, all channels together, each weighted by its noise.

    Args:
        fall: mean over the rows of the squared error without it less that with it; error: its standard error.
        sure: correlation of the error without it with its contribution, in standard errors.
        excess: mean of the baseline's squared error above the noise, not below 0 or `fall`.
        completes: noise alone is left with it, and more without it: then the laws have no discrepancy.
    """

    fall: float
    error: float
    excess: float
    sure: float
    completes: bool = False

    @property
    def share(self) -> float:
        """Share of the excess, from -1 to 1."""
        return float(np.clip(self.fall / self.excess, -1.0, 1.0)) if self.excess > 0.0 else 0.0

    @property
    def tolerable(self) -> bool:
        """Return whether the error does not rise by more than a standard error (Breiman et al. 1984: their rule)."""
        return self.fall >= -self.error

    def credible(
        self,
        criteria: Criteria = CRITERIA,
        *,
        unexplained: float = 0.0,
        questions: int = 1,
        moments: int = 0,
    ) -> bool:
        """Return whether the gain is significant, and larger than model discrepancy and missing physics explain.

        Args:
            criteria: the levels.
            unexplained: share of the excess, 0 to 1, that the whole model leaves.
            questions: how many effects are asked about at once.
            moments: number of its episodes, each of which has to explain as much as remains unexplained; 0: it lasts.
        """
        least = max(
            0.0 if self.completes else criteria.least_share, (moments or criteria.beside_unexplained) * unexplained
        )
        return bool(self.fall > 0.0 and self.sure > criteria.standard_errors(questions) and self.share >= least)

    def contrary(self, criteria: Criteria = CRITERIA, *, questions: int = 1) -> bool:
        """Return whether the error rises with it significantly, and by more than the discrepancy of a correct law."""
        return bool(
            self.fall < -criteria.standard_errors(questions) * self.error and self.share <= -criteria.least_share
        )


def paired(
    without: Array, residual: Array, excess: Array, *, own: Sequence[int] | slice = slice(None), parameters: int = 0
) -> Gain:
    """Compare the errors (n, C) without an effect and with it on the same rows, in units of the noise.

    With the error w without it, r with it and its contribution d = w - r, the squared error falls by d^2 + 2 r d, and w
    correlates with d by w d = d^2 + r d: the correlation is significant before the fall is, for an effect that is absent raises
    the error by d^2. Only r d is random, so that an effect that acts in one piece of many is no less significant for that. Where
    physics is missing r d is large, but a fall in nearly every piece is no chance either: the smaller of the two spreads counts.

    Args:
        excess: (C,) of the baseline.
        own: channels that are compared; all have to be noise alone where the effect completes the model.
        parameters: number of parameters fitted on these very rows, each with the penalty of Akaike 1974.
    """
    old, new = (np.mean(x**2, axis=0) for x in (without, residual))
    whole = bool(np.any(old > CRITERIA.beyond_noise) and np.all(new <= CRITERIA.noise_alone))
    without, residual, excess = without[:, own], residual[:, own], excess[own]
    effect, n = without - residual, max(len(residual), 1)
    count = max(min(PIECES, len(residual)), 1)
    luck = np.sum(residual * effect, axis=1)
    match = np.sum(effect**2, axis=1) + luck
    fall, error = _sum(match + luck, 2.0 * luck, count)
    matched, its = _sum(match, luck, count)
    fall = (fall - 2.0 * parameters) / n
    return Gain(fall, error / n, max(float(np.sum(np.maximum(excess, 0.0))), fall), matched / max(its, 1e-300), whole)


def _sum(x: Array, lucky: Array, count: int) -> tuple[float, float]:
    """Return the sum of x (n,) and its standard error over so many pieces: from its random part, or the spread if less."""
    each, luck = (np.array([piece.sum() for piece in np.array_split(one, count)]) for one in (x, lucky))
    spread = float(np.std(each, ddof=1)) * np.sqrt(count) if count > 1 else np.inf
    return float(each.sum()), min(float(np.sqrt(np.sum(luck**2))), spread)

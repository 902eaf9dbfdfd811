"""The interface of all regressions of a model's residual on generic functions."""

from abc import ABC, abstractmethod
from dataclasses import dataclass, field
from typing import Self

import numpy as np

from galen_hw.diagnosis.lack_of_fit.gram import Sums
from galen_hw.spatial import Array


@dataclass
class Regression(ABC):
    """Regression of one channel's residual on families of functions.

    Args:
        plain, white: inner products of the families, the plain ones first, as they are and whitened.
        residual, white_residual: (n,) over the noise's standard deviation, and whitened.
        weighed: by generalised or plain least squares: the first is best where noise is the residual's larger part, the second
            where physics is.
        least: share of the residual that must be explained.
        chosen: families of which it takes something; reached, white_gain: falls of the sum of squares on held-out folds.
    """

    plain: Sums
    white: Sums
    residual: Array
    white_residual: Array
    weighed: bool
    least: float = field(default=1e-3, kw_only=True)
    chosen: list[str] = field(init=False, default_factory=list)
    reached: float = field(init=False, default=0.0)
    white_gain: float = field(init=False, default=0.0)

    @abstractmethod
    def coefficients(self) -> dict[str, Array]:
        """Return the coefficients (k,) of every function of the chosen families, in the channel's unit."""

    @abstractmethod
    def cross_validated(self, *, white: bool = False) -> Array:
        """Return predictions (n,) of each row from other folds, over the noise's deviation; or whitened ones."""


@dataclass
class Blend(Regression):
    """Mean of two regressions: where neither is the truth their errors differ, and partly cancel (Bates and Granger 1969)."""

    of: tuple[Regression, ...] = ()

    @classmethod
    def between(cls, *of: Regression) -> Self:
        """Return the mean of regressions of one residual on the same families."""
        one = of[0]
        return cls(one.plain, one.white, one.residual, one.white_residual, one.weighed, of)

    def __post_init__(self) -> None:
        """Compute its gains on the same folds as theirs."""
        self.chosen = list(dict.fromkeys(name for one in self.of for name in one.chosen))
        for_plain, for_white = self.cross_validated(), self.cross_validated(white=True)
        self.reached = float(for_plain @ (2.0 * self.residual - for_plain))
        self.white_gain = float(for_white @ (2.0 * self.white_residual - for_white))

    def coefficients(self) -> dict[str, Array]:
        """Return the mean coefficients; 0 where one has none."""
        out: dict[str, Array] = {}
        for one in self.of:
            for name, theta in one.coefficients().items():
                out[name] = out.get(name, 0.0) + theta / len(self.of)
        return {name: out[name] for name in self.chosen}

    def cross_validated(self, *, white: bool = False) -> Array:
        """Return the mean predictions (n,) of each row from other folds."""
        return np.asarray(sum(one.cross_validated(white=white) for one in self.of) / len(self.of))

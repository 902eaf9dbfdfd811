"""Gradient boosting on force, joints and the force's past: what a good black box reaches on the same data."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, ClassVar, Self

import numpy as np
from sklearn.ensemble import HistGradientBoostingRegressor
from threadpoolctl import threadpool_limits

from galen_hw.errors import UsageError
from galen_hw.identification.deflection.data import DeflectionSet
from galen_hw.identification.deflection.features import with_past
from galen_hw.identification.deflection.model import DeflectionModel
from galen_hw.spatial import Array


@dataclass
class Boosting(DeflectionModel):
    """One boosted forest a component; for comparison, it is not served (trees cannot be saved as plain numbers)."""

    NAME: ClassVar[str] = "gradient boosting"
    ABOUT: ClassVar[str] = "boosted trees on force, joints and the force's past"
    _forests: list[HistGradientBoostingRegressor] = field(default_factory=list)

    # The histograms are small: beside other work the threads that fill them wait for one another for longer than they compute.
    @threadpool_limits.wrap(limits=1)  # type: ignore[untyped-decorator]
    def fit(self, sets: Sequence[DeflectionSet]) -> Self:
        """Early stopping on a tenth of the rows, scikit-learn's defaults otherwise."""
        x = np.concatenate([with_past(s) for s in sets])
        y = np.concatenate([s.give for s in sets])
        self._forests = [HistGradientBoostingRegressor(early_stopping=True, random_state=0).fit(x, c) for c in y.T]
        return self

    @threadpool_limits.wrap(limits=1)  # type: ignore[untyped-decorator]
    def predict(self, data: DeflectionSet) -> Array:
        """Give (N, d)."""
        x = with_past(data)
        return np.stack([f.predict(x) for f in self._forests], axis=1)

    def to_json(self) -> dict[str, Any]:
        """Not offered.

        Raises:
            UsageError: always.
        """
        raise UsageError("boosted trees are for comparison only", todo="choose another model to serve")

    @classmethod
    def from_json(cls, values: dict[str, Any]) -> Self:
        """Not offered, see `to_json`."""
        del values
        raise UsageError("boosted trees are for comparison only", todo="choose another model to serve")

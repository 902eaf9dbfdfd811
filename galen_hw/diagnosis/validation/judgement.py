"""The judgement of a model on held-out data."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from galen_hw.diagnosis.estimation.dataset import Bench
from galen_hw.diagnosis.estimation.model import Model
from galen_hw.diagnosis.lack_of_fit.structure_test import Structure
from galen_hw.diagnosis.stats.criteria import CRITERIA
from galen_hw.diagnosis.stats.paired_test import Gain
from galen_hw.diagnosis.stats.sampling import Mask
from galen_hw.spatial import Array

ELSEWHERE = "another recording"


@dataclass
class Judged:
    """Mean squared errors on held-out rows, (C,).

    Args:
        name: of what was held out.
        before: of the baseline; after: with all effects; without: per effect's key, with that one left out.
        floor: of the noise.
        outside_contacts: `after` on rows outside the model's contacts, None: there are none or no such rows; the course of a
            contact is no law of the arm, and fitted only as well as its few shapes allow.
        gains: per effect's key, its gain in the held-out excess; of momentary effects on all rows of their own recording, less
            the penalty of their parameters.
        tests: per effect's key, the gains of which one has to be credible; raw, and whitened where noise alone is left.
        refused: keys of effects that informative held-out rows contradict.
        by_place: for keys with several effects, per number in the model's effects: the tests of that one alone.
        cross_validated: keys of effects that another recording hardly excites: their gains are from held-out blocks of their own.
        with_generic: `after` with the predictions of generic functions, where these are supported; None: they are not.
        episodes: times (s) of contacts in another recording; good: (M,) its judged rows, all others are left out of these errors;
            None: not another recording.
    """

    name: str
    before: Array
    after: Array
    without: dict[str, Array]
    floor: Array
    gains: dict[str, Gain] = field(default_factory=dict)
    tests: dict[str, list[Gain]] = field(default_factory=dict)
    refused: set[str] = field(default_factory=set)
    by_place: dict[int, list[Gain]] = field(default_factory=dict)
    cross_validated: set[str] = field(default_factory=set)
    episodes: tuple[tuple[float, float], ...] = ()
    good: Mask | None = None
    outside_contacts: Array | None = None
    with_generic: Array | None = None

    @property
    def reached(self) -> Array:
        """Mean squared errors (C,) with all predictions, named or not."""
        return self.after if self.with_generic is None else self.with_generic

    def gain(self, key: str) -> float:
        """Return the share of the excess, channels weighted by their noise, that an effect removes."""
        return self.gains[key].share

    def unexplained(self, channels: Sequence[int]) -> float:
        """Return the share of the excess that is left with all effects, in those of some channels that hold more than noise."""
        more = np.isin(np.arange(len(self.after)), channels) & (self.after > CRITERIA.noise_alone * self.floor)
        return max(self.share(np.where(more, self.after - self.floor, 0.0)), 0.0)

    def unnamed_gain(self) -> float:
        """Return the share of the excess that is predicted without a name."""
        return 0.0 if self.with_generic is None else self.share(self.after - self.with_generic)

    def share(self, lost: Array) -> float:
        """Return the share of the held-out excess, channels weighed by their noise, that mean squares (C,) are."""
        excess = float(np.sum(np.maximum(self.before - self.floor, 0.0) / self.floor))
        return float(np.clip(np.sum(lost / self.floor) / excess, -1.0, 1.0)) if excess > 0 else 0.0

    def fit(self, bench: Bench, structures: list[Structure]) -> dict[str, dict[str, float]]:
        """Return the `fit` part of the answer."""
        names = bench.scene.channels
        better = np.zeros(bench.width)
        for one in structures:
            better[one.channel] = max(better[one.channel], one.share)
        after = self.reached
        hoped = np.maximum(self.after * (1.0 - np.clip(better, 0.0, 1.0)), np.minimum(self.floor, self.after))
        values = {
            "rmse_before": np.sqrt(self.before),
            "rmse_after": np.sqrt(after),
            "noise_floor": np.where(bench.without_data, 0.0, np.sqrt(self.floor)),
            "ceiling": np.sqrt(np.minimum(hoped, after)),
            "rows_averaged": np.full(bench.width, bench.rows.stride),
        }
        return {k: {n: float(x) for n, x in zip(names, v, strict=True)} for k, v in values.items()}


def touched(model: Model) -> Mask:
    """Return the rows (M,) of the model's bench during its contacts."""
    out = np.zeros(len(model.bench.rows), dtype=bool)
    for h in model.effects:
        if h.effect is not None and h.effect.touches:
            out |= h.raw.values.any(axis=(1, 2))
    return out

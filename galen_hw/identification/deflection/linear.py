"""The report's linear models: each axis by its own force, and all axes by all forces."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, ClassVar, Self

import numpy as np

from galen_hw.identification.deflection.data import DeflectionSet
from galen_hw.identification.deflection.model import DeflectionModel
from galen_hw.identification.deflection.stream import GiveStream, LinearStream
from galen_hw.spatial import Array


@dataclass
class IndependentLinear(DeflectionModel):
    """d_a = c_a f_a for each base axis a (report, figures 3 and 4); stiffness as if the arm stood in one place only."""

    NAME: ClassVar[str] = "independent linear"
    ABOUT: ClassVar[str] = "each axis gives in proportion to its own force"
    gain: Array = field(default_factory=lambda: np.zeros(3))

    def fit(self, sets: Sequence[DeflectionSet]) -> Self:
        """One slope an axis, least squares with a constant of each set taken out."""
        force, give = _centred(sets)
        power = np.sum(force**2, axis=0)
        self.gain = np.sum(force * give[:, :3], axis=0) / np.where(power > 0.0, power, 1.0)
        return self

    def predict(self, data: DeflectionSet) -> Array:
        """Position give (N, 3)."""
        return np.asarray(self.gain * data.force)

    def to_json(self) -> dict[str, Any]:
        """Slopes in m/N."""
        return {"gain_m_per_n": self.gain.tolist()}

    @classmethod
    def from_json(cls, values: dict[str, Any]) -> Self:
        """From slopes."""
        return cls(np.array(values["gain_m_per_n"]))

    def stream(self, std: Array | None = None) -> GiveStream:
        """The slopes on a diagonal."""
        return LinearStream(np.diag(self.gain), std)


@dataclass
class CoupledLinear(DeflectionModel):
    """d = C f with a full matrix (report, figure 5): one stiffness for all configurations, axes coupled."""

    NAME: ClassVar[str] = "coupled linear"
    ABOUT: ClassVar[str] = "every axis gives in proportion to all forces"
    matrix: Array = field(default_factory=lambda: np.zeros((3, 3)))

    def fit(self, sets: Sequence[DeflectionSet]) -> Self:
        """Least squares with a constant of each set taken out; the smallest matrix where a direction was not pushed."""
        force, give = _centred(sets)
        self.matrix = np.asarray(np.linalg.lstsq(force, give, rcond=None)[0].T, dtype=float)
        return self

    def predict(self, data: DeflectionSet) -> Array:
        """Give (N, d)."""
        return np.asarray(data.force @ self.matrix.T)

    def to_json(self) -> dict[str, Any]:
        """The matrix in m/N (and rad/N)."""
        return {"matrix_per_n": self.matrix.tolist()}

    @classmethod
    def from_json(cls, values: dict[str, Any]) -> Self:
        """From the matrix."""
        return cls(np.array(values["matrix_per_n"]))

    def stream(self, std: Array | None = None) -> GiveStream:
        """The matrix."""
        return LinearStream(self.matrix, std)


def _centred(sets: Sequence[DeflectionSet]) -> tuple[Array, Array]:
    """Forces and gives of all sets, each set less its mean: what is left of the registration is no stiffness."""
    force = np.concatenate([s.force - s.force.mean(axis=0) for s in sets])
    give = np.concatenate([s.give - s.give.mean(axis=0) for s in sets])
    return force, give

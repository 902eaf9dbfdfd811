"""What every deflection model offers, so that all are fitted, judged, saved and served alike."""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import Any, ClassVar, Self

from galen_hw.errors import UsageError
from galen_hw.identification.deflection.data import DeflectionSet
from galen_hw.identification.deflection.stream import GiveStream
from galen_hw.spatial import Array


class DeflectionModel(ABC):
    """A model of the tip's give.

    `fit` forgets what was learned before. `predict` is for a whole recording, in order: a model with memory starts at
    rest at its first row.
    """

    NAME: ClassVar[str]
    """As it stands in tables and files."""
    ABOUT: ClassVar[str]
    """One line: what it assumes."""

    @abstractmethod
    def fit(self, sets: Sequence[DeflectionSet]) -> Self:
        """Learn from the sets."""

    @abstractmethod
    def predict(self, data: DeflectionSet) -> Array:
        """Give (N, d) of the tip: m, and rad where orientation was learned."""

    @abstractmethod
    def to_json(self) -> dict[str, Any]:
        """All that `from_json` needs, plain values."""

    @classmethod
    @abstractmethod
    def from_json(cls, values: dict[str, Any]) -> Self:
        """The model of a file."""

    def stream(self, std: Array | None = None) -> GiveStream:
        """The model at work, sample by sample.

        Args:
            std: (d,) one sigma of its held-out error, for models that do not know their own.

        Raises:
            UsageError: it is for comparison only.
        """
        del std
        raise UsageError(f"{self.NAME} is for comparison only", todo="galen-hw deflection select another model")

"""What all clocks have in common, and what the engine asks of them to seek several at once: it knows none by its name."""

from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import replace
from typing import Self

from galen_hw.physics.channels import joint_of
from galen_hw.physics.effects.base import Downstream, Effect
from galen_hw.physics.effects.columns import Columns
from galen_hw.physics.effects.traits import Follows
from galen_hw.physics.scenes.base import Scene
from galen_hw.physics.scenes.initial_state import Beginning
from galen_hw.spatial import Array

BETWEEN = ("lines", "bows", "steps")
"""What the simulated does between two rows: runs straight, along a parabola, or has the later one's value all the way."""


class Timing(Downstream):
    """An effect of the clock."""

    CLOCK = True

    NEEDS_CLOCK = True
    joint: str
    between: str

    def __post_init__(self) -> None:
        """Refuse what it does not know: TypeError."""
        if self.between not in BETWEEN:
            raise TypeError(f"between two rows are {', '.join(BETWEEN)}, not {self.between}")

    @property
    def interpolation(self) -> str:
        """Its own interpolation between two rows, see `BETWEEN`."""
        return self.between

    def interpolated(self, between: str) -> Self:
        """Return the timing effect with another interpolation between two rows."""
        return replace(self, between=between)  # type: ignore[type-var]

    @property
    def bowed(self) -> bool:
        """Return whether the simulated runs along parabolas between two rows."""
        return self.between == "bows"

    @abstractmethod
    def beginning(self, scene: Scene, theta: Array, others: Sequence[Effect]) -> Beginning:
        """Return what it leaves open, with theta (k,), at the beginning of a recording: it answers to what came before."""

    @abstractmethod
    def retimed(self, scene: Scene, x: Array, theta: Array) -> Array:
        """Return signals (N, m) as this stream delivers them, whatever they are."""

    def follows(self, scene: Scene, channel: int) -> Follows:
        """Return what it follows: the rate of the simulated signal."""
        return Follows("rate")

    def places(self, scene: Scene) -> tuple[int, ...]:
        """Return the channels that it makes late: the named joint's, or all."""
        return tuple(i for i, name in enumerate(scene.channels) if self.joint in ("", joint_of(name)))

    def delivered(self, scene: Scene, columns: Columns, theta: Array) -> Columns:
        """Return what another effect does, as it arrives through this stream: the channels of `joint` if one is named."""
        places = self.places(scene)
        mine = [i for i, c in enumerate(columns.channels) if c in places]
        if not mine or not columns.count:
            return columns
        values = columns.values.copy()
        flat = values[:, mine].reshape(len(values), -1)
        values[:, mine] = self.retimed(scene, flat, theta).reshape(len(values), len(mine), columns.count)
        return Columns(columns.channels, values)


class Filter(Timing):
    """A clock that answers slowly: it smooths what it delivers, by a constant that is searched."""

    @abstractmethod
    def followed(self, scene: Scene, x: Array) -> Array:
        """Return the output (N, m) of the filter for what is simulated (N, m), all of which goes through it."""


class Shift(Timing):
    """A clock that delivers everything as it was, and later."""

    SHIFT = True

    @abstractmethod
    def lagging(
        self, constant: float, shortest: float, damping: float | None = None, speed_limit: float | None = None
    ) -> Filter:
        """Return what answers slowly where this one is late, all of it, by a constant, s.

        Args:
            constant, shortest: s; damping: of the second order; speed_limit: of what is no faster, unit of the channel over s.
        """

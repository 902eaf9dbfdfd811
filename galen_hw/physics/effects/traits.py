"""What the engine asks of an effect beside its columns, each with the answer of most: what it is like, where and when it acts."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar, Protocol, Self

import numpy as np
from numpy.typing import NDArray

from galen_hw.physics.effects.columns import Columns
from galen_hw.physics.scenes.base import Scene
from galen_hw.physics.scenes.initial_state import Beginning
from galen_hw.spatial import Array

if TYPE_CHECKING:
    from galen_hw.physics.effects.base import Effect

Span = tuple[float, float]
"""Start and end, s."""


@dataclass(frozen=True, slots=True)
class Line:
    """A line of the spectrum.

    Args:
        frequency: Hz; breadth: Hz to either side that belong to it; wanders: whether its phase and strength go to and fro.
    """

    frequency: float
    breadth: float
    wanders: bool


@dataclass(frozen=True, slots=True, eq=False)
class Follows:
    """What an effect is a function of.

    Args:
        quantity: "time"; "position", "speed" or "load" of a joint; "signal" that is simulated in a channel, or its "rate";
            "column" of the recording.
        name: of the joint, channel or column; "": the first of its joints that moves, the channel that is looked at.
        period: with which it repeats along that, 0: not at all.
        memory: whether it goes another way back.
        values: (N,) of it where they are its own; None: as the scene has them.
    """

    quantity: str
    name: str = ""
    period: float = 0.0
    memory: bool = False
    values: Array | None = None


class Averages(Protocol):
    """Averaged rows of a scene, which know what is late without all of its rows."""

    @property
    def simulated(self) -> Array:
        """(M, C) of what was simulated."""

    def average(self, x: Array) -> Array:
        """Return the averages (M, ...) of signals (N, ...)."""

    def late(self, x: Array, seconds: float, *, bowed: bool = False) -> Array:
        """Return the averages (M, ...) of signals (N, ...) that come later by seconds."""


class Words:
    """What is said of an effect to people: each kind in its own file."""

    SAYS: ClassVar[str] = ""
    """What it is; empty: the first line of its docstring."""
    KNOWN_BY: ClassVar[str] = "nothing else that was asked does the same"
    """By what it is told from others."""
    CONFIRMED_BY: ClassVar[str] = ""
    """A recording that would show it best."""
    REMOVED_BY: ClassVar[str] = ""
    """A motion without it, where people can take it away."""
    HEAD: ClassVar[tuple[str, ...]] = ()
    """Parameters that are named first, by regular expression; with none of them the size of the signal speaks."""
    RMS_TOLD: ClassVar[bool] = False
    """The size of its signal is told beside them."""
    ALIKE: ClassVar[Mapping[str, str]] = {}
    """Keys of look-alikes, and why the two cannot be told apart; each pair stands with one of them."""
    TOLD_APART: ClassVar[Mapping[str, str]] = {}
    """The same, and what would tell them apart where no motion that can be simulated does."""

    @classmethod
    def structural(cls, scene: Scene, parameters: Sequence[str]) -> list[str]:
        """Return keys of what no recording of this kind can tell from it, by names of parameters that were found."""
        del scene, parameters
        return []


class Traits(Words):
    """What an effect is like."""

    NEEDS_CLOCK: ClassVar[bool] = False
    DOWNSTREAM: ClassVar[bool] = False
    """It acts on what a stream delivers, after everything else, see `Downstream`."""
    BEHIND: ClassVar[tuple[str, ...]] = ()
    """Of downstream effects: keys of others through which its own change arrives; all others stand beside it."""
    CLOCK: ClassVar[bool] = False
    """Of downstream effects: a delay or filter through which all else arrives."""
    SHIFT: ClassVar[bool] = False
    """Of clocks: it delivers everything as it was, and later."""
    EPISODIC: ClassVar[bool] = False
    """Its parameters belong to moments of one recording and do not carry over to another."""
    THROUGHOUT: ClassVar[bool] = False
    """Of episodic effects: it is there all through its recording."""
    BRIEF: ClassVar[bool] = False
    """It acts in few rows only, which may all lie in one block."""
    COMPLEXITY: ClassVar[int] = 3
    """Of look-alikes that do nearly as well while the model still misses much, that with less goes first."""
    RIGID: ClassVar[bool] = False
    """A constant of the arm or its load; these stand for each other in twos and threes: an axis that is turned is the joint
    before it with another zero, and the sensor turned back."""
    MIMICS_RIGID: ClassVar[bool] = False
    """It may have been taken for one: a steady pull for a payload on a tilted arm, a gain for most of one on a single link."""
    FLEXIBLE: ClassVar[bool] = False
    """Its form bends enough to take what several constants of geometry or load do together."""
    LOAD_POWER: ClassVar[bool] = False
    """It goes with a power of its joint's load: of several, a sum bends as one likes."""
    PROVES: ClassVar[bool] = False
    """Its own parameters must say that it is what it is called, see `known` and `patches`."""
    CONSTANT: ClassVar[bool] = False
    """It is the constant of a channel: beside it no other is free."""
    WARMS: ClassVar[bool] = False
    """It may come from warmth, and shows as the machine warms and cools."""
    SIDE_BY_SIDE: ClassVar[bool] = False
    """Several of its kind may stand in one place."""
    READ_ORDER: ClassVar[float] = np.inf
    """Of what acts on a load as it is read, see `Effect.reads`: its place in the order in which the load meets them."""
    GEOMETRY_ORDER: ClassVar[float] = np.inf
    """Of what is wrong about how the arm stands: its place in the order in which each meets what those before have made of it."""
    MEETS_BODIES: ClassVar[bool] = True
    """Its change is another one where a body more hangs on the arm; not of inertia, which that body's own change has in it."""

    @classmethod
    def lasting(cls) -> bool:
        """Return whether it acts all along, and in another recording as in this one."""
        return not (cls.EPISODIC or cls.BRIEF)

    @classmethod
    def always_fitted(cls, predict: str) -> bool:
        """Return whether it is the constant of a channel of this group, which is in every model and judged at its end."""
        del predict
        return False

    @classmethod
    def fitted_as(cls, channel: str, predict: str) -> Self | None:
        """Return what the constant of a channel of this group is called where the baseline may have none; None: not this."""
        del channel, predict
        return None

    @classmethod
    def supposed(cls, channel: str) -> tuple[Self, float] | None:
        """Return what it would be in a channel whose driver was not recorded, and the supposed range of that driver."""
        del channel
        return None

    @property
    def touches(self) -> tuple[Span, ...]:
        """Episodes outside which it is nothing, each of which was found by itself and tells of its own numbers."""
        return ()

    def finer(self, time: Array) -> Iterator[Self]:
        """Yield it with an ever finer course in its episodes, as far as rows at times (M,), s, can bear."""
        yield from ()

    @property
    def jump(self) -> float | None:
        """The moment, s, from which all is otherwise; None where there is none."""
        return None

    def jumping(self, moment: float) -> Self:
        """Return the same jump at another moment, s."""
        del moment
        return self

    @property
    def single(self) -> tuple["Effect", ...]:
        """Each part by itself of what was asked together, as several jumps are that follow any slope; empty where it is one."""
        return ()

    def line(self, scene: Scene) -> Line | None:
        """Return the line of the spectrum that it is; None where it is none."""
        del scene
        return None

    def indistinct(self, other: "Effect", span: float) -> bool:
        """Return whether a recording so long (s) cannot tell it from another of its family."""
        del span
        return self == other

    @property
    def clips(self) -> tuple[str, float] | None:
        """The channel whose readings it holds back, and the limit beyond which they do not go; None where it is no limit."""
        return None

    def levelled(self, limit: float) -> Self:
        """Return the same at another limit."""
        del limit
        return self

    def at_limit(self, scene: Scene) -> NDArray[np.bool_]:
        """Return which rows (N,) all that its channel carries takes beyond the limit."""
        return np.zeros(len(scene), dtype=bool)

    @property
    def side(self) -> str:
        """A word for which of several in one place it is."""
        return ""

    def delivered(self, scene: Scene, columns: Columns, theta: Array) -> Columns:
        """Return what another effect does (`columns`), as it arrives behind this one with its parameters theta."""
        del scene, theta
        return columns

    def delivered_on(self, rows: Averages, scene: Scene, columns: Columns, theta: Array) -> Columns:
        """Return the same with its rows averaged: an effect may know a cheaper way than by all of them."""
        out = self.delivered(scene, columns, theta)
        return Columns(out.channels, rows.average(out.values))

    def shifted(self, rows: Averages, scene: Scene, theta: Array) -> Array | None:
        """Return the averaged change (M, C) of what delivers the simulated as it was, and later; None of all else."""
        del rows, scene, theta
        return None

    @property
    def complexity(self) -> int:
        """Of its kind, or of what it is of its kind."""
        return self.COMPLEXITY

    @property
    def interpolation(self) -> str:
        """Of clocks: what lies between two rows to it, see `BETWEEN`."""
        return ""

    def interpolated(self, between: str) -> Self:
        """Return the same with another interpolation between two rows."""
        del between
        return self

    def staged(self, start: float, length: float) -> Self:
        """Return the same in a recording that is still to be made, which begins at `start` and takes so long, s."""
        del start, length
        return self

    def growth(self, length: float) -> float:
        """Return how much larger its parameters are in a recording that takes so long, s."""
        del length
        return 1.0

    def again(self, start: float, length: float) -> tuple["Effect", ...]:
        """Return what is to be fitted anew for it to another recording; empty where it is as it was, or was once."""
        del start, length
        return ()

    def beginning(self, scene: Scene, theta: Array, others: Sequence["Effect"]) -> Beginning:
        """Return what it leaves open of the beginning of a recording, with parameters theta (k,) given others: it has memory."""
        del scene, theta, others
        return Beginning()

    def presumes(self, scene: Scene) -> bool:
        """Return whether it is there only for how the recording began, where any beginning is fitted: it is the same there."""
        del scene
        return False

    def follows(self, scene: Scene, channel: int) -> Follows | None:
        """Return what it is a function of in a channel; None where that is to be found out."""
        del scene, channel
        return None

    def known(self, theta: Array, spread: Array) -> bool:
        """Return whether its parameters (k,) say, by their standard deviations (k,), that it is what it is called."""
        del theta, spread
        return True

    def patches(self, others: Sequence["Effect"]) -> bool:
        """Return whether it is nothing by itself beside others, but what these miss."""
        del others
        return False

    def partners(self, scene: Scene) -> Iterator["Effect"]:
        """Yield what may be there beside it: asked only where it is in the model."""
        del scene
        yield from ()

    def starts(self, scene: Scene, theta: Array) -> list[tuple["Effect", Array]]:
        """Return what is sought from it with its parameters theta (k,), and parameters to begin the search with.

        Of what is loose the physics that it stands for; of what is curved itself, plain.
        """
        del scene, theta
        return []

    def richer_starts(self, scene: Scene, theta: Array) -> Iterator[list[tuple["Effect", Array]]]:
        """Yield form by form the same with more parameters, and where their search begins, of what is curved, at theta."""
        del scene, theta
        yield from ()

"""What an effect is: a named piece of physics, its linear parameters, and the few nonlinear ones that are searched."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import fields, replace
from typing import Any, ClassVar, Final, Self

import numpy as np

from galen_hw.physics.effects.columns import Columns
from galen_hw.physics.effects.parameters import Parameter, Searched
from galen_hw.physics.effects.traits import Traits
from galen_hw.physics.scenes.base import Scene
from galen_hw.spatial import Array

DOUBT: Final = 2.2
"""`Effect.doubt` where the proposals stand on a grid of octaves or so."""


LOADS: Final = ("wrench", "effort")
"""Groups whose channels are loads."""


class Effect(Traits, ABC):
    """One hypothesis of one kind: a frozen dataclass whose fields say where it acts and hold what is searched.

    The predicted change of the compared channels is `columns(scene) @ theta`, zero for theta = 0. Where physics is
    nonlinear in theta, `exact` gives the change itself and `columns` its slope at zero.
    """

    KEY: ClassVar[str] = ""
    SEARCHED: ClassVar[Mapping[str, Searched]] = {}

    @classmethod
    @abstractmethod
    def propose(cls, scene: Scene) -> Iterator[Self]:
        """Yield the hypotheses that this scene allows, one for every place and every value of the grid."""

    @classmethod
    def ahead(cls, scene: Scene, effects: Sequence[Self]) -> None:
        """Keep in the scene what many of one kind compute more quickly together, before their columns are asked."""
        del scene, effects

    @abstractmethod
    def parameters(self, scene: Scene) -> tuple[Parameter, ...]:
        """Return the linear parameters, in the order of the columns."""

    @abstractmethod
    def columns(self, scene: Scene) -> Columns:
        """Return the slope of the compared channels by the linear parameters at zero."""

    def averaged(self, scene: Scene, average: Callable[[Array], Array]) -> Columns:
        """Return the columns with rows averaged, (N, ...) to (M, ...): an effect may know a cheaper way than by all of them."""
        columns = self.columns(scene)
        return Columns(columns.channels, average(columns.values))

    def exact(self, scene: Scene, theta: Array) -> Array | None:
        """Return the change (N, C) for parameters theta (k,); None where `columns @ theta` is exact."""
        return None

    def bends(self, scene: Scene, theta: Array) -> bool:
        """Return whether `exact` gives a change: an effect may know without computing it."""
        return self.exact(scene, theta) is not None

    def change(self, scene: Scene, theta: Array) -> Array:
        """Return the change (N, C) for parameters theta (k,)."""
        exact = self.exact(scene, np.asarray(theta, dtype=float))
        if exact is not None:
            return exact
        columns = self.columns(scene)
        out = np.zeros((len(scene), len(scene.channels)))
        out[:, list(columns.channels)] = columns.values @ np.asarray(theta, dtype=float)
        return out

    def strides(self, scene: Scene, theta: Array) -> Array:
        """Return the steps (k,) of its parameters by which `exact` is differentiated around theta (k,)."""
        return np.full(len(theta), 1e-4 * max(float(np.max(np.abs(theta))), 1e-6))

    @property
    def joints(self) -> tuple[str, ...]:
        """Joints it sits in."""
        joint = getattr(self, "joint", "")
        return (joint,) if joint else ()

    @property
    def location(self) -> tuple[str, ...]:
        """Where it sits, and what it is: two in one place are rivals."""
        if self.SIDE_BY_SIDE:
            return (str(id(self)),)
        names = ("joint", "channel", "driver", "source", "place", "part", "axis", "upper")
        return (self.KEY, *(str(getattr(self, name, "")) for name in names), *map(str, getattr(self, "errors", ())))

    @property
    def swings(self) -> bool:
        """Of clocks: whether it answers with a frequency of its own."""
        return False

    @property
    def freedom(self) -> int | None:
        """Physical parameters where the columns are a relaxation with more; None: as many as columns."""
        return None

    @property
    def loose(self) -> bool:
        """Whether it stands for physics with fewer parameters that is sought from it; where none is found it owes all of them."""
        return False

    def pinned(self, scene: Scene) -> Array | None:
        """Return the one value (k,) that its linear parameters can have, nan for one that is free; None where all are."""
        if self.freedom != 0:
            return None
        return np.array([p.expected for p in self.parameters(scene)], dtype=float)

    @property
    def held(self) -> Array | None:
        """Values (k,) that its linear parameters have in a model, whatever the data say; None: they are fitted."""
        return None

    @property
    def family(self) -> tuple[Any, ...]:
        """What it is apart from the searched values: the same hypothesis at another point of the grid."""
        return (self.KEY, *((f.name, getattr(self, f.name)) for f in fields(self) if f.name not in self.SEARCHED))  # type: ignore[arg-type]

    def searched(self) -> dict[str, float]:
        """Return the values of the searched parameters that are in use."""
        return {name: getattr(self, name) for name in self.SEARCHED if getattr(self, name) is not None}

    def searched_unit(self, name: str) -> str:
        """Return the unit of a searched parameter, "rad or m" and its like where the joint says which."""
        return self.SEARCHED[name].unit

    def with_searched(self, values: Mapping[str, float]) -> Self:
        """Return the effect at another point of the search."""
        return replace(self, **values)  # type: ignore[type-var]

    def doubt(self, scene: Scene) -> float:
        """Return the factor, above 1, within which the optimum of a searched value is to be sought around a proposed one."""
        return DOUBT

    @property
    def contains(self) -> tuple[str, ...]:
        """Keys of the ends of a stream that are part of what it describes: its change does not go through them again."""
        return ()

    def reads(self, scene: Scene) -> bool:
        """Return whether it acts on a load as it is read, whatever makes it up: the changes of other effects too."""
        return False

    def body(self, scene: Scene, theta: Array) -> Array | None:
        """Return the inertial parameters (10,) that it hangs on the sensor, in the order of `Scene.body_port`; None: no body."""
        return None

    def stands(self, scene: Scene, theta: Array) -> Scene | None:
        """Return the scene with the corrected geometry, which other errors of geometry meet; None: they do not."""
        return None

    def at_work(self, scene: Scene) -> bool:
        """Return whether it is identifiable as named in this recording: friction that never breaks loose is but a lag."""
        return True

    def possible(self, scene: Scene, theta: Array, spread: Array) -> bool:
        """Return whether parameters (k,), or others within three standard errors `spread` (k,) of them, are real."""
        return True

    @property
    def remark(self) -> str:
        """A sentence on where it sits that the answer adds; empty where there is nothing to add."""
        return ""

    @property
    def wandering(self) -> tuple[str, ...]:
        """Channels whose slow movement it is."""
        return ()

    def unshaped(self, step: float) -> tuple["Effect", ...]:
        """Return what it may do besides, in no shape of its own, that must not pass for noise.

        Args:
            step: s, to which its moments are known; 0: to the row.
        """
        del step
        return ()

    @property
    def relaxed(self) -> Self:
        """The same with more parameters than its physics has, so that it is linear in them."""
        return self

    @property
    def curved(self) -> bool:
        """Return whether its slope at nothing says little of what it does elsewhere: it is settled step by damped step."""
        return False

    @property
    def stripped(self) -> Self:
        """The same without what a richer form of it adds."""
        return self

    @property
    def bound(self) -> bool:
        """Return whether a law between its parameters holds, as placed by `told_by`."""
        return False

    def told_by(self, theta: Array) -> Self | None:
        """Return the effect bound to a law between its parameters that these (k,) can place; None without one."""
        return None

    def richer(self, scene: Scene) -> Iterator[Self]:
        """Yield it with something more that is searched: asked only of an effect that is in the model as it is."""
        yield from ()

    def otherwise(self) -> Self | None:
        """Return the equivalent form with another reference, where other effects may make up for the difference, or None."""
        return None

    def unlimited(self) -> Self:
        """Return it without what keeps a search away from its look-alikes: what it may be, not what it would be called."""
        return self

    def to_term(self, scene: Scene, theta: Array) -> dict[str, Any]:
        """Return the effect with its parameters as a term of a tool's file: fields and linear parameters by name, SI units."""
        values: dict[str, Any] = {"group": scene.observations.predict}
        for f in fields(self):  # type: ignore[arg-type]
            value = getattr(self, f.name)
            if value is not None and value not in ("", np.inf):
                values[f.name] = _flat(value)
        named = zip(self.parameters(scene), np.asarray(theta, dtype=float), strict=True)
        return {"effect": self.KEY, "parameters": values | {p.name: float(v) for p, v in named}}

    @classmethod
    def from_term(cls, parameters: Mapping[str, Any]) -> Self:
        """Return the effect of a term's parameters; the linear ones are asked for by `theta_of`."""
        form = {}
        for f in fields(cls):  # type: ignore[arg-type]
            if f.name in parameters:
                value = parameters[f.name]
                separate = isinstance(value, str) and str(f.type).startswith("tuple[str")
                form[f.name] = tuple(value.split(" ")) if separate else _paired(value, str(f.type))
        return cls(**form)

    @classmethod
    def from_form(cls, form: Mapping[str, Any]) -> Self:
        """Return the effect of its own fields; lists become tuples again."""
        return cls(**{k: _frozen(v) for k, v in form.items()})

    def theta_of(self, scene: Scene, parameters: Mapping[str, Any]) -> Array:
        """Return the linear parameters (k,) of a term, in the order of the columns.

        Raises:
            KeyError: one is missing.
        """
        return np.array([float(parameters[p.name]) for p in self.parameters(scene)])


def _frozen(value: Any) -> Any:
    return tuple(_frozen(v) for v in value) if isinstance(value, list) else value


def _flat(value: Any) -> Any:
    """Return strings of a tuple joined by blanks, pairs of numbers laid flat: what a tool's file can hold."""
    if isinstance(value, tuple) and value and isinstance(value[0], str):
        return " ".join(value)
    if isinstance(value, tuple) and value and isinstance(value[0], tuple):
        return tuple(float(x) for pair in value for x in pair)
    return value


def _paired(value: Any, kind: str) -> Any:
    if isinstance(value, (list, tuple)):
        numbers = tuple(value)
        return tuple(zip(numbers[::2], numbers[1::2], strict=True)) if kind.startswith("tuple[tuple") else numbers
    return value


class Downstream(Effect):
    """An effect on everything that a stream delivers, other effects' changes included: a late clock, a reading that clips."""

    DOWNSTREAM = True

    @abstractmethod
    def delivered(self, scene: Scene, columns: Columns, theta: Array) -> Columns:
        """Return what another effect does, as it arrives."""

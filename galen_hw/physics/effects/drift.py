"""Offsets that move slowly: with the clock, or with a thermometer."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import ClassVar, Self

import numpy as np

from galen_hw.physics.effects.base import LOADS, Effect
from galen_hw.physics.effects.columns import Columns, in_channel, in_each
from galen_hw.physics.effects.parameters import Parameter, Searched, duration, log_grid, unit_of
from galen_hw.physics.effects.traits import Follows
from galen_hw.physics.scenes.base import Scene
from galen_hw.spatial import Array

WALK = 14
"""Of one that wanders as a walk does: down to what can be told from noise."""
WALKING = 6
"""Numbers that these are worth: a walk has one, its strength, and waves that are the smaller the quicker they are cost little.

Twice their log evidence, sum(1 + log(1 + (w / k)^2)) for noise with a corner at wave w = 10, is 34; a number of the usual kind
costs 5 to 8 of it.
"""


@dataclass(frozen=True)
class Drift(Effect):
    """The offset moves slowly: straight, r = a t / D; warm-up, r = a (1 - exp(-t / T)); wander, some half cosines over D.

    A wander has a few `waves` (half cosines over D, five as proposed), a walk all that are slower than noise, of which each
    quicker one is the smaller.
    A warm-up with a `second` constant is the sum of two: what is near the heat is warm before what is far from it.

    D is the length of the recording. Beyond it (a tool's file in the live services) a straight drift is carried on for as
    long again and a wander not at all, then both are held; a warm-up has an end of its own. Visible in any recording longer
    than the drift. Confused with temperature where none was measured, with gravity where the poses are ordered, and with
    the slow end of coloured noise. With `channels` it is the same form in several, each with amplitudes of its own: what
    warms or settles moves more than one zero.
    """

    KEY = "drift"
    SAYS = "the offset moves slowly with time"
    KNOWN_BY = "it follows the clock and not the arm"
    CONFIRMED_BY = "come back to one home pose every eight poses, in random order, and record a temperature"
    HEAD = ("change.*", "amplitude.*")
    ALIKE: ClassVar = {
        "temperature": "no temperature was recorded that could settle it",
        "creep": "both move slowly in one direction",
        "cable_drag": "the arm went through its poses in one order, so that time and place go together",
        "payload": "the poses were ordered so that gravity changes with time",
    }
    TOLD_APART: ClassVar = {"temperature": "log the temperature at the sensor while the machine warms up, at rest"}
    WARMS = True
    SEARCHED: ClassVar = {"constant": Searched(1e-2, 1e6, "s"), "second": Searched(1e-2, 1e6, "s")}
    EPISODIC = True
    THROUGHOUT = True
    channel: str = ""
    form: str = "linear"
    constant: float | None = None
    start: float = 0.0
    length: float = 1.0
    channels: tuple[str, ...] = ()
    second: float | None = None
    waves: int = 5

    @classmethod
    def propose(cls, scene: Scene, *, quickest: float = 5.0) -> Iterator[Self]:
        """Yield straight, warm-up and wander in every channel, none quicker than sensors are; without a clock over rows.

        None over recordings laid end to end: the clock between them is made up.

        Args:
            quickest: time constant (s) of the quickest drift: what warms in a sensor takes tens of seconds, and nothing
                else drifts quicker.
        """
        start, length = float(scene.time[0]), duration(scene)
        if length <= 0.0 or len(scene) < 12 or scene.observations.apart:
            return
        quickest = quickest if scene.clock else 0.0
        for name in scene.channels if length >= quickest else ():
            yield cls(name, "linear", None, start, length)
            for constant in log_grid(max(length / 30.0, quickest), length / 1.5, 5):
                yield cls(name, "warm_up", constant, start, length)
            if length >= cls.waves * quickest:
                yield cls(name, "wander", None, start, length)

    @classmethod
    def structural(cls, scene: Scene, parameters: Sequence[str]) -> list[str]:
        """Return what a thermometer would show."""
        return [] if scene.observations.has("temperature.") else ["temperature"]

    def staged(self, start: float, length: float) -> Self:
        """Return it over all of another recording."""
        return replace(self, start=start, length=length)

    def growth(self, length: float) -> float:
        """Return how much larger it is: a straight drift goes on."""
        return length / max(self.length, 1e-9) if self.form == "linear" else 1.0

    def again(self, start: float, length: float) -> tuple[Effect, ...]:
        """Return it begun anew; it may wander as well."""
        begun = self.staged(start, length)
        return (begun,) if begun.form == "wander" else (begun, replace(begun, form="wander", constant=None))

    def follows(self, scene: Scene, channel: int) -> Follows:
        """Return what it follows: time."""
        return Follows("time")

    @property
    def wandering(self) -> tuple[str, ...]:
        """All channels that it is in, where it wanders."""
        return self.channels or (self.channel,)

    @property
    def freedom(self) -> int | None:
        """Number of physical parameters of a random walk."""
        return WALKING if self.waves == WALK else None

    def richer(self, scene: Scene) -> Iterator[Self]:
        """Yield a quicker warm-up beside the one that stands for both, or a slower one."""
        if self.constant is not None and self.second is None:
            for quick, slow in ((0.3, 3.0), (0.1, 1.0), (1.0, 10.0)):
                yield replace(self, constant=quick * self.constant, second=slow * self.constant)

    def parameters(self, scene: Scene) -> tuple[Parameter, ...]:
        """Return the amplitudes over the whole recording."""
        one = "amplitude" if self.form == "warm_up" else "change"
        # A tool's file makes a float of every number.
        names = [f"cosine_{k}" for k in range(1, int(self.waves) + 1)] if self.form == "wander" else [one]
        names += ["amplitude_second"] if self.second is not None else []
        if not self.channels:
            return tuple(Parameter(name, unit_of(scene, self.channel)) for name in names)
        return tuple(Parameter(f"{name}_{c}", unit_of(scene, c)) for c in self.channels for name in names)

    def columns(self, scene: Scene) -> Columns:
        """Return the shapes by the clock, or by the row number without one."""
        return self.averaged(scene, lambda shapes: shapes)

    def averaged(self, scene: Scene, average: Callable[[Array], Array]) -> Columns:
        """Return the averaged shapes, which all channels share."""
        places = tuple(scene.channels.index(name) for name in self.channels or (self.channel,))
        return in_each(places, average(self.shapes(scene.time)))

    def shapes(self, time: Array) -> Array:
        """Return the shapes (N, n) that it can take at times (N,), s."""
        furthest = {"linear": 2.0 * self.length, "wander": self.length}.get(self.form, np.inf)
        t = np.clip(time - self.start, 0.0, furthest)
        if self.form == "wander":
            return np.stack([np.cos(np.pi * k * t / self.length) for k in range(1, int(self.waves) + 1)], axis=-1)
        if self.constant is not None:
            constants = [self.constant] if self.second is None else [self.constant, self.second]
            return np.stack([-np.expm1(-t / T) for T in constants], axis=-1)
        return (t / self.length)[:, None]


@dataclass(frozen=True)
class Temperature(Effect):
    """The offset follows a measured temperature: r = k (T - T0), T0 the first one.

    With the form "zero_and_span" the scale too, + s (T - T0) x with x the simulated channel: data sheets give both
    coefficients, and a screw that grows is longer where more of it is used. With a `constant` it follows as the sensor's body
    does where the thermometer hangs beside it: by a first-order lag. Visible where the temperature changes and not only with
    time. Confused with drift. With `channels` it is one thermometer in several, each with a coefficient of its own: what warms
    moves more than one zero.
    """

    KEY = "temperature"
    SAYS = "the offset follows the measured temperature"
    KNOWN_BY = "it follows the thermometer better than the clock"
    CONFIRMED_BY = "record a warm and a cold start with the arm at rest"
    HEAD = ("coefficient", "span")
    WARMS = True
    SEARCHED: ClassVar = {"constant": Searched(1e-2, 1e5, "s")}
    channel: str = ""
    place: str = ""
    reference: float = 0.0
    channels: tuple[str, ...] = ()
    constant: float | None = None
    form: str = "zero"

    @classmethod
    def propose(cls, scene: Scene) -> Iterator[Self]:
        """Yield every channel with every thermometer that moves, at once and later, its zero alone and its zero and scale."""
        length = duration(scene) if scene.clock else 0.0
        constants = (None, *log_grid(length / 30.0, length / 3.0, 3))
        for name, values in scene.observations.columns.items():
            if name.startswith("temperature.") and np.isfinite(values).all() and np.ptp(values) > 1e-6:
                for constant in constants:
                    start = float(values[0])
                    yield from (cls(channel, name, start, constant=constant) for channel in scene.channels)
                    if scene.observations.predict in (*LOADS, "position"):
                        scaled = (c for c, x in zip(scene.channels, scene.simulated.T, strict=True) if np.ptp(x) > 0.0)
                        yield from (
                            cls(channel, name, start, constant=constant, form="zero_and_span") for channel in scaled
                        )

    def parameters(self, scene: Scene) -> tuple[Parameter, ...]:
        """Return the offset per kelvin."""
        if not self.channels:
            zero = Parameter("coefficient", f"{unit_of(scene, self.channel)}/K")
            return (zero, Parameter("span", "1/K")) if self.form == "zero_and_span" else (zero,)
        return tuple(Parameter(f"coefficient_{name}", f"{unit_of(scene, name)}/K") for name in self.channels)

    def columns(self, scene: Scene) -> Columns:
        """Return the measured temperature less the reference."""
        places = tuple(scene.channels.index(name) for name in self.channels or (self.channel,))
        warmth = self.warmth(scene)
        if self.form == "zero_and_span":
            return in_channel(places[0], [warmth, warmth * scene.simulated[:, places[0]]])
        return in_each(places, warmth[:, None])

    @classmethod
    def supposed(cls, channel: str) -> tuple[Self, float]:
        """Return the effect and a range of ten kelvin."""
        return cls(channel, "temperature.sensor"), 10.0

    def staged(self, start: float, length: float) -> Self:
        """Return it by the thermometer at the sensor where it has none."""
        return replace(self, place=self.place or "temperature.sensor", reference=0.0)

    def follows(self, scene: Scene, channel: int) -> Follows:
        """Return what it follows: the thermometer."""
        return Follows("column", self.place)

    def warmth(self, scene: Scene) -> Array:
        """Return the kelvin (N,) over the reference, of the thermometer or of what follows it."""
        warmth = np.asarray(scene.observations.columns[self.place]) - self.reference
        return warmth if self.constant is None else scene.lag("warmth", warmth[:, None], self.constant)[:, 0]

"""Effects of a sensor's channels: offset, drift, temperature, scale, leaks and clipping."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from galen_hw.physics.effects.base import LOADS, Downstream, Effect
from galen_hw.physics.effects.columns import Columns, in_channel, in_each
from galen_hw.physics.effects.parameters import FARTHEST_SCALE, Parameter, Searched, duration, log_grid, unit_of
from galen_hw.physics.effects.traits import Follows
from galen_hw.physics.scenes.base import Scene
from galen_hw.spatial import Array


@dataclass(frozen=True)
class Bias(Effect):
    """A constant offset: r = b.

    Visible where the baseline does not fit offsets anyway. Confused with joint_offset (position), payload and base_tilt
    where the poses hardly differ.
    """

    KEY = "bias"
    SAYS = "a constant offset that the model does not hold"
    KNOWN_BY = "it stays the same through the whole recording"
    CONFIRMED_BY = "add poses with the sensor upside down"
    HEAD = ("offset",)
    ALIKE: ClassVar = {
        "joint_offset": "an offset of the reading and of the joint's zero look the same here",
        "link_geometry": "an arm that stands elsewhere and a tracker that is off read the same",
        "payload": "gravity hardly turns in the sensor",
    }
    TOLD_APART: ClassVar = {
        "link_geometry": "measure a mark on the base with the tracker: an arm that stands elsewhere moves it not",
        "joint_offset": "check the joint's zero against a mechanical mark; no motion of the arm can",
    }
    CONSTANT = True
    COMPLEXITY = 0
    channel: str

    @classmethod
    def always_fitted(cls, predict: str) -> bool:
        """In every group."""
        return True

    @classmethod
    def fitted_as(cls, channel: str, predict: str) -> Self | None:
        """Of all but positions, where it is the joint's zero."""
        return None if predict == "position" else cls(channel)

    @classmethod
    def structural(cls, scene: Scene, parameters: Sequence[str]) -> list[str]:
        """The zero of the joint that is read."""
        return ["joint_offset"] if scene.observations.predict == "position" else []

    def follows(self, scene: Scene, channel: int) -> Follows:
        """Nothing."""
        return Follows("time")

    @classmethod
    def propose(cls, scene: Scene) -> Iterator[Self]:
        """One a channel, unless offsets are free."""
        if not scene.belief.bias_free:
            yield from (cls(name) for name in scene.channels)

    def parameters(self, scene: Scene) -> tuple[Parameter, ...]:
        """The offset."""
        return (Parameter("offset", unit_of(scene, self.channel)),)

    def columns(self, scene: Scene) -> Columns:
        """Ones."""
        return in_channel(scene.channels.index(self.channel), [np.ones(len(scene))])


HALF_COSINES = 5
"""Of a wander, over the length of the recording."""
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

    A wander has a few `waves`, a walk all that are slower than noise, of which each quicker one is the smaller.
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
    waves: int = HALF_COSINES

    @classmethod
    def propose(cls, scene: Scene) -> Iterator[Self]:
        """Straight, warm-up and wander in every channel; over the row number where there is no clock.

        None over recordings laid end to end: the clock between them is made up.
        """
        start, length = float(scene.time[0]), duration(scene)
        if length <= 0.0 or len(scene) < 12 or scene.observations.apart:
            return
        for name in scene.channels:
            yield cls(name, "linear", None, start, length)
            for constant in log_grid(length / 30.0, length / 1.5, 5):
                yield cls(name, "warm_up", constant, start, length)
            yield cls(name, "wander", None, start, length)

    @classmethod
    def structural(cls, scene: Scene, parameters: Sequence[str]) -> list[str]:
        """What a thermometer would show."""
        return [] if scene.observations.has("temperature.") else ["temperature"]

    def staged(self, start: float, length: float) -> Self:
        """All of it, from there."""
        return replace(self, start=start, length=length)

    def growth(self, length: float) -> float:
        """A straight one goes on."""
        return length / max(self.length, 1e-9) if self.form == "linear" else 1.0

    def again(self, start: float, length: float) -> tuple[Effect, ...]:
        """It begins anew, and may wander as well."""
        begun = self.staged(start, length)
        return (begun,) if begun.form == "wander" else (begun, replace(begun, form="wander", constant=None))

    def follows(self, scene: Scene, channel: int) -> Follows:
        """The clock."""
        return Follows("time")

    @property
    def wandering(self) -> tuple[str, ...]:
        """Of all that it is in."""
        return self.channels or (self.channel,)

    @property
    def freedom(self) -> int | None:
        """Of a walk."""
        return WALKING if self.waves == WALK else None

    def richer(self, scene: Scene) -> Iterator[Self]:
        """A quicker warm-up beside the one that stands for both, or a slower one."""
        if self.constant is not None and self.second is None:
            for quick, slow in ((0.3, 3.0), (0.1, 1.0), (1.0, 10.0)):
                yield replace(self, constant=quick * self.constant, second=slow * self.constant)

    def parameters(self, scene: Scene) -> tuple[Parameter, ...]:
        """Amplitudes over the whole recording."""
        one = "amplitude" if self.form == "warm_up" else "change"
        # A tool's file makes a float of every number.
        names = [f"cosine_{k}" for k in range(1, int(self.waves) + 1)] if self.form == "wander" else [one]
        names += ["amplitude_second"] if self.second is not None else []
        if not self.channels:
            return tuple(Parameter(name, unit_of(scene, self.channel)) for name in names)
        return tuple(Parameter(f"{name}_{c}", unit_of(scene, c)) for c in self.channels for name in names)

    def columns(self, scene: Scene) -> Columns:
        """By the clock, or by the row number without one."""
        return self.averaged(scene, lambda shapes: shapes)

    def averaged(self, scene: Scene, average: Callable[[Array], Array]) -> Columns:
        """All channels share their shapes."""
        places = tuple(scene.channels.index(name) for name in self.channels or (self.channel,))
        return in_each(places, average(self.shapes(scene.time)))

    def shapes(self, time: Array) -> Array:
        """(N, n) the forms that it can take at times (N,), s."""
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

    With a `constant` it follows as the sensor's body does where the thermometer hangs beside it: by a first-order lag.
    Visible where the temperature changes and not only with time. Confused with drift. With `channels` it is one thermometer
    in several, each with a coefficient of its own: what warms moves more than one zero.
    """

    KEY = "temperature"
    SAYS = "the offset follows the measured temperature"
    KNOWN_BY = "it follows the thermometer better than the clock"
    CONFIRMED_BY = "record a warm and a cold start with the arm at rest"
    HEAD = ("coefficient",)
    WARMS = True
    SEARCHED: ClassVar = {"constant": Searched(1e-2, 1e5, "s")}
    channel: str = ""
    place: str = ""
    reference: float = 0.0
    channels: tuple[str, ...] = ()
    constant: float | None = None

    @classmethod
    def propose(cls, scene: Scene) -> Iterator[Self]:
        """Every channel with every thermometer that moves, at once and later."""
        length = duration(scene) if scene.clock else 0.0
        constants = (None, *log_grid(length / 30.0, length / 3.0, 3))
        for name, values in scene.observations.columns.items():
            if name.startswith("temperature.") and np.isfinite(values).all() and np.ptp(values) > 1e-6:
                for constant in constants:
                    start = float(values[0])
                    yield from (cls(channel, name, start, constant=constant) for channel in scene.channels)

    def parameters(self, scene: Scene) -> tuple[Parameter, ...]:
        """Offset per kelvin."""
        if not self.channels:
            return (Parameter("coefficient", f"{unit_of(scene, self.channel)}/K"),)
        return tuple(Parameter(f"coefficient_{name}", f"{unit_of(scene, name)}/K") for name in self.channels)

    def columns(self, scene: Scene) -> Columns:
        """Measured temperature less the reference."""
        places = tuple(scene.channels.index(name) for name in self.channels or (self.channel,))
        return in_each(places, self.warmth(scene)[:, None])

    @classmethod
    def supposed(cls, channel: str) -> tuple[Self, float]:
        """By ten kelvin."""
        return cls(channel, "temperature.sensor"), 10.0

    def staged(self, start: float, length: float) -> Self:
        """By the thermometer at the sensor where it has none."""
        return replace(self, place=self.place or "temperature.sensor", reference=0.0)

    def follows(self, scene: Scene, channel: int) -> Follows:
        """The thermometer."""
        return Follows("column", self.place)

    def warmth(self, scene: Scene) -> Array:
        """(N,) kelvin over the reference, of the thermometer or of what follows it."""
        warmth = np.asarray(scene.observations.columns[self.place]) - self.reference
        return warmth if self.constant is None else scene.lag("warmth", warmth[:, None], self.constant)[:, 0]


@dataclass(frozen=True)
class Gain(Effect):
    """One channel's scale is off: r = g w, w what is simulated in that channel.

    Visible where the channel's signal varies. Confused with payload (all channels by one factor), joint_scale (position).
    """

    KEY = "gain"
    SAYS = "the channel's scale is off"
    KNOWN_BY = "it is proportional to the channel's own signal"
    CONFIRMED_BY = "repeat the poses with a second, known mass"
    HEAD = ("gain_error",)
    ALIKE: ClassVar = {
        "payload": "more weight and a larger scale are proportional for one tool",
        "joint_scale": "the channel is nearly proportional to the joint's travel",
    }
    COMPLEXITY = 1
    MIMICS_RIGID = True
    channel: str

    @classmethod
    def propose(cls, scene: Scene) -> Iterator[Self]:
        """Every channel that varies; joint positions have `joint_scale` for it."""
        if scene.observations.predict == "position":
            return
        spread = np.nanstd(scene.simulated, axis=0)
        yield from (cls(name) for name, s in zip(scene.channels, spread, strict=True) if s > 0.0)

    def follows(self, scene: Scene, channel: int) -> Follows:
        """What the channel carries."""
        return Follows("signal")

    def reads(self, scene: Scene) -> bool:
        """All that the channel carries."""
        return scene.observations.predict in LOADS

    def parameters(self, scene: Scene) -> tuple[Parameter, ...]:
        """Relative error of the scale."""
        return (Parameter("gain_error", "1", furthest=FARTHEST_SCALE),)

    def columns(self, scene: Scene) -> Columns:
        """The simulated channel."""
        place = scene.channels.index(self.channel)
        return in_channel(place, [scene.simulated[:, place]])


@dataclass(frozen=True)
class CrossTalk(Effect):
    """One channel leaks into another: r_a = k w_b, an off-diagonal term of the calibration matrix.

    Visible where b varies otherwise than a. Confused with sensor_mounting (a skew matrix) and payload.
    """

    KEY = "cross_talk"
    SAYS = "another channel leaks into this one"
    KNOWN_BY = "it is proportional to the other channel's signal"
    CONFIRMED_BY = "repeat the poses with a second, known mass"
    HEAD = ("leak",)
    ALIKE: ClassVar = {
        "payload": "with one tool, weight that moves between channels can be its own or a leak",
        "sensor_mounting": "a turned sensor is a skew matrix of cross-talk",
    }
    FLEXIBLE = True
    channel: str
    source: str

    @classmethod
    def propose(cls, scene: Scene) -> Iterator[Self]:
        """Every ordered pair of channels of a wrench or of joint efforts."""
        if scene.observations.predict not in ("wrench", "effort"):
            return
        spread = np.nanstd(scene.simulated, axis=0)
        for a in scene.channels:
            for b, s in zip(scene.channels, spread, strict=True):
                if a != b and s > 0.0:
                    yield cls(a, b)

    def follows(self, scene: Scene, channel: int) -> Follows:
        """What the other channel carries."""
        return Follows("signal", self.source)

    def reads(self, scene: Scene) -> bool:
        """All that the channel carries."""
        return scene.observations.predict in LOADS

    def parameters(self, scene: Scene) -> tuple[Parameter, ...]:
        """The share that leaks."""
        a, b = unit_of(scene, self.channel), unit_of(scene, self.source)
        return (Parameter("leak", "1", furthest=FARTHEST_SCALE) if a == b else Parameter("leak", f"{a}/({b})"),)

    def columns(self, scene: Scene) -> Columns:
        """The other channel as simulated."""
        source = scene.simulated[:, scene.channels.index(self.source)]
        return in_channel(scene.channels.index(self.channel), [source])


@dataclass(frozen=True)
class Saturation(Downstream):
    """Readings clip: y = min(w, L) or max(w, L); the parameter is the share of the clipping that is seen (1 when it clips).

    Visible where the simulated channel goes beyond what was ever read. Confused with gain and hardening.
    """

    KEY = "saturation"
    SAYS = "the readings clip at a limit"
    KNOWN_BY = "readings pile up at the limit where the simulation goes on"
    HEAD = ("limit",)
    SEARCHED: ClassVar = {}
    BRIEF: ClassVar[bool] = True
    channel: str
    limit: float
    upper: bool

    @classmethod
    def propose(cls, scene: Scene) -> Iterator[Self]:
        """At the most extreme readings, where rows pile up there."""
        if scene.observations.predict == "targets":
            return
        for place, name in enumerate(scene.channels):
            y = scene.measured[:, place]
            y = y[np.isfinite(y)]
            for upper in (True, False):
                limit = clipping_level(y if upper else -y)
                if limit is not None:
                    yield cls(name, limit if upper else -limit, upper)

    @property
    def clips(self) -> tuple[str, float]:
        """Itself."""
        return self.channel, self.limit

    def levelled(self, limit: float) -> Self:
        """There."""
        return replace(self, limit=limit)

    @property
    def side(self) -> str:
        """Its end of the range."""
        return "high" if self.upper else "low"

    def follows(self, scene: Scene, channel: int) -> Follows:
        """What the channel carries."""
        return Follows("signal")

    def parameters(self, scene: Scene) -> tuple[Parameter, ...]:
        """The share of the clipping."""
        return (Parameter("share", "1", 0.0, expected=1.0),)

    def delivered(self, scene: Scene, columns: Columns, theta: Array) -> Columns:
        """Nothing of what another effect does in this channel while it clips."""
        place = scene.channels.index(self.channel)
        if place not in columns.channels or not columns.count:
            return columns
        clipped = self.at_limit(scene)
        values = columns.values.copy()
        values[clipped, columns.channels.index(place)] *= 1.0 - np.clip(theta[0], 0.0, 1.0)
        return Columns(columns.channels, values)

    def columns(self, scene: Scene) -> Columns:
        """What takes the reading back to the limit where it would be beyond it."""
        place = scene.channels.index(self.channel)
        shown = scene.simulated + scene.standing + (0.0 if self.channel in scene.limited else scene.carried)
        back = self.limit - shown[:, place]
        return in_channel(place, [np.where(self.at_limit(scene), back, 0.0)])

    def at_limit(self, scene: Scene) -> NDArray[np.bool_]:
        """(N,) rows in which all that the channel carries goes beyond the limit."""
        whole = (scene.simulated + scene.standing + scene.carried)[:, scene.channels.index(self.channel)]
        return np.asarray(whole > self.limit if self.upper else whole < self.limit)


def clipping_level(y: Array) -> float | None:
    """The limit at the upper end of readings (N,) if they pile up there, else None.

    A pile: the topmost narrow bin holds far more rows than the one below it; noise may lie on top of the limit.
    """
    if len(y) < 30 or np.ptp(y) == 0.0:
        return None
    top, span = float(np.max(y)), float(np.ptp(y))
    at_top = int(np.sum(y >= top - 1e-9 * span - 1e-12))
    if at_top >= max(5, 0.002 * len(y)) and np.sum(y >= top - 0.02 * span) < 3 * at_top:
        return top
    width = 0.04 * span
    counts = np.histogram(y, bins=np.arange(top - 6 * width, top + width / 2, width))[0][::-1]
    peak = int(np.argmax(counts[:3])) if len(counts) >= 5 else 0
    if (
        len(counts) < 5
        or counts[peak] < max(8, 0.02 * len(y))
        or counts[peak] < 2.5 * max(counts[peak + 1 : peak + 3].max(), 1)
    ):
        return None
    near = y[(y > top - (peak + 1) * width - width / 2)]
    return float(np.median(near))

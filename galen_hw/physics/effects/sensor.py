"""Effects of a sensor's channels: offset, scale, leaks and clipping."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from galen_hw.physics.effects.base import LOADS, Downstream, Effect
from galen_hw.physics.effects.columns import Columns, in_channel
from galen_hw.physics.effects.parameters import FARTHEST_SCALE, Parameter, unit_of
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
        """Return True: in every group."""
        return True

    @classmethod
    def fitted_as(cls, channel: str, predict: str) -> Self | None:
        """Return it for all but positions, where it is the joint's zero."""
        return None if predict == "position" else cls(channel)

    @classmethod
    def structural(cls, scene: Scene, parameters: Sequence[str]) -> list[str]:
        """Return the zero of the joint that is read."""
        return ["joint_offset"] if scene.observations.predict == "position" else []

    def follows(self, scene: Scene, channel: int) -> Follows:
        """Return what it follows: nothing but time."""
        return Follows("time")

    @classmethod
    def propose(cls, scene: Scene) -> Iterator[Self]:
        """Yield one a channel, unless offsets are free."""
        if not scene.belief.bias_free:
            yield from (cls(name) for name in scene.channels)

    def parameters(self, scene: Scene) -> tuple[Parameter, ...]:
        """Return the offset."""
        return (Parameter("offset", unit_of(scene, self.channel)),)

    def columns(self, scene: Scene) -> Columns:
        """Return a column of ones."""
        return in_channel(scene.channels.index(self.channel), [np.ones(len(scene))])


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
    READ_ORDER = 3
    channel: str

    @classmethod
    def propose(cls, scene: Scene) -> Iterator[Self]:
        """Yield every channel that varies; joint positions have `joint_scale` for it."""
        if scene.observations.predict == "position":
            return
        spread = np.nanstd(scene.simulated, axis=0)
        alive = (name for name, s in zip(scene.channels, spread, strict=True) if s > 0.0)
        yield from (cls(name) for name in alive if name not in scene.turned)

    def follows(self, scene: Scene, channel: int) -> Follows:
        """Return what it follows: the channel's own signal."""
        return Follows("signal")

    def reads(self, scene: Scene) -> bool:
        """Return whether it acts on all that the channel carries."""
        return scene.observations.predict in LOADS

    def parameters(self, scene: Scene) -> tuple[Parameter, ...]:
        """Return the relative error of the scale."""
        return (Parameter("gain_error", "1", furthest=FARTHEST_SCALE),)

    def columns(self, scene: Scene) -> Columns:
        """Return the simulated channel."""
        place = scene.channels.index(self.channel)
        return in_channel(place, [scene.simulated[:, place]])


@dataclass(frozen=True)
class CrossTalk(Effect):
    """One channel leaks into another: r_a = k w_b, an off-diagonal term of the calibration matrix; of positions coupled joints.

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
    READ_ORDER = 2
    channel: str
    source: str

    @classmethod
    def propose(cls, scene: Scene) -> Iterator[Self]:
        """Yield every ordered pair of channels of a wrench, of joints' efforts or of their positions.

        A source whose simulation goes by less than its readings scatter from row to row has no signal that could leak: multiples
        of thousands of it fit other physics.
        """
        if scene.observations.predict not in ("wrench", "effort", "position") or len(scene) < 2:
            return
        spread = np.nanstd(scene.simulated, axis=0)
        scatter = np.nan_to_num(np.nanmedian(np.abs(np.diff(scene.residual, axis=0)), axis=0))
        for a in scene.channels:
            for b, s, least in zip(scene.channels, spread, scatter, strict=True):
                if a != b and s > least:
                    yield cls(a, b)

    @property
    def remark(self) -> str:
        """A sentence on the other channel."""
        return f"What leaks into {self.channel} is {self.source}."

    def follows(self, scene: Scene, channel: int) -> Follows:
        """Return what it follows: the other channel's signal."""
        return Follows("signal", self.source)

    def reads(self, scene: Scene) -> bool:
        """Return whether it acts on all that the channel carries."""
        return scene.observations.predict in LOADS

    def parameters(self, scene: Scene) -> tuple[Parameter, ...]:
        """Return the share that leaks."""
        a, b = unit_of(scene, self.channel), unit_of(scene, self.source)
        return (Parameter("leak", "1", furthest=FARTHEST_SCALE) if a == b else Parameter("leak", f"{a}/({b})"),)

    def columns(self, scene: Scene) -> Columns:
        """Return the other channel as simulated."""
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
    BRIEF: ClassVar[bool] = True
    channel: str
    limit: float
    upper: bool

    @classmethod
    def propose(cls, scene: Scene) -> Iterator[Self]:
        """Yield the most extreme readings, where rows pile up there."""
        if scene.observations.predict == "targets":
            return
        for place, name in enumerate(scene.channels):
            if name in scene.turned:
                continue
            y = scene.measured[:, place]
            y = y[np.isfinite(y)]
            for upper in (True, False):
                limit = clipping_level(y if upper else -y)
                if limit is not None:
                    yield cls(name, limit if upper else -limit, upper)

    @property
    def clips(self) -> tuple[str, float]:
        """Its channel and its limit."""
        return self.channel, self.limit

    def levelled(self, limit: float) -> Self:
        """Return it with another limit."""
        return replace(self, limit=limit)

    @property
    def side(self) -> str:
        """A word for its end of the range."""
        return "high" if self.upper else "low"

    def follows(self, scene: Scene, channel: int) -> Follows:
        """Return what it follows: the channel's own signal."""
        return Follows("signal")

    def parameters(self, scene: Scene) -> tuple[Parameter, ...]:
        """Return the share of the clipping."""
        return (Parameter("share", "1", 0.0, expected=1.0),)

    def delivered(self, scene: Scene, columns: Columns, theta: Array) -> Columns:
        """Return what another effect does, nothing of it in this channel while it clips."""
        place = scene.channels.index(self.channel)
        if place not in columns.channels or not columns.count:
            return columns
        clipped = self.at_limit(scene)
        values = columns.values.copy()
        values[clipped, columns.channels.index(place)] *= 1.0 - np.clip(theta[0], 0.0, 1.0)
        return Columns(columns.channels, values)

    def columns(self, scene: Scene) -> Columns:
        """Return what takes the reading back to the limit where it would be beyond it."""
        place = scene.channels.index(self.channel)
        shown = scene.simulated + scene.standing + (0.0 if self.channel in scene.limited else scene.carried)
        back = self.limit - shown[:, place]
        return in_channel(place, [np.where(self.at_limit(scene), back, 0.0)])

    def at_limit(self, scene: Scene) -> NDArray[np.bool_]:
        """Return which rows (N,) all that the channel carries takes beyond the limit."""
        whole = (scene.simulated + scene.standing + scene.carried)[:, scene.channels.index(self.channel)]
        return np.asarray(whole > self.limit if self.upper else whole < self.limit)


def clipping_level(y: Array) -> float | None:
    """Return the limit at the upper end of readings (N,) if they pile up there, else None.

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

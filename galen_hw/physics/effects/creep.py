"""Slow settling after a change of load."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import ClassVar, Self

import numpy as np

from galen_hw.physics.channels import joint_of
from galen_hw.physics.effects.base import LOADS, Effect
from galen_hw.physics.effects.columns import Columns, in_all, in_channel, through
from galen_hw.physics.effects.drift import Drift
from galen_hw.physics.effects.parameters import FARTHEST_SCALE, Parameter, Searched, duration, log_grid
from galen_hw.physics.effects.traits import Follows
from galen_hw.physics.scenes.base import Scene
from galen_hw.physics.scenes.initial_state import Beginning, Lagging
from galen_hw.spatial import Array

KELVIN = 7
"""Elements by which a spectrum of constants is made up: over three decades two to a decade."""


@dataclass(frozen=True)
class Creep(Effect):
    """Slow settling after a change of load.

    T dz/dt = x - z; r = a z ("more" to come after the load, a Kelvin element in series with what the model has) or
    r = a (z - x) ("less" at first, as relaxation is seen by a calibrated sensor).

    x is a channel's simulated load (sensor), or the load of a joint (pose: the joint gives by a z). Settled at the start, or
    `rested`: the load comes on with the first row. What settles within a third of a second does not creep: that is a filter.
    With `spread` D it settles in no single time, as most matter does: z is the mean over constants from T / D to T D, evenly in
    their logarithm (the box spectrum of Nowick and Berry, Anelastic Relaxation, 1972, ch. 4, as `KELVIN` elements).
    Visible in rests of a few T after a change of load. Confused with lag (short T), compliance or gain (T below the rests) and
    drift.
    """

    KEY = "creep"
    SAYS = "it settles slowly after a change of load"
    KNOWN_BY = "it goes on settling while the load rests"
    CONFIRMED_BY = "hold a load for a minute after each change of load"
    HEAD = ("share", "compliance", "constant")
    ALIKE: ClassVar = {
        "hysteresis": "both remember the load; only rests of different length part them",
        "compliance": "nearly all rests are longer than the settling",
    }
    FLEXIBLE = True
    SEARCHED: ClassVar = {
        "constant": Searched(0.3, 1e4, "s"),
        "spread": Searched(1.2, 1e3, "1"),
    }
    NEEDS_CLOCK = True
    READ_ORDER = 1
    constant: float
    channel: str = ""
    joint: str = ""
    form: str = "more"
    longest: float = np.inf
    rested: bool = False
    spread: float | None = None

    @classmethod
    def propose(cls, scene: Scene) -> Iterator[Self]:
        """Yield time constants from half a second to a third of the recording; rested too where there is a load at the start."""
        longest = duration(scene) / 3.0
        if not scene.clock or longest <= 0.6:
            return
        for constant in log_grid(0.5, longest, 7):
            for form in ("more", "less"):
                for channel, joint in _bearing(scene):
                    yield cls(constant, channel, joint, form, longest)
                    if scene.observations.predict != "position" and _begun(scene, channel, joint):
                        yield cls(constant, channel, joint, form, longest, rested=True)

    @property
    def remark(self) -> str:
        """A sentence on how it began."""
        return "Its load came on as the recording began: nothing had settled." if self.rested else ""

    def at_work(self, scene: Scene, *, least: float = 1.05) -> bool:
        """Return whether it is slower than a filter: at the shortest constant it stands for something quicker.

        Args:
            least: times its shortest constant from which creep is creep.
        """
        return self.constant > least * self.SEARCHED["constant"].low

    def with_searched(self, values: Mapping[str, float]) -> Self:
        """Return it with another constant, not above the longest that this recording can tell from a compliance."""
        constant = min(values.get("constant", self.constant), self.longest)
        return replace(super().with_searched(values), constant=constant)

    def richer(self, scene: Scene) -> Iterator[Self]:
        """Yield many constants for one: over a decade, or over several."""
        if self.spread is None:
            yield from (replace(self, spread=ratio) for ratio in log_grid(3.0, 30.0, 3))

    def otherwise(self) -> Self:
        """Return it late for missing at first, or the reverse: a load read wrong all along makes one of the other."""
        return replace(self, form="less" if self.form == "more" else "more")

    def lags(self, scene: Scene) -> tuple[Lagging, ...]:
        """Return what may still have been settling: its time constant, and of many the shortest and the longest too."""
        spread = (1.0,) if self.spread is None else (1.0 / self.spread, 1.0, self.spread)
        places = () if self.joint else tuple(i for i, name in enumerate(scene.channels) if self.channel in ("", name))
        return tuple(Lagging(places, self.constant * ratio, self.joint) for ratio in spread)

    def beginning(self, scene: Scene, theta: Array, others: Sequence[Effect]) -> Beginning:
        """Return its lags where an offset fades as one not settled does: more may have been before than settled and rested."""
        alike = any(isinstance(one, Drift) and self._fades_with(one) for one in others)
        return Beginning(lags=self.lags(scene)) if alike else Beginning()

    def presumes(self, scene: Scene) -> bool:
        """Return whether it began rested, and any beginning as quick is fitted."""
        known = [(c, lag) for lag in scene.beginning.lags for c in lag.places]
        return self.rested and all(
            any(c == place and _as_quick(one.constant, lag.constant) for c, one in known)
            for lag in self.lags(scene)
            for place in lag.places
        )

    def _fades_with(self, drift: Drift) -> bool:
        if drift.constant is None or self.channel not in ("", drift.channel):
            return False
        return _as_quick(drift.constant, self.constant)

    def follows(self, scene: Scene, channel: int) -> Follows:
        """Return what it follows: time."""
        return Follows("time")

    def unlimited(self) -> Self:
        """Return it with any constant: what never settles here is a compliance to this recording, but creep may be there."""
        return replace(self, longest=np.inf)

    def reads(self, scene: Scene) -> bool:
        """Return whether it is the sensor's own."""
        return not self.joint and scene.observations.predict in LOADS

    def parameters(self, scene: Scene) -> tuple[Parameter, ...]:
        """Return the settled share of the load, or the compliance of the joint."""
        if self.joint and scene.observations.predict != "position":
            return (Parameter("compliance", scene.compliance_unit(self.joint)),)
        # What is missing at first by more than that is behind a filter: matter that gives so much is no part of a machine.
        return (Parameter("share", "1", furthest=FARTHEST_SCALE),)

    def columns(self, scene: Scene) -> Columns:
        """Return the load's slow part through its port."""
        if self.channel:
            place = scene.channels.index(self.channel)
            return in_channel(place, [self._slow(scene, scene.simulated[:, place])])
        if not self.joint:
            slow = self._settling(scene, scene.simulated)
            return in_all([slow if self.form == "more" else slow - scene.simulated], len(scene.channels))
        load = scene.load(self.joint)
        if load is None or scene.observations.predict == "position":
            load = scene.q[:, scene.joint_index(self.joint)]
        return through(scene, self.joint, [self._slow(scene, load)])

    def _slow(self, scene: Scene, x: Array) -> Array:
        slow = self._settling(scene, x[:, None])[:, 0]
        return slow if self.form == "more" else slow - x

    def _settling(self, scene: Scene, x: Array) -> Array:
        """Return what has settled (N, m) of loads (N, m)."""
        if self.spread is None:
            return scene.lag("creep", x, self.constant, empty=self.rested)
        each = self.constant * self.spread ** np.linspace(-1.0, 1.0, KELVIN)
        slow = [scene.lag(("creep", k), x, T, empty=self.rested) for k, T in enumerate(each.tolist())]
        return np.asarray(np.mean(slow, axis=0))


def _as_quick(one: float, other: float, *, ratio: float = 1.5) -> bool:
    """Return whether two time constants are as good as one.

    Args:
        ratio: of two time constants within which what fades may be what had not settled of a creep.
    """
    return bool(abs(np.log(one / other)) < np.log(ratio))


def _begun(scene: Scene, channel: str, joint: str, *, share: float = 0.1) -> bool:
    """Return whether what bears has a load at the start.

    Args:
        share: of its spread that a load is at the start, from which it matters whether it has settled.
    """
    load = scene.load(joint) if joint else scene.simulated[:, scene.channels.index(channel) if channel else slice(None)]
    return load is not None and bool(np.any(np.abs(load[0]) > share * np.nanstd(load, axis=0)))


def _bearing(scene: Scene) -> Iterator[tuple[str, str]]:
    """Yield (channel, "") of what bears load itself, ("", "") for a sensor's body as a whole, or ("", joint)."""
    if scene.observations.predict in ("pose", "targets"):
        yield from (("", joint) for joint in scene.joint_names if scene.load(joint) is not None)
    elif scene.observations.predict in ("wrench", "effort"):
        spread = np.nanstd(scene.simulated, axis=0)
        yield from ((name, "") for name, s in zip(scene.channels, spread, strict=True) if s > 0.0)
        if scene.observations.predict == "wrench" and np.all(spread > 0.0):
            yield "", ""
    else:
        yield from (("", joint_of(name)) for name in scene.channels)

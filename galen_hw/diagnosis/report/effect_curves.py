"""Each found effect's curve over the variable that it depends on, all other effects removed."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np

from galen_hw.diagnosis.findings.variables import Variable, variables
from galen_hw.diagnosis.report.caps import CAPS
from galen_hw.diagnosis.report.plot_data import Curve
from galen_hw.diagnosis.report.summary import channel_words
from galen_hw.diagnosis.work import Work
from galen_hw.physics.effects.base import Effect
from galen_hw.physics.effects.traits import Follows
from galen_hw.physics.scenes.base import Scene
from galen_hw.spatial import Array


@dataclass(frozen=True)
class Axis:
    """The horizontal axis of a curve."""

    label: str
    unit: str
    x: Array
    loop: bool = False


def curves_of(work: Work) -> list[Curve]:
    """Return one picture for every part of every effect, in its strongest channel."""
    model, residual, scene = work.model, work.model.residual(), work.bench.scene
    known = variables(work.bench)
    out: list[Curve] = []
    for h, s in zip(model.parts, model.slices(), strict=True):
        if h.effect is None or not h.count or len(out) == CAPS.curves:
            continue
        change = h.contribution(model.theta[s])
        best = int(np.argmax(np.std(change, axis=0) / work.bench.noise.sigma[list(h.raw.channels)]))
        c = h.raw.channels[best]
        axis = axis_of(work, h.effect, c, change[:, best], known)
        name = channel_words(scene.channels[c])
        place = ", ".join(h.effect.joints) or name
        data = change[:, best] + residual[:, c]
        title = f"{h.effect.KEY.replace('_', ' ')}, {place}"
        out.append(
            Curve(
                h.effect.KEY,
                title,
                axis.label,
                axis.unit,
                name,
                scene.units[c],
                axis.x,
                data,
                change[:, best],
                axis.loop,
            )
        )
    return out


def axis_of(work: Work, effect: Effect, channel: int, change: Array, known: list[Variable]) -> Axis:
    """Return the variable that an effect depends on, as an axis."""
    follows = effect.follows(work.bench.scene, channel)
    if follows is not None and follows.quantity == "time" and not follows.period:
        return _time(work)
    axis = None if follows is None else QUANTITIES[follows.quantity](_Along(work, effect, follows, channel))
    if axis is None and known:
        best = max(known, key=lambda v: _ordered(v.values, change) + 0.05 * v.name.endswith(".position"))
        axis = Axis(best.label, best.unit, best.values)
    return _time(work) if axis is None else axis


def _time(work: Work) -> Axis:
    scene = work.bench.scene
    return Axis("time" if scene.clock else "row", "s" if scene.clock else "", work.bench.time, True)


@dataclass(frozen=True)
class _Along:
    """The variable that an effect follows in a channel, as an axis of each quantity."""

    work: Work
    effect: Effect
    follows: Follows
    channel: int

    @property
    def scene(self) -> Scene:
        """Of the recording."""
        return self.work.bench.scene

    def average(self, x: Array) -> Array:
        """Return signals (N,) averaged on the bench's rows."""
        return self.work.bench.rows.average(x)

    def time(self) -> Axis:
        """Return the phase of a periodic effect."""
        return _folded("time", "s", self.work.bench.time, self.follows)

    def position(self) -> Axis:
        """Return the position of the joint that the effect follows."""
        joint = self.follows.name
        x, unit = self.average(self.scene.q[:, self.scene.joint_index(joint)]), self.scene.joint_units(joint)[0]
        return _folded(f"{joint} position", unit, x, self.follows)

    def speed(self) -> Axis | None:
        """Return the speed of its joint, or the force at the tip where none moves."""
        joint = self._moved()
        if joint is None:
            return self._force()
        speed = self.average(self.scene.rates[0][:, self.scene.joint_index(joint)])
        return Axis(f"{joint} speed", f"{self.scene.joint_units(joint)[0]}/s", speed)

    def load(self) -> Axis | None:
        """Return the load of the joint that it follows, or of its own, or the force at the tip where there is none."""
        joint, load = self.follows.name or self._moved(), self.follows.values
        if load is None and joint is not None:
            load = self.scene.load(joint)
        if joint is None or load is None:
            return self._force()
        return Axis(f"{joint} load", self.scene.joint_units(joint)[1], self.average(load), self.follows.memory)

    def column(self) -> Axis | None:
        """Return the thermometer that it follows."""
        name = self.follows.name
        known = self.scene.observations.columns.get(name)
        return None if known is None else Axis(name, "degC", self.average(np.asarray(known)))

    def signal(self) -> Axis:
        """Return the simulated signal, for scales, leaks and memories."""
        names = self.scene.channels
        source = names.index(self.follows.name) if self.follows.name in names else self.channel
        label, x = f"{channel_words(names[source])}, simulated", self.average(self.scene.simulated[:, source])
        return Axis(label, self.scene.units[source], x, self.follows.memory)

    def rate(self) -> Axis:
        """Return the rate of the simulated signal, for delays."""
        c = self.channel
        label = f"{channel_words(self.scene.channels[c])}, simulated rate"
        return Axis(label, f"{self.scene.units[c]}/s", self.average(self.scene.simulated_rate[:, c]))

    def _moved(self) -> str | None:
        """Return the first of its joints that moves."""
        return next((j for j in self.effect.joints if j in self.scene.moved), None)

    def _force(self) -> Axis | None:
        """Return the applied force along the channel's axis, for the structure's compliance."""
        name = f"applied.force.{self.scene.channels[self.channel].rsplit('.', 1)[-1]}"
        force = self.scene.observations.columns.get(name)
        if force is None or not np.isfinite(force).all():
            return None
        return Axis(name.replace(".", " "), "N", self.average(np.asarray(force)))


QUANTITIES: Final[dict[str, Callable[[_Along], Axis | None]]] = {
    "time": _Along.time,
    "position": _Along.position,
    "speed": _Along.speed,
    "load": _Along.load,
    "signal": _Along.signal,
    "rate": _Along.rate,
    "column": _Along.column,
}


def _folded(label: str, unit: str, x: Array, follows: Follows, *, most: float = 3.0) -> Axis:
    """Return a coordinate folded onto one period where it covers many.

    Args:
        most: periods; more are folded onto one.
    """
    if not follows.period or np.ptp(x) <= most * follows.period:
        return Axis(label, unit, x, follows.memory)
    return Axis(f"{label} within one period", unit, np.mod(x, follows.period))


def _ordered(x: Array, y: Array, bins: int = 24) -> float:
    """Return the share of y's variance that is a function of x (correlation ratio in bins of equal count)."""
    order = np.argsort(x)
    total = float(np.var(y))
    within = sum(float(np.sum((y[p] - y[p].mean()) ** 2)) for p in np.array_split(order, bins) if len(p))
    return 1.0 - within / max(total * len(y), 1e-300)

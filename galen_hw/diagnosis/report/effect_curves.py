"""Each found effect's own curve: against what it is a function of, all other effects taken off."""

from dataclasses import dataclass

import numpy as np

from galen_hw.diagnosis.findings.variables import Variable, joint_units, variables
from galen_hw.diagnosis.report.caps import CAPS
from galen_hw.diagnosis.report.plot_data import Curve
from galen_hw.diagnosis.report.summary import channel_words
from galen_hw.diagnosis.work import Work
from galen_hw.physics.effects.backlash import Backlash
from galen_hw.physics.effects.base import Effect
from galen_hw.physics.effects.events import Vibration
from galen_hw.physics.effects.friction import TorqueRipple
from galen_hw.physics.effects.sensor import CrossTalk, Temperature
from galen_hw.spatial import Array

OVER_TIME = ("drift", "step", "contact", "bias", "creep")
OVER_SPEED = ("friction",)
OVER_LOAD = ("compliance", "hardening")
OVER_SIGNAL = ("gain", "saturation")
OVER_RATE = ("time_delay", "lag")


@dataclass(frozen=True)
class Axis:
    """What stands along the horizontal axis."""

    label: str
    unit: str
    x: Array
    loop: bool = False


def curves_of(work: Work) -> list[Curve]:
    """One picture for every part of every effect, in its strongest channel."""
    model, rest, scene = work.model, work.model.rest(), work.bench.scene
    known = variables(work.bench)
    out: list[Curve] = []
    for h, s in zip(model.parts, model.slices(), strict=True):
        if h.effect is None or not h.count or len(out) == CAPS.curves:
            continue
        change = h.does(model.theta[s])
        best = int(np.argmax(np.std(change, axis=0) / work.bench.noise.sigma[list(h.raw.channels)]))
        c = h.raw.channels[best]
        axis = axis_of(work, h.effect, c, change[:, best], known)
        name = channel_words(scene.channels[c])
        place = ", ".join(h.effect.joints) or name
        data = change[:, best] + rest[:, c]
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
    """The variable that an effect is a function of."""
    key, over_time = effect.KEY, effect.KEY in OVER_TIME
    axis = _periodic(work, effect)
    if key in ("hysteresis", "backlash"):
        axis = _driver(work, effect, channel)
    elif key in (*OVER_SPEED, *OVER_LOAD):
        axis = _of_joint(work, effect) or _of_force(work, channel)
    elif key in (*OVER_SIGNAL, *OVER_RATE, "cross_talk", "temperature"):
        axis = _of_channel(work, effect, channel)
    if axis is None and not over_time and known:
        best = max(known, key=lambda v: _ordered(v.values, change) + 0.05 * v.name.endswith(".position"))
        axis = Axis(best.name.removeprefix("joint.").replace(".", " "), best.unit, best.values)
    return _time(work) if axis is None else axis


def _time(work: Work) -> Axis:
    scene = work.bench.scene
    return Axis("time" if scene.clock else "row", "s" if scene.clock else "", work.bench.rows.average(scene.time), True)


def _periodic(work: Work, effect: Effect) -> Axis | None:
    """What repeats, against the phase of its period."""
    scene, average = work.bench.scene, work.bench.rows.average
    if isinstance(effect, Vibration):
        return _folded("time", "s", average(scene.time), 1.0 / effect.frequency)
    if isinstance(effect, TorqueRipple) and effect.joint in scene.joint_names:
        x, unit = average(scene.q[:, scene.joint_index(effect.joint)]), joint_units(scene, effect.joint)[0]
        return _folded(f"{effect.joint} position", unit, x, 2.0 * np.pi / effect.wave_number)
    return None


def _of_joint(work: Work, effect: Effect) -> Axis | None:
    """Friction over the joint's speed, give over its load."""
    scene, average = work.bench.scene, work.bench.rows.average
    joint = next((j for j in effect.joints if j in scene.moved), None)
    if joint is None:
        return None
    unit, load_unit = joint_units(scene, joint)
    if effect.KEY in OVER_SPEED:
        return Axis(f"{joint} speed", f"{unit}/s", average(scene.rates[0][:, scene.joint_index(joint)]))
    load = scene.load(joint)
    return None if load is None else Axis(f"{joint} load", load_unit, average(load))


def _of_force(work: Work, channel: int) -> Axis | None:
    """The structure's give over the force along the channel's axis."""
    name = f"applied.force.{work.bench.scene.channels[channel].rsplit('.', 1)[-1]}"
    force = work.bench.scene.observations.columns.get(name)
    if force is None or not np.isfinite(force).all():
        return None
    return Axis(name.replace(".", " "), "N", work.bench.rows.average(np.asarray(force)))


def _of_channel(work: Work, effect: Effect, channel: int) -> Axis | None:
    """Scales and leaks over the simulated signal, delays over its rate, temperature over the thermometer."""
    scene, average = work.bench.scene, work.bench.rows.average
    if isinstance(effect, Temperature):
        known = scene.observations.columns.get(effect.place)
        return None if known is None else Axis(effect.place, "degC", average(np.asarray(known)))
    source = scene.channels.index(effect.source) if isinstance(effect, CrossTalk) else channel
    name, unit = channel_words(scene.channels[source]), scene.units[source]
    if effect.KEY in OVER_RATE:
        return Axis(f"{name}, simulated rate", f"{unit}/s", average(scene.simulated_rate[:, source]))
    return Axis(f"{name}, simulated", unit, average(scene.simulated[:, source]))


def _folded(label: str, unit: str, x: Array, period: float, *, most: float = 3.0) -> Axis:
    """A coordinate folded onto one period where it goes through many.

    Args:
        most: periods; more are folded onto one.
    """
    if np.ptp(x) <= most * period:
        return Axis(label, unit, x)
    return Axis(f"{label} within one period", unit, np.mod(x, period))


def _driver(work: Work, effect: Effect, channel: int) -> Axis:
    """What a memory remembers: a joint's position or load, or the simulated channel."""
    scene, average = work.bench.scene, work.bench.rows.average
    kind, _, joint = getattr(effect, "driver", f"joint:{getattr(effect, 'joint', '')}").partition(":")
    load = scene.load(joint) if kind == "load" else None
    if isinstance(effect, Backlash) and effect.half_width is None:
        load = effect.load(scene)
    if load is not None:
        return Axis(f"{joint} load", joint_units(scene, joint)[1], average(load), loop=True)
    if joint in scene.joint_names:
        x = average(scene.q[:, scene.joint_index(joint)])
        return Axis(f"{joint} position", joint_units(scene, joint)[0], x, loop=True)
    label = f"{channel_words(scene.channels[channel])}, simulated"
    return Axis(label, scene.units[channel], average(scene.simulated[:, channel]), loop=True)


def _ordered(x: Array, y: Array, bins: int = 24) -> float:
    """Share of the variance of y that is a function of x (correlation ratio in bins of equal count)."""
    order = np.argsort(x)
    total = float(np.var(y))
    within = sum(float(np.sum((y[p] - y[p].mean()) ** 2)) for p in np.array_split(order, bins) if len(p))
    return 1.0 - within / max(total * len(y), 1e-300)

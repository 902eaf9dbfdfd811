"""Memory of load or motion, whatever the speed."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import ClassVar, Self

import numpy as np

from galen_hw.physics.channels import joint_of
from galen_hw.physics.effects.base import LOADS, Effect
from galen_hw.physics.effects.columns import Columns, in_channel, through
from galen_hw.physics.effects.parameters import Parameter, Searched, log_grid
from galen_hw.physics.effects.traits import Follows
from galen_hw.physics.scenes.base import Scene
from galen_hw.spatial import Array


@dataclass(frozen=True)
class Hysteresis(Effect):
    """Rate-independent memory: Prandtl-Ishlinskii, r = sum_i a_i (P_{r_i}[x] - x), P_r the play operator of half width r.

    With `form` "more" r = sum_i a_i P_{r_i}[x], of weights of one sign: what a load leaves comes on top of it, and is not what
    is missing of it. A gain is the difference of the two.

    x is the simulated channel (a sensor's load, a joint's position) or a joint's position or load; widths r_i are shares
    `widths` of the amplitude `scale`. The same sum is a set of Maxwell slip elements. Without a `channel` it moves the arm
    through the port of the joint that drives it: friction beside the joint's spring (of load), a gear's memory (of motion).

    With `reach`: one element that sticks over +- reach and then slips, r = f e + g d(e), e = (x - P_reach[x]) / reach, with
    play in series: d is a dead zone of +- `gap` (a share of the reach), scaled to 1 where it slips (Kuhnen 2003, modified
    Prandtl-Ishlinskii). `linear` adds a spring and a damper, which stand for what a linear simulation made of the loop.

    With `wear` the loop's slope wears off over the reach: Bouc-Wen in the place of plays, of which no sum turns round so.

    Visible at reversals; confused with backlash (one width), Coulomb friction (very small widths), and creep.
    """

    KEY = "hysteresis"
    SAYS = "it remembers past load or motion, whatever the speed"
    KNOWN_BY = "it depends on where the motion turned round and not on how quick it was"
    CONFIRMED_BY = "sweep one joint slowly to and fro with small and with large reversals"
    RMS_TOLD = True
    ALIKE: ClassVar = {
        "backlash": "play is one element of a hysteresis",
        "friction": "friction with presliding is a hysteresis of motion",
    }
    TOLD_APART: ClassVar = {
        "friction": "sweep the joint slowly to and fro with ever smaller reversals, the servo off",
        "backlash": "sweep the joint slowly to and fro with ever smaller reversals",
    }
    FLEXIBLE = True
    SEARCHED: ClassVar = {
        "reach": Searched(1e-7, 10.0, "rad or m"),
        "gap": Searched(0.02, 0.95, "1"),
        "wear": Searched(0.1, 1.0, "1"),
    }
    READ_ORDER = 0
    channel: str = ""
    driver: str = ""
    scale: float = 1.0
    widths: tuple[float, ...] = (0.04, 0.12, 0.3, 0.6)
    linear: bool = False
    reach: float | None = None
    gap: float | None = None
    form: str = "less"
    wear: float | None = None

    @classmethod
    def structural(cls, scene: Scene, parameters: Sequence[str]) -> list[str]:
        """Return what holds a servo back at a reversal."""
        return ["friction", "backlash"] if scene.observations.predict == "position" else []

    @classmethod
    def propose(cls, scene: Scene) -> Iterator[Self]:
        """Yield elements of each channel's own simulated signal; of a joint's motion or load for what that joint carries."""
        if scene.observations.predict in ("pose", "targets"):
            yield from cls._through_joints(scene)
            return
        for name in scene.channels:
            for driver in _drivers(scene, name):
                scale = 0.5 * float(np.ptp(_signal(scene, driver)))
                if scale > 0.0:
                    yield cls(name, driver, scale)
                    yield cls(name, driver, scale, (0.12,))
                    if driver == name:
                        yield cls(name, driver, scale, form="more")
                        if scene.observations.predict in LOADS:
                            # A loop of the joint that turns the load is so like it that it must not come first.
                            yield from cls(name, driver, scale).richer(scene)
                    if scene.observations.predict == "effort" and scene.belief.robot is None:
                        yield cls(name, driver, scale, linear=True)
                        yield from cls._slipping(name, driver, scale)

    @classmethod
    def of_load(cls, joint: str, widths: Iterable[float]) -> Self:
        """Return friction beside a port's spring: one Maxwell slip element a width (N or N m) on the port's load."""
        return cls("", f"load:{joint}", 1.0, tuple(widths))

    @classmethod
    def _through_joints(cls, scene: Scene) -> Iterator[Self]:
        """Yield one sharp element of searched width, and a spectrum, of every joint's load and motion."""
        for joint in scene.joint_names:
            if scene.joint_port(joint) is None:
                continue
            drivers = [f"load:{joint}"] if scene.load(joint) is not None else []
            drivers += [f"joint:{joint}"] if joint in scene.moved else []
            for driver in drivers:
                scale = 0.5 * float(np.ptp(_signal(scene, driver)))
                if scale > 0.0:
                    yield cls("", driver, scale)
                    if driver.startswith("load:"):
                        yield from (
                            cls("", driver, scale, (), reach=r) for r in log_grid(0.01 * scale, 0.95 * scale, 7)
                        )

    @classmethod
    def _slipping(cls, name: str, driver: str, scale: float) -> Iterator[Self]:
        """Yield one sticking and slipping element, without and with play in series."""
        for reach in log_grid(0.03 * scale, 0.6 * scale, 5):
            yield from (cls(name, driver, scale, (), linear=True, reach=reach, gap=gap) for gap in (None, 0.3, 0.6))

    def searched_unit(self, name: str) -> str:
        """Return the unit of what drives it, a motion or a load."""
        if name == "reach" and not self.driver.startswith("joint"):
            return "N m or N"
        return super().searched_unit(name)

    def follows(self, scene: Scene, channel: int) -> Follows:
        """Return what it follows: what drives it, with another way back."""
        kind, _, joint = self.driver.partition(":")
        if kind == "load" and scene.load(joint) is not None:
            return Follows("load", joint, memory=True)
        if joint in scene.joint_names:
            return Follows("position", joint, memory=True)
        return Follows("signal", memory=True)

    @property
    def joints(self) -> tuple[str, ...]:
        """The joint that drives it."""
        own = joint_of(self.channel)
        return (self.driver.split(":", 1)[1],) if ":" in self.driver else ((own,) if own else ())

    def richer(self, scene: Scene) -> Iterator[Self]:
        """Yield a slope that wears off, which turns round otherwise than plays."""
        if self.reach is None and self.form == "less" and len(self.widths) > 1:
            for share in log_grid(0.03, 0.6, 4):
                yield from (replace(self, reach=share * self.scale, wear=shape) for shape in (0.5, 1.0))

    def otherwise(self) -> Self | None:
        """Return what comes on top of a load for what is missing of it, or the reverse: a gain makes one of the other."""
        if not self.channel or self.driver != self.channel or self.reach is not None or len(self.widths) == 1:
            return None
        return replace(self, form="less" if self.form == "more" else "more")

    def possible(self, scene: Scene, theta: Array, spread: Array) -> bool:
        """Return whether plays on top have weights of one sign: else one of them is a gain, and the others are missing of it."""
        if self.form == "less":
            return True
        sign = np.sign(np.sum(theta))
        return bool(np.all(sign * theta + 3.0 * spread >= 0.0))

    def reads(self, scene: Scene) -> bool:
        """Return whether it is the sensor's own."""
        return self.channel != "" and self.driver == self.channel and scene.observations.predict in LOADS

    def parameters(self, scene: Scene) -> tuple[Parameter, ...]:
        """Return the weights of the operators."""
        own = scene.units[scene.channels.index(self.channel)] if self.channel else "rad or m"
        if self.wear is not None:
            return (Parameter("height", own),)
        unit = "1" if self.driver == self.channel else f"{own}/unit"
        slip = [] if self.reach is None else [Parameter("stick_force", own)]
        slip += [] if self.gap is None else [Parameter("closed_gap_force", own)]
        rates = [Parameter("stiffness", unit), Parameter("damping", f"{unit} s")] if self.linear else []
        return (*(Parameter(f"weight_{r * self.scale:.4g}", unit) for r in self.widths), *slip, *rates)

    def columns(self, scene: Scene) -> Columns:
        """Return play, less its input or as it is, one column a width; or the one loop whose slope wears off."""
        x = _signal(scene, self.driver)[:, None]
        if self.wear is not None and self.reach is not None:
            out = [scene.wear("wear", x[:, 0], self.reach, self.wear)]
        else:
            out = self._plays(scene, x)
        if self.channel:
            return in_channel(scene.channels.index(self.channel), out)
        return through(scene, self.joints[0], out)

    def _plays(self, scene: Scene, x: Array) -> list[Array]:
        """Return the plays of what drives it (N, 1), and what else stands beside them."""
        r = np.asarray(self.widths) * self.scale
        wide = np.repeat(x, len(r), axis=1)
        start = scene.resting(self.channel) if self.channel and self.driver == self.channel else None
        play = scene.play("hysteresis", wide, r, None if start is None else np.repeat(start, len(r), axis=1))
        out = list((play if self.form == "more" else play - wide).T)
        if self.reach is not None:
            out += self._slip(scene, x, self.reach)
        if self.linear:
            joint = scene.joint_index(self.driver.split(":", 1)[1])
            out += [x[:, 0], scene.rates[0][:, joint]]
        return out

    def _slip(self, scene: Scene, x: Array, reach: float) -> list[Array]:
        e = (x - scene.play("slip", x, reach))[:, 0] / reach
        if self.gap is None:
            return [e]
        return [e, np.sign(e) * np.maximum(np.abs(e) - self.gap, 0.0) / (1.0 - self.gap)]


def _drivers(scene: Scene, channel: str) -> list[str]:
    group, place = scene.observations.predict, scene.channels.index(channel)
    if group == "effort":
        return [f"joint:{joint_of(channel)}"] if joint_of(channel) in scene.moved else []
    own = [channel] if channel not in scene.turned and np.nanstd(scene.simulated[:, place]) > 0.0 else []
    return own + ([f"joint:{j}" for j in scene.moved] if group == "wrench" else [])


def _signal(scene: Scene, driver: str) -> Array:
    kind, _, joint = driver.partition(":")
    if kind == "joint":
        return np.asarray(scene.q[:, scene.joint_index(joint)])
    if kind == "load":
        load = scene.load(joint)
        return np.zeros(len(scene)) if load is None else load
    return np.asarray(scene.simulated[:, scene.channels.index(driver)])

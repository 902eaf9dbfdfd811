"""Give under load: compliance, and stiffness that changes with load."""

import re
from collections.abc import Iterator
from dataclasses import dataclass
from typing import ClassVar, Self

import numpy as np

from galen_hw.physics.channels import joint_of
from galen_hw.physics.effects.base import Effect
from galen_hw.physics.effects.columns import Columns, in_all, through
from galen_hw.physics.effects.parameters import Parameter, Searched, log_grid
from galen_hw.physics.effects.traits import Follows
from galen_hw.physics.scenes.base import Scene
from galen_hw.physics.scenes.joint import PositionScene
from galen_hw.physics.scenes.pose import ArmScene
from galen_hw.spatial import Array

LOAD_WORDS = ("load", "torque", "force", "effort", "current", "duty", "pwm")
"""Words in the name of a covariate that is what a motor gives: the registers of servos, in units of their own."""


@dataclass(frozen=True)
class Compliance(Effect):
    """Elastic give under load.

    A joint by c times its load, q' = q + c tau ("joint"); the structure along the base's axes ("structure") or the tool along
    the sensor's ("tool") by c times the force there; what the arm stands on, which tilts about the base's x and y by c times
    the moment of all weights and forces about its origin ("base"); `source` says whose load it is: the "applied" force's or that
    of "all" it bears, what hangs on the arm included (of a joint also that "weight" alone, or its "own": that and the weight of
    the arm's links); in positions without a model of the weights, the sag of what hangs on the joint under its own weight, a sin
    + b cos of the angle against the vertical of the link beyond it, the sum of the joints from `first` on that turn about
    parallel axes; `links` more of the chain each with their own ("weight"). A servo that is told to stand and is pulled, by c
    times what its load register says ("loop").

    Visible when the load changes otherwise than with motion. Confused with time_delay where load follows speed, with
    joint_offset for a constant load, with creep, hardening and payload.
    """

    KEY = "compliance"
    SAYS = "elastic give under load, own weight included"
    KNOWN_BY = "it is proportional to the load"
    CONFIRMED_BY = "load the tip with three known weights in three directions"
    HEAD = ("compliance.*",)
    ALIKE: ClassVar = {"hardening": "over this range of load the stiffness hardly changes"}
    LOAD_POWER = True
    form: str = "joint"
    joint: str = ""
    source: str = "all"
    first: str = ""
    links: int = 1

    @property
    def location(self) -> tuple[str, ...]:
        """Where it sits and its form: a joint and a structure may give side by side."""
        return (*super().location, self.form)

    @property
    def complexity(self) -> int:
        """Return more of what the arm stands on than of a joint: of an arm in a plane its tilt is the first joint's give."""
        return self.COMPLEXITY + (self.form == "base")

    def follows(self, scene: Scene, channel: int) -> Follows:
        """Return what it follows: its load."""
        return (
            Follows("load", self.joint, values=_load(scene, self.joint, "own"))
            if self.source == "own"
            else Follows("load")
        )

    @classmethod
    def propose(cls, scene: Scene) -> Iterator[Self]:
        """Yield every joint that bears load; the structure where a force on the tip is known."""
        for joint in scene.joint_names:
            if scene.joint_port(joint) is None:
                continue
            if isinstance(scene, ArmScene) and (own := scene.own_load(joint)) is not None and np.ptp(own) > 0.0:
                yield cls("joint", joint, "own")
            if _bears(scene, joint):
                yield cls("joint", joint)
                if isinstance(scene, ArmScene) and scene.belief.hanging and np.any(scene.force):
                    yield cls("joint", joint, "applied")
                    yield cls("joint", joint, "weight")
        if isinstance(scene, ArmScene) and scene.base_ports() is not None:
            yield cls("base")
        if isinstance(scene, ArmScene) and np.any(scene.force) and scene.observations.predict == "pose":
            for form in ("structure", "tool"):
                yield cls(form)
                if scene.belief.hanging:
                    yield cls(form, "", "applied")
        if isinstance(scene, PositionScene) and scene.belief.robot is None:
            yield from cls._sagging(scene)
            yield from cls._pulled(scene)

    @classmethod
    def _pulled(cls, scene: Scene) -> Iterator[Self]:
        """Yield one joint that nobody moves: beside a motion a load is its consequence."""
        if scene.moved or len(scene.channels) != 1 or np.ptp(scene.simulated[:, 0]) > 0.0:
            return
        for name, values in scene.observations.columns.items():
            words = re.split(r"[._]", name.lower())
            if words[0] == "covariate" and not set(LOAD_WORDS).isdisjoint(words) and np.ptp(values) > 0.0:
                yield cls("loop", joint_of(scene.channels[0]), name)

    @classmethod
    def _sagging(cls, scene: Scene) -> Iterator[Self]:
        names = [joint_of(name) for name in scene.channels]
        for i, joint in enumerate(names):
            for first in names[max(0, i - 2) : i + 1]:
                if not _bears(scene, joint):
                    yield from (
                        cls("weight", joint, "all", first, links) for links in (1, 2) if i + links <= len(names)
                    )

    def parameters(self, scene: Scene) -> tuple[Parameter, ...]:
        """Return the compliance per load."""
        if self.form == "weight":
            return tuple(Parameter(f"{f}_{link}", "rad") for link in self._links(scene) for f in ("sin", "cos"))
        if self.form == "loop":
            return (Parameter("compliance", f"{scene.units[0]} a unit"),)
        if self.form == "base":
            return tuple(Parameter(f"compliance_base_{letter}", "rad/(N m)") for letter in "xy")
        if self.form != "joint":
            return tuple(Parameter(f"compliance_{letter}", "m/N") for letter in "xyz")
        return (Parameter("compliance", scene.compliance_unit(self.joint)),)

    def _links(self, scene: Scene) -> list[str]:
        names = [joint_of(name) for name in scene.channels]
        return names[names.index(self.joint) :][: self.links]

    def columns(self, scene: Scene) -> Columns:
        """Return the load through the joint's port, or the force along axes."""
        width = len(scene.channels)
        if self.form == "weight":
            return self._sag(scene)
        if self.form == "loop":
            return Columns((0,), np.asarray(scene.observations.columns[self.source], dtype=float)[:, None, None])
        if self.form == "joint":
            load = _load(scene, self.joint, self.source)
            assert load is not None, "proposed only where there is a load"
            return through(scene, self.joint, [load])
        assert isinstance(scene, ArmScene), "proposed only for poses"
        if self.form == "base":
            return in_all(scene.base_ports() or [], width)
        frame = np.tile(np.eye(3), (len(scene), 1, 1)) if self.form == "structure" else scene.T_sensor[:, :3, :3]
        out, force = [], scene.force + scene.weight if self.source == "all" else scene.force
        for axis in range(3):
            along = frame[:, :, axis]
            move = along * np.sum(along * force, axis=1, keepdims=True)
            out.append(np.concatenate([move, np.zeros((len(scene), width - 3))], axis=1))
        return in_all(out, width)

    def _sag(self, scene: Scene) -> Columns:
        names = [joint_of(name) for name in scene.channels]
        start, out = names.index(self.first), []
        for link in self._links(scene):
            angle = sum(scene.q[:, scene.joint_index(name)] for name in names[start : names.index(link) + 1])
            out += [np.sin(angle), np.cos(angle)]
        values = np.stack(out, axis=-1)[:, None, :]
        return Columns((names.index(self.joint),), values)


@dataclass(frozen=True)
class Hardening(Effect):
    """Stiffness grows or falls with load: q' = q + c tau |tau| or q + c tau^3; without a model, r = c x^3 of the joint's travel.

    With a `knee` t the stiffness is k (1 + |tau| / t), which grows in proportion to the load: of the linear give the part
    q' = q + c tau (|tau| / t) / (1 + |tau| / t) is missing (Johnson, Contact Mechanics, ch. 4: joints in contact stiffen so).

    Visible over a wide range of load. Nested with compliance, with which it is confused at small load and far above the knee.
    """

    KEY = "hardening"
    SAYS = "stiffness changes with load"
    KNOWN_BY = "it grows faster than the load"
    CONFIRMED_BY = "load the tip with three known weights, the heaviest near the limit"
    LOAD_POWER = True
    SEARCHED: ClassVar = {"knee": Searched(1e-9, 1e6, "N m or N")}
    joint: str
    power: int = 3
    knee: float | None = None

    @classmethod
    def propose(cls, scene: Scene) -> Iterator[Self]:
        """Yield every joint that bears load, or that an unknown device moves; a knee where a linear compliance is believed."""
        for joint in scene.joint_names:
            free = scene.observations.predict == "effort" and scene.belief.robot is None and joint in scene.moved
            if free or (_bears(scene, joint) and scene.joint_port(joint) is not None):
                yield from (cls(joint, power) for power in (2, 3))
                load = scene.load(joint)
                if load is not None and scene.belief.compliance.get(joint):
                    size = float(np.max(np.abs(load)))
                    yield from (cls(joint, 2, knee) for knee in log_grid(0.05 * size, 2.0 * size, 4))

    def parameters(self, scene: Scene) -> tuple[Parameter, ...]:
        """Return the compliance per power of the load."""
        if self.knee is not None:
            return (Parameter("compliance", scene.compliance_unit(self.joint)),)
        return (Parameter("coefficient", f"rad or m/(load)^{self.power}"),)

    def follows(self, scene: Scene, channel: int) -> Follows:
        """Return what it follows: its load."""
        return Follows("load")

    def law(self, x: Array) -> Array:
        """Return the law (N,) of loads (N,), per unit of the parameter."""
        if self.knee is None:
            return np.asarray(x * np.abs(x) ** (self.power - 1))
        return np.asarray(x * np.abs(x) / (self.knee + np.abs(x)))

    def columns(self, scene: Scene) -> Columns:
        """Return the power of the load through the joint's port."""
        port, load = scene.joint_port(self.joint), _load(scene, self.joint, "all")
        if port is None or load is None or (scene.belief.robot is None and scene.observations.predict == "effort"):
            place = [joint_of(name) for name in scene.channels].index(self.joint)
            x = scene.q[:, scene.joint_index(self.joint)]
            return Columns((place,), self.law(x)[:, None, None])
        return through(scene, self.joint, [self.law(load)])


def _bears(scene: Scene, joint: str) -> bool:
    load = _load(scene, joint, "all")
    return load is not None and bool(np.nanstd(load) > 1e-12)


def _load(scene: Scene, joint: str, source: str) -> Array | None:
    load: Array | None
    if isinstance(scene, ArmScene) and source == "own":
        load = scene.own_load(joint)
    elif isinstance(scene, ArmScene) and source != "all":
        load = scene.weight_load(joint) if source == "weight" else scene.torque_from(joint, scene.force, scene.tip)
    else:
        load = scene.load(joint)
    return load

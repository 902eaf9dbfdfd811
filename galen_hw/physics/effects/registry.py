"""The table of effects: one line a key of the vocabulary; modules are loaded when they are needed."""

import importlib
from collections.abc import Mapping
from typing import Any, Final
from weakref import WeakValueDictionary

from galen_hw.errors import UsageError
from galen_hw.physics.effects.base import Effect
from galen_hw.physics.effects.clocks import Shift
from galen_hw.physics.observations import Observations
from galen_hw.physics.scenes.base import Scene

EFFECTS: Final[dict[str, str]] = {
    "bias": "galen_hw.physics.effects.sensor:Bias",
    "step": "galen_hw.physics.effects.events:Step",
    "drift": "galen_hw.physics.effects.drift:Drift",
    "temperature": "galen_hw.physics.effects.drift:Temperature",
    "gain": "galen_hw.physics.effects.sensor:Gain",
    "cross_talk": "galen_hw.physics.effects.sensor:CrossTalk",
    "saturation": "galen_hw.physics.effects.sensor:Saturation",
    "time_delay": "galen_hw.physics.effects.timing:TimeDelay",
    "lag": "galen_hw.physics.effects.timing:Lag",
    "creep": "galen_hw.physics.effects.creep:Creep",
    "hysteresis": "galen_hw.physics.effects.hysteresis:Hysteresis",
    "backlash": "galen_hw.physics.effects.backlash:Backlash",
    "vibration": "galen_hw.physics.effects.events:Vibration",
    "glitches": "galen_hw.physics.effects.events:Glitches",
    "payload": "galen_hw.physics.effects.load:Payload",
    "base_tilt": "galen_hw.physics.effects.load:BaseTilt",
    "inertial": "galen_hw.physics.effects.load:Inertial",
    "joint_offset": "galen_hw.physics.effects.geometry:JointOffset",
    "joint_scale": "galen_hw.physics.effects.geometry:JointScale",
    "link_geometry": "galen_hw.physics.effects.geometry:LinkGeometry",
    "sensor_mounting": "galen_hw.physics.effects.geometry:SensorMounting",
    "friction": "galen_hw.physics.effects.friction:Friction",
    "compliance": "galen_hw.physics.effects.compliance:Compliance",
    "hardening": "galen_hw.physics.effects.compliance:Hardening",
    "torque_ripple": "galen_hw.physics.effects.friction:TorqueRipple",
    "cable_drag": "galen_hw.physics.effects.cable:CableDrag",
    "contact": "galen_hw.physics.effects.events:Contact",
    "unknown": "galen_hw.physics.effects.events:Unknown",
}

SCENES: Final[dict[str, str]] = {
    "wrench": "galen_hw.physics.scenes.wrench:WrenchScene",
    "pose": "galen_hw.physics.scenes.pose:PoseScene",
    "targets": "galen_hw.physics.scenes.pose:TargetsScene",
    "effort": "galen_hw.physics.scenes.joint:EffortScene",
    "position": "galen_hw.physics.scenes.joint:PositionScene",
}


_in_use: Final[WeakValueDictionary[int, Scene]] = WeakValueDictionary()
"""Scenes by the identity of the recording, which each of them holds."""


def _load(path: str) -> Any:
    module, name = path.split(":")
    return getattr(importlib.import_module(module), name)


def effect_class(key: str) -> type[Effect]:
    """Return the class of a key.

    Raises:
        UsageError: no such key.
    """
    if key not in EFFECTS:
        raise UsageError(f"no effect {key!r}", where="terms", todo=f"one of: {', '.join(EFFECTS)}")
    return _load(EFFECTS[key])  # type: ignore[no-any-return]


def kinds() -> list[type[Effect]]:
    """Return the classes of all keys, in the order of the table."""
    return [effect_class(key) for key in EFFECTS]


def shifts(scene: Scene) -> list[Shift]:
    """Return the clocks that a scene allows and that deliver all as it was, and later."""
    return [one for kind in kinds() if issubclass(kind, Shift) for one in kind.propose(scene)]


def constant_of(channel: str, predict: str) -> Effect:
    """Return what the constant of a channel of a group is where the baseline may have none."""
    return next(one for kind in kinds() if (one := kind.fitted_as(channel, predict)) is not None)


def scene_of(observations: Observations, **options: Any) -> Scene:
    """Return the scene of the compared group; options as in `Scene`.

    Without options, and while it is in use, the same one again: its motion is differentiated and simulated once.
    """
    if options:
        return _new_scene(observations, options)
    scene = _in_use.get(id(observations))
    if scene is None:
        scene = _in_use[id(observations)] = _new_scene(observations, {})
    return scene


def _new_scene(observations: Observations, options: Mapping[str, Any]) -> Scene:
    known = _load("galen_hw.physics.effects.terms:known_change") if observations.belief.terms else None
    return _load(SCENES[observations.predict])(observations, known=known, **options)  # type: ignore[no-any-return]


def effect_of(term: Mapping[str, Any]) -> Effect:
    """Return the effect that a term describes.

    Raises:
        UsageError: an unknown key, or fields that do not fit.
    """
    try:
        return effect_class(term["effect"]).from_term(term.get("parameters", {}))
    except (KeyError, TypeError) as error:
        raise UsageError(f"not a term of an effect ({error})", where="terms", todo="save the model again") from error

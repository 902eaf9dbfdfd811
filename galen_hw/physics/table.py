"""The table of effects: one line a key of the vocabulary; modules are loaded when they are needed."""

import importlib
from collections.abc import Mapping
from typing import Any, Final

from galen_hw.errors import UsageError
from galen_hw.physics.effect import Effect
from galen_hw.physics.observations import Observations
from galen_hw.physics.scene import Scene

EFFECTS: Final[dict[str, str]] = {
    "bias": "galen_hw.physics.sensor_effects:Bias",
    "step": "galen_hw.physics.event_effects:Step",
    "drift": "galen_hw.physics.sensor_effects:Drift",
    "temperature": "galen_hw.physics.sensor_effects:Temperature",
    "gain": "galen_hw.physics.sensor_effects:Gain",
    "cross_talk": "galen_hw.physics.sensor_effects:CrossTalk",
    "saturation": "galen_hw.physics.sensor_effects:Saturation",
    "time_delay": "galen_hw.physics.time_effects:TimeDelay",
    "lag": "galen_hw.physics.time_effects:Lag",
    "creep": "galen_hw.physics.memory_effects:Creep",
    "hysteresis": "galen_hw.physics.memory_effects:Hysteresis",
    "backlash": "galen_hw.physics.play_effects:Backlash",
    "vibration": "galen_hw.physics.event_effects:Vibration",
    "glitches": "galen_hw.physics.event_effects:Glitches",
    "payload": "galen_hw.physics.body_effects:Payload",
    "base_tilt": "galen_hw.physics.body_effects:BaseTilt",
    "inertial": "galen_hw.physics.body_effects:Inertial",
    "joint_offset": "galen_hw.physics.geometry_effects:JointOffset",
    "joint_scale": "galen_hw.physics.geometry_effects:JointScale",
    "link_geometry": "galen_hw.physics.geometry_effects:LinkGeometry",
    "sensor_mounting": "galen_hw.physics.geometry_effects:SensorMounting",
    "friction": "galen_hw.physics.joint_effects:Friction",
    "compliance": "galen_hw.physics.elastic_effects:Compliance",
    "hardening": "galen_hw.physics.elastic_effects:Hardening",
    "torque_ripple": "galen_hw.physics.joint_effects:TorqueRipple",
    "cable_drag": "galen_hw.physics.cable_effects:CableDrag",
    "contact": "galen_hw.physics.event_effects:Contact",
    "unknown": "galen_hw.physics.event_effects:Unknown",
}

SCENES: Final[dict[str, str]] = {
    "wrench": "galen_hw.physics.scene_wrench:WrenchScene",
    "pose": "galen_hw.physics.scene_pose:PoseScene",
    "targets": "galen_hw.physics.scene_pose:TargetsScene",
    "effort": "galen_hw.physics.scene_joint:EffortScene",
    "position": "galen_hw.physics.scene_joint:PositionScene",
}


def _load(path: str) -> Any:
    module, name = path.split(":")
    return getattr(importlib.import_module(module), name)


def effect_class(key: str) -> type[Effect]:
    """The class of a key.

    Raises:
        UsageError: no such key.
    """
    if key not in EFFECTS:
        raise UsageError(f"no effect {key!r}", where="terms", todo=f"one of: {', '.join(EFFECTS)}")
    return _load(EFFECTS[key])  # type: ignore[no-any-return]


def scene_of(observations: Observations, **options: Any) -> Scene:
    """The scene of the compared group; options as in `Scene`."""
    return _load(SCENES[observations.predict])(observations, **options)  # type: ignore[no-any-return]


def effect_of(term: Mapping[str, Any]) -> Effect:
    """The effect that a term describes.

    Raises:
        UsageError: an unknown key, or fields that do not fit.
    """
    try:
        return effect_class(term["effect"]).from_term(term.get("parameters", {}))
    except (KeyError, TypeError) as error:
        raise UsageError(f"not a term of an effect ({error})", where="terms", todo="save the model again") from error

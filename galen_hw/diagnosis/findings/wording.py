"""What is said in plain words: of findings, why they are believed, and why look-alikes cannot be told apart."""

from collections.abc import Iterable
from typing import Final

from galen_hw.physics.effects.registry import effect_class
from galen_hw.physics.scenes.base import Scene

SAYS: Final[dict[str, str]] = {
    "bias": "a constant offset that the model does not hold",
    "step": "the offset jumps at a moment",
    "drift": "the offset moves slowly with time",
    "temperature": "the offset follows the measured temperature",
    "gain": "the channel's scale is off",
    "cross_talk": "another channel leaks into this one",
    "saturation": "the readings clip at a limit",
    "time_delay": "the recording is late against the simulation",
    "lag": "the recording follows the simulation like a filter of the first order, or of the second where a damping is given",
    "creep": "it settles slowly after a change of load",
    "hysteresis": "it remembers past load or motion, whatever the speed",
    "backlash": "a dead band at every reversal: play, or the stand-off of a servo against friction",
    "vibration": "an oscillation of one frequency",
    "glitches": "isolated or repeated samples, far off what is measured around them",
    "payload": "the carried body's mass or centre of mass differs from what is believed",
    "base_tilt": "gravity does not point where the model says",
    "inertial": "forces of acceleration that the static model leaves out",
    "joint_offset": "the joint's zero is off",
    "joint_scale": "the joint's scale is off",
    "link_geometry": "a link or an axis is not where or how the model says",
    "sensor_mounting": "the sensor is turned or shifted on its flange",
    "friction": "friction in the joint",
    "compliance": "elastic give under load, own weight included",
    "hardening": "stiffness changes with load",
    "torque_ripple": "a force periodic in the joint's position",
    "cable_drag": "a cable or hose pulls, depending on where the arm is",
    "contact": "an outside force acts during some episodes",
    "unknown": "structure that nothing named explains",
}

BELIEVED: Final[dict[str, str]] = {
    "bias": "it stays the same through the whole recording",
    "step": "before and after the moment the residual is level",
    "drift": "it follows the clock and not the arm",
    "temperature": "it follows the thermometer better than the clock",
    "gain": "it is proportional to the channel's own signal",
    "cross_talk": "it is proportional to the other channel's signal",
    "saturation": "readings pile up at the limit where the simulation goes on",
    "time_delay": "it is proportional to the rate of change and the same everywhere",
    "lag": "it is large where the signal moves quickly and dies away where it rests",
    "creep": "it goes on settling while the load rests",
    "hysteresis": "it depends on where the motion turned round and not on how quick it was",
    "backlash": "it shifts by a fixed width at reversals, whatever their size",
    "vibration": "it is one line of the spectrum, above what the joints themselves do",
    "payload": "it turns with gravity in the sensor as a weight does",
    "base_tilt": "it is what a turned gravity gives in all channels at once",
    "inertial": "it follows the accelerations by the known masses",
    "joint_offset": "one constant angle gives it in all channels and poses",
    "joint_scale": "it grows in proportion to the joint's travel",
    "link_geometry": "one constant error of the arm gives it in all poses",
    "sensor_mounting": "one constant turn or shift of the sensor gives it in all poses",
    "friction": "it follows the direction and the size of the joint's speed",
    "compliance": "it is proportional to the load",
    "hardening": "it grows faster than the load",
    "torque_ripple": "it repeats with the joint's position, at any speed",
    "cable_drag": "it depends on the arm's position and not on the clock",
    "contact": "it comes and goes at moments, and nothing is left between them",
}

WHY: Final[dict[frozenset[str], str]] = {
    frozenset(("drift", "temperature")): "no temperature was recorded that could settle it",
    frozenset(("drift", "creep")): "both move slowly in one direction",
    frozenset(("drift", "step")): "one jump and a quick slope differ only near the moment",
    frozenset(
        ("drift", "cable_drag")
    ): "the arm went through its poses in one order, so that time and place go together",
    frozenset(("drift", "payload")): "the poses were ordered so that gravity changes with time",
    frozenset(("time_delay", "lag")): "for motion this slow a delay and a first-order lag are the same",
    frozenset(("time_delay", "friction")): "for motion at nearly one speed a delay shifts as friction does",
    frozenset(("lag", "friction")): "a lag and viscous friction both follow the speed",
    frozenset(("lag", "creep")): "creep is a lag with a long time constant",
    frozenset(("joint_offset", "bias")): "an offset of the reading and of the joint's zero look the same here",
    frozenset(("bias", "link_geometry")): "an arm that stands elsewhere and a tracker that is off read the same",
    frozenset(("joint_offset", "base_tilt")): "the first joint turns about a level axis, as a tilt of the base does",
    frozenset(
        ("joint_offset", "sensor_mounting")
    ): "the last joint's zero and the sensor's seat turn about the same axis",
    frozenset(("joint_offset", "link_geometry")): "over this range of poses a zero and a tilted axis do the same",
    frozenset(("joint_offset", "joint_scale")): "over this narrow range of the joint a scale is nearly a constant",
    frozenset(("link_geometry", "sensor_mounting")): "a tilt behind the last axis is the sensor's seat",
    frozenset(("link_geometry", "base_tilt")): "a tilt before the first axis is the base's",
    frozenset(("payload", "sensor_mounting")): "a shifted sensor changes the torque as a moved centre of mass does",
    frozenset(("payload", "cross_talk")): "with one tool, weight that moves between channels can be its own or a leak",
    frozenset(("payload", "gain")): "more weight and a larger scale are proportional for one tool",
    frozenset(("payload", "bias")): "gravity hardly turns in the sensor",
    frozenset(("payload", "cable_drag")): "over these poses the cable pulls much as a weight does",
    frozenset(("sensor_mounting", "cross_talk")): "a turned sensor is a skew matrix of cross-talk",
    frozenset(("backlash", "hysteresis")): "play is one element of a hysteresis",
    frozenset(
        ("backlash", "friction")
    ): "a servo without integral action stands off against friction as if it had play",
    frozenset(("hysteresis", "friction")): "friction with presliding is a hysteresis of motion",
    frozenset(("hysteresis", "creep")): "both remember the load; only rests of different length part them",
    frozenset(("compliance", "hardening")): "over this range of load the stiffness hardly changes",
    frozenset(("compliance", "creep")): "nearly all rests are longer than the settling",
    frozenset(("compliance", "joint_offset")): "the load hardly changes",
    frozenset(("compliance", "joint_scale")): "the load is nearly proportional to the joint's travel",
    frozenset(("gain", "joint_scale")): "the channel is nearly proportional to the joint's travel",
    frozenset(("vibration", "torque_ripple")): "the joint turns at nearly constant speed",
    frozenset(("cable_drag", "torque_ripple")): "over less than one period a ripple is a spring",
    frozenset(("contact", "step")): "the force does not end before the recording does",
}

ALIKE: Final = "both make the same signal in this recording, to within its noise"


def why(found: str, rival: str) -> str:
    """Why two effects cannot be told apart: by structure where that is known, else what this recording shows."""
    return WHY.get(frozenset((found, rival)), ALIKE)


def structural(found: str, scene: Scene, parameters: Iterable[str] = ()) -> list[str]:
    """Effects that no recording of this kind can tell from the one found, whatever the likelihood says.

    Args:
        found: key; parameters: names of the finding's parameters.
    """
    group, out = scene.observations.predict, []
    if found == "drift" and not scene.observations.has("temperature."):
        out.append("temperature")
    bare = [name.rsplit(": ", 1)[-1] for name in parameters if name != "rms_signal"]
    if found == "link_geometry" and group == "pose" and bare and all(name.startswith("frame_shift") for name in bare):
        out.append("bias")
    if group == "position":
        same = {
            "joint_offset": ["bias"],
            "bias": ["joint_offset"],
            "backlash": ["friction", "hysteresis"],
            "hysteresis": ["friction", "backlash"],
        }
        out += same.get(found, [])
    return out


NEXT: Final[dict[str, str]] = {
    "drift": "come back to one home pose every eight poses, in random order, and record a temperature",
    "temperature": "record a warm and a cold start with the arm at rest",
    "bias": "add poses with the sensor upside down",
    "time_delay": "move one joint at two speeds, with quick starts",
    "lag": "move one joint at two speeds, with quick starts",
    "creep": "hold a load for a minute after each change of load",
    "hysteresis": "sweep one joint slowly to and fro with small and with large reversals",
    "backlash": "sweep one joint slowly to and fro with small and with large reversals",
    "friction": "sweep each joint both ways at three speeds",
    "payload": "repeat the poses with a second, known mass",
    "gain": "repeat the poses with a second, known mass",
    "cross_talk": "repeat the poses with a second, known mass",
    "sensor_mounting": "repeat the poses with the tool turned by 180 degrees",
    "base_tilt": "put a level on the base, or turn the arm about a second axis",
    "joint_offset": "visit poses that spread all joints, and check one zero with a level",
    "joint_scale": "visit both ends of the joint's range",
    "link_geometry": "visit poses that spread all joints in random order, with some repeated",
    "compliance": "load the tip with three known weights in three directions",
    "hardening": "load the tip with three known weights, the heaviest near the limit",
    "contact": "repeat the same path in free air",
    "cable_drag": "repeat the poses in random order with the cable unplugged",
    "vibration": "hold still for a minute with the motors on, then off",
}


SETTLED_BY: Final[dict[frozenset[str], str]] = {
    frozenset(
        ("bias", "link_geometry")
    ): "measure a mark on the base with the tracker: an arm that stands elsewhere moves it not",
    frozenset(("bias", "joint_offset")): "check the joint's zero against a mechanical mark; no motion of the arm can",
    frozenset(("joint_offset", "base_tilt")): "put a level on the base; no motion of the arm can",
    frozenset(
        ("joint_offset", "sensor_mounting")
    ): "check the last joint's zero with a level; no motion of the arm can",
    frozenset(("link_geometry", "sensor_mounting")): "turn the tool by 180 degrees on its flange and repeat the poses",
    frozenset(("link_geometry", "base_tilt")): "put a level on the base; no motion of the arm can",
    frozenset(("drift", "temperature")): "log the temperature at the sensor while the machine warms up, at rest",
    frozenset(
        ("backlash", "friction")
    ): "push the stopped joint lightly by hand in both directions: play gives, friction does not",
    frozenset(
        ("hysteresis", "friction")
    ): "sweep the joint slowly to and fro with ever smaller reversals, the servo off",
    frozenset(("backlash", "hysteresis")): "sweep the joint slowly to and fro with ever smaller reversals",
}


def settled_by(found: str, rival: str) -> str:
    """What would tell two effects apart where it cannot be simulated."""
    plain = NEXT.get(rival, NEXT.get(found, "record a motion over a wider range, at two speeds"))
    return SETTLED_BY.get(frozenset((found, rival)), plain)


def saying(key: str) -> str:
    """Return what a kind of effect is, in words; of one without words here, the first line of its class."""
    return SAYS.get(key) or (effect_class(key).__doc__ or key.replace("_", " ")).splitlines()[0].rstrip(".")


def believing(key: str) -> str:
    """Return by what a kind of effect is known."""
    return BELIEVED.get(key, "nothing else that was asked does the same")

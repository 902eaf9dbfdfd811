"""What is said in plain words: of findings, of look-alikes, and of the recording that would settle them."""

from collections.abc import Sequence
from typing import Final

SAYS: Final[dict[str, str]] = {
    "bias": "a constant offset that the model does not hold",
    "step": "the offset jumps at a moment",
    "drift": "the offset moves slowly with time",
    "temperature": "the offset follows the measured temperature",
    "gain": "the channel's scale is off",
    "cross_talk": "another channel leaks into this one",
    "saturation": "the readings clip at a limit",
    "time_delay": "the recording is late against the simulation, by the same time everywhere",
    "lag": "the recording follows the simulation like a first-order filter",
    "creep": "it settles slowly after a change of load",
    "hysteresis": "it remembers past load or motion, whatever the speed",
    "backlash": "a dead band at every reversal: play, or the stand-off of a servo against friction",
    "vibration": "an oscillation of one frequency",
    "glitches": "isolated samples far off their neighbours",
    "payload": "the carried body's mass or centre of mass differs from what is believed",
    "base_tilt": "gravity does not point where the model says",
    "inertial": "forces of acceleration that the static model leaves out",
    "joint_offset": "the joint's zero is off",
    "joint_scale": "the joint's scale is off",
    "link_geometry": "a link or an axis is not where or how the model says",
    "sensor_mounting": "the sensor is turned or shifted on its flange",
    "friction": "friction in the joint: it follows the direction and the size of the speed",
    "compliance": "elastic give under load, own weight included",
    "hardening": "stiffness changes with load",
    "torque_ripple": "a force periodic in the joint's position",
    "cable_drag": "a cable or hose pulls, depending on where the arm is",
    "contact": "an outside force acts during some episodes",
    "unknown": "structure that nothing named explains",
}

WHY: Final[dict[frozenset[str], str]] = {
    frozenset(("drift", "temperature")): "no temperature was recorded that could settle it",
    frozenset(("drift", "creep")): "both move slowly in one direction",
    frozenset(("time_delay", "lag")): "for motion this slow a delay and a first-order lag are the same",
    frozenset(("joint_offset", "bias")): "an offset of the reading and of the joint's zero look the same here",
    frozenset(("joint_offset", "base_tilt")): "the first joint turns about a level axis, as a tilt of the base does",
    frozenset(
        ("joint_offset", "sensor_mounting")
    ): "the last joint's zero and the sensor's seat turn about the same axis",
    frozenset(("payload", "sensor_mounting")): "a shifted sensor changes the torque as a moved centre of mass does",
    frozenset(("sensor_mounting", "cross_talk")): "a turned sensor is a skew matrix of cross-talk",
    frozenset(("payload", "gain")): "more weight and a larger scale are proportional for one tool",
    frozenset(("backlash", "hysteresis")): "play is one element of a hysteresis",
    frozenset(
        ("backlash", "friction")
    ): "a servo without integral action stands off against friction as if it had play",
    frozenset(("hysteresis", "friction")): "friction with presliding is a hysteresis of motion",
    frozenset(("compliance", "hardening")): "over this range of load the stiffness hardly changes",
    frozenset(("compliance", "joint_offset")): "the load hardly changes",
    frozenset(("vibration", "torque_ripple")): "the joint turns at nearly constant speed",
}

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


def why(found: str, rival: str) -> str:
    """Why two effects cannot be told apart: structural where known, else by this recording's numbers."""
    return WHY.get(frozenset((found, rival)), "it reproduces the same signal in this recording to within its noise")


def next_experiment(found: Sequence[str], rivals: Sequence[str], unknown: str) -> str:
    """One recipe that settles what is open."""
    if rivals:
        pair = f"{found[0]} from {rivals[0]}"
        return f"To tell {pair}: {NEXT.get(rivals[0], NEXT.get(found[0], 'record a richer motion'))}."
    if unknown:
        return (
            f"Something is left in {unknown}: repeat the motion three times, at two speeds, one joint after the other."
        )
    if found:
        return f"To confirm {found[0]}: {NEXT.get(found[0], 'repeat the recording on another motion')}."
    return "Nothing is open; a longer recording with more motion would show smaller effects."

"""What is said, repaired and claimed where gravity points elsewhere than the recording names."""

from dataclasses import replace

import numpy as np

from galen_hw.kinematics import UrdfRobot
from galen_hw.physics.observations import Observations
from galen_hw.premises.base import Action, Claim, Remark
from galen_hw.premises.criteria import CRITERIA
from galen_hw.spatial import Array


def angle_between(a: Array, b: Array) -> float:
    """Return the angle, rad, between two directions (3,)."""
    return float(np.arctan2(np.linalg.norm(np.cross(a, b)), float(a @ b)))


def tilt_between(a: Array, b: Array) -> Array:
    """Return (3,) a rotation vector, rad, about an axis of the xy plane that takes the direction of a to that of b.

    There is one for any two directions, and a tilt of the base is told by it: turned about z, gravity tilts by more.
    """
    a, b = a / np.linalg.norm(a), b / np.linalg.norm(b)
    # As far along the axis as before.
    for across in (b - a, np.array([a[0], a[1], 0.0]), np.array([0.0, -1.0, 0.0])):
        length = float(np.hypot(across[0], across[1]))
        if length > 1e-9:
            break
    axis = np.array([-across[1], across[0], 0.0]) / length
    from_, to = (v - axis * (axis @ v) for v in (a, b))
    return np.asarray(axis * np.arctan2(axis @ np.cross(from_, to), from_ @ to))


def gravity_remark(key: str, seen: Observations, found: Array, channels: tuple[str, ...]) -> Remark:
    """Return the repair and the claim of a `base_tilt`.

    Args:
        key: of the premise; found: (3,) direction of gravity in the base; channels: that it changes.
    """
    belief, named = seen.belief, seen.belief.gravity
    gravity = found * float(np.linalg.norm(named) / np.linalg.norm(found))
    if angle_between(-named, gravity) < CRITERIA.least_turn:
        gravity = -named  # hung upside down; what is left is small, and an effect's
    direction = ", ".join(f"{g:.2f}" for g in gravity)
    angle, turn = np.degrees(angle_between(named, gravity)), tilt_between(named, gravity)
    what = f"gravity points along ({direction}) m/s^2 in the base, {angle:.1f} deg from what is named"
    parameters = {f"tilt_{a}": (float(turn[k]), 0.0, "rad") for k, a in enumerate("xy")}
    term = {"effect": "base_tilt", "parameters": {"axis": "xy", **{k: v[0] for k, v in parameters.items()}}}
    robot = belief.robot.under(gravity) if isinstance(belief.robot, UrdfRobot) else belief.robot
    repaired = replace(seen, belief=replace(belief, gravity=gravity, robot=robot))
    claim = Claim("base_tilt", parameters, channels, terms=(term,))
    return Remark(key, what, f'"gravity": [{direction}] in recording.json', channels, Action.REPAIRED, repaired, claim)

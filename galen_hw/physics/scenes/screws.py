"""Small motions of the arm's distal part as screws [v, w] in the base: v is the velocity at the base's origin."""

from dataclasses import replace
from typing import Any

import numpy as np

from galen_hw.kinematics import GalenRobot, UrdfRobot
from galen_hw.spatial import Array, rotation_about, rotation_exp, skew


def exponential(screw: Array) -> Array:
    """Return the exponentials of screws (N, 6) as transforms (N, 4, 4)."""
    v, w = screw[:, :3], screw[:, 3:]
    angle2 = np.sum(w * w, axis=1)[:, None, None]
    W = skew(w)
    angle = np.sqrt(angle2)
    safe = np.where(angle2 > 1e-16, angle2, 1.0)
    b = np.where(angle2 > 1e-16, (1.0 - np.cos(angle)) / safe, 0.5)
    c = np.where(angle2 > 1e-16, (1.0 - np.sinc(angle / np.pi)) / safe, 1.0 / 6.0)
    V = np.eye(3) + b * W + c * (W @ W)
    out = np.zeros((len(screw), 4, 4))
    out[:, :3, :3], out[:, 3, 3] = rotation_exp(w), 1.0
    out[:, :3, 3] = (V @ v[:, :, None])[:, :, 0]
    return out


def about(axis: Array, point: Array) -> Array:
    """Return the screw (N, 6) of a unit turn about axis (N, 3) through point (N, 3)."""
    return np.concatenate([np.cross(point, axis), axis], axis=1)


def joint_screws(scene: Any, joint: str) -> Array | None:
    """Return the motion (N, 6) of the sensor per joint rate; None without a robot."""
    robot = scene.belief.robot
    if robot is None or joint not in robot.joint_names:
        return None
    cache = scene.__dict__.setdefault("_joint_screws", {})
    if "all" not in cache:
        J = robot.sensor_jacobian(scene.q)
        p = robot.sensor_pose(scene.q)[:, :3, 3]
        cache["all"] = np.concatenate([J[:, :3] - np.cross(J[:, 3:], p[:, :, None], axis=1), J[:, 3:]], axis=1)
    return np.asarray(cache["all"][:, :, robot.joint_names.index(joint)])


def forget(scene: Any) -> None:
    """Forget the screws of a scene whose arm stands otherwise than that of which it is a copy."""
    for name in ("_joint_screws", "_axis_screws"):
        scene.__dict__.pop(name, None)


def frames(scene: Any) -> list[tuple[str, Array, Array]]:
    """Return joints that turn the sensor: name, frame (N, 4, 4) in the base just before the turn, axis (3,) in that frame."""
    robot = scene.belief.robot
    if isinstance(robot, GalenRobot):
        return _galen_frames(robot, scene.q)
    return robot.turning_frames(scene.q) if isinstance(robot, UrdfRobot) else []


def _galen_frames(robot: GalenRobot, q: Array) -> list[tuple[str, Array, Array]]:
    roll, tilt = (np.tile(np.eye(4), (len(q), 1, 1)) for _ in range(2))
    roll[:, :3, 3] = robot.delta.platform(q[:, :3]) + np.asarray(robot.platform_to_roll)
    tilt[:, :3, :3] = rotation_about(0, q[:, 3])
    tilt[:, :3, 3] = roll[:, :3, 3] + tilt[:, :3, :3] @ np.asarray(robot.roll_to_tilt)
    return [("roll", roll, np.eye(3)[0]), ("tilt", tilt, np.eye(3)[1])]


def axis_screws(scene: Any) -> list[tuple[str, str, list[Array]]]:
    """Return small errors of links and axes as (name, joint, screws (N, 6) applied one after the other), per rad or m.

    `axis_tilt` turns an axis and leaves the arm's zero pose as it is (a screw before the joint, and back after it);
    `frame_tilt` turns everything beyond it; `axis_shift` and `frame_shift` do the same to its place.
    """
    known = scene.__dict__.setdefault("_axis_screws", {})
    if "all" not in known:
        known["all"] = _delta_screws(scene) + _axes(scene)
    return list(known["all"])


def axis_moves(scene: Any, joint: str, amounts: dict[str, float]) -> list[Array]:
    """Return screws (N, 6), one after the other, of errors of one joint's links and axes by so much each, rad or m."""
    found = {name: screws for name, at, screws in axis_screws(scene) if at == joint}
    parts = [[amount * screw for screw in found[name]] for name, amount in amounts.items()]
    return [np.sum(together, axis=0) for together in zip(*parts, strict=True)]


def _axes(scene: Any) -> list[tuple[str, str, list[Array]]]:
    out = []
    for joint, T, axis in frames(scene):
        R, p = T[:, :3, :3], T[:, :3, 3]
        after = R @ rotation_exp(np.outer(scene.q[:, scene.joint_index(joint)], axis))
        zero = np.zeros((len(p), 3))
        for letter, unit in zip("xyz", np.eye(3), strict=True):
            shift, back = (np.concatenate([frame @ unit, zero], axis=1) for frame in (R, after))
            if abs(unit @ axis) > 0.7:
                out.append((f"frame_shift.{letter}", joint, [shift]))
                continue
            turn, turn_back = about(R @ unit, p), about(after @ unit, p)
            out += [(f"axis_tilt.{letter}", joint, [turn, -turn_back]), (f"frame_tilt.{letter}", joint, [turn])]
            out += [(f"axis_shift.{letter}", joint, [shift, -back]), (f"frame_shift.{letter}", joint, [shift])]
    return out


def _delta_screws(scene: Any) -> list[tuple[str, str, list[Array]]]:
    """Return the rod length and effective radius of the Galen's delta: a motion of the platform."""
    robot = scene.belief.robot
    if not isinstance(robot, GalenRobot):
        return []
    out, step = [], 1e-5
    for name in ("rod_length", "radius"):
        ends = []
        for sign in (1.0, -1.0):
            delta = replace(robot.delta, **{name: getattr(robot.delta, name) + sign * step})
            ends.append(delta.platform(scene.q[:, :3]))
        move = (ends[0] - ends[1]) / (2.0 * step)
        out.append((name, "carriage1", [np.concatenate([move, np.zeros_like(move)], axis=1)]))
    return out

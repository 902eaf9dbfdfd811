"""Brings a tracked pose from the tracker's axes to the base's: by its positions and its orientations, each by its noise."""

import numpy as np
from scipy.stats import chi2

from galen_hw.physics.effects.registry import scene_of
from galen_hw.physics.observations import Observations
from galen_hw.physics.scenes.base import Scene
from galen_hw.physics.scenes.pose import POSITION, QUATERNION
from galen_hw.premises.base import known_rows, with_matrix
from galen_hw.premises.criteria import CRITERIA
from galen_hw.premises.rotations import angle_of, turned_alike
from galen_hw.spatial import Array, quaternion_from_rotation, rotation_exp, rotation_from_quaternion, rotation_log, skew

ROUNDS = 2
"""Steps of Gauss and Newton from the positions' registration, which is near: the first is all but exact."""
MOUNTED = 0.002
"""Chance with which a body that sits as the model says may look turned on its link."""


def sampled(seen: Observations, names: tuple[str, ...]) -> Observations:
    """Return rows with joints and the named columns, at most `CRITERIA.most_rows` of them, evenly chosen."""
    robot = seen.belief.robot
    joints = () if robot is None else tuple(f"joint.{name}.position" for name in robot.joint_names)
    return seen.taken(known_rows(seen, (*joints, *names), CRITERIA.most_rows))


def registered(seen: Observations, Q: Array, measured: Array, expected: Array) -> Observations:
    """Return the recording with positions and orientations in the base's axes.

    Args:
        Q: (3, 3) axes of the tracker, as `similarity` finds them; measured, expected: (N, 3) positions, m.
    """
    out = _turned(seen, Q, expected.mean(axis=0) - measured.mean(axis=0) @ Q)
    if not seen.has_all(*QUATERNION):
        return out
    for _ in range(ROUNDS):
        some = sampled(out, (*POSITION, *QUATERNION))
        if len(some) < CRITERIA.fewest_vectors:
            return out
        scene = scene_of(some)
        turned, R = rotation_from_quaternion(some.matrix(*QUATERNION)), poses(scene)
        mounted, left = turned_alike(R, turned)
        if max(left, angle_of(mounted)) > CRITERIA.least_turn:
            return out  # quaternions in another order, or a body turned on its link, which is asked next
        angle = rotation_log(turned @ np.swapaxes(R, 1, 2))
        out = _turned(out, *_refinement(scene.simulated[:, :3], some.matrix(*POSITION), R, angle))
    return out


def _turned(seen: Observations, Q: Array, shift: Array) -> Observations:
    """Return the recording with positions p Q + shift, and orientations turned with them."""
    out = with_matrix(seen, POSITION, seen.matrix(*POSITION) @ Q + shift)
    if seen.has_all(*QUATERNION):
        there = np.isfinite(seen.matrix(*QUATERNION)).all(axis=1)
        q = np.full((len(seen), 4), np.nan)
        R = rotation_from_quaternion(seen.matrix(*QUATERNION)[there])
        # Of a mirrored frame a rotation is mirrored on both sides: where the body's axes are mirrored too.
        turned = Q.T @ R @ (np.eye(3) if np.linalg.det(Q) > 0.0 else Q)
        q[there] = quaternion_from_rotation(turned)
        out = with_matrix(out, QUATERNION, q)
    return out


def _refinement(p: Array, measured: Array, R: Array, angle: Array) -> tuple[Array, Array]:
    """Return the turn (3, 3) and shift (3,), as of `_turned`, that are left between tracker and base.

    Of a small turn of the base, a shift and, where it is surely there, a small turn of the body on its link, which is not
    applied, by least squares: positions alone may lie near a line, about which they say nothing.

    Args:
        p, measured: (N, 3) positions, m; R: (N, 3, 3) orientations; angle: (N, 3) by which they are missed, in the base, rad.
    """
    away = measured - p
    zero, one = np.zeros((len(p), 3, 3)), np.tile(np.eye(3), (len(p), 1, 1))
    centre = p.mean(axis=0)
    rows = [np.concatenate([-skew(p - centre), one, zero], axis=2), np.concatenate([one, zero, R], axis=2)]
    sizes = [max(float(np.std(x - x.mean(axis=0))), 1e-12) for x in (away, angle)]
    A = np.concatenate([row.reshape(-1, 9) / size for row, size in zip(rows, sizes, strict=True)])
    b = np.concatenate([away.ravel() / sizes[0], angle.ravel() / sizes[1]])
    x, left = _solved(A[:, :6], b)
    whole, less = _solved(A, b)
    if left - less > chi2.isf(MOUNTED, 3) * less / len(b):
        x = whole
    turn = rotation_exp(x[:3])
    return turn, centre - (centre + x[3:6]) @ turn


def _solved(A: Array, b: Array) -> tuple[Array, float]:
    """Return the least-squares x of A x = b, columns made alike in size, and the squared residual."""
    scale = np.maximum(np.linalg.norm(A, axis=0), 1e-300)
    x = np.linalg.lstsq(A / scale, b, rcond=CRITERIA.small_turn**2)[0] / scale
    return np.asarray(x), float(np.sum((b - A @ x) ** 2))


def poses(scene: Scene) -> Array:
    """Return (N, 3, 3) the simulated orientation of the tip."""
    return np.asarray(scene._pose[:, :3, :3])  # type: ignore[attr-defined]  # noqa: SLF001

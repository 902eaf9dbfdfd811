"""Lengths of a robot's links by tracked positions: the model of another size has the same axes and joints."""

from collections.abc import Iterator
from typing import ClassVar, Final

import numpy as np

from galen_hw.kinematics import UrdfRobot
from galen_hw.physics.effects.registry import scene_of
from galen_hw.physics.observations import Observations
from galen_hw.physics.scenes.pose import POSITION
from galen_hw.physics.scenes.screws import frames
from galen_hw.premises.base import Action, Remark, Stage
from galen_hw.premises.criteria import CRITERIA
from galen_hw.premises.registration import poses, sampled
from galen_hw.spatial import Array

ANOTHER: Final = 0.05
"""Of the sum of all links: no arm is built with a link so far off; errors of a calibration are tenths of a per cent."""

TOLD: Final = 0.01
"""Of a unit: what of a link's own direction no motion shows, up to which its length is told."""


class LinkLengths:
    """Tests whether links of other lengths explain what positions miss: along the same axes, far beyond what is built wrong.

    The place of the tip is linear in the vectors from joint to joint, turned as the joints say. A tip that is named wrong is left
    to the search: links are blamed for what it cannot explain.
    """

    KEY: ClassVar[str] = "link_lengths"
    STAGE: ClassVar[Stage] = Stage.FRAMES

    def examine(self, seen: Observations) -> Iterator[Remark]:
        """Yield at most one remark, on all links that are of another length."""
        robot = seen.belief.robot
        if seen.predict != "pose" or not isinstance(robot, UrdfRobot) or not seen.has_all(*POSITION):
            return
        some = sampled(seen, POSITION)
        scene = scene_of(some) if len(some) else None
        turning = [] if scene is None else frames(scene)
        if scene is None or len(turning) < 2 or len(turning) < len(robot.joint_names):
            return  # of a joint that slides no length is fixed
        names, places = [name for name, _, _ in turning], np.stack([T[:, :3, 3] for _, T, _ in turning])
        turns = np.stack([*(T[:, :3, :3] for _, T, _ in turning[1:]), poses(scene)])
        missed = some.matrix(*POSITION) - scene.simulated[:, :3]
        if 3 * len(some) < 4 * 3 * (len(turns) + 1):
            return
        whole, links, told = _fitted(turns, missed)
        tip, _, _ = _fitted(turns[-1:], missed)
        if tip == 0.0 or whole > CRITERIA.small_turn * tip:
            return
        named = np.einsum("knji,knj->kni", turns[:-1], np.diff(places, axis=0)).mean(axis=1)
        lengths, others = (np.linalg.norm(x, axis=1) for x in (named, named + links[:-1]))
        # Along the axis of the next joint a link and what follows it are one length: neither is told.
        along = np.zeros((len(named), told.shape[1]))
        for k, way in enumerate(named):
            along[k, 3 * k : 3 * k + 3] = way / max(float(lengths[k]), 1e-12)
        sure = np.linalg.norm(along - along @ told.T @ told, axis=1) < TOLD
        changed = np.flatnonzero(sure & (np.abs(others - lengths) > ANOTHER * np.sum(lengths)))
        if not len(changed):
            return
        each = ", ".join(
            f"{names[k]} to {names[k + 1]} {1e3 * others[k]:.0f} mm where the model has {1e3 * lengths[k]:.0f}"
            for k in changed
        )
        what = f"the links of the recorded arm are of other lengths than the model's: {each}"
        todo = "give the model of this arm (is it one of another size?)"
        yield Remark(self.KEY, what, todo, POSITION, Action.REFUSED)


def _fitted(turns: Array, missed: Array) -> tuple[float, Array, Array]:
    """Return the mean square, m^2, that changed vectors and a constant leave of misses (N, 3), and the changes (K, 3).

    And (r, 3 K + 3) orthonormal directions of changes and constant that show.

    Args:
        turns: (K, N, 3, 3) axes in which each vector is constant.
    """
    columns = np.concatenate([*turns, np.tile(np.eye(3), (len(missed), 1, 1))], axis=2).reshape(3 * len(missed), -1)
    U, size, V = np.linalg.svd(columns, full_matrices=False)
    shown = size > 1e-6 * size[0]
    change = V[shown].T @ (U[:, shown].T @ missed.ravel() / size[shown])
    left = missed.ravel() - columns @ change
    return float(np.mean(left**2)), change[:-3].reshape(-1, 3), V[shown]

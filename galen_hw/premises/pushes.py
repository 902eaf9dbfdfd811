"""Pushes on the tip beside where it is seen to go: a structure gives with a push, never against it."""

from collections.abc import Iterator
from dataclasses import replace
from typing import ClassVar, Final

import numpy as np
from scipy.optimize import nnls

from galen_hw.physics.effects.compliance import Compliance
from galen_hw.physics.effects.registry import scene_of
from galen_hw.physics.observations import Observations
from galen_hw.physics.scenes.pose import POSITION
from galen_hw.premises.base import Action, Remark, Stage, joint_positions, known_rows, with_columns, with_matrix
from galen_hw.premises.criteria import CRITERIA
from galen_hw.premises.registration import poses
from galen_hw.premises.unit_tables import FORCES, units_of
from galen_hw.spatial import Array

FORCE: Final = tuple(f"applied.force.{a}" for a in "xyz")


class PushSigns:
    """Tests that the tip moves with the force on it: no spring, friction or play gives back more than a push puts in.

    Judged within each segment, so that neither registration nor a constant of either enters. An arm that moves is missed for
    more reasons than a push: there the two must be one signal.
    """

    KEY: ClassVar[str] = "push_signs"
    STAGE: ClassVar[Stage] = Stage.FRAMES

    def examine(self, seen: Observations) -> Iterator[Remark]:
        """Yield one remark where the work of the pushes is surely negative."""
        names = (*FORCE, *POSITION)
        if seen.predict != "pose" or seen.belief.robot is None or not seen.has_all(*names):
            return
        some = seen.taken(known_rows(seen, (*names, *joint_positions(seen))))
        if len(some) < CRITERIA.pieces * CRITERIA.fewest_vectors:
            return
        scene = scene_of(replace(some, belief=replace(some.belief, compliance={})))
        force, give = some.matrix(*FORCE), scene.residual[:, :3]
        arm = float(np.sum(np.var(scene.simulated[:, :3], axis=0)))
        for part in some.segments:
            force[part] -= force[part].mean(axis=0)
            give[part] -= give[part].mean(axis=0)
        size = float(np.sum(force**2)) * float(np.sum(give**2))
        if not np.isfinite(size) or size == 0.0:
            return
        slope, spread = _compliance(force, give)
        stands = arm <= float(np.sum(np.var(give, axis=0)))
        alike = float(np.sum(force * give)) / np.sqrt(size)
        if slope < -CRITERIA.standard_errors * spread and (stands or alike < -CRITERIA.half):
            told = f"the tip moves against applied.force, by {-1e6 * slope:.3g} +- {1e6 * spread:.2g} um/N"
            what = f"{told}: its sign is opposite, the arm's reaction and not the push"
            # Not turned round: other sets of the same session, whose pushes say less, would keep the wrong sign.
            yield Remark(self.KEY, what, "turn applied.force round, in all sets alike", FORCE, Action.REFUSED)


class PushUnits:
    """Tests whether the force on the tip is in another unit: the believed compliance gives as a factor of one unit says."""

    KEY: ClassVar[str] = "push_units"
    STAGE: ClassVar[Stage] = Stage.FRAMES

    def examine(self, seen: Observations) -> Iterator[Remark]:
        """Yield one remark; the force is repaired where that factor of it leaves hardly anything."""
        names = (*FORCE, *POSITION)
        if seen.predict != "pose" or not seen.belief.compliance or not seen.has_all(*names):
            return
        some = seen.taken(known_rows(seen, (*names, *joint_positions(seen))))
        if len(some) < CRITERIA.pieces * CRITERIA.fewest_vectors:
            return
        bent, free = (
            scene_of(replace(some, belief=replace(some.belief, compliance=one))) for one in (some.belief.compliance, {})
        )
        give, expected = free.residual[:, :3], (bent.simulated - free.simulated)[:, :3]
        for part in some.segments:
            give[part] -= give[part].mean(axis=0)
            expected[part] -= expected[part].mean(axis=0)
        size = float(np.sum(expected**2))
        if not size > 0.0:
            return
        factor = float(np.sum(give * expected)) / size
        left = [float(np.sum((give - k * expected) ** 2)) for k in (factor, 1.0)]
        units = units_of(1.0 / factor, FORCES) if factor > 0.0 else []
        if not units or left[0] > min(CRITERIA.gross_left * float(np.sum(give**2)), CRITERIA.gross_gain * left[1]):
            return
        unit = units[0]
        what = f"the tip gives {factor:.3g} times as much as applied.force says, all joints alike: it is in {unit}"
        repaired = with_columns(seen, {name: seen.columns[name] / FORCES[unit] for name in FORCE})
        yield Remark(self.KEY, what, "", FORCE, Action.REPAIRED, repaired)


def _compliance(F: Array, d: Array) -> tuple[float, float]:
    """Return the compliance (N, 3) along the push (N, 3), m/N, of all pushes, and its standard error over contiguous pieces."""
    work, size = np.sum(F * d, axis=1), np.sum(F**2, axis=1)
    slope = float(work.sum() / size.sum())
    left = work - slope * size
    return slope, float(np.sqrt(sum(piece.sum() ** 2 for piece in np.array_split(left, CRITERIA.pieces))) / size.sum())


class PushAxes:
    """Tests whether the force on the tip is in the axes of the tip or of the sensor and not in the base's, as its name says.

    Asked of joints that give, each by as much as suits: in the right axes hardly anything is left.
    """

    KEY: ClassVar[str] = "push_axes"
    STAGE: ClassVar[Stage] = Stage.FRAMES

    def examine(self, seen: Observations) -> Iterator[Remark]:
        """Yield one remark; the force is turned into the base's axes."""
        names = (*FORCE, *POSITION)
        robot = seen.belief.robot
        if seen.predict != "pose" or robot is None or not seen.has_all(*names):
            return
        some = seen.taken(known_rows(seen, (*names, *joint_positions(seen)), CRITERIA.stretch))
        if len(some) < CRITERIA.pieces * CRITERIA.fewest_vectors:
            return
        as_named = _given(some)
        if as_named is None or as_named < CRITERIA.gross_left:
            return
        for place, where in (("tip", _tip), ("sensor", _sensor)):
            left = _given(with_matrix(some, FORCE, turned(some.matrix(*FORCE), where(some))))
            if left is not None and left < min(CRITERIA.gross_left, CRITERIA.gross_gain * as_named):
                what = f"applied.force is in the axes of the {place}: so read, joints that give leave {left:.0%} of the give, "
                what += f"and {as_named:.0%} as it is named, in the base's"
                known = known_rows(seen, (*names, *joint_positions(seen)))
                force = np.full((len(seen), 3), np.nan)
                force[known] = turned(seen.matrix(*FORCE)[known], where(seen.taken(known)))
                yield Remark(self.KEY, what, "", FORCE, Action.REPAIRED, with_matrix(seen, FORCE, force))
                return


def turned(vectors: Array, R: Array) -> Array:
    """Return vectors (N, 3) in the axes that rotations (N, 3, 3) lead to."""
    return np.asarray(np.einsum("nij,nj->ni", R, vectors))


def _tip(some: Observations) -> Array:
    return poses(scene_of(some))


def _sensor(some: Observations) -> Array:
    robot = some.belief.robot
    assert robot is not None, "asked only with a robot"
    return np.asarray(robot.sensor_pose(some.matrix(*joint_positions(some)))[:, :3, :3])


def _given(some: Observations) -> float | None:
    """Return the share of the tip's give that no compliance of its joints explains; None where no joint bears the pushes."""
    scene = scene_of(replace(some, belief=replace(some.belief, compliance={})))
    give = scene.residual[:, :3].copy()
    columns = [e.columns(scene) for e in Compliance.propose(scene) if e.form == "joint"]
    if not columns or not np.isfinite(give).all():
        return None
    X = np.concatenate([c.full(len(scene.channels)) for c in columns], axis=2)[:, :3]
    for part in some.segments:
        give[part] -= give[part].mean(axis=0)
        X[part] -= X[part].mean(axis=0)
    A, b = X.reshape(-1, X.shape[2]), give.ravel()
    A = A / np.maximum(np.linalg.norm(A, axis=0), 1e-300)
    return float(nnls(A, b)[1] ** 2 / max(float(b @ b), 1e-300))

"""Frames, handedness and units of a tracked pose and of tracked points, against the arm as its joints say it stood."""

from collections.abc import Iterator
from dataclasses import replace
from typing import ClassVar

import numpy as np

from galen_hw.physics.effects.registry import scene_of
from galen_hw.physics.observations import Observations
from galen_hw.physics.scenes.pose import POSITION, QUATERNION
from galen_hw.premises.base import Action, Remark, Stage, with_columns, with_matrix
from galen_hw.premises.channels import slope
from galen_hw.premises.conventions import misread
from galen_hw.premises.criteria import CRITERIA
from galen_hw.premises.registration import poses, registered, sampled
from galen_hw.premises.rotations import (
    Similarity,
    angle_of,
    as_axes,
    as_turn,
    mounting_claim,
    nearest_axes,
    other_quaternions,
    scaled,
    signed_permutations,
    similarity,
    turned_alike,
)
from galen_hw.premises.unit_tables import TRACKED_LENGTHS, unit_of
from galen_hw.spatial import Array, rotation_from_quaternion


class PoseFrames:
    """Tests a tracked position in the base frame: metres, axes of the base, right-handed; and the order of its quaternions."""

    KEY: ClassVar[str] = "pose_frames"
    STAGE: ClassVar[Stage] = Stage.FRAMES

    def examine(self, seen: Observations) -> Iterator[Remark]:
        """Yield a remark on unit and axes of the position, then one on the orientation."""
        if seen.predict != "pose" or seen.belief.robot is None or not seen.has_all(*POSITION):
            return
        some = sampled(seen, POSITION)
        if len(some) < CRITERIA.fewest_vectors:
            return
        for remark in self._column(seen, some):
            yield remark
            seen = remark.repaired or seen
            some = sampled(seen, POSITION)
        for remark in self._position(seen, some):
            yield remark
            seen = remark.repaired or seen
        if seen.has_all(*QUATERNION):
            yield from self._orientation(seen)

    def _column(self, seen: Observations, some: Observations) -> Iterator[Remark]:
        """Yield a remark on the one column that is in another unit than the others."""
        expected, measured = scene_of(some).simulated[:, :3], some.matrix(*POSITION)
        found = [slope(x, y) for x, y in zip(expected.T, measured.T, strict=True)]
        scales = {k: scale for k, scale in enumerate(found) if scale is not None and scale > 0.0}
        units = {k: unit for k, scale in scales.items() if (unit := unit_of(scale, TRACKED_LENGTHS))}
        if len(units) != 1 or len(scales) < 2:
            return
        ((k, unit),) = units.items()
        if any(abs(np.log(scale)) > np.log(CRITERIA.least_factor) for n, scale in scales.items() if n != k):
            return
        repaired = with_columns(seen, {POSITION[k]: seen.columns[POSITION[k]] / TRACKED_LENGTHS[unit]})
        what = f"{POSITION[k]} moves {scales[k]:.4g} times as far as the arm, the others do not: it is in {unit}"
        yield Remark(self.KEY, what, "", (POSITION[k],), Action.REPAIRED, repaired)

    def _position(self, seen: Observations, some: Observations) -> Iterator[Remark]:
        expected, measured = scene_of(some).simulated[:, :3], some.matrix(*POSITION)
        plain = scaled(expected, measured)
        if plain.rank < 2:
            yield from self._standing(seen, expected.mean(axis=0), measured.mean(axis=0))
            return
        right = plain.Q[0, 0] > 0.0 and plain.unexplained <= CRITERIA.small_turn
        found, factor = _axes(expected, measured, plain if right else None), 1.0
        if found is None:
            return
        if not 0.5 < found.scale < 2.0:
            unit = unit_of(found.scale, TRACKED_LENGTHS) if found.scale else ""
            text = f"the tracked position moves {found.scale:.4g} times as far as the arm"
            if not unit:
                yield Remark(self.KEY, f"{text}: it is not in metres", "give metres", POSITION, Action.REFUSED)
                return
            factor = TRACKED_LENGTHS[unit]
            seen = with_columns(seen, {name: seen.columns[name] / factor for name in POSITION})
            yield Remark(self.KEY, f"{text}: it is in {unit}", "", POSITION, Action.REPAIRED, seen)
        if right:
            return
        axes, away = nearest_axes(found.Q)
        mirrored = np.linalg.det(found.Q) < 0.0
        if not mirrored and angle_of(found.Q) <= CRITERIA.least_turn:
            return
        repaired = registered(seen, found.Q, measured / factor, expected)
        if mirrored:
            what = f"the tracker's axes are left-handed: {as_axes(axes)} of the base"
            what += "" if away < CRITERIA.least_turn else ", and turned"
        elif away < CRITERIA.least_turn / 2.0:
            what = f"the pose is in other axes than the base's: {as_axes(axes)} of the base"
        else:
            what = f"the pose is in other axes than the base's, turned by {as_turn(found.Q)}"
        yield Remark(self.KEY, f"{what}; registered to the base", "", POSITION, Action.REPAIRED, repaired)

    def _standing(self, seen: Observations, expected: Array, measured: Array) -> Iterator[Remark]:
        """Yield a remark on unit or handedness of an arm that stands: read so its place (3,) in the base is the simulated one."""
        far, near = float(np.linalg.norm(measured)), float(np.linalg.norm(expected))
        unit = unit_of(far / near, TRACKED_LENGTHS) if near > 0.0 and far > 0.0 else ""
        if unit and float(measured @ expected) > np.cos(CRITERIA.least_turn) * far * near:
            repaired = with_columns(seen, {name: seen.columns[name] / TRACKED_LENGTHS[unit] for name in POSITION})
            text = f"the tracked position lies {far / near:.4g} times as far from the base as the arm reaches: it is in {unit}"
            yield Remark(self.KEY, text, "", POSITION, Action.REPAIRED, repaired)
            return
        plain = float(np.linalg.norm(measured - expected))
        others = [(float(np.linalg.norm(measured @ P - expected)), k) for k, P in enumerate(signed_permutations()) if k]
        missed, k = min(others)
        if plain > CRITERIA.small_turn * near and missed < CRITERIA.gross_left * plain:
            axes = signed_permutations()[k]
            left = "the tracker's axes are left-handed" if np.linalg.det(axes) < 0.0 else "the pose is in other axes"
            what = f"the tip stands where the arm has it if x, y, z are read otherwise: {left}: {as_axes(axes)} of the base"
            yield Remark(self.KEY, what, "write the position in the base's right-handed axes", POSITION, Action.REFUSED)

    def _orientation(self, seen: Observations) -> Iterator[Remark]:
        some = sampled(seen, (*POSITION, *QUATERNION))
        if len(some) < CRITERIA.fewest_vectors:
            return
        expected = poses(scene_of(some))
        q = some.matrix(*QUATERNION)
        misses = {
            says: turned_alike(expected, rotation_from_quaternion(one))
            for says, one in {"": q, **other_quaternions(q)}.items()
        }
        spread = turned_alike(np.tile(np.eye(3), (len(some), 1, 1)), expected)[1]
        if spread < CRITERIA.least_turn:
            return  # an arm that hardly turns cannot tell
        turn, left = misses[""]
        best = min(misses, key=lambda says: misses[says][1])
        if best and misses[best][1] < 0.25 * left and misses[best][1] < 0.25 * spread:
            seen = with_matrix(seen, QUATERNION, other_quaternions(seen.matrix(*QUATERNION))[best])
            yield Remark(self.KEY, f"the pose's quaternions {best}", "", QUATERNION, Action.REPAIRED, seen)
            turn, left = misses[best]
        elif left >= 0.25 * spread and self._placed(some):
            says, rest = misread(expected, rotation_from_quaternion(q))
            if rest < CRITERIA.gross_left * left:
                todo = "convert the orientation again, or leave its columns out and compare the position"
                yield Remark(self.KEY, f"the pose's orientation is {says}", todo, QUATERNION, Action.REFUSED)
                return
        if angle_of(turn) > CRITERIA.least_turn and left < 0.25 * spread:
            yield self._flange(seen, turn)

    def _placed(self, some: Observations) -> bool:
        """Return whether the position is the arm's: else a joint may be what is read otherwise, not the orientation."""
        return scaled(scene_of(some).simulated[:, :3], some.matrix(*POSITION)).unexplained <= CRITERIA.small_turn

    def _flange(self, seen: Observations, turn: Array) -> Remark:
        """Return the repair and the claim of a tracked body that sits turned on its flange by (3, 3), exactly."""
        repaired = replace(seen, belief=replace(seen.belief, tip_rotation=seen.belief.tip_rotation @ turn))
        what, todo = (
            f"the tracked body is turned by {as_turn(turn)} on its link",
            "turn the tip's link in the model by it",
        )
        claim = mounting_claim(turn, "turn", QUATERNION[:3])
        return Remark(self.KEY, what, todo, QUATERNION, Action.REPAIRED, repaired, claim)


def _axes(expected: Array, measured: Array, plain: Similarity | None) -> Similarity | None:
    """Return the axes to believe: those that are named, else a turn, else a mirror; None where none does nearly."""
    if plain is not None:
        return plain
    before = scaled(expected, measured)
    limit = min(CRITERIA.gross_left, CRITERIA.gross_gain * (before.unexplained if before.Q[0, 0] > 0.0 else np.inf))
    options = [similarity(expected, measured, determinant=d) for d in (1, -1)]
    good = [o for o in options if o.unexplained <= limit]
    if not good or good[0].rank < 2:
        return None
    least = min(o.unexplained for o in good)
    # In a plane a mirror is a turn: a turn is what people do.
    return next(o for o in good if o.unexplained <= CRITERIA.as_good * least)


class TargetFrames:
    """Tests tracked points, whose registration is free: metres, and a right-handed tracker."""

    KEY: ClassVar[str] = "target_frames"
    STAGE: ClassVar[Stage] = Stage.FRAMES

    def examine(self, seen: Observations) -> Iterator[Remark]:
        """Yield one remark where another unit or handedness meets the arm far better."""
        names = tuple(name for name in seen.columns if name.startswith("target."))
        if seen.predict != "targets" or not names or seen.belief.robot is None or seen.simulation is not None:
            return
        some = sampled(seen, names)
        if len(some) < CRITERIA.fewest_vectors:
            return
        first = _unexplained(some, names, 1.0, mirror=False)
        if first <= CRITERIA.small_turn**2:
            return
        size = _size(some, names)
        units = [("", 1.0), *((unit, f) for unit, f in TRACKED_LENGTHS.items() if 0.1 < size / f < 10.0)]
        tries = [(unit, f, mirror) for unit, f in units for mirror in (False, True)]
        left = {one: _unexplained(some, names, one[1], mirror=one[2]) for one in tries[1:]}
        best = min(left, key=lambda one: left[one], default=None)
        if best is None or left[best] > min(CRITERIA.small_turn, CRITERIA.gross_gain * first):
            return
        says = [f"targets are in {best[0]}"] if best[0] else []
        says += ["the tracker's axes are left-handed: x is mirrored"] if best[2] else []
        repaired = with_columns(seen, _read(seen, names, best[1], mirror=best[2]))
        yield Remark(self.KEY, "; ".join(says), "", names, Action.REPAIRED, repaired)


def _read(seen: Observations, names: tuple[str, ...], factor: float, *, mirror: bool) -> dict[str, Array]:
    """Return the target columns in another unit, mirrored or not."""
    return {n: seen.columns[n] / factor * (-1.0 if mirror and n.endswith(".x") else 1.0) for n in names}


def _unexplained(some: Observations, names: tuple[str, ...], factor: float, *, mirror: bool) -> float:
    """Return the unexplained share of the targets' motion, read so."""
    scene = scene_of(with_columns(some, _read(some, names, factor, mirror=mirror)))
    moved = scene.measured - scene.measured.mean(axis=0)
    return float(np.sum(scene.residual**2) / max(float(np.sum(moved**2)), 1e-300))


def _size(some: Observations, names: tuple[str, ...]) -> float:
    """Return how many times the arm's motion the targets move, at its largest."""
    robot = some.belief.robot
    assert robot is not None, "asked only with a robot"
    q = some.matrix(*(f"joint.{name}.position" for name in robot.joint_names))
    arm = robot.sensor_pose(q)[:, :3, 3]
    spread = [float(np.sqrt(np.sum(np.var(x, axis=0)))) for x in (some.matrix(*names[:3]), arm)]
    return spread[0] / max(spread[1], 1e-9)

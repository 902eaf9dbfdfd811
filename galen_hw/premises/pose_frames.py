"""Frames, handedness and units of a tracked pose and of tracked points, against the arm as its joints say it stood."""

from collections.abc import Iterator
from dataclasses import replace
from typing import ClassVar, Final

import numpy as np

from galen_hw.physics.effects.registry import scene_of
from galen_hw.physics.observations import Observations
from galen_hw.physics.scenes.base import Scene
from galen_hw.physics.scenes.pose import POSITION, QUATERNION
from galen_hw.premises.base import Action, Claim, Remark, Stage, with_columns
from galen_hw.premises.criteria import CRITERIA
from galen_hw.premises.rotations import Similarity, angle_of, as_axes, as_turn, nearest_axes, scaled, similarity
from galen_hw.spatial import Array, quaternion_from_rotation, rotation_from_quaternion, rotation_log

LENGTHS: Final = {"mm": 1e3, "cm": 1e2, "inches": 1.0 / 0.0254, "feet": 1.0 / 0.3048, "km": 1e-3}


def sampled(seen: Observations, names: tuple[str, ...]) -> Observations:
    """Return rows with joints and the named columns, at most `CRITERIA.most_rows` of them, evenly chosen."""
    robot = seen.belief.robot
    joints = () if robot is None else tuple(f"joint.{name}.position" for name in robot.joint_names)
    rows = np.flatnonzero(np.isfinite(seen.matrix(*joints, *names)).all(axis=1))
    if len(rows) > CRITERIA.most_rows:
        rows = rows[np.linspace(0, len(rows) - 1, CRITERIA.most_rows).astype(int)]
    return seen.taken(rows)


def length_unit(scale: float) -> tuple[str, float] | None:
    """Return the unit of which a metre has `scale`, within a twentieth; None: none that is known, or metres."""
    return next(((u, f) for u, f in LENGTHS.items() if abs(np.log(scale / f)) < CRITERIA.same_factor), None)


class PoseFrames:
    """Tests a tracked position in the base frame: metres, axes of the base, right-handed; and the order of its quaternions."""

    KEY: ClassVar[str] = "pose_frames"
    STAGE: ClassVar[Stage] = Stage.FRAMES

    def examine(self, seen: Observations) -> Iterator[Remark]:
        """Yield a remark on unit and axes of the position, then one on the orientation."""
        if seen.predict != "pose" or seen.belief.robot is None or not all(name in seen.columns for name in POSITION):
            return
        some = sampled(seen, POSITION)
        if len(some) < CRITERIA.fewest_vectors:
            return
        for remark in self._position(seen, some):
            yield remark
            seen = remark.repaired or seen
        if all(name in seen.columns for name in QUATERNION):
            yield from self._orientation(seen)

    def _position(self, seen: Observations, some: Observations) -> Iterator[Remark]:
        expected, measured = scene_of(some).simulated[:, :3], some.matrix(*POSITION)
        plain = scaled(expected, measured)
        if plain.rank < 2:
            yield from self._standing(seen, expected.mean(axis=0), measured.mean(axis=0))
            return
        right = plain.Q[0, 0] > 0.0 and plain.unexplained <= CRITERIA.small_turn
        found, unit = _axes(expected, measured, plain if right else None), None
        if found is None:
            return
        if not 0.5 < found.scale < 2.0:
            unit = length_unit(found.scale)
            text = f"the tracked position moves {found.scale:.4g} times as far as the arm"
            if unit is None:
                yield Remark(self.KEY, f"{text}: it is not in metres", "give metres", POSITION, Action.REFUSED)
                return
            seen = with_columns(seen, {name: seen.columns[name] / unit[1] for name in POSITION})
            yield Remark(self.KEY, f"{text}: it is in {unit[0]}", "", POSITION, Action.REPAIRED, seen)
        if right:
            return
        axes, away = nearest_axes(found.Q)
        mirrored = np.linalg.det(found.Q) < 0.0
        if not mirrored and angle_of(found.Q) <= CRITERIA.least_turn:
            return
        factor = 1.0 if unit is None else unit[1]
        repaired = _registered(seen, found.Q, measured / factor, expected)
        if mirrored:
            what = f"the tracker's axes are left-handed: {as_axes(axes)} of the base"
            what += "" if away < CRITERIA.least_turn else ", and turned"
        elif away < CRITERIA.least_turn / 2.0:
            what = f"the pose is in other axes than the base's: {as_axes(axes)} of the base"
        else:
            what = f"the pose is in other axes than the base's, turned by {as_turn(found.Q)}"
        yield Remark(self.KEY, f"{what}; registered to the base", "", POSITION, Action.REPAIRED, repaired)

    def _standing(self, seen: Observations, expected: Array, measured: Array) -> Iterator[Remark]:
        """Yield a remark on the unit of an arm that stands: in metres its place (3,) in the base would be the simulated one."""
        far, near = float(np.linalg.norm(measured)), float(np.linalg.norm(expected))
        unit = length_unit(far / near) if near > 0.0 else None
        if unit is not None and float(measured @ expected) > np.cos(CRITERIA.least_turn) * far * near:
            repaired = with_columns(seen, {name: seen.columns[name] / unit[1] for name in POSITION})
            text = f"the tracked position lies {far / near:.4g} times as far from the base as the arm reaches: it is in {unit[0]}"
            yield Remark(self.KEY, text, "", POSITION, Action.REPAIRED, repaired)

    def _orientation(self, seen: Observations) -> Iterator[Remark]:
        some = sampled(seen, (*POSITION, *QUATERNION))
        if len(some) < CRITERIA.fewest_vectors:
            return
        expected = simulated_turns(scene_of(some))
        x, y, z, w = (some.columns[name] for name in QUATERNION)
        tries = {
            "": (x, y, z, w),
            "have w first": (y, z, w, x),
            "are inverted": (-x, -y, -z, w),
            "have w first and are inverted": (-y, -z, -w, x),
        }
        misses = {}
        for says, quaternion in tries.items():
            R = rotation_from_quaternion(np.stack(quaternion, axis=1))
            misses[says] = turned_alike(expected, R)
        spread = turned_alike(np.tile(np.eye(3), (len(some), 1, 1)), expected)[1]
        if spread < CRITERIA.least_turn:
            return  # an arm that hardly turns cannot tell
        turn, left = misses[""]
        best = min(tries, key=lambda says: misses[says][1])
        if best and misses[best][1] < 0.25 * left and misses[best][1] < 0.25 * spread:
            order = {"": (0, 1, 2, 3), "have w first": (1, 2, 3, 0), "are inverted": (0, 1, 2, 3)}.get(
                best, (1, 2, 3, 0)
            )
            values = seen.matrix(*QUATERNION)[:, order]
            if "inverted" in best:
                values = values * np.array([-1.0, -1.0, -1.0, 1.0])
            seen = with_columns(seen, dict(zip(QUATERNION, values.T, strict=True)))
            yield Remark(
                self.KEY,
                f"the pose's quaternions {best.replace('inverted', 'the inverse')}",
                "",
                QUATERNION,
                Action.REPAIRED,
                seen,
            )
            turn, left = misses[best]
        if angle_of(turn) > CRITERIA.least_turn and left < 0.25 * spread:
            yield self._flange(seen, turn)

    def _flange(self, seen: Observations, turn: Array) -> Remark:
        """The tracked body sits turned on the flange by (3, 3), exactly."""
        vector = rotation_log(turn)
        parameters = {f"turn_{a}": (float(v), 0.0, "rad") for a, v in zip("xyz", vector, strict=True)}
        term = {"effect": "sensor_mounting", "parameters": {"part": "turn", **{k: v[0] for k, v in parameters.items()}}}
        belief = replace(seen.belief, tip_rotation=seen.belief.tip_rotation @ turn)
        what = f"the tracked body is turned by {as_turn(turn)} on its link"
        claim = Claim("sensor_mounting", parameters, QUATERNION[:3], terms=(term,))
        return Remark(
            self.KEY,
            what,
            "turn the tip's link in the model by it",
            QUATERNION,
            Action.REPAIRED,
            replace(seen, belief=belief),
            claim,
        )


def _axes(expected: Array, measured: Array, plain: Similarity | None) -> Similarity | None:
    """The axes to believe: those that are named where they do, else a turn, else a mirror; None where none does nearly."""
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


def _registered(seen: Observations, Q: Array, measured: Array, expected: Array) -> Observations:
    """The recording with positions, and orientations, brought from axes Q (3, 3) to the base's, its middle where the arm's is."""
    shift = expected.mean(axis=0) - measured.mean(axis=0) @ Q
    position = seen.matrix(*POSITION) @ Q + shift
    columns = dict(zip(POSITION, position.T, strict=True))
    if all(name in seen.columns for name in QUATERNION):
        there = np.isfinite(seen.matrix(*QUATERNION)).all(axis=1)
        q = np.full((len(seen), 4), np.nan)
        R = rotation_from_quaternion(seen.matrix(*QUATERNION)[there])
        # Of a mirrored frame a rotation is mirrored on both sides: where the body's axes are mirrored too.
        turned = Q.T @ R @ (np.eye(3) if np.linalg.det(Q) > 0.0 else Q)
        q[there] = quaternion_from_rotation(turned)
        columns |= dict(zip(QUATERNION, q.T, strict=True))
    return with_columns(seen, columns)


def simulated_turns(scene: Scene) -> Array:
    """Return the simulated orientation (N, 3, 3) of the tip."""
    return np.asarray(scene._pose[:, :3, :3])  # type: ignore[attr-defined]  # noqa: SLF001


def turned_alike(expected: Array, R: Array) -> tuple[Array, float]:
    """Return the turn G (3, 3) of R (N, 3, 3) = expected G, and the rms angle (rad) that it leaves."""
    relative = np.swapaxes(expected, 1, 2) @ R
    U, _, Vt = np.linalg.svd(relative.mean(axis=0))
    G = (U * np.array([1.0, 1.0, np.sign(np.linalg.det(U @ Vt))])) @ Vt
    left = rotation_log(np.swapaxes(relative, 1, 2) @ G)
    return G, float(np.sqrt(np.mean(np.sum(left**2, axis=1))))


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
        first = _left(some, names, 1.0, mirror=False)
        if first <= CRITERIA.small_turn**2:
            return
        size = _size(some, names)
        units = [("", 1.0), *((unit, f) for unit, f in LENGTHS.items() if 0.1 < size / f < 10.0)]
        tries = [(unit, f, mirror) for unit, f in units for mirror in (False, True)]
        left = {one: _left(some, names, one[1], mirror=one[2]) for one in tries[1:]}
        best = min(left, key=lambda one: left[one], default=None)
        if best is None or left[best] > min(CRITERIA.small_turn, CRITERIA.gross_gain * first):
            return
        says = [f"targets are in {best[0]}"] if best[0] else []
        says += ["the tracker's axes are left-handed: x is mirrored"] if best[2] else []
        repaired = with_columns(seen, _read(seen, names, best[1], mirror=best[2]))
        yield Remark(self.KEY, "; ".join(says), "", names, Action.REPAIRED, repaired)


def _read(seen: Observations, names: tuple[str, ...], factor: float, *, mirror: bool) -> dict[str, Array]:
    """Target columns in another unit, mirrored or not."""
    return {n: seen.columns[n] / factor * (-1.0 if mirror and n.endswith(".x") else 1.0) for n in names}


def _left(some: Observations, names: tuple[str, ...], factor: float, *, mirror: bool) -> float:
    """Unexplained share of the targets' motion, read so."""
    scene = scene_of(with_columns(some, _read(some, names, factor, mirror=mirror)))
    moved = scene.measured - scene.measured.mean(axis=0)
    return float(np.sum(scene.residual**2) / max(float(np.sum(moved**2)), 1e-300))


def _size(some: Observations, names: tuple[str, ...]) -> float:
    """Times the arm's motion that the targets move, at its largest."""
    robot = some.belief.robot
    assert robot is not None, "asked only with a robot"
    q = some.matrix(*(f"joint.{name}.position" for name in robot.joint_names))
    arm = robot.sensor_pose(q)[:, :3, 3]
    spread = [float(np.sqrt(np.sum(np.var(x, axis=0)))) for x in (some.matrix(*names[:3]), arm)]
    return spread[0] / max(spread[1], 1e-9)

"""Joints read with the opposite sign of the model's, or in another one's column: told by the whole simulation."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import combinations
from typing import ClassVar

import numpy as np

from galen_hw.physics.channels import joint_of
from galen_hw.physics.effects.registry import scene_of
from galen_hw.physics.observations import Observations
from galen_hw.physics.scenes.base import Scene
from galen_hw.physics.scenes.pose import QUATERNION
from galen_hw.premises.base import Action, Remark, Stage, joint_positions, known_rows, with_columns
from galen_hw.premises.criteria import CRITERIA
from galen_hw.premises.effort_units import beside_friction
from galen_hw.premises.registration import poses
from galen_hw.premises.rotations import scaled, turned_alike
from galen_hw.premises.sampling import compared_names, measured
from galen_hw.premises.wrench_reading import FORCE, at_rest, readings
from galen_hw.spatial import Array, rotation_from_quaternion

OWN: Mapping[str, tuple[str, ...]] = {
    "position": ("position", "velocity", "command"),
    "effort": ("effort",),
}
"""Columns of a joint that one slip turns round, or exchanges, together."""
Rates = tuple[Array, Array] | None
DIFFERENTIABLE_S = 0.05
"""Time between rows up to which a motion of an arm can be differentiated: ten rows of its quickest half second."""


@dataclass(frozen=True)
class _Try:
    """Another way to read joints.

    Args:
        kind: of column, "position" or "effort".
        joints: that are read otherwise.
        swapped: the two read each other's columns; else all are turned round.
    """

    kind: str
    joints: tuple[str, ...]
    swapped: bool

    def read(self, seen: Observations) -> Observations:
        """Return the recording read so."""
        new = {}
        others = self.joints[::-1] if self.swapped else self.joints
        for joint, other in zip(self.joints, others, strict=True):
            for what in OWN[self.kind]:
                column = seen.columns.get(f"joint.{other}.{what}")
                if column is not None:
                    new[f"joint.{joint}.{what}"] = column if self.swapped else -column
        return with_columns(seen, new)

    def moved(self, seen: Observations, rates: Rates) -> Rates:
        """Return the joints' speeds and accelerations (N, n) read so."""
        if rates is None or self.kind != "position":
            return rates
        at = [seen.joint_names.index(joint) for joint in self.joints]
        out = [x.copy() for x in rates]
        for new, old in zip(out, rates, strict=True):
            new[:, at] = old[:, at[::-1]] if self.swapped else -old[:, at]
        return out[0], out[1]

    @property
    def columns(self) -> tuple[str, ...]:
        """Names of the columns that are read otherwise."""
        return tuple(f"joint.{joint}.{self.kind}" for joint in self.joints)


class JointReading:
    """Tests whether the simulation meets what is compared if joints are turned round, or two of them exchanged.

    Asked only where the columns as named leave most of it unexplained and no other axes explain it. Friction of any size, a
    constant and, of a weight, any mass are left free: none of them can turn a joint round.
    """

    KEY: ClassVar[str] = "joint_reading"
    STAGE: ClassVar[Stage] = Stage.FRAMES

    def examine(self, seen: Observations) -> Iterator[Remark]:
        """Yield at most one remark: signs are put right, columns of other joints refused."""
        some = _thinned(seen)
        if some is None:
            return
        scene = scene_of(some)
        if not _doubtful(some, scene):
            return
        # Differentiated once: a joint that is read otherwise moves otherwise in the same way.
        rates = scene.rates if scene.clock else None
        plain = _unexplained(some, rates)
        found = {
            one: left
            for one in _tries(some)
            if (left := _unexplained(one.read(some), one.moved(some, rates))) is not None
        }
        good = _best(plain, found) if plain is not None else []
        if not good or plain is None:
            return
        best = good[0]
        if not _with_constant(some, best):
            return
        names = " or ".join(", ".join(one.columns) for one in good)
        before, after = (1.0 - _mean_unexplained(left, plain, found) for left in (plain, found[best]))
        if best.swapped:
            what = f"{names} are swapped: the simulation explains {before:.0%} of what is compared"
            what += f", and {after:.0%} with the two exchanged"
            yield Remark(self.KEY, what, "give each joint its own column", best.columns, Action.REFUSED)
            return
        has = "has" if len(best.joints) == 1 else "have"
        what = f"{names} {has} the opposite sign of the model's"
        what += f": it explains {before:.0%} of what is compared, and {after:.0%} so turned round"
        yield Remark(self.KEY, what, "", best.columns, Action.REPAIRED, best.read(seen))


def _thinned(seen: Observations) -> Observations | None:
    """Return rows with all joints and compared channels, evenly chosen; at rest where too far apart for a motion."""
    seen = measured(seen)
    robot, names, driven = seen.belief.robot, compared_names(seen), joint_positions(seen)
    if not names or (robot is None and seen.simulation is None and seen.predict != "position"):
        return None
    lacking = robot is not None and len(driven) < len(robot.joint_names)
    if lacking and seen.simulation is None and seen.predict != "position":
        return None
    rows = known_rows(seen, (*names, *driven))
    if len(rows) < CRITERIA.fewest_vectors:
        return None
    some = seen.taken(rows[:: -(-len(rows) // CRITERIA.most_rows)])
    spaced = some.time is not None and float(np.median(np.diff(some.time))) <= DIFFERENTIABLE_S
    return some if spaced or seen.simulation is not None else at_rest(some)


def _tries(some: Observations) -> Iterator[_Try]:
    """Yield each joint turned round, two of them, and two exchanged: of what is compared, and of the positions that drive it."""
    kinds = [some.predict] if some.predict in OWN else []
    if some.belief.robot is not None and some.simulation is None and some.predict != "position":
        kinds.append("position")
    for kind in kinds:
        joints = [j for j in some.joint_names if f"joint.{j}.{kind}" in some.columns]
        for joint in joints:
            yield _Try(kind, (joint,), swapped=False)
        for pair in combinations(joints, 2):
            yield _Try(kind, pair, swapped=True)
        for pair in combinations(joints, 2):
            yield _Try(kind, pair, swapped=False)


def _with_constant(some: Observations, best: _Try) -> bool:
    """Return whether a reading of joints explains the constants of what is compared too: else more is wrong than it says."""
    if some.predict not in OWN:
        return True
    before, after = (float(np.sum((s.measured - s.simulated) ** 2)) for s in map(scene_of, (some, best.read(some))))
    return after < CRITERIA.half * before


def _best(plain: Array, found: Mapping[_Try, Array]) -> list[_Try]:
    """Return the reading that explains nearly all that any does, far better than the columns as named; empty without one.

    A second one that does as well, of other joints, leaves it open. Of the same joints, as of an arm of one, the effort and the
    position turned round are one and the same: both are given.
    """
    score = {one: _mean_unexplained(left, plain, found) for one, left in found.items()}
    least = min(score.values(), default=1.0)
    if least > min(CRITERIA.gross_left, CRITERIA.gross_gain * _mean_unexplained(plain, plain, found)):
        return []
    good = [one for one in found if score[one] <= max(CRITERIA.as_good * least, CRITERIA.small_turn**2)]
    # Simplest first: of two that are as good, one joint less is turned round.
    good = [one for one in good if len(one.joints) == 1 or one.swapped] or good
    return good if len({(one.joints, one.swapped) for one in good}) == 1 else []


def _mean_unexplained(left: Array, plain: Array, found: Mapping[_Try, Array]) -> float:
    """Return the mean unexplained share of the channels of which some reading explains at least half."""
    told = np.min([plain, *found.values()], axis=0) < CRITERIA.half
    return float(np.mean(left[told])) if told.any() else 1.0


def _doubtful(some: Observations, scene: Scene) -> bool:
    """Return whether something that is compared misses its simulation by more than its noise and friction can say."""
    if some.predict not in OWN:
        left = _unexplained(some, None)
        return left is not None and float(np.max(left)) > CRITERIA.small_turn
    y, x = scene.measured, scene.simulated
    if len(y) < 50 or not (np.isfinite(x).all() and np.isfinite(y).all()):
        return False
    for c, name in enumerate(scene.channels):
        own, rest = (_residual(_free(scene, name), v[:, c]) for v in (x, y))
        size = max(float(np.sum(own**2)), 1e-300)
        slope = float(np.sum(own * rest)) / size
        std = float(np.std(rest - slope * own)) / np.sqrt(size)
        if abs(slope - 1.0) > max(CRITERIA.half, CRITERIA.standard_errors * std):
            return True
    return False


def _unexplained(some: Observations, rates: Rates) -> Array | None:
    """Return the unexplained shares (K,) of what is compared; None where nothing is simulated."""
    if some.predict in OWN:
        return _of_joints(some, rates)
    if some.simulation is not None:
        return None
    if some.predict == "wrench":
        return _of_wrench(some)
    return _of_pose(some) if some.predict == "pose" else None


def _of_wrench(some: Observations) -> Array | None:
    """Return the unexplained share (1,) of the force, whatever weighs there."""
    if not some.has_all(*FORCE):
        return None
    one = next(iter(readings(some))).plain
    return np.array([one.unexplained if one.Q[0, 0] > 0.0 else 1.0])


def _of_pose(some: Observations) -> Array | None:
    """Return the shares of the place and, if tracked, of the orientation; None where a pose cannot be simulated."""
    scene = scene_of(some)
    if not np.isfinite(scene.simulated).all():
        return None
    one = scaled(scene.simulated[:, :3], scene.measured[:, :3])
    left = [one.unexplained if one.Q[0, 0] > 0.0 else 1.0]
    if some.has_all(*QUATERNION):
        expected = poses(scene)
        R = rotation_from_quaternion(some.matrix(*QUATERNION))
        spread = turned_alike(np.tile(np.eye(3), (len(some), 1, 1)), expected)[1]
        left.append(min((turned_alike(expected, R)[1] / max(spread, 1e-9)) ** 2, 1.0))
    return np.array(left)


def _of_joints(some: Observations, rates: Rates) -> Array | None:
    """Return the shares by channel, given a constant and, of efforts, friction of any size."""
    scene = scene_of(some, rates=rates)
    y, x = scene.measured, scene.simulated
    if len(y) < 50 or not (np.isfinite(x).all() and np.isfinite(y).all()):
        return None
    out = []
    for c, name in enumerate(scene.channels):
        free = _free(scene, name)
        moved, left = (_residual(free, v) for v in (y[:, c], y[:, c] - x[:, c]))
        out.append(min(float(np.sum(left**2)) / max(float(np.sum(moved**2)), 1e-300), 1.0))
    return np.array(out)


def _free(scene: Scene, channel: str) -> Array:
    """Return the nuisance columns (N, k) of a channel: a constant, and of an effort the two shapes of friction."""
    if scene.observations.predict != "effort" or not scene.clock:
        return np.ones((len(scene), 1))
    joint = joint_of(channel)
    return beside_friction(scene.rates[0][:, scene.joint_index(joint)])


def _residual(free: Array, y: Array) -> Array:
    """Return the residual of y (N,) after least squares on columns (N, k)."""
    return np.asarray(y - free @ np.linalg.lstsq(free, y, rcond=None)[0])

"""Joints read with another sign or zero than the model's, or in another one's column: told by the whole simulation."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations, pairwise, product
from typing import ClassVar, Final

import numpy as np
from scipy.optimize import linear_sum_assignment

from galen_hw.physics.channels import joint_of
from galen_hw.physics.effects.registry import scene_of
from galen_hw.physics.observations import Observations
from galen_hw.physics.scenes.base import Scene
from galen_hw.physics.scenes.pose import QUATERNION
from galen_hw.premises.base import Action, Remark, Stage, with_columns
from galen_hw.premises.criteria import CRITERIA
from galen_hw.premises.effort_units import beside_friction
from galen_hw.premises.registration import poses
from galen_hw.premises.rotations import scaled, turned_alike
from galen_hw.premises.thinning import DIFFERENTIABLE_S, Rates, thinned
from galen_hw.premises.unit_tables import JOINT_ANGLES, JOINT_LENGTHS
from galen_hw.premises.wrench_reading import FORCE, at_rest, readings
from galen_hw.spatial import Array, rotation_from_quaternion

OWN: Mapping[str, tuple[str, ...]] = {
    "position": ("position", "velocity", "command"),
    "effort": ("effort",),
    "every": ("position", "velocity", "command", "effort"),
}
"""Columns of a joint that one slip turns round, or exchanges, together."""
SIGN: Final = "the opposite sign of the model's"
SWAPPED: Final = "swapped"
SHIFTED: Final = "shifted by a column, so that each joint has its neighbour's"
ORDERED: Final = "in another order, as of names that were sorted"
COUPLED: Final = "those of two motors that drive both joints, as in a differential"
REFUSED: Final = {
    SWAPPED: ("the two exchanged", "give each joint its own column"),
    SHIFTED: ("each read from the next column", "begin the list of joints where that of the columns begins"),
    ORDERED: ("each read as the joint's that it follows", "give each joint its own column"),
    COUPLED: ("their sum and difference", "give the efforts of the joints themselves"),
}
"""What is refused: as what it was read instead, and what to do."""


@dataclass(frozen=True)
class _Try:
    """Another way to read joints: a linear map of their columns, and another zero.

    Args:
        kind: of column, "position", "effort", or "every" of a joint's.
        joints: that are read otherwise.
        mix: (n, n) what each joint is of the columns of all of them.
        zeros: rad that are added to the position of each, none: 0.
        says: what the mistake is, in words; empty: the sign.
    """

    kind: str
    joints: tuple[str, ...]
    mix: tuple[tuple[float, ...], ...]
    zeros: tuple[float, ...] = ()
    says: str = ""

    def read(self, seen: Observations) -> Observations:
        """Return the recording read so."""
        new = dict[str, Array]()
        for what in OWN[self.kind]:
            names = [f"joint.{joint}.{what}" for joint in self.joints]
            if seen.has_all(*names):
                read = seen.matrix(*names) @ np.array(self.mix).T
                if self.zeros and what != "velocity":
                    read = read + np.array(self.zeros)
                new |= dict(zip(names, read.T, strict=True))
        return with_columns(seen, new)

    def moved(self, seen: Observations, rates: Rates) -> Rates:
        """Return the joints' speeds and accelerations (N, n) read so."""
        if rates is None or self.kind == "effort":
            return rates
        at = [seen.joint_names.index(joint) for joint in self.joints]
        out = [x.copy() for x in rates]
        for x in out:
            x[:, at] = x[:, at] @ np.array(self.mix).T
        return out[0], out[1]

    @property
    def columns(self) -> tuple[str, ...]:
        """Names of the columns that are read otherwise."""
        kinds = ("position", "effort") if self.kind == "every" else (self.kind,)
        return tuple(f"joint.{joint}.{kind}" for joint in self.joints for kind in kinds)


class JointReading:
    """Tests whether the simulation meets what is compared if joints are turned round, exchanged, or counted from another zero.

    Asked only where the columns as named leave most of it unexplained and no other axes explain it. Friction of any size, a
    constant and, of a weight, any mass are left free: none of them can turn a joint round, or its zero by a quarter.
    """

    KEY: ClassVar[str] = "joint_reading"
    STAGE: ClassVar[Stage] = Stage.FRAMES

    def examine(self, seen: Observations) -> Iterator[Remark]:
        """Yield at most one remark: signs and zeros are put right, columns of other joints or of motors refused."""
        some_rows = thinned(seen)
        # Differentiated once: a joint that is read otherwise moves otherwise in the same way.
        if some_rows is None or not _doubtful(*some_rows):
            return
        some, rates = some_rows
        plain = _unexplained(some, rates)
        found = {
            one: left
            for one in _tries(some, rates)
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
        if best.says in REFUSED:
            read, todo = REFUSED[best.says]
            what = f"{names} are {best.says}: the simulation explains {before:.0%} of what is compared"
            what += f", and {after:.0%} with {read}"
            yield Remark(self.KEY, what, todo, best.columns, Action.REFUSED)
            return
        has = "has" if len(best.joints) == 1 else "have"
        what = f"{names} {has} {best.says or SIGN}: it explains {before:.0%} of what is compared"
        what += f", and {after:.0%} so {'read' if best.says else 'turned round'}"
        yield Remark(self.KEY, what, "", best.columns, Action.REPAIRED, best.read(seen))


def better(one: Observations, other: Observations) -> bool:
    """Return whether over a whole motion one reading of a recording leaves far less unexplained than another."""
    shares = [None if rows is None else _unexplained(*rows) for rows in map(thinned, (one, other))]
    first, second = shares
    if first is None or second is None or len(first) != len(second):
        return False
    told = np.minimum(first, second) < CRITERIA.half
    return bool(told.any() and np.mean(first[told]) < CRITERIA.gross_gain * np.mean(second[told]))


def _tries(some: Observations, rates: Rates) -> Iterator[_Try]:
    """Yield other readings: joints turned round, exchanged or from another zero, of what is compared and of what drives it."""
    kinds = [some.predict] if some.predict in OWN else []
    if some.belief.robot is not None and some.simulation is None and some.predict != "position":
        kinds.append("position")
    for kind in kinds:
        joints = [j for j in some.joint_names if f"joint.{j}.{kind}" in some.columns]
        yield from (_Try(kind, (joint,), ((-1.0,),)) for joint in joints)
        if kind == "position" != some.predict:
            turning = [joint for joint in joints if not some.belief.slides(joint)]
            yield from _zeros(turning)
            yield from _linked(turning)
            yield from (_in_unit(joint, slides=joint not in turning) for joint in joints)
        for pair in combinations(joints, 2):
            yield _Try(kind, pair, ((0.0, 1.0), (1.0, 0.0)), says=SWAPPED)
        for pair in combinations(joints, 2):
            yield _Try(kind, pair, ((-1.0, 0.0), (0.0, -1.0)))
        if len(joints) > 2:
            yield from _shifted(kind, joints)
        if kind == "effort":
            yield from _coupled(joints)
        if kind == some.predict:
            yield from _ordered(some, rates, kind)
    if len(kinds) == 2 and kinds[0] == "effort":
        # A message that names its joints in another order takes all of their columns with it.
        yield from (_Try("every", pair, ((0.0, 1.0), (1.0, 0.0)), says=SWAPPED) for pair in combinations(joints, 2))
        for first, last in combinations(range(len(joints) + 1), 2):
            if last - first > 2:
                yield from _shifted("every", joints[first:last])


def _zeros(joints: Sequence[str]) -> Iterator[_Try]:
    """Yield positions that are counted from a zero a quarter of a turn or half of one elsewhere, either way round."""
    for joint in joints:
        for sign, turned in ((1.0, ""), (-1.0, " and the opposite sign")):
            for quarters in (1, 2, -1):
                says = f"its zero {abs(90 * quarters)} deg from the model's{turned}"
                yield _Try("position", (joint,), ((sign,),), (quarters * np.pi / 2.0,), says)
    # The pose in which the second is counted from where the first points, as an upright arm's.
    for pair in pairwise(joints):
        for ways in product((1.0, -1.0), repeat=2):
            turns = "the same way" if ways[0] == ways[1] else "opposite ways"
            says, zeros = f"their zeros 90 deg from the model's, {turns}", tuple(way * np.pi / 2.0 for way in ways)
            yield _Try("position", pair, ((1.0, 0.0), (0.0, 1.0)), zeros, says)


def _in_unit(joint: str, *, slides: bool) -> _Try:
    """Return positions of one joint in the unit that people think in, unlike those of all others."""
    unit, factor = ("mm", JOINT_LENGTHS["mm"]) if slides else ("degrees", JOINT_ANGLES["degrees"])
    return _Try("position", (joint,), ((1.0 / factor,),), says=f"{unit} for its unit, unlike the others")


def _linked(joints: Sequence[str]) -> Iterator[_Try]:
    """Yield positions that are counted against the link before the last one: a parallel linkage, or J3 as a pendant shows it."""
    for pair in pairwise(joints):
        for sign, way in ((1.0, "added to"), (-1.0, "taken off")):
            says = f"a coupling, as J2 and J3 of a pendant: the first is {way} the second"
            yield _Try("position", pair, ((1.0, 0.0), (sign, 1.0)), says=says)


def _shifted(kind: str, joints: Sequence[str]) -> Iterator[_Try]:
    """Yield columns of joints that began one too early or too late, the last one first: another device's came first, say."""
    for way in (1, -1):
        mix = np.roll(np.eye(len(joints)), way, axis=1)
        yield _Try(kind, tuple(joints), tuple(map(tuple, mix.tolist())), says=SHIFTED)


def _ordered(some: Observations, rates: Rates, kind: str) -> Iterator[_Try]:
    """Yield the order in which each column stands for the joint whose simulation it follows, all together (an assignment).

    Of two that are exchanged, or all that are shifted by one, there are shorter words.
    """
    scene = scene_of(some, rates=rates)
    y, x = scene.measured, scene.simulated
    if len(y) < 50 or not (np.isfinite(x).all() and np.isfinite(y).all()):
        return
    count = len(scene.channels)
    left = np.empty((count, count))
    for joint, name in enumerate(scene.channels):
        free = _free(scene, name)
        rest, own = _residual(free, y), _residual(free, x[:, joint])
        part = np.sum((rest - own[:, None]) ** 2, axis=0) / np.maximum(np.sum(rest**2, axis=0), 1e-300)
        left[joint] = np.minimum(part, 1.0)
    # What nothing explains stays where it is.
    column = linear_sum_assignment(
        np.where(left < CRITERIA.half, left, 1.0) + CRITERIA.small_turn * (1.0 - np.eye(count))
    )[1]
    moved = [k for k in range(count) if column[k] != k]
    by_one = len(moved) == count and any(np.array_equal(column, np.roll(np.arange(count), way)) for way in (1, -1))
    if len(moved) > 2 and not by_one:
        mix = np.array([[float(column[a] == b) for b in moved] for a in moved])
        yield _Try(
            kind, tuple(joint_of(scene.channels[k]) for k in moved), tuple(map(tuple, mix.tolist())), says=ORDERED
        )


def _coupled(joints: Sequence[str]) -> Iterator[_Try]:
    """Yield efforts of two motors that drive neighbouring joints together, through a differential: each way round."""
    for pair in pairwise(joints):
        for scale, sign in product((1.0, 0.5), (1.0, -1.0)):
            yield _Try("effort", pair, ((scale, scale), (sign * scale, -sign * scale)), says=COUPLED)


def _with_constant(some: Observations, best: _Try) -> bool:
    """Return whether a reading of joints explains the constants of what is compared too: else more is wrong than it says.

    Of the channels that are read otherwise; where what drives them is, of all.
    """
    if some.predict not in OWN:
        return True
    plain, read = (scene_of(seen) for seen in (some, best.read(some)))
    at = [k for k, name in enumerate(plain.channels) if best.kind != some.predict or name in best.columns]
    before, after = (float(np.sum((s.measured - s.simulated)[:, at] ** 2)) for s in (plain, read))
    return after < CRITERIA.half * before


def _best(plain: Array, found: Mapping[_Try, Array]) -> list[_Try]:
    """Return the reading that explains nearly all that any does, far better than the columns as named; empty without one.

    A second one that does as well, of other joints, leaves it open. Of the same joints, as of an arm of one, the effort and the
    position turned round are one and the same: both are given. What no other reading nearly explains may leave more: friction of
    no simple shape is much of a small joint's effort.
    """
    score = {one: _mean_unexplained(left, plain, found) for one, left in found.items()}
    least = min(score.values(), default=1.0)
    good = [one for one in found if score[one] <= max(CRITERIA.as_good * least, CRITERIA.small_turn**2)]
    second = min((score[one] for one in found if one not in good), default=1.0)
    limit = CRITERIA.gross_gain if least < CRITERIA.gross_gain * second else CRITERIA.gross_left
    if least > min(limit, CRITERIA.gross_gain * _mean_unexplained(plain, plain, found)):
        return []
    # Simplest first: of two that are as good, one joint less is turned round, or counted from another zero.
    good = [one for one in good if len(one.joints) == 1 or (one.says and not one.zeros)] or good
    good = [one for one in good if one.says != ORDERED] or good
    return good if len({(one.joints, one.says) for one in good}) == 1 else []


def _mean_unexplained(left: Array, plain: Array, found: Mapping[_Try, Array]) -> float:
    """Return the mean unexplained share of the channels of which some reading explains half, and far more than the columns do.

    1 without any, and of a reading that loses a channel which the columns as named explain.
    """
    best = np.min([plain, *found.values()], axis=0)
    told = best < np.minimum(CRITERIA.half, CRITERIA.gross_gain * plain)
    lost = bool(np.any((plain <= CRITERIA.gross_left) & (left > CRITERIA.half)))
    return float(np.mean(left[told])) if told.any() and not lost else 1.0


def _doubtful(some: Observations, rates: Rates) -> bool:
    """Return whether something that is compared misses its simulation by more than its noise and friction can say."""
    if some.predict not in OWN:
        left = _unexplained(some, None)
        # What an arm's tip is off by is far smaller beside its reach than a load beside its weight.
        least = CRITERIA.small_turn if some.predict == "wrench" else CRITERIA.small_turn**2
        return left is not None and float(np.max(left)) > least
    scene = scene_of(some, rates=rates)
    y, x = scene.measured, scene.simulated
    if len(y) < 50 or not (np.isfinite(x).all() and np.isfinite(y).all()):
        return False
    for c, name in enumerate(scene.channels):
        own, rest = (_residual(_free(scene, name), v[:, c]) for v in (x, y))
        size = max(float(np.sum(own**2)), 1e-300)
        slope = float(np.sum(own * rest)) / size
        std = float(np.std(rest - slope * own)) / np.sqrt(size)
        if abs(slope - 1.0) > max(CRITERIA.gross_gain, CRITERIA.standard_errors * std):
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
    return _of_pose(some) if some.predict == "pose" else _of_targets(some)


def _of_wrench(some: Observations) -> Array | None:
    """Return the unexplained share (1,) of the force, whatever weighs there."""
    if not some.has_all(*FORCE):
        return None
    # Differentiated here between the chosen rows, which may be too far apart.
    spaced = some.time is not None and float(np.median(np.diff(some.time))) <= DIFFERENTIABLE_S
    reading = next(iter(readings(some if spaced or some.simulation is not None else at_rest(some))))
    if not np.isfinite(reading.expected).all():
        return None
    one = reading.plain
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


def _of_targets(some: Observations) -> Array | None:
    """Return the share (1,) of what tracked points move, the tracker's frame and their places on the tip as they fit best."""
    scene = scene_of(some)
    if not np.isfinite(scene.simulated).all():
        return None
    left = np.sum((scene.measured - scene.simulated) ** 2)
    return np.array([min(float(left / np.sum((scene.measured - scene.measured.mean(axis=0)) ** 2)), 1.0)])


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

"""Frames and signs of a wrench and of the sensor's orientation: solved as rotations, of any size and either handedness."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import ClassVar, Final

import numpy as np

from galen_hw.physics.effects.registry import scene_of
from galen_hw.physics.observations import Observations
from galen_hw.premises.base import Action, Remark, Stage, with_matrix
from galen_hw.premises.criteria import CRITERIA
from galen_hw.premises.gravity import angle_between, gravity_remark
from galen_hw.premises.rotations import angle_of, as_axes, as_turn, mounting_claim, nearest_axes, signed_permutations
from galen_hw.premises.wrench_reading import (
    FORCE,
    INVERSE,
    ORIENTATION,
    TORQUE,
    Reading,
    any_gravity,
    at_rest,
    comparable,
    lever_fit,
    readings,
    reread,
    sensor_rotations,
    turn_sensor,
    turn_wrench,
)
from galen_hw.spatial import Array

IDENTITY: Final = np.eye(3)
HALF_ABOUT_Z: Final = np.diag([-1.0, -1.0, 1.0])


@dataclass(frozen=True)
class _Found:
    """A reading that meets the force, and the axes Q (3, 3) in which it does."""

    reading: Reading
    Q: Array
    unexplained: float
    kind: str


class WrenchFrames:
    """Tests that force and torque are in the sensor's axes with the sign of the specification, under the gravity that is named.

    A weight turns against the sensor as R^T g does. Where that, times a mass, plus a constant, misses most of what the force
    does, other readings of the columns are tried, the simplest first: another order of the quaternions, axes of the base, a
    turned or mirrored set of axes (Procrustes, either determinant), gravity along another direction. One is believed only where
    it meets the force far better than what is named, and nearly completely: an unknown push can imitate none of them.
    """

    KEY: ClassVar[str] = "wrench_frames"
    STAGE: ClassVar[Stage] = Stage.FRAMES

    def examine(self, seen: Observations) -> Iterator[Remark]:
        """Yield at most one remark on force and torque together, behind one on exchanged columns."""
        if seen.predict != "wrench" or not seen.has_all(*FORCE, *TORQUE):
            return
        if _are_exchanged(seen):
            seen = _exchanged(seen)
            what = "force and torque are exchanged: the columns of the torque hold the weight"
            yield Remark(self.KEY, what, "", (*FORCE, *TORQUE), Action.REPAIRED, seen)
        found = self._found(at_rest(comparable(seen, CRITERIA.most_rows)))
        named = (
            found is not None and np.array_equal(found.Q, IDENTITY) and found.kind == "plain" and not found.reading.says
        )
        if not named and seen.belief.dynamic and seen.time is not None:
            # What accelerates the tool may be the larger part of the force, and tells a sign from gravity that points up.
            found = self._found(comparable(seen))
        if found is None:
            return
        gravity = found.kind == "gravity"
        if not gravity and np.array_equal(found.Q, IDENTITY) and _about_tip(found.reading.seen):
            yield self._moved(seen, found)
            return
        remark = (
            gravity_remark(self.KEY, seen, _gravity(found.reading)[0], (*FORCE, *TORQUE))
            if gravity
            else self._of_axes(seen, found)
        )
        if remark is None:
            remark = self._torque_in_base(seen, found.reading.seen)
        if remark is not None:
            yield remark

    def _torque_in_base(self, seen: Observations, some: Observations) -> Remark | None:
        """Return the repair of a torque in axes of the base beside a force in the sensor's, whatever hangs there."""
        force, torque = some.matrix(*FORCE), some.matrix(*TORQUE)
        base = lever_fit(force, _into_sensor(some, torque))[1]
        if base > min(CRITERIA.gross_left, CRITERIA.gross_gain * lever_fit(force, torque)[1]):
            return None
        repaired = with_matrix(seen, TORQUE, _into_sensor(seen, seen.matrix(*TORQUE)))
        what = "the torque is in axes of the base, the force in the sensor's"
        return Remark(self.KEY, what, "", TORQUE, Action.REPAIRED, repaired)

    def _found(self, seen: Observations) -> _Found | None:
        """Return the reading to believe; None where none can be: too few rows, one direction alone, or other forces."""
        if len(seen) < CRITERIA.fewest_vectors:
            return None
        usable = list(readings(seen))
        plain = usable[0].plain
        if plain.rank < 2:
            return None
        if plain.unexplained <= CRITERIA.small_turn:
            best: _Found | None = _Found(usable[0], plain.Q, plain.unexplained, "plain")
        else:
            best = _best(usable, plain.unexplained if _is_named(plain.Q) else np.inf)
        if best is not None and np.array_equal(best.Q, -IDENTITY):
            best = _sign_or_gravity(seen, best)
        return None if best is not None and best.kind == "gravity" and not _possible(seen, best) else best

    def _moved(self, seen: Observations, found: _Found) -> Remark:
        """Say that the moments are about the tip; what the reading says of the rest first."""
        says = [found.reading.says] if found.reading.says else []
        there = _about_origin(reread(seen, found.reading.says) if says else seen)
        says.append("the moments are about the tool's tip, not the sensor's origin")
        return Remark(self.KEY, "; ".join(says), "", TORQUE, Action.REPAIRED, there)

    def _of_axes(self, seen: Observations, found: _Found) -> Remark | None:
        """Return a remark on what the force's axes say, and what the torque's do beside them."""
        says = [found.reading.says] if found.reading.says else []
        seen = reread(seen, found.reading.says) if says else seen
        Q = found.Q
        axes, away = nearest_axes(Q)
        mirrored = np.linalg.det(Q) < 0.0
        torque_axes, kept_tool = _torque_axes(found.reading.seen, Q)
        if not mirrored and angle_of(Q) <= CRITERIA.least_turn and np.array_equal(torque_axes, Q):
            return self._repaired(seen, says)
        alike = np.allclose(torque_axes, Q)
        if not mirrored and alike:
            if says:
                turned = f"the sensor is turned by {as_turn(Q.T)} on its link"
                if says == [INVERSE] and angle_of(Q @ HALF_ABOUT_Z) <= CRITERIA.least_turn:
                    # Of Rx(c) Ry(b) Rz(a) in the place of Rz(a) Ry(b) Rx(c) gravity shows no more.
                    turned += " (or Euler angles were put together in the other order)"
                return self._repaired(seen, [*says, turned], turn=Q.T)
            return self._mounting(seen, Q.T, tool_turns=not kept_tool)
        if angle_of(axes.T @ Q) > CRITERIA.least_turn or away > CRITERIA.least_turn:
            says.append(f"the axes of the force are {'mirrored and ' if mirrored else ''}turned")
            line = "; ".join(says)
            return Remark(
                self.KEY, line, "write the wrench in the sensor's right-handed axes", (*FORCE, *TORQUE), Action.REFUSED
            )
        torque_axes = axes if alike else torque_axes
        says += _axes_say(axes, torque_axes)
        if not _tool_known(seen) and (
            np.array_equal(axes, -IDENTITY) or not (alike or np.array_equal(torque_axes, IDENTITY))
        ):
            # A centre of mass on the other side fits as well with the other sign.
            line = f"{'; '.join(says)}; which sign the torque has cannot be told without a tool whose centre of mass is named"
            todo = "put axes and signs right in the file, or name the tool's mass and com in recording.json"
            return Remark(self.KEY, line, todo, (*FORCE, *TORQUE), Action.REFUSED)
        return self._repaired(turn_wrench(seen, axes.T, torque_axes.T), says)

    def _repaired(self, seen: Observations, says: list[str], turn: Array | None = None) -> Remark | None:
        if not says:
            return None
        columns = (*FORCE, *TORQUE) if not says[0].startswith("the quaternion") else ORIENTATION
        seen = seen if turn is None else turn_sensor(seen, turn)
        return Remark(self.KEY, "; ".join(says), "", columns, Action.REPAIRED, seen)

    def _mounting(self, seen: Observations, turn: Array, *, tool_turns: bool) -> Remark:
        what = f"the sensor is turned by {as_turn(turn)} on its link"
        repaired = turn_sensor(seen, turn)
        if not tool_turns:
            tool = repaired.belief.tool
            turned = replace(tool, com=turn.T @ tool.com, inertia=turn.T @ tool.inertia @ turn)
            repaired = replace(repaired, belief=replace(repaired.belief, tool=turned))
        claim = mounting_claim(turn, "turn" if tool_turns else "turn_alone", (*FORCE, *TORQUE))
        todo = "turn the sensor's link in the robot's model by it"
        return Remark(self.KEY, what, todo, (*FORCE, *TORQUE), Action.REPAIRED, repaired, claim)


def _are_exchanged(seen: Observations) -> bool:
    """Return whether the force stands in the torque's columns."""
    some = at_rest(comparable(seen, CRITERIA.most_rows))
    if len(some) < CRITERIA.fewest_vectors:
        return False
    named = next(iter(readings(some)))
    least = min(CRITERIA.gross_left, CRITERIA.gross_gain * named.plain.unexplained)
    if named.plain.rank < 2 or named.plain.unexplained <= CRITERIA.gross_left:
        return False
    # Moments of any size with no tool named: as forces they may turn with gravity, but then the forces are no moments of a tool.
    spread = [float(np.sum(np.var(some.matrix(*names), axis=0))) for names in (FORCE, TORQUE)]
    if spread[0] > CRITERIA.longest_lever**2 * spread[1]:
        return False
    one = next(iter(readings(_exchanged(some))))
    found = _Found(one, IDENTITY, one.plain.unexplained, "plain")
    return found.unexplained <= least and _is_named(one.plain.Q) and _weighs(found)


def _into_sensor(seen: Observations, vectors: Array) -> Array:
    """Return vectors (N, 3) in axes of the base in those of the sensor."""
    return np.asarray(np.einsum("nji,nj->ni", sensor_rotations(scene_of(seen)), vectors))


def _exchanged(seen: Observations) -> Observations:
    """Return the recording with the columns of force and torque exchanged."""
    return with_matrix(seen, (*FORCE, *TORQUE), seen.matrix(*TORQUE, *FORCE))


def _is_named(Q: Array) -> bool:
    return bool(Q[0, 0] > 0.0)


def _possible(seen: Observations, found: _Found) -> bool:
    """Return whether gravity may point as found: far from what is named, and the known tool weighs what it weighs.

    A cable that pulls one way in the base is as a part of gravity, but of another size.
    """
    weight, _ = _gravity(found.reading)
    mass = sum(body.mass for body in seen.belief.hanging)
    size = float(np.linalg.norm(seen.belief.gravity))
    off = abs(float(np.linalg.norm(weight)) / (mass * size) - 1.0) if mass > 0.0 else 0.0
    return bool(off < CRITERIA.gross_left and angle_between(seen.belief.gravity, weight) > CRITERIA.least_turn)


def _best(usable: list[Reading], plain: float) -> _Found | None:
    """Return the simplest reading that meets the force nearly completely and far better than the columns as named."""
    others = [r for r in usable[1:] if r.plain.unexplained < 1.0 and _is_named(r.plain.Q)]
    options = [_Found(reading, IDENTITY, reading.plain.unexplained, "plain") for reading in others]
    first = usable[0].plain
    if not _is_named(first.Q):
        # Turned round as a whole: a sign is simpler than any turn of axes or of gravity.
        options.insert(0, _Found(usable[0], first.Q, first.unexplained, "turned"))
    for determinant in (1, -1):
        one = usable[0].turned(determinant)
        options.append(_Found(usable[0], one.Q, one.unexplained, "turned"))
    _weight, unexplained = _gravity(usable[0])
    options.insert(len(options) - 1, _Found(usable[0], IDENTITY, unexplained, "gravity"))
    for reading in usable[1:]:
        for determinant in (1, -1):
            one = reading.turned(determinant)
            options.append(_Found(reading, one.Q, one.unexplained, "turned"))
    good = [
        o
        for o in options
        if o.unexplained <= min(CRITERIA.gross_left, CRITERIA.gross_gain * plain)
        and (o.kind == "gravity" or _weighs(o))
    ]
    if not good:
        return None
    # What small effects leave is no reason for a less simple reading.
    enough = max(CRITERIA.as_good * min(o.unexplained for o in good), CRITERIA.small_turn)
    return next(o for o in good if o.unexplained <= enough)


def _gravity(reading: Reading) -> tuple[Array, float]:
    """Return gravity and unexplained share as `any_gravity`, less what accelerates the tool where the model says it."""
    seen, force = reading.seen, reading.force
    if seen.belief.dynamic and seen.time is not None and seen.simulation is None and len(seen.belief.hanging):
        force = force - (scene_of(seen).simulated - scene_of(at_rest(seen)).simulated)[:, :3]
    return any_gravity(sensor_rotations(scene_of(seen)), force)


def _sign_or_gravity(seen: Observations, sign: _Found) -> _Found:
    """Return a force of opposite sign, or gravity that points up: at rest they are one, what accelerates tells them apart."""
    if not seen.belief.dynamic or seen.time is None or seen.simulation is not None:
        return sign
    up = replace(seen, belief=replace(seen.belief, gravity=-seen.belief.gravity))
    hangs = next(iter(readings(up))).plain
    if not _is_named(hangs.Q) or hangs.unexplained > CRITERIA.half * sign.unexplained:
        return sign
    return _Found(sign.reading, IDENTITY, hangs.unexplained, "gravity")


def _weighs(option: _Found) -> bool:
    """Return whether the force of a reading is of the size that the named tool has, as far as one is named."""
    reading, tool = option.reading, option.reading.seen.belief.hanging
    mass = sum(body.mass for body in tool)
    if mass <= 0.0 or reading.seen.simulation is not None:
        return True
    one = reading.plain if option.kind == "plain" else reading.turned(int(np.sign(np.linalg.det(option.Q))))
    return 1.0 / CRITERIA.least_factor < one.scale / mass < CRITERIA.least_factor


def _tool_known(seen: Observations) -> bool:
    """Return whether the simulation has a moment: its sign is then known."""
    tool = seen.belief.tool
    return seen.simulation is not None or (tool.mass > 0.0 and bool(np.any(tool.com)))


def _torque_axes(seen: Observations, Q: Array) -> tuple[Array, bool]:
    """Return the axes (3, 3) of the torque given a force in axes Q, and whether the tool stayed when the sensor turned.

    Where the tool is known, its moment says the sign too; where not, any lever does, and the torque is taken to be as the force
    unless another set of axes meets it far better.
    """
    scene = scene_of(seen)
    force, torque = seen.matrix(*FORCE) @ Q, seen.matrix(*TORQUE)
    known = _tool_known(seen)
    if known:
        expected = scene.simulated[:, 3:]
        turns = np.cross(scene.belief.tool.com, scene.simulated[:, :3] @ Q.T)
        options = [(Q, _unexplained(turns, torque), False), (Q, _unexplained(expected @ Q.T, torque), True)]
        options += [(P, _unexplained(expected @ P.T, torque), True) for P in _others(Q)]
    else:
        options = [(P, lever_fit(force, torque @ P)[1], False) for P in (Q, *_others(Q))]
    enough = min(CRITERIA.gross_left, CRITERIA.gross_gain * options[0][1])
    if known:
        # A tool that hangs elsewhere explains other axes too, and is the better answer where these leave far more.
        enough = min(enough, max(CRITERIA.as_good * lever_fit(force, torque @ Q)[1], CRITERIA.small_turn))
    better = [o for o in options[1:] if o[1] <= enough]
    if options[0][1] <= CRITERIA.gross_left or not better:
        if known and options[1][1] < options[0][1]:
            return Q, True
        return Q, False
    least = min(o[1] for o in better)
    best = next(o for o in better if o[1] <= CRITERIA.as_good * least)
    return best[0], best[2]


def _about_tip(seen: Observations) -> bool:
    """Return whether the moments are those of the named tool about its tip: nearly all that is missed about the origin."""
    if not _tool_known(seen) or not np.any(seen.belief.tip):
        return False
    expected, torque = scene_of(seen).simulated[:, 3:], seen.matrix(*TORQUE)
    # In N m, and of the named size: a lever that is added explains a larger share of what it makes larger itself.
    named, tip, whole = (
        float(np.sum((x - x.mean(axis=0)) ** 2))
        for x in (torque - expected, _about_origin(seen).matrix(*TORQUE) - expected, torque)
    )
    return tip <= min(CRITERIA.small_turn * whole, CRITERIA.gross_gain * named)


def _about_origin(seen: Observations) -> Observations:
    """Return the recording with moments about the sensor's origin that were about the tip of the tool."""
    moment = seen.matrix(*TORQUE) + np.cross(seen.belief.tip, seen.matrix(*FORCE))
    return with_matrix(seen, TORQUE, moment)


def _others(Q: Array) -> list[Array]:
    """Return other axes that a torque may have given a force in axes Q: the named, turned round, and any order and sign."""
    return [P for P in (IDENTITY, -Q, -IDENTITY, *signed_permutations()) if not np.allclose(P, Q)]


def _unexplained(expected: Array, measured: Array) -> float:
    """Return the unexplained share of measured (N, 3) by expected times a scale that is not negative, and a constant."""
    x, y = expected - expected.mean(axis=0), measured - measured.mean(axis=0)
    scale = max(float(np.sum(x * y)) / max(float(np.sum(x**2)), 1e-300), 0.0)
    return float(np.sum((y - scale * x) ** 2) / max(float(np.sum(y**2)), 1e-300))


def _axes_say(force: Array, torque: Array) -> list[str]:
    """Say force and torque axes in words."""
    if np.array_equal(force, torque):
        if np.array_equal(force, -IDENTITY):
            return [
                "force and torque have the opposite sign (reaction instead of action), or the robot hangs upside down"
            ]
        return [f"wrench: axes {as_axes(force)} of the sensor{_handed(force)}"]
    out = []
    for name, P in (("wrench.force", force), ("wrench.torque", torque)):
        if np.array_equal(P, IDENTITY):
            continue
        if np.array_equal(P, -IDENTITY):
            out.append(f"{name} has the opposite sign (reaction instead of action)")
        else:
            out.append(f"{name}: axes {as_axes(P)} of the sensor{_handed(P)}")
    return out


def _handed(P: Array) -> str:
    mirrored = [a for k, a in enumerate("xyz") if P[k, k] < 0.0]
    if np.linalg.det(P) > 0.0:
        return ""
    if len(mirrored) == 1 and np.count_nonzero(np.diag(P)) == 3:
        return f"; {mirrored[0]} is mirrored: left-handed axes"
    return ": left-handed axes"

"""Efforts of joints against the rigid model: where gravity points, and a link whose body the model leaves out.

Both are linear: inverse dynamics in gravity, and in the inertial parameters of a body (Atkeson, An, Hollerbach 1986). They are
solved exactly beside a constant and friction of any size in every joint.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import ClassVar, Self

import numpy as np

from galen_hw.kinematics import UrdfRobot
from galen_hw.physics.channels import joint_of
from galen_hw.physics.observations import Observations
from galen_hw.physics.scenes.joint import EffortScene
from galen_hw.premises.base import Action, Remark, Stage
from galen_hw.premises.channels import compared
from galen_hw.premises.criteria import CRITERIA
from galen_hw.premises.effort_units import beside_friction
from galen_hw.premises.gravity import angle_between, gravity_remark
from galen_hw.premises.joint_reading import JointReading, better
from galen_hw.spatial import Array

FEWEST_ROWS = 50


@dataclass(frozen=True)
class Efforts:
    """A stretch of a motion with the efforts that it took.

    Args:
        scene: of N rows and C joints; robot: of its model.
        beside: per joint orthonormal columns (N, 3) of a constant and of friction.
    """

    scene: EffortScene
    robot: UrdfRobot
    beside: tuple[Array, ...]

    @classmethod
    def of(cls, seen: Observations) -> Self | None:
        """Return those of a recording; None where there is no model, no clock or hardly a row."""
        if seen.predict != "effort" or seen.simulation is not None or not isinstance(seen.belief.robot, UrdfRobot):
            return None
        scene = compared(seen)
        if not isinstance(scene, EffortScene) or len(scene) < FEWEST_ROWS or not scene.clock:
            return None
        speeds = scene.rates[0]
        joints = [joint_of(name) for name in scene.channels]
        bases = [np.linalg.qr(beside_friction(speeds[:, scene.joint_index(joint)]))[0] for joint in joints]
        return cls(scene, seen.belief.robot, tuple(bases))

    def own(self, values: Array) -> Array:
        """Return (N C, k) values (N, C, k) without what a constant and friction can do, over the efforts' spread by unit."""
        spread = np.std(self.scene.measured, axis=0)
        units = np.array(self.scene.units)
        size = [max(float(np.max(spread[units == unit])), 1e-12) for unit in self.scene.units]
        each = [(x - Q @ (Q.T @ x)) / s for Q, x, s in zip(self.beside, np.moveaxis(values, 1, 0), size, strict=True)]
        return np.concatenate(each)

    @property
    def nothing(self) -> bool:
        """Return whether the measured efforts are far smaller than the simulated, beside friction, and not these in a unit."""
        y, x = (self.own(one[:, :, None]).ravel() for one in (self.scene.measured, self.scene.simulated))
        alike = float(y @ x) ** 2 / max(float(y @ y) * float(x @ x), 1e-300)
        return float(y @ y) < CRITERIA.small_turn * float(x @ x) and alike < CRITERIA.half

    def unexplained(self, efforts: Array) -> float:
        """Return the share of the measured efforts' square, beside friction, that efforts (N, C) do not explain."""
        whole, rest = (self.own(x[:, :, None]) for x in (self.scene.measured, self.scene.measured - efforts))
        return float(np.sum(rest**2) / max(float(np.sum(whole**2)), 1e-300))


class EffortGravity:
    """Tests that gravity points where the model says: whatever its direction, efforts are linear in it."""

    KEY: ClassVar[str] = "effort_gravity"
    STAGE: ClassVar[Stage] = Stage.FRAMES

    def examine(self, seen: Observations) -> Iterator[Remark]:
        """Yield one remark where another direction explains the efforts, with gravity's own size, and the named one does not."""
        efforts = Efforts.of(seen)
        if efforts is None:
            return
        if efforts.nothing:
            what = "the efforts hold neither weight nor acceleration of the model: are they an observer's external torques?"
            yield Remark(self.KEY, what, "record what the joints bear", efforts.scene.channels, Action.REFUSED)
            return
        found = gravity_of(efforts, seen.belief.gravity)
        if found is None:
            return
        if found.length < CRITERIA.gross_left:
            yield from self._compensated(seen, efforts, found)
        elif found.believed:
            remark = gravity_remark(self.KEY, seen, found.gravity, efforts.scene.channels)
            if remark.repaired is None or not _another_zero(seen, remark.repaired):
                yield remark

    def _compensated(self, seen: Observations, efforts: Efforts, found: "OtherGravity") -> Iterator[Remark]:
        """Yield a remark where the efforts are those of an arm without weight: a driver has taken its model's gravity off."""
        without = efforts.unexplained(found.moving)
        # Efforts in another unit are small too, but then a little gravity explains them, and their motion does not.
        most = (1.0 + CRITERIA.gross_left) * min(1.0, efforts.unexplained(found.alone))
        if without > min(most, CRITERIA.gross_gain * efforts.unexplained(efforts.scene.simulated)):
            return
        robot, none = efforts.robot.under(np.zeros(3)), np.zeros(3)
        repaired = replace(seen, belief=replace(seen.belief, gravity=none, robot=robot))
        what = "the efforts hold no gravity: the robot's driver has taken it off; compared without it"
        yield Remark(self.KEY, what, "", efforts.scene.channels, Action.REPAIRED, repaired)


class MotionForces:
    """Tests that forces of acceleration are those of the clock and the inertias: gravity's tell that the efforts are right."""

    KEY: ClassVar[str] = "motion_forces"
    STAGE: ClassVar[Stage] = Stage.FRAMES

    def examine(self, seen: Observations) -> Iterator[Remark]:
        """Yield a refusal where in all joints what accelerates them is one share of the model's, and gravity is the model's.

        Stamps that are k times too near give accelerations k^2 times too large, in every joint.
        """
        efforts = Efforts.of(seen)
        port = None if efforts is None else efforts.scene.gravity_port()
        if efforts is None or port is None or not efforts.scene.belief.dynamic:
            return
        scene = efforts.scene
        weight = port @ seen.belief.gravity
        parts = np.stack([scene.simulated - weight, weight], axis=-1)
        each = [found for c in range(len(scene.channels)) if (found := self._shares(efforts, parts, c)) is not None]
        if len(each) < 2:
            return
        shares, errors = (np.array(x) for x in zip(*each, strict=True))
        share = float(np.average(shares[:, 0], weights=errors[:, 0] ** -2.0))
        both = np.array([share, 1.0])
        off = np.abs(shares - both) > np.maximum(CRITERIA.paired_errors * errors, CRITERIA.gross_left * both)
        if off.any() or share <= 0.0 or abs(np.log(share)) < CRITERIA.least_turn:
            return
        left, plain = efforts.unexplained(parts @ both), efforts.unexplained(scene.simulated)
        if left > min(CRITERIA.gross_left, CRITERIA.gross_gain * plain):
            return
        what = (
            f"what accelerates {len(each)} joints takes {share:.3g} times the model's effort in each, and gravity the model's: "
            f"stamps should be {share**-0.5:.3g} times as far apart, or all inertias of the model are wrong"
        )
        todo = "write measured stamps, not rows times a nominal period; if they are right, mend the model's inertias"
        yield Remark(self.KEY, what, todo, ("time",), Action.REFUSED)

    def _shares(self, efforts: Efforts, parts: Array, c: int) -> tuple[Array, Array] | None:
        """Return the shares (2,) of motion and gravity in a channel and their standard errors; None where it tells neither.

        Args:
            parts: (N, C, 2) efforts of the motion and of gravity.
        """
        Q, y = efforts.beside[c], efforts.scene.measured[:, c]
        X, y = (x - Q @ (Q.T @ x) for x in (parts[:, c], y))
        pieces = [part for part in np.array_split(np.arange(len(y)), CRITERIA.pieces) if len(part)]
        normal = X.T @ X
        size = np.sqrt(np.diag(normal))
        if np.any(size <= 0.0) or np.linalg.cond(normal / np.outer(size, size)) > 1.0 / CRITERIA.small_turn**2:
            return None
        inverse = np.linalg.inv(normal)
        share = inverse @ (X.T @ y)
        # What is left wanders: each piece is one piece of luck.
        score = np.array([X[part].T @ (y[part] - X[part] @ share) for part in pieces])
        error = np.sqrt(np.diag(inverse @ (score.T @ score) @ inverse))
        return (share, error) if np.all(error < CRITERIA.gross_left * np.abs(share)) else None


@dataclass(frozen=True)
class OtherGravity:
    """The gravity that explains efforts best.

    Args:
        gravity: (3,) m/s^2, of the named size; length: that of the solution over the named one.
        moving: (N, C) efforts of the motion without gravity; alone: those of the gravity that explains them best without it.
        unexplained: share that gravity leaves.
        believed: whether it is another direction, of gravity's own size, and explains what the named one does not.
    """

    gravity: Array
    length: float
    moving: Array
    alone: Array
    unexplained: float
    believed: bool


def _another_zero(seen: Observations, turned: Observations) -> bool:
    """Return whether a joint that is counted from another zero explains a motion far better than gravity that is turned."""
    read = (remark.repaired for remark in JointReading().examine(seen))
    return any(other is not None and better(other, turned) for other in read)


def gravity_of(efforts: Efforts, named: Array) -> OtherGravity | None:
    """Solve for the gravity (3,) that explains efforts, given friction; None where they do not tell its direction."""
    port = efforts.scene.gravity_port()
    if port is None or np.linalg.norm(named) == 0.0:
        return None
    scene = efforts.scene
    moving = scene.simulated - port @ named
    X = efforts.own(port)
    size = np.linalg.svd(X, compute_uv=False)
    if size[0] == 0.0 or size[1] < CRITERIA.small_turn * size[0]:
        return None

    def solved(y: Array) -> Array:
        own = efforts.own(y[:, :, None])[:, 0]
        return np.asarray(np.linalg.lstsq(X, own, rcond=CRITERIA.small_turn)[0], dtype=float)

    found = solved(scene.measured - moving)
    length = float(np.linalg.norm(found) / np.linalg.norm(named))
    gravity = found / max(length, 1e-300)
    left, plain = efforts.unexplained(moving + port @ gravity), efforts.unexplained(scene.simulated)
    turned = efforts.unexplained(-scene.simulated)
    believed = (
        abs(length - 1.0) <= CRITERIA.gross_left
        and angle_between(named, found) > CRITERIA.least_turn
        and left <= min(CRITERIA.gross_left, CRITERIA.gross_gain * plain, CRITERIA.half * turned)
    )
    return OtherGravity(gravity, length, moving, port @ solved(scene.measured), left, believed)


class MissingBody:
    """Tests for a link without <inertial> that must weigh something: with a body there the model explains the efforts."""

    KEY: ClassVar[str] = "missing_body"
    STAGE: ClassVar[Stage] = Stage.FRAMES

    def examine(self, seen: Observations) -> Iterator[Remark]:
        """Yield a refusal with the link of which a body explains most; a load at the sensor that does as well is no mistake."""
        efforts = Efforts.of(seen)
        if efforts is None:
            return
        carrier = efforts.robot.carrier or 0
        missing = {link: joint for link, joint in efforts.robot.bodiless.items() if joint != carrier}
        if not missing:
            return
        rests = {link: self._rest(efforts, joint) for link, joint in missing.items()}
        link = min(rests, key=lambda name: float(np.sum(rests[name] ** 2)))
        whole = float(np.sum(efforts.own(efforts.scene.residual[:, :, None]) ** 2))
        left = float(np.sum(rests[link] ** 2)) / max(whole, 1e-300)
        if left > CRITERIA.gross_left or not _surely_less(rests[link], self._rest(efforts, carrier)):
            return
        what = (
            f"{efforts.robot.urdf.where}: link {link}: no <inertial>, so that it weighs nothing; with a body there the model "
            f"explains {100.0 * (1.0 - left):.0f} % of what the efforts are off by"
        )
        yield Remark(self.KEY, what, "give its mass, origin and inertia", efforts.scene.channels, Action.REFUSED)

    def _rest(self, efforts: Efforts, joint: int) -> Array:
        """Return the residual (C, N), as of `own`, of a fit with a body on what a joint moves; all if it moves nothing."""
        scene = efforts.scene
        y = efforts.own(scene.residual[:, :, None])[:, 0]
        zero = np.zeros_like(scene.q)
        dq, ddq = scene.rates if scene.belief.dynamic else (zero, zero)
        whole = efforts.robot.body_regressor(joint, scene.q, dq, ddq)
        order = [scene.joint_index(joint_of(name)) for name in scene.channels]
        X = efforts.own(whole[:, order])
        size = np.linalg.norm(X, axis=0)
        X = X[:, size > 0.0] / size[size > 0.0]
        return np.asarray((y - X @ np.linalg.lstsq(X, y, rcond=1e-6)[0]).reshape(len(scene.channels), -1))


def _surely_less(rest: Array, other: Array) -> bool:
    """Return whether a residual (C, N) is less than another's, piece by piece, surely by the difference's error."""
    pieces = np.array_split(np.sum(other**2 - rest**2, axis=0), CRITERIA.pieces)
    gain = np.array([piece.sum() for piece in pieces])
    return bool(gain.mean() > CRITERIA.paired_errors * gain.std(ddof=1) / np.sqrt(CRITERIA.pieces))

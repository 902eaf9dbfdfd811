"""Ways in which a wrench can have been written down, and how well each meets gravity and the tool."""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from galen_hw.physics.effects.registry import scene_of
from galen_hw.physics.observations import Observations
from galen_hw.physics.rigid import gravity_in_sensor
from galen_hw.physics.scenes.base import Scene
from galen_hw.physics.scenes.wrench import WrenchScene
from galen_hw.premises.base import known_rows, with_matrix
from galen_hw.premises.rotations import Similarity, other_quaternions, scaled, similarity
from galen_hw.spatial import Array, skew

ORIENTATION = tuple(f"sensor.orientation.{axis}" for axis in "xyzw")
FORCE = tuple(f"wrench.force.{axis}" for axis in "xyz")
TORQUE = tuple(f"wrench.torque.{axis}" for axis in "xyz")
IN_BASE = "the wrench is in axes of the base"
INVERSE = "the quaternions take base to sensor (the inverse)"


@dataclass(frozen=True)
class Reading:
    """One way to read the columns.

    Args:
        seen: the recording, read so.
        says: what the mistake is; empty for the columns as they are named.
        expected: (N, 3) force of a kilogram (or of the believed tool), sensor axes.
        force: (N, 3) as measured, sensor axes.
    """

    seen: Observations
    says: str
    expected: Array
    force: Array

    @property
    def plain(self) -> Similarity:
        """Weight and constant alone: nothing is turned."""
        return scaled(self.expected, self.force)

    def turned(self, determinant: int) -> Similarity:
        """Fit axes of the force turned (+1) or mirrored (-1) against those that are named."""
        return similarity(self.expected, self.force, determinant=determinant)


def readings(seen: Observations) -> Iterator[Reading]:
    """Yield the recording as it is, then with each other order of its quaternions and in axes of the base.

    Args:
        seen: without rows that cannot be compared, see `comparable`.
    """
    for says, one in _orientations(seen):
        scene = scene_of(one)
        R, expected = sensor_rotations(scene), _expected(scene)
        force = one.matrix(*FORCE)
        yield Reading(one, says, expected, force)
        if not says:
            yield Reading(_in_sensor_axes(one, R), IN_BASE, expected, _turned_back(R, force))


def reread(seen: Observations, says: str) -> Observations:
    """Return a whole recording in the reading of that name."""
    if says == IN_BASE:
        there = driven(seen)
        R = np.full((len(seen), 3, 3), np.nan)
        R[there] = sensor_rotations(scene_of(seen.taken(there)))
        return _in_sensor_axes(seen, R)
    return dict(_orientations(seen))[says]


def driven(seen: Observations) -> NDArray[np.bool_]:
    """Return which rows (N,) say how the sensor stood."""
    return np.asarray(np.isfinite(seen.matrix(*_driving(seen))).all(axis=1))


def _driving(seen: Observations) -> tuple[str, ...]:
    """Return the columns that say how the sensor stood: all joints of the robot, else the sensor's orientation."""
    robot = seen.belief.robot
    names = () if robot is None else tuple(f"joint.{name}.position" for name in robot.joint_names)
    return names if robot is not None and seen.has_all(*names) else ORIENTATION


def comparable(seen: Observations, most: int | None = None) -> Observations:
    """Return the rows on which wrench and orientation are known, at most so many of them, evenly chosen."""
    rows = known_rows(seen, (*_driving(seen), *FORCE, *TORQUE), most)
    return seen if len(rows) == len(seen) else seen.taken(rows)


def at_rest(seen: Observations) -> Observations:
    """Return the recording with weight alone in its simulation: rows may then be far apart."""
    return replace(seen, belief=replace(seen.belief, dynamic=False))


def _orientations(seen: Observations) -> Iterator[tuple[str, Observations]]:
    yield "", seen
    if seen.belief.robot is not None or not seen.has_all(*ORIENTATION):
        return
    written = seen.matrix(*ORIENTATION)
    for says, quaternions in other_quaternions(written).items():
        how = says.replace("are the inverse", "take base to sensor (the inverse)")
        yield f"the quaternions {how}", with_matrix(seen, ORIENTATION, quaternions)
    yield "the quaternions are of roll and yaw that were exchanged", with_matrix(seen, ORIENTATION, _other_way(written))


def _other_way(q: Array) -> Array:
    """Return quaternions x y z w (N, 4) of Rz(a) Ry(b) Rx(c) where they are of Rz(c) Ry(b) Rx(a): A, B, C read as roll to yaw."""
    there, out = np.isfinite(q).all(axis=1), q.copy()
    angles = Rotation.from_quat(q[there]).as_euler("ZYX")
    out[there] = Rotation.from_euler("ZYX", angles[:, ::-1]).as_quat()
    return out


def sensor_rotations(scene: Scene) -> Array:
    """Return the rotations (N, 3, 3) from sensor to base of a wrench's scene."""
    assert isinstance(scene, WrenchScene), "asked only of wrenches"
    return scene.R


def _expected(scene: Scene) -> Array:
    """Return the force (N, 3) of the believed tool, per kilogram; of a kilogram at rest where none is believed."""
    mass = sum(body.mass for body in scene.belief.hanging)
    if mass > 0.0 and scene.observations.simulation is None:
        return np.asarray(scene.simulated[:, :3] / mass)
    if scene.observations.simulation is not None and np.isfinite(scene.simulated[:, :3]).all():
        return np.asarray(scene.simulated[:, :3])
    return gravity_in_sensor(sensor_rotations(scene), scene.belief.gravity)


def _turned_back(R: Array, v: Array) -> Array:
    return np.asarray(np.einsum("nji,nj->ni", R, v))


def _in_sensor_axes(seen: Observations, R: Array) -> Observations:
    force, torque = (_turned_back(R, seen.matrix(*names)) for names in (FORCE, TORQUE))
    return with_matrix(seen, (*FORCE, *TORQUE), np.hstack([force, torque]))


def turn_wrench(seen: Observations, force: Array, torque: Array) -> Observations:
    """Return the recording with force and torque columns multiplied by (3, 3) matrices."""
    f, t = seen.matrix(*FORCE) @ force.T, seen.matrix(*TORQUE) @ torque.T
    return with_matrix(seen, (*FORCE, *TORQUE), np.hstack([f, t]))


def turn_sensor(seen: Observations, turn: Array) -> Observations:
    """Return the recording of a sensor that is turned by (3, 3) on its link, in its own axes."""
    belief = seen.belief
    zeroed = None if belief.zeroed_rotation is None else belief.zeroed_rotation @ turn
    return replace(seen, belief=replace(belief, sensor_turn=belief.sensor_turn @ turn, zeroed_rotation=zeroed))


def lever_fit(force: Array, torque: Array) -> tuple[Array, float]:
    """Return the centre of mass (3,) m and the unexplained share of torque = c x force + constant, both (N, 3)."""
    f, t = force - force.mean(axis=0), torque - torque.mean(axis=0)
    rows = -skew(f).reshape(-1, 3)
    com = np.linalg.lstsq(rows, t.reshape(-1), rcond=None)[0]
    left = t - np.cross(com, f)
    return com, float(np.sum(left**2) / max(float(np.sum(t**2)), 1e-300))


def any_gravity(R: Array, force: Array) -> tuple[Array, float]:
    """Return the weight (3,) in the base, N, and the unexplained share of force (N, 3) = R^T weight + constant."""
    rows = np.swapaxes(R, 1, 2)
    rows, f = rows - rows.mean(axis=0), force - force.mean(axis=0)
    weight = np.linalg.lstsq(rows.reshape(-1, 3), f.reshape(-1), rcond=None)[0]
    left = f - rows @ weight
    return weight, float(np.sum(left**2) / max(float(np.sum(f**2)), 1e-300))

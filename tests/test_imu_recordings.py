"""Wrench recordings of a sensor whose motion an IMU says and no joints do; path, readings and wrench by formulas of their own."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from galen_hw.diagnosis.pipeline import diagnose
from galen_hw.kinematics import GalenRobot
from galen_hw.physics.effects.registry import scene_of
from galen_hw.physics.observations import Belief, Observations
from galen_hw.physics.rigid import Body

WRENCH = tuple(f"wrench.{kind}.{axis}" for kind in ("force", "torque") for axis in "xyz")
G = np.array([0.0, 0.0, -9.80665])
MASS, COM = 1.2, np.array([0.02, -0.01, 0.08])
INERTIA = np.array([[4e-3, 2e-4, -1e-4], [2e-4, 3e-3, 3e-4], [-1e-4, 3e-4, 2e-3]])
SIGMA = np.array([0.02, 0.02, 0.02, 1e-3, 1e-3, 1e-3])
H = 1e-4
"""Step of the differences, s: of formulas, not of samples."""


class Path:
    """A sensor that swings to and fro and turns about three axes.

    Args:
        pace: Hz, of the slowest swing; reach: m; turn: rad; seed: of the phases; facing: rad about z, amid the swings.
    """

    def __init__(self, pace: float, reach: float = 0.1, turn: float = 0.5, seed: int = 1, facing: float = 0.0) -> None:
        rng = np.random.default_rng(seed)
        self.f, self.phase = pace * rng.uniform(1.0, 2.5, (6, 3)), rng.uniform(0.0, 6.28, (6, 3))
        self.size, self.middle = np.repeat([reach, turn], 3), np.array([0.0, 0.0, 0.0, facing, 0.0, 0.0])

    def _swings(self, t):
        return np.sin(2 * np.pi * self.f * t[:, None, None] + self.phase).sum(axis=2) * self.size / 2.0 + self.middle

    def origin(self, t):
        return self._swings(t)[:, :3]

    def R(self, t):
        return Rotation.from_euler("zyx", self._swings(t)[:, 3:]).as_matrix()

    def omega(self, t):
        """(N, 3) in the base, from the turn within 2 H."""
        return Rotation.from_matrix(self.R(t + H) @ self.R(t - H).swapaxes(1, 2)).as_rotvec() / (2 * H)

    def acceleration(self, t, at=(0.0, 0.0, 0.0)):
        """(N, 3) in the base, of a point of the sensor."""
        before, now, after = (self.origin(s) + self.R(s) @ np.array(at) for s in (t - H, t, t + H))
        return (after - 2.0 * now + before) / H**2

    def spin(self, t):
        """(N, 3) angular momentum about the centre of mass, in the base."""
        R = self.R(t)
        return np.einsum("nij,jk,nlk,nl->ni", R, INERTIA, R, self.omega(t))

    def wrench(self, t, gravity=G):
        """(N, 6) that the tool makes the sensor read: what it takes to hold it, the other way round."""
        into = self.R(t).swapaxes(1, 2)
        force = MASS * np.einsum("nij,nj->ni", into, gravity - self.acceleration(t, COM))
        turned = np.einsum("nij,nj->ni", into, (self.spin(t + H) - self.spin(t - H)) / (2 * H))
        return np.concatenate([force, np.cross(COM, force) - turned], axis=1)

    def columns(self, t, wrench, *, gravity=True, gyroscope=True):
        """The recording; the accelerometer reads 9.8 upwards at rest, or nothing."""
        into, columns = self.R(t).swapaxes(1, 2), {"time": t} | dict(zip(WRENCH, wrench.T, strict=True))
        columns |= dict(zip((f"sensor.orientation.{a}" for a in "xyzw"), self._quaternion(t).T, strict=True))
        felt = np.einsum("nij,nj->ni", into, self.acceleration(t) - (G if gravity else 0.0))
        columns |= {f"imu.acceleration.{a}": felt[:, i] for i, a in enumerate("xyz")}
        turning = np.einsum("nij,nj->ni", into, self.omega(t))
        columns |= {f"imu.angular_velocity.{a}": turning[:, i] for i, a in enumerate("xyz") if gyroscope}
        return columns

    def _quaternion(self, t):
        return Rotation.from_matrix(self.R(t)).as_quat()


def clock(seconds, rate=200.0):
    return np.arange(round(seconds * rate)) / rate


def scene(columns, *, dynamic, robot=None):
    belief = Belief(robot=robot, tool=Body(MASS, COM, INERTIA), dynamic=dynamic, bias_free=True)
    return scene_of(Observations("wrench", columns, None, belief))


def inside(t):
    return (t > t[0] + 0.2) & (t < t[-1] - 0.2)


@pytest.mark.parametrize("gyroscope", [True, False])
@pytest.mark.parametrize("gravity", [True, False])
def test_a_rigid_simulation_holds_the_inertia_that_the_imu_says(gravity, gyroscope):
    """Newton and Euler of the tool within a ten thousandth of what moves: with gravity in the accelerometer or taken off, the
    turning by a gyroscope or from the orientation."""
    path, t = Path(0.8), clock(20.0)
    expected = path.wrench(t)
    columns = path.columns(t, expected, gravity=gravity, gyroscope=gyroscope)
    made = scene(columns, dynamic=True)
    moving = np.std(made.simulated - scene(columns, dynamic=False).simulated, axis=0)
    assert np.all(moving[:3] > 5.0)
    assert np.all(moving[3:] > 0.1)
    assert np.all(np.abs(made.simulated - expected)[inside(t)] < 1e-4 * moving)
    assert made.ends[[0, -1]].all()
    assert not made.ends[inside(t)].any()


def test_where_one_run_ends_and_the_next_begins_nothing_is_differentiated():
    """The orientation jumps there, and is not the faster for a quaternion that changes its sign on the way round."""
    t, paths = clock(10.0), (Path(0.8, seed=1), Path(0.8, seed=2, facing=np.pi))
    parts = [path.columns(t, path.wrench(t), gyroscope=False) for path in paths]
    whole = {k: np.concatenate([p[k] for p in parts]) for k in parts[0]}
    whole |= {"time": np.arange(2 * len(t)) / 200.0, "segment": np.repeat([0.0, 1.0], len(t))}
    alpha = np.concatenate([(path.omega(t + H) - path.omega(t - H)) / (2 * H) for path in paths])
    error = np.abs(scene(whole, dynamic=True).motion.alpha - alpha)
    assert np.all(error < 0.02 * np.std(alpha, axis=0))
    assert np.all(error[np.tile(inside(t), 2)] < 1e-4 * np.ptp(alpha))


def test_without_a_clock_the_imu_still_says_how_the_sensor_accelerates():
    """And how it turns, by a gyroscope; not how that changes."""
    path, t = Path(0.8), clock(20.0)
    columns = path.columns(t, path.wrench(t))
    del columns["time"]
    motion = scene(columns, dynamic=True).motion
    assert motion.acceleration == pytest.approx(path.acceleration(t), abs=1e-3)
    assert motion.omega == pytest.approx(path.omega(t), abs=1e-6)
    assert not motion.alpha.any()


def test_an_imu_with_a_hole_or_beside_joints_is_not_asked():
    """The sensor is then at rest, or moves as the joints say."""
    path, t, robot = Path(0.8), clock(5.0), GalenRobot()
    columns = path.columns(t, path.wrench(t))
    q = 0.1 * np.sin(2.0 * t[:, None] + np.arange(5.0)) + 0.5 * (robot.lower + robot.upper)
    joints = {f"joint.{n}.position": q[:, i] for i, n in enumerate(robot.joint_names)}
    bare = {k: v for k, v in columns.items() if not k.startswith("imu.")}
    plain, beside = (scene(c | joints, dynamic=True, robot=robot) for c in (bare, columns))
    assert np.array_equal(plain.simulated, beside.simulated)
    columns["imu.acceleration.y"][7] = np.nan
    assert not scene(columns, dynamic=True).motion.acceleration.any()


def test_a_row_by_itself_moves_as_in_its_recording():
    """One sample could tell neither the gravity in an accelerometer nor a derivative; another body asks no IMU again."""
    path, t = Path(0.8), clock(5.0)
    made = scene(path.columns(t, path.wrench(t)), dynamic=True)
    assert made.row(300, {}).simulated == pytest.approx(made.simulated[300:301])
    assert made.with_body(np.eye(10)[0]).motion.alpha is made.motion.alpha


TILT = Rotation.from_euler("xy", [0.01, -0.015]).apply(G)


def shaken(path, t, *, felt=0.02, gravity=True, tilt=G):
    """A recording with noise, the accelerometer's in m/s^2, under a gravity that may not be the believed one."""
    rng = np.random.default_rng(2)
    columns = path.columns(t, path.wrench(t, tilt) + rng.normal(size=(len(t), 6)) * SIGMA, gravity=gravity)
    more = np.einsum("nji,j->ni", path.R(t), G - tilt)
    for i, a in enumerate("xyz"):
        columns[f"imu.acceleration.{a}"] += more[:, i] + felt * rng.normal(size=len(t))
        columns[f"imu.angular_velocity.{a}"] += 0.1 * felt * rng.normal(size=len(t))
    return columns


@pytest.mark.inject
@pytest.mark.parametrize("gravity", [True, False])
def test_inertia_that_a_static_model_forgot_is_named(gravity):
    """All of it, and nothing else; a model that has it agrees."""
    columns = shaken(Path(0.8), clock(20.0, 100.0), gravity=gravity)
    d = diagnose(scene(columns, dynamic=False)).diagnosis
    assert ([f.effect for f in d.findings], d.verdict) == (["inertial"], "explained")
    assert d.findings[0].parameters["share"].value == pytest.approx(1.0, abs=0.01)
    assert diagnose(scene(columns, dynamic=True)).diagnosis.verdict == "agrees"


def test_where_nothing_accelerates_a_static_model_agrees():
    """The IMU's noise is no inertia."""
    columns = shaken(Path(0.01, reach=0.01), clock(60.0, 40.0))
    assert diagnose(scene(columns, dynamic=False)).diagnosis.verdict == "agrees"


@pytest.mark.inject
def test_a_tilted_base_is_not_named_inertia():
    """What an accelerometer feels of gravity beside the believed one is no acceleration, and hides no tilt."""
    columns = shaken(Path(0.03, reach=0.02), clock(60.0, 40.0), felt=0.005, tilt=TILT)
    d = diagnose(scene(columns, dynamic=True)).diagnosis
    assert ([f.effect for f in d.findings], d.verdict) == (["base_tilt"], "explained")
    assert diagnose(scene(columns, dynamic=False)).diagnosis.findings[0].effect == "base_tilt"

"""Poses with an orientation: a motion is late in both, and an orientation is no reading with a scale or a limit."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from galen_hw.diagnosis.pipeline import diagnose
from galen_hw.kinematics import GalenRobot
from galen_hw.physics.effects.registry import kinds, scene_of
from galen_hw.physics.observations import Belief, Observations

ROBOT = GalenRobot()
JOINTS = ("carriage1", "carriage2", "carriage3", "roll", "tilt")
SIZES = np.array([0.03, 0.025, 0.02, 0.5, 0.4])


def recorded(late: float, offset: float = 0.0, *, clock: bool = True) -> Observations:
    """A pose tracked for 40 s at 50 Hz, late by so many seconds, with a carriage whose zero is off."""
    t = np.arange(2000) / 50.0

    def at(time: np.ndarray) -> np.ndarray:
        return SIZES * np.sin(np.outer(time, 0.9 + 0.31 * np.arange(5)) + np.arange(5))

    rng = np.random.default_rng(4)
    T = ROBOT.sensor_pose(at(t - late) + np.array([0.0, offset, 0.0, 0.0, 0.0]))
    R = Rotation.from_rotvec(2e-4 * rng.normal(size=(2000, 3))) * Rotation.from_matrix(T[:, :3, :3])
    place = T[:, :3, 3] + 5e-5 * rng.normal(size=(2000, 3))
    columns = {f"joint.{n}.position": q for n, q in zip(JOINTS, at(t).T, strict=True)}
    columns |= {f"pose.position.{a}": v for a, v in zip("xyz", place.T, strict=True)}
    columns |= {f"pose.orientation.{a}": v for a, v in zip("xyzw", R.as_quat().T, strict=True)}
    return Observations("pose", columns | ({"time": t} if clock else {}), None, Belief(robot=ROBOT))


@pytest.mark.parametrize("late", [0.018, -0.03])
def test_a_tracker_that_is_late_is_late_in_its_orientation(late: float) -> None:
    """Beside an error of geometry: both, within their errors, and nothing else; plays of the joints had been named."""
    found = diagnose(scene_of(recorded(late, 9e-4))).diagnosis
    values = {f.effect: f.parameters for f in found.findings}
    assert found.verdict == "explained"
    assert set(values) == {"time_delay", "joint_offset"}
    assert values["time_delay"]["delay"].value == pytest.approx(late, abs=2e-4)
    assert values["joint_offset"]["offset"].value == pytest.approx(9e-4, rel=0.03)


def test_what_has_turned_is_no_reading() -> None:
    """Compare the rotation from the simulated orientation, whatever that has turned before."""
    scene, still = scene_of(recorded(0.0)), scene_of(recorded(0.0, clock=False))
    assert scene.residual == pytest.approx(still.residual, abs=1e-9)
    assert np.ptp(scene.simulated[:, 3:], axis=0).min() > 0.1
    assert not np.any(still.simulated[:, 3:])
    for kind in kinds():
        for effect in kind.propose(scene):
            if effect.KEY in ("gain", "saturation", "hysteresis"):
                assert getattr(effect, "channel", "") not in scene.turned
    pieces = replace(recorded(0.0), columns=dict(recorded(0.0).columns) | {"segment": np.repeat([0.0, 1.0], 1000)})
    assert not np.any(scene_of(pieces).simulated[[0, 1000], 3:])

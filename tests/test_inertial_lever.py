"""Forces of acceleration where only the sensor's orientation was recorded: the lever to the centre of turn is found."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from galen_hw.diagnosis.pipeline import diagnose
from galen_hw.physics.effects.load import Inertial
from galen_hw.physics.effects.registry import scene_of
from galen_hw.physics.observations import Belief, Observations
from galen_hw.physics.rigid import Body
from galen_hw.physics.scenes.base import Scene

MASS, COM = 0.93, np.array([0.0, 0.0, 0.044])
G = np.array([0.0, 0.0, -9.80665])
LEVER = np.array([0.05, 0.0, 0.63])
H = 1e-4
NAMES = [f"wrench.{kind}.{a}" for kind in ("force", "torque") for a in "xyz"]


def orientation(t: np.ndarray, *, one_axis: bool) -> Rotation:
    """Swings about y, and about x too."""
    angles = np.stack([0.0 * t if one_axis else 0.5 * np.sin(1.7 * t + 0.4), 0.8 * np.sin(1.3 * t), 0.0 * t], axis=1)
    return Rotation.from_euler("xyz", angles)


def turning(*, one_axis: bool, rows: int = 3000, lever: np.ndarray = LEVER) -> Scene:
    """A point mass on a sensor whose origin turns about a fixed point at `lever` from it, sensor axes (m), at 100 Hz."""
    t = np.arange(rows) / 100.0
    place = [orientation(t + d, one_axis=one_axis).apply(lever + COM) for d in (-H, 0.0, H)]
    acceleration = (place[0] - 2.0 * place[1] + place[2]) / H**2
    turn = orientation(t, one_axis=one_axis)
    force = MASS * turn.inv().apply(G - acceleration)
    wrench = np.concatenate([force, np.cross(COM, force)], axis=1)
    wrench += np.random.default_rng(0).normal(size=wrench.shape) * ([0.02] * 3 + [0.001] * 3)
    columns = {"time": t} | dict(zip(NAMES, wrench.T, strict=True))
    columns |= dict(zip((f"sensor.orientation.{a}" for a in "xyzw"), turn.as_quat().T, strict=True))
    return scene_of(Observations("wrench", columns, None, Belief(tool=Body(MASS, COM), bias_free=True)))


def test_the_answer_to_a_lever_is_what_acceleration_adds() -> None:
    """Newton of the point mass about a centre at `LEVER`, within a thousandth, the com's own lever of the sensor set aside."""
    scene = turning(one_axis=False)
    (effect,) = Inertial.propose(scene)
    assert effect.lever == "xyz"
    moved = turning(one_axis=False, lever=2.0 * LEVER).measured - scene.measured  # the noise is the same
    inside = ~scene.ends
    assert (effect.columns(scene).values @ LEVER)[inside] == pytest.approx(moved[inside], abs=1e-3 * np.ptp(moved))


def test_a_lever_along_the_only_axis_of_turn_is_not_asked_for() -> None:
    assert [effect.lever for effect in Inertial.propose(turning(one_axis=True))] == ["xz"]


@pytest.mark.parametrize("one_axis", [True, False])
def test_a_lever_that_was_left_out_is_found(one_axis: bool) -> None:
    """By name, within two per cent of what the sensor's origin is off its centre of turn; the com of the tool is a part of it."""
    found = diagnose(turning(one_axis=one_axis)).diagnosis
    assert [finding.effect for finding in found.findings] == ["inertial"]
    parameters = found.findings[0].parameters
    for k, axis in enumerate("xz" if one_axis else "xyz"):
        expected = (LEVER + COM)["xyz".index(axis)]
        assert parameters[f"lever_{axis}"].value == pytest.approx(expected, abs=0.02 * 0.68), k
    assert found.verdict == "explained"

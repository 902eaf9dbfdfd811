"""Recordings that somebody's filter has gone through: told by their spectrum, and compared below its cut-off."""

import numpy as np
import pytest
from scipy.signal import butter, sosfiltfilt
from scipy.spatial.transform import Rotation

from galen_hw.diagnosis.pipeline import diagnose
from galen_hw.diagnosis.stats.sampling import Rows
from galen_hw.physics.effects.registry import scene_of
from galen_hw.physics.observations import Belief, Observations
from galen_hw.physics.rigid import Body
from galen_hw.physics.signals.recorded_band import recorded_band

RATE, UNITS = 100.0, ("N", "N", "N")
TIME = np.arange(3000) / RATE
GRAVITY = np.array([0.0, 0.0, -9.80665])
MASS, COM, ARM = 0.9, np.array([0.001, 0.0, 0.05]), np.array([0.1, 0.0, 0.6])


def filtered(x, cut):
    return sosfiltfilt(butter(2, cut, fs=RATE, output="sos"), x, axis=0)


def readings(noise=0.01):
    rng = np.random.default_rng(3)
    moves = np.stack([5.0 * np.sin(2 * np.pi * f * TIME) for f in (0.2, 0.31, 0.43)], axis=-1)
    return moves + noise * rng.standard_normal(moves.shape)


@pytest.mark.parametrize("cut", [4.0, 8.0])
def test_the_cut_off_is_told_by_what_is_missing_above_it(cut):
    found = recorded_band(filtered(readings(), cut), 1.0 / RATE, UNITS)
    assert found is not None
    assert 0.15 < found < 1.5 * cut


def test_a_sensor_s_own_noise_is_no_filter():
    assert recorded_band(readings(), 1.0 / RATE, UNITS) is None
    assert recorded_band(np.round(readings(0.0), 2), 1.0 / RATE, UNITS) is None


def test_one_channel_with_noise_of_all_frequencies_is_enough():
    x = filtered(readings(), 5.0)
    x[:, 1] += 0.01 * np.random.default_rng(1).standard_normal(len(x))
    assert recorded_band(x, 1.0 / RATE, ("N", "N m", "N")) is None


def test_averages_of_rows_are_filtered_before_and_gaps_stay_gaps():
    rows = Rows((slice(0, 1500), slice(1500, 3000)), 4, cut=0.05)
    x = np.sin(2 * np.pi * 0.5 * TIME)[:, None] + np.sin(2 * np.pi * 23.0 * TIME)[:, None]
    slow = Rows(rows.segments, 4).average(np.sin(2 * np.pi * 0.5 * TIME)[:, None])
    inside = np.r_[20:355, 395:730]
    assert np.max(np.abs(rows.average(x) - slow)[inside]) < 0.05
    x[700:704] = np.nan
    assert np.isnan(rows.average(x)[175]).all()
    assert np.isfinite(rows.average(x)[:170]).all()


def turned():
    """An arm that turns a sensor about y, faster and slower, read with the noise of encoders."""
    angle = 0.9 * np.sin(2 * np.pi * 0.25 * TIME) + 0.25 * np.sin(2 * np.pi * 0.71 * TIME)
    rate = np.gradient(angle, 1.0 / RATE)
    return angle, rate, np.gradient(rate, 1.0 / RATE)


def test_forces_of_acceleration_are_named_though_the_wrench_was_filtered_and_the_orientation_is_noisy():
    """Above the filter's cut-off the accelerations of a noisy orientation would be compared with nothing at all."""
    rng = np.random.default_rng(5)
    angle, rate, faster = turned()
    R = Rotation.from_rotvec(angle[:, None] * np.array([0.0, 1.0, 0.0]))
    omega, alpha = (np.stack([0 * x, x, 0 * x], axis=-1) for x in (rate, faster))
    acceleration = np.cross(alpha, ARM) + np.cross(omega, np.cross(omega, ARM))
    force = MASS * (R.inv().apply(np.tile(GRAVITY, (len(TIME), 1))) - acceleration)
    wrench = np.concatenate([force, np.cross(COM, force)], axis=1)
    wrench += np.repeat([0.05, 0.002], 3) * rng.standard_normal(wrench.shape)
    noisy = angle + 2e-4 * rng.standard_normal(len(TIME))
    read = Rotation.from_rotvec(noisy[:, None] * np.array([0.0, 1.0, 0.0])).as_quat()
    columns = {"time": TIME} | {f"sensor.orientation.{a}": read[:, i] for i, a in enumerate("xyzw")}
    names = [f"wrench.{kind}.{a}" for kind in ("force", "torque") for a in "xyz"]
    columns |= dict(zip(names, filtered(wrench, 5.0).T, strict=True))
    belief = Belief(tool=Body(MASS, COM, np.zeros((3, 3))), dynamic=False, bias_free=True)
    found = diagnose(scene_of(Observations("wrench", columns, None, belief))).diagnosis
    assert found.findings[0].effect == "inertial"
    assert {f.effect for f in found.findings} == {"inertial"}
    lever = found.findings[0].parameters["lever_z"]
    assert lever.value == pytest.approx(ARM[2], abs=max(3.0 * lever.std, 0.05 * ARM[2]))
    assert any("the recording was filtered" in note for note in found.notes)

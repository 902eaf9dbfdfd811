"""The report's equations, as derived, are exact; as printed, they are not."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from galen_hw.identification import report
from galen_hw.physics.rigid import Body, predicted_wrench
from galen_hw.spatial import rotation_about, rotation_exp

TOOL = Body(0.287, np.array([0.031, 0.004, -0.063]))
BIAS = Body(0.085, np.array([0.002, -0.001, 0.011]))


def sweep(tilts=7, rolls=8):
    tilt, roll = (a.ravel() for a in np.meshgrid(np.linspace(-0.6, 0.6, tilts), np.linspace(-0.9, 0.9, rolls)))
    return rotation_about(0, roll) @ rotation_about(1, tilt)


def readings(R, tool, bias=BIAS, zero=None):
    return predicted_wrench(R, tool, bias_body=bias, zeroed_rotation=np.eye(3) if zero is None else zero)


def relative(found, true):
    return np.max(np.abs(np.asarray(found) - true)) / np.max(np.abs(true))


def test_exact_readings_give_both_bodies_back_to_1e_12():
    """Equations (1) to (8), R(0) on both sides, recover mass and centre of mass of bias body and tool to 1e-12."""
    R = sweep()
    body, tool = report.two_step(R, readings(R, TOOL), zero=np.eye(3), bare=(R, readings(R, Body())))

    for found, true in ((body, BIAS), (tool, TOOL)):
        assert abs(found.mass - true.mass) < 1e-12 * true.mass
        assert relative(found.com, true.com) < 1e-12
        assert relative(found.force, [0.0, 0.0, -9.80665 * true.mass]) < 1e-12


@settings(max_examples=50)
@given(seed=st.integers(0, 2**32 - 1))
def test_any_zeroing_pose_and_any_bodies_are_recovered(seed):
    """The derivation holds for a sensor zeroed anywhere and for any weights, to 1e-10."""
    rng = np.random.default_rng(seed)
    bias, tool = (Body(rng.uniform(0.05, 2.0), rng.uniform(-0.2, 0.2, 3)) for _ in range(2))
    zero, R = rotation_exp(rng.normal(size=3)), rotation_exp(rng.normal(size=(20, 3)))
    bare = (R, readings(R, Body(), bias, zero))
    found = report.two_step(R, readings(R, tool, bias, zero), zero=zero, bare=bare)

    for one, true in zip(found, (bias, tool), strict=True):
        assert one.mass == pytest.approx(true.mass, rel=1e-10)
        assert one.com == pytest.approx(true.com, abs=1e-10)


def test_equation_3_as_printed_is_wrong_where_theta_is_not_zero():
    """With R_i in place of R(0), exact readings give a centre of mass that is millimetres off; as derived, none."""
    R = sweep()
    bare = readings(R, Body())
    f_b = report.bias_force(R, np.eye(3), bare[:, :3])
    printed = report.bias_point_as_printed(R, np.eye(3), bare[:, 3:], f_b)
    derived = report.bias_point(R, np.eye(3), bare[:, 3:], f_b)

    assert np.linalg.norm(printed - BIAS.com) > 1e-3
    assert np.linalg.norm(derived - BIAS.com) < 1e-14


def test_the_printed_and_the_derived_rows_agree_only_at_the_zeroing_pose():
    """The rows of (3) differ by -R(0)^T hat(f) (R_i - R(0)), which is zero only for R_i = R(0)."""
    f = np.array([0.0, 0.0, -0.8])
    p = np.array([0.01, 0.02, 0.03])
    for R, agree in ((np.eye(3), True), (rotation_about(0, 0.4), False)):
        torque = predicted_wrench(R[None], Body(), bias_body=Body(0.8 / 9.80665, p), zeroed_rotation=np.eye(3))[0, 3:]
        printed = (R.T - np.eye(3)) @ report.skew(f) @ -R @ p
        assert np.allclose(printed, torque, atol=1e-12) is agree


def test_a_constant_offset_misleads_the_two_steps():
    """Nothing in the equations can take a constant offset, so the mass is wrong by it: the reason for the joint fit."""
    R = sweep()
    wrench = readings(R, TOOL) + np.array([0.0, 0.0, 0.2, 0.0, 0.0, 0.0])
    _, tool = report.two_step(
        R, wrench, zero=np.eye(3), body=report.WeightedPoint(BIAS.mass * np.array([0, 0, -9.80665]), BIAS.com)
    )

    assert abs(tool.mass - TOOL.mass) > 0.01


def test_equation_11_predicts_the_readings():
    """The prediction of the fitted bodies is the reading itself."""
    R = sweep()
    wrench = readings(R, TOOL)
    g = np.array([0, 0, -9.80665])
    found = report.predict(
        R,
        np.eye(3),
        report.WeightedPoint(BIAS.mass * g, BIAS.com),
        report.WeightedPoint(TOOL.mass * g, TOOL.com),
    )

    assert found == pytest.approx(wrench, abs=1e-14)

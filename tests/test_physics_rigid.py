"""The weights and inertia of rigid bodies, against hand calculation and against pinocchio's inverse dynamics."""

import numpy as np
import pytest

from galen_hw.kinematics import GalenRobot, Motion
from galen_hw.physics.rigid import Body, gravity_map, inertial_wrench, predicted_wrench
from galen_hw.spatial import rotation_about, rotation_exp, transform

TOOL = Body(0.287, np.array([0.031, 0.004, -0.063]), np.diag([5.6e-4, 6.4e-4, 1.4e-4]))
EMPTY = Body(0.085, np.array([0.002, -0.001, 0.011]), np.diag([1e-5, 2e-5, 3e-5]))
G = np.array([0.3, -0.2, -9.8])


def test_a_hanging_weight_reads_as_the_specification_says() -> None:
    """Force R^T w and torque c x R^T w."""
    R = rotation_exp(np.array([[0.3, -0.5, 0.2], [1.2, 0.1, -0.4]]))
    wrench = predicted_wrench(R, TOOL, gravity=G)
    for Ri, row in zip(R, wrench, strict=True):
        force = Ri.T @ (TOOL.mass * G)
        assert row == pytest.approx(np.concatenate([force, np.cross(TOOL.com, force)]), abs=1e-15)


def test_zeroing_takes_the_bias_body_away_in_that_pose_only() -> None:
    """With no tool the reading is the offset where it was zeroed, and the turned weight elsewhere (equation 11)."""
    R0, R1 = rotation_about(0, 0.4), rotation_about(1, 0.7)
    offset = np.arange(6) * 0.1
    wrench = predicted_wrench(np.stack([R0, R1]), Body(), bias_body=EMPTY, zeroed_rotation=R0, offset=offset, gravity=G)
    assert wrench[0] == pytest.approx(offset, abs=1e-15)
    turned = EMPTY.mass * (R1.T - R0.T) @ G
    assert wrench[1] - offset == pytest.approx(np.concatenate([turned, np.cross(EMPTY.com, turned)]), abs=1e-15)
    assert gravity_map(TOOL, bias_body=EMPTY).shape == (6, 4)


def test_free_fall_weighs_nothing() -> None:
    """A sensor that accelerates with gravity reads zero: inertia cancels weight, whatever the inertia tensor."""
    R = rotation_exp(np.array([[0.3, -0.5, 0.2]]))
    still = np.zeros((1, 3))
    motion = Motion(transform(R, still), G[None], still, still)
    total = predicted_wrench(R, TOOL, bias_body=EMPTY, gravity=G) + inertial_wrench(motion, TOOL, EMPTY)
    assert np.abs(total).max() < 1e-14


def test_inertia_is_the_rate_of_change_of_momentum() -> None:
    """Minus the derivative of linear and angular momentum about the sensor, taken numerically along a motion."""
    robot = GalenRobot()
    amplitude, rate = np.array([0.03, -0.02, 0.04, 0.5, 0.4]), np.array([3.0, 2.0, 4.0, 2.5, 3.5])

    def joints(t: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        return (
            amplitude * np.sin(rate * t),
            amplitude * rate * np.cos(rate * t),
            -amplitude * rate**2 * np.sin(rate * t),
        )

    def momentum(t: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        q, dq, _ = joints(t)
        T, J = robot.sensor_pose(q)[0], robot.sensor_jacobian(q)[0]
        R, (v, w) = T[:3, :3], (J @ dq).reshape(2, 3)
        c = T[:3, 3] + R @ TOOL.com
        linear = TOOL.mass * (v + np.cross(w, R @ TOOL.com))
        return T, linear, np.cross(c, linear) + R @ TOOL.inertia @ R.T @ w

    t, h = 0.37, 1e-5
    T, _, _ = momentum(t)
    before, after = momentum(t - h), momentum(t + h)
    force, moment = -(after[1] - before[1]) / (2 * h), -(after[2] - before[2]) / (2 * h)
    R = T[:3, :3]
    expected = np.concatenate([R.T @ force, R.T @ (moment - np.cross(T[:3, 3], force))])
    q, dq, ddq = joints(t)
    assert inertial_wrench(robot.sensor_motion(q, dq, ddq), TOOL)[0] == pytest.approx(expected, rel=1e-6, abs=1e-8)

"""Spatial algebra: group laws, frame invariance, round trips."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from numpy.testing import assert_allclose

from galen_hw import spatial

components = st.floats(-10.0, 10.0, allow_nan=False)
vectors = arrays(float, 3, elements=components)
angles = arrays(float, 3, elements=st.floats(-1.8, 1.8))
wrenches = arrays(float, 6, elements=components)


@st.composite
def transforms(draw: st.DrawFn) -> np.ndarray:
    return spatial.transform(spatial.rotation_exp(draw(angles)), draw(vectors))


@given(vectors, vectors)
def test_skew_is_the_cross_product(v: np.ndarray, w: np.ndarray) -> None:
    """[v]x w = v x w, and the matrix is antisymmetric."""
    assert_allclose(spatial.skew(v) @ w, np.cross(v, w), atol=1e-12)
    assert_allclose(spatial.skew(v), -spatial.skew(v).T)


@given(angles)
def test_rotation_exp_is_a_rotation_and_log_takes_it_back(rotvec: np.ndarray) -> None:
    """Orthonormal, right-handed, and within pi the logarithm is the inverse."""
    R = spatial.rotation_exp(rotvec)
    assert_allclose(R @ R.T, np.eye(3), atol=1e-13)
    assert_allclose(np.linalg.det(R), 1.0, atol=1e-13)
    assert_allclose(spatial.rotation_exp(spatial.rotation_log(R)), R, atol=1e-12)
    if np.linalg.norm(rotvec) < 3.1:
        assert_allclose(spatial.rotation_log(R), rotvec, atol=1e-9)


@given(st.sampled_from([0, 1, 2]), st.floats(-3.0, 3.0))
def test_rotation_about_an_axis_is_the_exponential(axis: int, angle: float) -> None:
    """Both ways of writing a turn about a coordinate axis agree."""
    assert_allclose(spatial.rotation_about(axis, angle), spatial.rotation_exp(angle * np.eye(3)[axis]), atol=1e-13)


@given(angles)
def test_quaternion_round_trip(rotvec: np.ndarray) -> None:
    """Rotation to quaternion and back; the scalar part is not negative."""
    R = spatial.rotation_exp(rotvec)
    q = spatial.quaternion_from_rotation(R)
    assert q[3] >= 0.0
    assert_allclose(spatial.rotation_from_quaternion(q), R, atol=1e-12)


def test_quaternion_at_half_turns() -> None:
    """Turns by pi, where the scalar part vanishes, keep their axis."""
    for axis in np.eye(3):
        q = spatial.quaternion_from_rotation(spatial.rotation_exp(np.pi * axis))
        assert_allclose(np.abs(q), [*np.abs(axis), 0.0], atol=1e-12)


@given(transforms(), transforms(), transforms())
def test_transforms_form_a_group(A: np.ndarray, B: np.ndarray, C: np.ndarray) -> None:
    """Inverse and associativity."""
    assert_allclose(A @ spatial.inverse(A), np.eye(4), atol=1e-11)
    assert_allclose((A @ B) @ C, A @ (B @ C), atol=1e-9)


@given(transforms(), wrenches, wrenches)
def test_power_does_not_depend_on_the_frame(T: np.ndarray, wrench: np.ndarray, twist: np.ndarray) -> None:
    """The wrench's and the twist's adjoints belong together: w . v is the same in both frames."""
    there = (spatial.wrench_adjoint(T) @ wrench) @ (spatial.twist_adjoint(T) @ twist)
    assert_allclose(there, wrench @ twist, rtol=1e-9, atol=1e-7)


@given(transforms(), transforms())
def test_adjoints_compose(A: np.ndarray, B: np.ndarray) -> None:
    """Ad(A B) = Ad(A) Ad(B)."""
    assert_allclose(spatial.twist_adjoint(A @ B), spatial.twist_adjoint(A) @ spatial.twist_adjoint(B), atol=1e-8)
    assert_allclose(spatial.wrench_adjoint(A @ B), spatial.wrench_adjoint(A) @ spatial.wrench_adjoint(B), atol=1e-8)


def test_a_weight_reads_as_the_recording_format_says() -> None:
    """A hanging weight w at c reads force R^T w and torque c x R^T w at the sensor (spec of recordings)."""
    R, w, c = spatial.rotation_exp([0.3, -0.7, 0.2]), np.array([0.0, 0.0, -2.8]), np.array([0.03, 0.0, -0.06])
    at_centre = spatial.transform(R.T, np.zeros(3))  # base to sensor axes, at the centre of mass
    shifted = spatial.transform(np.eye(3), c)
    wrench = spatial.wrench_adjoint(shifted) @ spatial.wrench_adjoint(at_centre) @ np.concatenate([w, np.zeros(3)])
    assert_allclose(wrench, np.concatenate([R.T @ w, np.cross(c, R.T @ w)]), atol=1e-13)


@given(st.integers(0, 2**32 - 1))
def test_quaternions_that_go_on_have_the_rotations_they_had(seed):
    """Signs at random along a turn: no step is longer than its mirror image, and no rotation changes."""
    rng = np.random.default_rng(seed)
    q = rng.normal(size=(20, 4))
    q /= np.linalg.norm(q, axis=1)[:, None]
    out = spatial.continuous(q)
    assert np.all(np.sum(out[1:] * out[:-1], axis=1) >= 0.0)
    assert np.allclose(spatial.rotation_from_quaternion(out), spatial.rotation_from_quaternion(q))
    assert spatial.continuous(q[:0]).shape == (0, 4)

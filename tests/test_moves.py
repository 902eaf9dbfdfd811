"""Recordings of moves and rests: each move is followed by a spline of its own, or it is left to one through all."""

from collections.abc import Callable

import numpy as np
import pytest

from galen_hw.physics.signals.differentiation import denoised, derivatives
from galen_hw.physics.signals.rest_to_rest import moved
from galen_hw.physics.signals.splines import spline

DT = 0.01

Profile = Callable[[np.ndarray], np.ndarray]


def least_jerk(part: np.ndarray) -> np.ndarray:
    return part**3 * (10.0 - 15.0 * part + 6.0 * part**2)


def smoother(part: np.ndarray) -> np.ndarray:
    return part**4 * (35.0 - 84.0 * part + 70.0 * part**2 - 20.0 * part**3)


def raised(part: np.ndarray) -> np.ndarray:
    """Sets out with a jolt."""
    return 0.5 - 0.5 * np.cos(np.pi * part)


def trapezoid(part: np.ndarray) -> np.ndarray:
    """Speed in ramps: jolts in the midst of a move too."""
    ramp, fast = 0.25, 4.0 / 3.0
    slowing = 1.0 - 0.5 * fast * (1.0 - part) ** 2 / ramp
    return np.where(
        part < ramp, 0.5 * fast * part**2 / ramp, np.where(part < 1.0 - ramp, fast * (part - ramp / 2.0), slowing)
    )


def sweep(profile: Profile, digit: float, *, jitter: float = 0.0, seconds: float = 60.0) -> tuple[np.ndarray, ...]:
    """Times, readings and true accelerations (N,) of an arm that goes from place to place."""
    rng = np.random.default_rng(7)
    t = np.arange(round(seconds / DT)) * DT
    t = t + jitter * DT * rng.uniform(-0.5, 0.5, len(t))
    x, second = np.zeros_like(t), np.zeros_like(t)
    at, place, h = 1.0, 0.0, 1e-4
    while at < seconds - 3.0:
        lasts, to = rng.uniform(0.6, 1.5), rng.uniform(-1.0, 1.0)
        far = to - place

        def where(when: np.ndarray, at: float = at, lasts: float = lasts) -> np.ndarray:
            return profile(np.clip((when - at) / lasts, 0.0, 1.0))

        x += far * where(t)
        second += far * (where(t + h) - 2.0 * where(t) + where(t - h)) / h**2
        place, at = to, at + lasts + rng.uniform(0.6, 1.6)
    return t, np.round(x / digit) * digit if digit else x, second


def missed(second: np.ndarray, truth: np.ndarray) -> float:
    return float(np.std((second - truth)[20:-20]) / np.std(truth))


@pytest.mark.parametrize("jitter", [0.0, 0.3])
@pytest.mark.parametrize(
    ("profile", "digit"), [(least_jerk, 1e-5), (least_jerk, 1e-4), (smoother, 1e-6), (smoother, 1e-5)]
)
def test_a_start_from_rest_keeps_its_corner(profile: Profile, digit: float, jitter: float) -> None:
    """Accelerations are nearer by a third and more than by one spline through all, and nothing moves at rest."""
    t, x, truth = sweep(profile, digit, jitter=jitter)
    found = moved(t, x)
    assert found is not None
    whole = spline(t, x)
    assert whole is None or missed(found[2], truth) < 0.65 * missed(whole(t, 2), truth)
    assert missed(found[2], truth) < 0.008
    still = np.convolve(np.diff(x, prepend=x[0]) == 0.0, np.ones(41), "same") == 41
    assert still.any()
    assert not found[1:, still].any()
    np.testing.assert_array_equal(found[0, still], x[still])
    assert np.abs(found[0] - x).max() < 3.0 * digit
    first, second = derivatives(t, x[:, None], [slice(0, len(t))])
    np.testing.assert_allclose(np.stack([first[:, 0], second[:, 0]]), found[1:], atol=1e-3 * np.std(truth))


def test_what_has_been_followed_once_is_followed_as_before() -> None:
    """Joints are made quiet first and differentiated then: the second time changes nothing."""
    t, x, _ = sweep(least_jerk, 1e-5)
    found = moved(t, x)
    assert found is not None
    quiet = denoised(t, x[:, None], [slice(0, len(t))])[:, 0]
    np.testing.assert_array_equal(quiet, found[0])
    again = moved(t, quiet)
    assert again is not None
    assert missed(again[2], found[2]) < 1e-3


def test_a_jolt_at_the_start_is_followed_where_the_readings_show_it() -> None:
    """A move that sets out at full acceleration, in steps of the encoder."""
    t, x, truth = sweep(raised, 2e-4)
    found, whole = moved(t, x), spline(t, x)
    assert found is not None
    assert whole is None or missed(found[2], truth) < 0.9 * missed(whole(t, 2), truth)


@pytest.mark.parametrize(
    ("profile", "digit"), [(trapezoid, 1e-7), (trapezoid, 1e-5), (raised, 1e-7), (least_jerk, 3e-3), (smoother, 2e-3)]
)
def test_moves_that_the_splines_do_not_fit_or_that_readings_hide_are_left(profile: Profile, digit: float) -> None:
    """Jolts within a move, or steps so coarse that nobody sees it begin."""
    t, x, _ = sweep(profile, digit)
    assert moved(t, x) is None


def test_what_has_no_rests_or_only_steps_of_the_encoder_is_left() -> None:
    """A slow motion in steps of the encoder seems to rest at each."""
    t = np.arange(6000) * DT
    steps = np.round(np.sin(0.2 * t) / 0.02) * 0.02
    noisy = np.sin(t) + 1e-4 * np.random.default_rng(1).normal(size=len(t))
    for x in (steps, noisy, np.zeros_like(t), t):
        assert moved(t, x) is None


def test_a_recording_may_begin_and_end_in_a_move() -> None:
    """There is no rest at that end, and nothing is asked of it there."""
    t, x, truth = sweep(least_jerk, 1e-6)
    going = np.flatnonzero(np.diff(x) != 0.0)
    first = int(going[0]) + 40
    last = int(going[going < going[0] + 3000][-1]) - 30
    found = moved(t[first:last], x[first:last])
    assert found is not None
    assert missed(found[2], truth[first:last]) < 0.02

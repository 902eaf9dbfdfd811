"""A servo that is no faster than its supply or its profile lets it: the operator, and recordings in which it is concealed."""

import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from galen_hw import diagnose, read_recording
from galen_hw.physics.operators.filters import lag
from galen_hw.physics.operators.speed_limit import limited_lag

STEP = 0.01


def commanded(t: np.ndarray, seed: int = 3) -> np.ndarray:
    """Far and near targets in turn, approached on smooth ramps, some of which ask for more speed than others (rad)."""
    rng = np.random.default_rng(seed)
    at, c = 0.5, np.zeros_like(t)
    while at < t[-1]:
        rise, height = rng.uniform(0.2, 1.2), rng.uniform(-1.2, 1.2)
        c += height * 0.5 * (1.0 - np.cos(np.pi * np.clip((t - at) / rise, 0.0, 1.0)))
        at += rng.uniform(0.8, 1.6)
    return c


def moved(command, t: np.ndarray, constant: float, limit: float, late: float) -> np.ndarray:
    """Positions (N,) by an ODE solver of another make, of a command as a function of the time."""

    def speed(now: float, y: np.ndarray) -> np.ndarray:
        return np.clip((command(now - late) - y) / constant, -limit, limit)

    found = solve_ivp(speed, (t[0], t[-1]), [0.0], t_eval=t, max_step=0.25 * STEP, rtol=1e-7, atol=1e-9)
    return found.y[0]


def recorded(folder: Path, limit: float, *, seconds: float = 60.0, late: float = 0.02, constant: float = 0.05) -> Path:
    """Write what a servo does with this limit, rad/s, read with half a milliradian of noise."""
    folder.mkdir()
    t = np.arange(0.0, seconds, STEP)
    fine = np.arange(-1.0, seconds, 0.1 * STEP)
    target = commanded(fine)
    y = moved(lambda now: np.interp(now, fine, target), t, constant, limit, late)
    y += np.random.default_rng(5).normal(0.0, 5e-4, len(t))
    table = np.column_stack([t, y, np.interp(t, fine, target)])
    head = "time,joint.servo.position,joint.servo.command"
    np.savetxt(folder / "recording.csv", table, "%.6f", ",", header=head, comments="")
    note = "a servo that follows at once"
    document = {"schema": 1, "robot": None, "predict": "position", "model": {"bias": "free"}, "notes": note}
    (folder / "recording.json").write_text(json.dumps(document))
    return folder


@given(st.integers(2, 60), st.floats(0.005, 1.0), st.floats(0.05, 20.0), st.integers(0, 10**6), st.booleans())
def test_it_is_never_faster_and_may_be_cut_anywhere(rows, constant, limit, seed, held):
    """Rows one by one give what all of them give."""
    rng = np.random.default_rng(seed)
    t = np.cumsum(rng.uniform(0.0, 0.05, rows))
    x = rng.normal(size=(rows, 2))
    whole, _ = limited_lag(t, x, constant, limit, None, held=held)
    assert np.all(np.abs(np.diff(whole, axis=0)) <= limit * np.diff(t)[:, None] + 1e-12)
    state, parts = None, []
    for i in range(rows):
        one, state = limited_lag(t[i : i + 1], x[i : i + 1], constant, limit, state, held=held)
        parts.append(one)
    np.testing.assert_allclose(np.concatenate(parts), whole, atol=1e-12)


@pytest.mark.parametrize("held", [False, True])
def test_without_reaching_its_limit_it_is_a_lag(held):
    """On an uneven clock too."""
    rng = np.random.default_rng(1)
    t = np.cumsum(rng.uniform(0.002, 0.02, 300))
    x = np.sin(t)[:, None] * [1.0, 2.0]
    for T in (0.03, 0.3):
        free, _ = lag(t, x, np.full(2, T), None, held=held)
        np.testing.assert_allclose(limited_lag(t, x, T, 10.0, None, held=held)[0], free)


def test_it_follows_the_differential_equation():
    """Source: T dy/dt = w - y within +- T v, by scipy's solver."""
    t = np.arange(0.0, 12.0, STEP)
    target = commanded(t)
    exact = moved(lambda now: np.interp(now, t, target), t, 0.08, 1.1, 0.0)
    mine, _ = limited_lag(t, target[:, None], 0.08, 1.1, None)
    # Once a limit begins or ends inside a step the two differ by less than what a step makes.
    assert np.max(np.abs(mine[:, 0] - exact)) < 0.3 * 1.1 * STEP
    assert np.mean(np.abs(np.diff(exact)) > 0.99 * 1.1 * STEP) > 0.1


@pytest.mark.inject
def test_a_concealed_limit_is_found_and_nothing_else(tmp_path):
    """Delay, constant and limit, within their intervals or a few per cent; no play, contact or hysteresis for it."""
    answer = diagnose(read_recording(recorded(tmp_path / "limited", 1.5)))
    named = {f.effect: f for f in answer.findings}
    assert set(named) <= {"time_delay", "lag", "joint_scale"}
    values = {name: v.value for name, v in named["lag"].parameters.items()}
    assert values["speed_limit"] == pytest.approx(1.5, rel=0.03)
    late = named["time_delay"].parameters["delay"].value if "time_delay" in named else 0.0
    assert late + values["constant"] == pytest.approx(0.07, abs=0.01)


@pytest.mark.inject
def test_no_limit_is_named_where_none_is_reached(tmp_path):
    """A servo that is fast enough."""
    answer = diagnose(read_recording(recorded(tmp_path / "free", 50.0)))
    assert {f.effect for f in answer.findings} <= {"time_delay", "lag"}
    assert not any("speed_limit" in f.parameters for f in answer.findings)

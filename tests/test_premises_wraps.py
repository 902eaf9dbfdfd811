"""Angles that a ring encoder wraps to one turn, and that were then resampled by straight lines: rows between the two ends."""

import numpy as np
import pytest

from galen_hw.diagnosis.pipeline import diagnose
from galen_hw.physics.effects.registry import scene_of
from galen_hw.physics.observations import Belief, Observations
from galen_hw.premises import Action
from galen_hw.premises.joints import WrappedJoints

TURN = 2.0 * np.pi


def angle(t: np.ndarray) -> np.ndarray:
    """A table that turns to and fro by several turns; (N,) rad."""
    return 9.0 * np.sin(0.21 * t) + 4.0 * np.sin(0.53 * t + 1.0)


def wrapped(q: np.ndarray, turn: float = TURN) -> np.ndarray:
    """Angles (N,) as the ring counts them, from zero to a turn."""
    return q / TURN * turn % turn


def resampled(q: np.ndarray, slow: np.ndarray, t: np.ndarray, turn: float = TURN) -> tuple[np.ndarray, np.ndarray, int]:
    """Return what straight lines make at t (N,) of ring counts at times slow (M,): values, rows that are off, and wraps."""
    ring = wrapped(q, turn)
    values = np.interp(t, slow, ring)
    right = np.interp(t, slow, q) / TURN * turn % turn
    off = np.abs((values - right + 0.5 * turn) % turn - 0.5 * turn) > 1e-9 * turn
    return values, off, int(np.sum(np.abs(np.diff(ring)) > 0.5 * turn))


@pytest.mark.parametrize("turn", [TURN, 360.0])
@pytest.mark.parametrize(("rate", "new"), [(100.0, 250.0), (100.0, 1000.0), (125.0, 200.0), (50.0, 40.0)])
def test_rows_between_the_ends_of_a_turn_are_left_out(rate: float, new: float, turn: float):
    """All of them, nearly no others, and what is left goes on."""
    slow = np.arange(0.0, 60.0, 1.0 / rate)
    t = np.arange(0.003, 59.9, 1.0 / new)
    noise = 3e-4 * np.random.default_rng(2).normal(size=len(slow))
    values, off, wraps = resampled(angle(slow) + noise, slow, t, turn)
    (found,) = WrappedJoints().examine(Observations("position", {"time": t, "joint.a.position": values}))
    assert found.action is Action.REPAIRED
    assert f"{wraps} times" in found.what
    assert found.todo == "unwrap before resampling"
    assert found.repaired is not None
    got = found.repaired.columns["joint.a.position"]
    out = np.isnan(got)
    assert np.all(out[off])
    assert out.sum() <= off.sum() + wraps
    assert f"{out.sum()} of {len(t)} rows" in found.what
    left = got[~out] / turn * TURN - angle(t[~out])
    assert np.ptp(left) < 20.0 * 3e-4 + TURN / 1000.0


def test_what_drives_is_interpolated_there():
    """Its motion is needed in every row."""
    slow, t = np.arange(0.0, 60.0, 0.01), np.arange(0.003, 59.9, 0.004)
    values, _, _ = resampled(angle(slow), slow, t)
    columns = {"time": t, "joint.a.position": values, "joint.a.effort": np.cos(t)}
    (found,) = WrappedJoints().examine(Observations("effort", columns))
    assert "interpolated" in found.what
    assert found.repaired is not None
    got = found.repaired.columns["joint.a.position"]
    assert np.isfinite(got).all()
    assert got - got[0] == pytest.approx(angle(t) - angle(t[:1]), abs=1e-3)


def test_rows_of_a_wrap_that_was_not_resampled_are_all_kept():
    t = np.arange(0.0, 60.0, 0.01)
    (found,) = WrappedJoints().examine(Observations("position", {"time": t, "joint.a.position": wrapped(angle(t))}))
    assert "between" not in found.what
    assert not found.todo
    assert found.repaired is not None
    assert np.isfinite(found.repaired.columns["joint.a.position"]).all()


@pytest.mark.parametrize("back", [0.3, 1.0, 3.0])
def test_a_joint_that_goes_back_by_a_turn_in_a_machine_s_time_is_no_wrap(back: float):
    """Slowly forth, quickly back, as a scanner does."""
    t = np.arange(0.0, 120.0, 0.01)
    phase = t % 30.0
    q = np.where(phase < 30.0 - back, phase / (30.0 - back), (30.0 - phase) / back) * TURN
    assert not list(WrappedJoints().examine(Observations("position", {"time": t, "joint.a.position": q})))


def test_a_play_beside_wraps_is_found():
    """Half width 0.9 mrad where noise is 0.3: rows between are thousands of times larger."""
    rng = np.random.default_rng(5)
    slow, t = np.arange(0.0, 60.0, 0.01), np.arange(0.02, 59.9, 0.004)
    motor = angle(slow)
    table, half = np.empty_like(motor), 0.9e-3
    table[0] = motor[0]
    for k in range(1, len(motor)):
        table[k] = np.clip(table[k - 1], motor[k] - half, motor[k] + half)
    values, _, _ = resampled(table + 3e-4 * rng.normal(size=len(slow)), slow, t)
    columns = {"time": t, "joint.table.position": values}
    simulation = {"joint.table.position": np.interp(t, slow, motor)}
    found = diagnose(scene_of(Observations("position", columns, simulation, Belief(bias_free=True)))).diagnosis
    (play,) = found.findings
    assert play.effect == "backlash"

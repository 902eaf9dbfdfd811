"""Readings of which a part is lost: positions of a joint that the log held, and loads without their sign."""

import numpy as np
import pytest

from galen_hw.physics.effects.registry import scene_of
from galen_hw.physics.observations import Belief, Observations
from galen_hw.premises import Action, examined
from galen_hw.premises.held_joints import HeldJoints
from tests.test_premises_efforts import G, arm


def motion(n: int = 2000) -> tuple[np.ndarray, np.ndarray]:
    """Clock (n,) at 50 Hz and positions (n, 4) that rest for a while at every end of a way."""
    t = np.arange(n) / 50.0
    way = [np.clip(1.3 * np.sin((0.7 + 0.13 * k) * t + k), -1.0, 1.0) for k in range(4)]
    return t, 0.8 * np.stack(way, axis=1)


def efforts(q: np.ndarray, t: np.ndarray, friction: float = 0.0, noise: float = 0.02) -> Observations:
    """Efforts of the arm in a motion (n, 4), with the positions that the log has."""
    machine = arm(load=0.8).under(G)
    dq = np.gradient(q, t, axis=0)
    moved = machine.inverse_dynamics(q, dq, np.gradient(dq, t, axis=0)) + friction * np.tanh(dq / 0.02)
    moved += noise * np.random.default_rng(3).normal(size=moved.shape)
    columns = {"time": t}
    for k, name in enumerate(machine.joint_names):
        columns |= {f"joint.{name}.position": q[:, k], f"joint.{name}.effort": moved[:, k]}
    return Observations("effort", columns, None, Belief(robot=machine, gravity=G, bias_free=True, dynamic=True))


@pytest.mark.parametrize(("at", "rows"), [(300, 8), (420, 60), (700, 400)])
def test_rows_of_a_joint_that_the_log_held_are_left_out(at: int, rows: int) -> None:
    """While it went on: these and no others, but for what it rested just before; the motion is not taken across."""
    t, q = motion()
    seen = efforts(q, t)
    name = seen.joint_names[1]
    values = q[:, 1].copy()
    values[at : at + rows] = values[at]
    assert abs(q[at + rows, 1] - values[at]) > 0.05, "it went on meanwhile"
    held = Observations("effort", dict(seen.columns) | {f"joint.{name}.position": values}, None, seen.belief)
    (found,) = HeldJoints().examine(held)
    assert found.action is Action.REPAIRED
    assert f"joint.{name}.position stands at one reading from" in found.what
    assert found.repaired is not None
    left = found.repaired.columns["time"]
    assert not np.isin(t[at + 1 : at + rows], left).any()
    assert len(t) - len(left) <= rows + 60
    assert len(found.repaired.segments) == 2
    assert np.isin(seen.columns["time"][at + rows :], left).all()


def test_joints_that_rest_and_go_on_are_not_held() -> None:
    """However often; neither what starts with a jerk, nor rows that were lost on a clock that shows it."""
    t, q = motion()
    assert not list(HeldJoints().examine(efforts(q, t)))
    assert not list(HeldJoints().examine(efforts(np.round(q, 2), t)))
    rest = int(np.flatnonzero(np.diff(q[:, 1]) == 0.0)[20])
    lost = np.r_[0:rest, rest + 60 : len(t)]
    assert not list(HeldJoints().examine(efforts(q, t).taken(lost)))
    ramp = np.repeat(np.array([0.0, 0.02]), 50).cumsum()
    jerk = np.stack([ramp] + [q[: len(ramp), k] for k in range(1, 4)], axis=1)
    assert not list(HeldJoints().examine(efforts(jerk, t[: len(ramp)])))


def test_what_the_model_drives_follows_the_rows_that_are_left() -> None:
    """Its simulation is right there."""
    t, q = motion()
    seen = efforts(q, t)
    name = seen.joint_names[1]
    values = q[:, 1].copy()
    values[420:480] = values[420]
    held = Observations("effort", dict(seen.columns) | {f"joint.{name}.position": values}, None, seen.belief)
    found = examined(held)
    assert [r.premise for r in found.remarks] == ["held_joints"]
    right, wrong, repaired = (float(np.std(scene_of(one).residual)) for one in (seen, held, found.observations))
    assert wrong > 1.5 * right
    assert repaired < 1.1 * right


@pytest.mark.parametrize("friction", [0.0, 0.4])
def test_efforts_without_a_sign_are_refused(friction: float) -> None:
    """All of an arm, whose friction has both signs as well; as they are, nothing is said."""
    seen = efforts(*motion()[::-1], friction)
    assert not examined(seen).remarks
    bare = {n: np.abs(v) if n.endswith(".effort") else v for n, v in seen.columns.items()}
    found = examined(Observations("effort", bare, None, seen.belief))
    (remark,) = found.refused
    assert remark.premise == "magnitudes"
    assert all(f"joint.{name}.effort" in remark.what for name in seen.joint_names)


def test_one_effort_without_a_sign_is_named_alone() -> None:
    """One drive that logs the size of its current."""
    seen = efforts(*motion()[::-1])
    name = f"joint.{seen.joint_names[2]}.effort"
    found = examined(Observations("effort", dict(seen.columns) | {name: np.abs(seen.columns[name])}, None, seen.belief))
    (remark,) = found.refused
    assert (remark.premise, remark.columns) == ("magnitudes", (name,))


def test_numbers_that_lost_their_minus_behind_the_point_are_refused() -> None:
    """A logger that writes whole part and thousandths as two whole numbers: -0.342 became 0.342, -1.342 stayed."""
    seen = efforts(*motion()[::-1])
    bare = {n: np.where((v > -1.0) & (v < 0.0), -v, v) if n.endswith(".effort") else v for n, v in seen.columns.items()}
    found = examined(Observations("effort", bare, None, seen.belief))
    (remark,) = found.refused
    assert remark.premise == "magnitudes"
    assert "never between -1 and 0" in remark.what


@pytest.mark.parametrize("joint", [1, 2])
def test_one_joint_in_degrees_is_put_right(joint: int) -> None:
    """Within the limits, since it hardly moves; all others are in rad."""
    t, q = motion()
    q = q.copy()
    q[:, joint] = 0.02 + 0.02 * np.sin(0.9 * t)
    seen = efforts(q, t, noise=0.002)
    name = f"joint.{seen.joint_names[joint]}.position"
    found = examined(Observations("effort", dict(seen.columns) | {name: np.degrees(q[:, joint])}, None, seen.belief))
    (remark,) = found.remarks
    assert remark.action is Action.REPAIRED
    assert remark.columns == (name,)
    assert "degrees" in remark.what
    assert found.observations.columns[name] == pytest.approx(q[:, joint], abs=1e-9)


@pytest.mark.parametrize("rate", [0.8, 1.25, 2.0])
def test_stamps_of_a_nominal_rate_are_told_by_what_accelerates(rate: float) -> None:
    """Gravity is right, and every joint needs the same share of the model's effort to move; friction stays out of it."""
    t, _ = motion()
    smooth = 0.8 * np.stack([np.sin((1.4 + 0.23 * k) * t + k) for k in range(4)], axis=1)
    seen = efforts(smooth, t, friction=0.3, noise=0.005)
    assert not examined(seen).remarks
    found = examined(Observations("effort", dict(seen.columns) | {"time": rate * t}, None, seen.belief))
    (remark,) = found.refused
    assert remark.premise == "motion_forces"
    said = float(remark.what.split("stamps should be ")[1].split()[0])
    assert said == pytest.approx(1.0 / rate, rel=0.01)


@pytest.mark.parametrize("way", [1, -1])
def test_efforts_in_their_neighbours_columns_are_refused(way: int) -> None:
    """A gripper's came first, or the first was left out."""
    seen = efforts(*motion()[::-1], noise=0.005)
    names = [f"joint.{name}.effort" for name in seen.joint_names]
    moved = dict(zip(names, np.roll(seen.matrix(*names), way, axis=1).T, strict=True))
    lost = names[0] if way > 0 else names[-1]
    moved[lost] = 0.31 + 0.005 * np.random.default_rng(5).normal(size=len(seen))
    found = examined(Observations("effort", dict(seen.columns) | moved, None, seen.belief))
    assert "shifted by a column" in found.refused[-1].what
    assert found.refused[-1].premise == "joint_reading"

"""Recordings with joints that slide, joints that nobody measured, several segments, and clocks that run backwards."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from galen_hw.diagnosis.findings.claims import mean_square
from galen_hw.diagnosis.pipeline import diagnose
from galen_hw.kinematics import UrdfRobot
from galen_hw.physics.effects.compliance import Compliance, Hardening
from galen_hw.physics.effects.creep import Creep
from galen_hw.physics.effects.friction import Friction
from galen_hw.physics.effects.geometry import JointOffset
from galen_hw.physics.effects.registry import scene_of
from galen_hw.physics.observations import Belief, Observations
from galen_hw.premises import cells, examined, load, thinning
from galen_hw.premises.channels import DeadChannels
from galen_hw.premises.clock import ClockUnit
from galen_hw.premises.criteria import CRITERIA
from galen_hw.premises.overflow import Overflow
from tests.test_premises_efforts import arm as four_joints
from tests.urdf_parts import joint, link, robot

RAIL = robot(
    link("base"),
    link("arm", 2.0),
    joint("turn", "base", "arm", "0 0 1"),
    link("slide", 1.0),
    joint("rail", "arm", "slide", "0 0 1", kind="prismatic"),
)
T = np.arange(1000) / 50.0


def rail(read: tuple[str, ...] = ("turn", "rail"), factor: float = 1.0) -> Observations:
    """A turning and a sliding joint and their commands; of these only some are read."""
    columns = {"time": T}
    for name, size, w in (("turn", 0.9, 0.7), ("rail", 0.04, 0.9)):
        if name in read:
            q = size * np.sin(w * T)
            columns |= {f"joint.{name}.command": factor * q, f"joint.{name}.position": factor * q}
    return Observations("position", columns, None, Belief(robot=UrdfRobot(RAIL).keeping(read)))


def test_parameters_of_a_joint_that_slides_are_in_metres():
    """Whatever it is called, and whichever joints are read."""
    scene = scene_of(rail(("rail",)))
    units = [effect.parameters(scene)[0].unit for effect in (JointOffset("rail"), Friction("rail", "viscous", 0.01))]
    assert units == ["m", "s"]
    pose = scene_of(replace(rail(), predict="pose"))
    found = [Compliance("joint", "rail"), Hardening("rail", 2, 1.0), Creep(1.0, joint="rail")]
    assert [effect.parameters(pose)[0].unit for effect in found] == ["m/N"] * 3
    found = [Compliance("joint", "turn"), Hardening("turn", 2, 1.0), Creep(1.0, joint="turn")]
    assert [effect.parameters(pose)[0].unit for effect in found] == ["rad/(N m)"] * 3


def test_metres_are_no_angles_where_the_first_joints_are_not_read():
    """A rail in millimetres is beyond its limits by a factor of millimetres, not of degrees."""
    found = examined(rail(("rail",), factor=1e3))
    assert [remark.premise for remark in found.remarks] == ["position_units"]
    assert "is it in mm" in found.remarks[0].what


def degrees(unmeasured: bool) -> Observations:
    """Three joints in degrees beside their simulation in rad, the last one perhaps not measured."""
    q = {f"joint.{name}.position": (1.0 + k) * np.sin((0.7 + 0.3 * k) * T) for k, name in enumerate("abc")}
    columns = {"time": T} | {name: np.degrees(values) for name, values in q.items()}
    if unmeasured:
        columns["joint.c.position"] = np.full(len(T), np.nan)
    return Observations("position", columns, q, Belief(bias_free=True))


@pytest.mark.parametrize("unmeasured", [False, True])
def test_a_joint_that_was_not_measured_hides_nothing_of_the_others(unmeasured: bool):
    """Units are told by the joints that were."""
    found = examined(degrees(unmeasured))
    assert [remark.premise for remark in found.remarks] == ["position_units"]
    assert "in degrees" in found.remarks[0].what
    assert found.observations.columns["joint.a.position"] == pytest.approx(np.sin(0.7 * T))


def test_a_channel_without_a_value_is_no_dead_channel():
    """Nor is any of a recording without rows; neither warns."""
    one = degrees(unmeasured=True)
    assert not list(DeadChannels().examine(one))
    assert not list(DeadChannels().examine(one.taken(slice(0, 0))))


def test_errors_before_claims_are_those_of_the_judged_channels():
    """Of a joint that was not measured no row is known."""
    scene = scene_of(degrees(unmeasured=True))
    judged = ["joint.a.position", "joint.b.position"]
    assert mean_square(scene, judged) == pytest.approx(np.var(scene.residual[:, :2], axis=0))


def test_angles_are_unwrapped_within_their_segments():
    """A segment that truly begins near minus half a turn stays there."""
    first, second = np.linspace(2.5, 3.5, 500), np.linspace(-3.1, -2.5, 500)
    wrapped = np.concatenate([(first + np.pi) % (2.0 * np.pi) - np.pi, second])
    columns = {"time": T, "segment": np.repeat([0.0, 1.0], 500), "joint.a.position": wrapped}
    effort = {"joint.a.effort": np.sin(T)}
    found = examined(Observations("effort", columns | effort, effort, Belief(bias_free=True)))
    assert [remark.premise for remark in found.remarks] == ["wrapped_joints"]
    assert found.observations.columns["joint.a.position"] == pytest.approx(np.concatenate([first, second]))


def test_a_reading_that_runs_over_its_integer_is_counted_on_within_its_segment():
    """What the next segment begins with is as it was read."""
    step = 0.01
    first, second = np.round(170 * np.sin(2.0 * T[:500])), np.round(-110 + 15 * np.sin(2.0 * T[500:]))
    true = np.concatenate([first, second])
    wrapped = (true + 128) % 256 - 128
    columns = {"time": T, "segment": np.repeat([0.0, 1.0], 500), "joint.a.effort": step * wrapped}
    (remark,) = Overflow().examine(Observations("effort", columns, {"joint.a.effort": step * true}, Belief()))
    assert remark.repaired is not None
    assert remark.repaired.columns["joint.a.effort"] == pytest.approx(step * true)


def test_rows_in_reverse_are_sorted_by_their_stamps():
    """They are exactly as smooth; no unit of a clock is asked of stamps that never advance."""
    one = degrees(unmeasured=False)
    backwards = one.taken(slice(None, None, -1))
    assert not list(ClockUnit().examine(backwards))
    found = examined(backwards)
    assert [remark.premise for remark in found.remarks] == ["row_order", "position_units"]
    assert found.observations.columns["time"] == pytest.approx(T)


def test_rows_with_a_clock_of_their_own_are_not_compared_one_by_one(monkeypatch: pytest.MonkeyPatch):
    """Poses are sought only where a stamp stands still."""
    monkeypatch.setattr(cells, "pose_bounds", lambda seen: pytest.fail("asked"))
    columns = {"time": T} | {f"wrench.{kind}.{a}": np.sin(T) for kind in ("force", "torque") for a in "xyz"}
    assert not list(cells.PoseRows().examine(Observations("wrench", columns)))
    values = np.zeros((len(T), 3))
    assert not cells._same_stamp(T, values).any()
    assert cells._same_stamp(np.minimum(T, 1.0), values).sum() == np.sum(T > 1.0)


def test_a_direction_that_rows_hardly_show_makes_no_change_of_a_load_sure():
    """A change that nothing bounds has no standard error of zero beside a value."""
    rng = np.random.default_rng(3)
    A, b = rng.normal(size=(60, 6, 10)), rng.normal(size=(60, 6))
    A[:, :, 9] = A[:, :, 8] + 1e-9 * rng.normal(size=(60, 6))
    found = load._fitted(A, b, slice(6, 10), 30, "load")
    assert np.all(np.abs(found.change) < CRITERIA.standard_errors * found.std)


def test_joints_are_tried_on_at_most_so_many_rows():
    """One fewer than twice as many are every other one."""
    found = thinning.thinned(degrees(unmeasured=True).taken(slice(0, 2 * CRITERIA.most_rows - 1)))
    assert found is not None
    some, rates = found
    assert rates is not None
    assert len(some) == len(rates[0]) == CRITERIA.most_rows
    assert np.allclose(np.diff(some.time), 2.0 / 50.0)


def test_gravity_is_claimed_of_the_joints_that_were_measured():
    """The arm is tilted, and one effort was not recorded: the claim's gain is that of the other channels."""
    believed = four_joints(load=1.0)
    gravity = np.array([0.0, 0.0, -9.80665])
    machine = believed.under(Rotation.from_rotvec([0.6, -0.4, 0.0]).apply(gravity))
    w, phase = 0.9 + 0.31 * np.arange(4), np.arange(4)
    angle = np.outer(T, w) + phase
    q, dq, ddq = 0.9 * np.sin(angle), 0.9 * w * np.cos(angle), -0.9 * w**2 * np.sin(angle)
    effort = machine.inverse_dynamics(q, dq, ddq) + 0.02 * np.random.default_rng(2).normal(size=q.shape)
    effort[:, 3] = np.nan
    columns = {"time": T}
    for k, name in enumerate(believed.joint_names):
        columns |= {f"joint.{name}.position": q[:, k], f"joint.{name}.effort": effort[:, k]}
    belief = Belief(robot=believed.under(gravity), gravity=gravity, bias_free=True)
    found = diagnose(scene_of(Observations("effort", columns, None, belief))).diagnosis
    (tilt,) = found.findings
    assert tilt.effect == "base_tilt"
    assert tilt.evidence["heldout_gain"] == pytest.approx(1.0, abs=1e-3)

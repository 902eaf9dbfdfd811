"""Joints, tables and models that were written down otherwise than they are named: mechanics are this file's own."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from galen_hw.cli import main
from galen_hw.kinematics import UrdfRobot
from galen_hw.physics.observations import Belief, Observations
from galen_hw.premises import Action, Remark, examined

G = np.array([0.0, 0.0, -9.80665])
JOINTS = ("pan", "lift", "elbow", "roll")
FORCE = [f"wrench.force.{a}" for a in "xyz"]
TORQUE = [f"wrench.torque.{a}" for a in "xyz"]
POSITION = [f"pose.position.{a}" for a in "xyz"]
LIMIT = '<limit lower="-3" upper="3" effort="{effort}" velocity="3"/>'


def urdf(mass: float = 1.0, effort: float = 90.0) -> str:
    """Four joints; masses times `mass`, limits of the efforts as given."""
    parts, parent = [], "base"
    for name, axis, place, weight in zip(
        JOINTS,
        ("0 0 1", "0 1 0", "0 1 0", "1 0 0"),
        ("0 0 .2", "0 0 .1", "0.3 0 0", "0.25 0 0"),
        (3, 4, 2, 1),
        strict=True,
    ):
        inertia = f'ixx="{0.01 * weight * mass}" iyy="{0.012 * weight * mass}" izz="{0.009 * weight * mass}"'
        parts.append(
            f'<link name="{name}_link"><inertial><origin xyz="0.12 0.02 0.03"/><mass value="{weight * mass}"/>'
            f'<inertia {inertia} ixy="0" ixz="0" iyz="0"/></inertial></link>'
            f'<joint name="{name}" type="revolute"><parent link="{parent}"/><child link="{name}_link"/>'
            f'<origin xyz="{place}"/><axis xyz="{axis}"/>{LIMIT.format(effort=effort)}</joint>'
        )
        parent = f"{name}_link"
    return f'<robot name="four"><link name="base"/>{"".join(parts)}</robot>'


def motion(n: int = 1200) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """t, q, dq, ddq of four joints, each with its own middle and frequency."""
    t = np.arange(n) / 60.0
    w, phase = np.array([0.7, 0.9, 1.1, 1.3]), np.arange(4.0)
    amplitude, middle = np.array([1.0, 0.6, 0.7, 1.2]), np.array([0.2, -0.6, 0.9, 0.3])
    angle = np.outer(t, w) + phase
    return t, middle + amplitude * np.sin(angle), amplitude * w * np.cos(angle), -amplitude * w**2 * np.sin(angle)


def robot(tmp_path: Path, **options: float) -> UrdfRobot:
    file = tmp_path / "four.urdf"
    file.write_text(urdf(**options))
    return UrdfRobot(file, sensor_link="roll_link")


def efforts(tmp_path: Path, believed: UrdfRobot | None = None) -> Observations:
    """What the arm needs, friction of its joints and noise: in the last one friction is nearly all of it."""
    t, *moved = motion()
    machine = robot(tmp_path)
    tau = machine.inverse_dynamics(*moved) + np.array([1.0, 1.5, 1.0, 1.2]) * np.tanh(moved[1] / 0.01)
    tau += np.random.default_rng(0).normal(size=tau.shape) * 0.05
    columns = {"time": t}
    for k, name in enumerate(JOINTS):
        columns |= {
            f"joint.{name}.{x}": v[:, k]
            for x, v in zip(("position", "velocity", "effort"), (*moved[:2], tau), strict=True)
        }
    return Observations("effort", columns, None, Belief(robot=believed or machine))


def poses(tmp_path: Path) -> Observations:
    """A tracked tip."""
    t, q, _, _ = motion(600)
    machine = robot(tmp_path)
    T = machine.sensor_pose(q)
    place = T[:, :3, 3] + 5e-5 * np.random.default_rng(1).normal(size=(len(t), 3))
    columns = {"time": t} | {f"joint.{name}.position": q[:, k] for k, name in enumerate(JOINTS)}
    turns = Rotation.from_matrix(T[:, :3, :3]).as_quat()
    columns |= {f"pose.orientation.{a}": turns[:, k] for k, a in enumerate("xyzw")}
    columns |= {name: place[:, k] for k, name in enumerate(POSITION)}
    return Observations("pose", columns, None, Belief(robot=machine))


def weights(tmp_path: Path) -> Observations:
    """A weight on the sensor, moved slowly."""
    t, q, _, _ = motion(600)
    machine = robot(tmp_path)
    force = 0.8 * machine.sensor_pose(q)[:, :3, :3].transpose(0, 2, 1) @ G
    torque = np.cross([0.01, -0.02, 0.06], force)
    wrench = np.concatenate([force, torque], axis=1) + 0.01 * np.random.default_rng(2).normal(size=(len(t), 6))
    columns = {"time": 10.0 * t} | {f"joint.{name}.position": q[:, k] for k, name in enumerate(JOINTS)}
    columns |= dict(zip(FORCE + TORQUE, wrench.T, strict=True))
    return Observations("wrench", columns, None, Belief(robot=machine, bias_free=True))


def spoilt(one: Observations, **columns: np.ndarray) -> Observations:
    return replace(one, columns=dict(one.columns) | {k.replace("__", "."): v for k, v in columns.items()})


def swapped(one: Observations, first: str, second: str, *kinds: str) -> Observations:
    new = {
        f"joint.{a}.{k}": one.columns[f"joint.{b}.{k}"] for a, b in ((first, second), (second, first)) for k in kinds
    }
    return replace(one, columns=dict(one.columns) | new)


def only(seen: Observations) -> Remark:
    (remark,) = examined(seen).remarks
    return remark


@pytest.mark.parametrize("make", [efforts, poses, weights])
def test_nothing_is_said_of_an_arm_that_is_read_as_it_is_named(tmp_path: Path, make) -> None:
    assert not examined(make(tmp_path)).remarks


@pytest.mark.parametrize("make", [efforts, poses, weights])
@pytest.mark.parametrize("joint", ["lift", "elbow"])
def test_a_joint_that_counts_the_other_way_is_turned_round(tmp_path: Path, make, joint: str) -> None:
    right = make(tmp_path)
    names = [n for n in (f"joint.{joint}.position", f"joint.{joint}.velocity") if n in right.columns]
    remark = only(replace(right, columns=dict(right.columns) | {n: -right.columns[n] for n in names}))
    assert (remark.premise, remark.action) == ("joint_reading", Action.REPAIRED)
    assert f"joint.{joint}.position has the opposite sign of the model's" in remark.what
    assert remark.repaired is not None
    assert all(np.array_equal(remark.repaired.columns[n], right.columns[n]) for n in names)


def test_an_effort_that_friction_hides_is_turned_round(tmp_path: Path) -> None:
    """Friction is as large as the elbow's weight in places: the sign of what the model needs says it."""
    right = efforts(tmp_path)
    remark = only(spoilt(right, joint__elbow__effort=-right.columns["joint.elbow.effort"]))
    assert remark.columns == ("joint.elbow.effort",)
    assert "opposite sign" in remark.what


@pytest.mark.parametrize(("make", "kind"), [(efforts, "effort"), (poses, "position")])
def test_swapped_joints_are_named_and_refused(tmp_path: Path, make, kind: str) -> None:
    remark = only(swapped(make(tmp_path), "lift", "elbow", kind))
    assert remark.action is Action.REFUSED
    assert f"joint.lift.{kind}, joint.elbow.{kind} are swapped" in remark.what


def test_velocities_of_each_other_say_that_columns_are_swapped(tmp_path: Path) -> None:
    remark = only(swapped(efforts(tmp_path), "lift", "elbow", "position"))
    assert remark.premise == "velocity_columns"
    assert "joint.lift.velocity is the change of joint.elbow.position and the other way round" in remark.what


def test_an_arm_on_a_wall_is_no_joint_that_is_turned_round(tmp_path: Path) -> None:
    """Another direction of gravity is physics with a name, and left to the search."""
    _, *moved = motion()
    file = tmp_path / "four.urdf"
    file.write_text(urdf())
    wall = UrdfRobot(file, sensor_link="roll_link", gravity=np.array([9.80665, 0.0, 0.0]))
    right = efforts(tmp_path)
    tau = wall.inverse_dynamics(*moved)
    seen = spoilt(right, **{f"joint__{n}__effort": tau[:, k] for k, n in enumerate(JOINTS)})
    assert "joint_reading" not in [r.premise for r in examined(seen).remarks]


def test_a_friction_joint_in_newton_millimetres_is_told_by_the_limits(tmp_path: Path) -> None:
    """What the model needs there is far below friction: no slope tells the unit, the motor's limit does."""
    right = efforts(tmp_path)
    remark = only(spoilt(right, joint__roll__effort=1e3 * right.columns["joint.roll.effort"]))
    assert (remark.premise, remark.action) == ("effort_units", Action.REFUSED)
    assert remark.columns == ("joint.roll.effort",)
    assert "limit 90" in remark.what


def test_limits_that_the_model_itself_breaks_are_placeholders(tmp_path: Path) -> None:
    assert not examined(efforts(tmp_path, robot(tmp_path, effort=1.0))).remarks


def test_masses_in_grams_are_not_efforts_in_another_unit(tmp_path: Path) -> None:
    """Efforts are within the limits and the model's needs are not: the model is wrong."""
    remark = only(efforts(tmp_path, robot(tmp_path, mass=1e3)))
    assert remark.action is Action.REFUSED
    assert "the model is too heavy" in remark.what
    assert "in g?" in remark.todo


def test_one_motor_cannot_need_a_thirtieth(tmp_path: Path) -> None:
    """A load adds: an effort in volts is no payload of -97 % of the arm."""
    right = efforts(tmp_path)
    names = [f"joint.{n}.effort" for n in JOINTS if n != "lift"]
    seen = replace(right, columns={k: v for k, v in right.columns.items() if k not in names})
    remark = only(spoilt(seen, joint__lift__effort=right.columns["joint.lift.effort"] / 35.15))
    assert remark.action is Action.REFUSED
    assert "efforts are not in N m" in remark.what


@pytest.mark.parametrize(("factor", "says"), [(1e-3, "efforts are not in N m"), (0.5, ""), (2.0, "")])
def test_a_simulation_of_others_in_another_unit_is_named(factor: float, says: str) -> None:
    """A damper in kN beside its simulation in N; half or twice it may be a simulation that is not good."""
    t, *_ = motion()
    q, rng = np.sin(3.0 * t), np.random.default_rng(3)
    force = 2e3 * q + 400.0 * np.sign(np.cos(3.0 * t))
    columns = {
        "time": t,
        "joint.damper.position": q,
        "joint.damper.effort": factor * force + rng.normal(size=len(t)) * factor,
    }
    remarks = examined(Observations("effort", columns, {"joint.damper.effort": 2e3 * q}, Belief())).remarks
    assert [r.action for r in remarks] == [Action.REFUSED] * bool(says)
    assert all(says in r.what for r in remarks)


def test_positions_in_revolutions_are_no_clock_that_runs_fast(tmp_path: Path) -> None:
    right = efforts(tmp_path)
    seen = replace(
        right, columns={k: v / (2.0 * np.pi) if k.endswith(".position") else v for k, v in right.columns.items()}
    )
    remark = only(seen)
    assert remark.premise == "position_units"
    assert "revolutions" in remark.what
    assert remark.repaired is not None
    # Velocities were in rad/s already, and stay.
    assert all(np.allclose(remark.repaired.columns[n], v) for n, v in right.columns.items())


def test_a_number_that_stands_for_lost_is_far_from_all_places(tmp_path: Path) -> None:
    right = poses(tmp_path)
    lost = np.random.default_rng(4).random(len(right)) < 0.05
    seen = replace(
        right, columns=dict(right.columns) | {n: np.where(lost, -9999.0, right.columns[n]) for n in POSITION}
    )
    remark = only(seen)
    assert f"{lost.sum()} of 600 rows" in remark.what
    assert "one and the same far place" in remark.what
    assert remark.repaired is not None
    assert np.array_equal(np.isnan(remark.repaired.columns[POSITION[0]]), lost)


def test_rows_that_were_sorted_by_something_else_are_sorted_by_their_stamps(tmp_path: Path) -> None:
    right = efforts(tmp_path)
    remark = only(right.taken(np.argsort(right.columns["joint.pan.position"])))
    assert remark.premise == "row_order"
    assert remark.repaired is not None
    assert np.array_equal(remark.repaired.matrix(*right.columns), right.matrix(*right.columns))


def test_a_recording_that_stands_twice_one_after_the_other_is_one(tmp_path: Path) -> None:
    right = efforts(tmp_path)
    remark = only(right.taken(np.tile(np.arange(len(right)), 2)))
    assert remark.premise == "doubled_rows"
    assert remark.repaired is not None
    assert len(remark.repaired) == len(right)


@pytest.mark.parametrize(
    ("name", "factor", "says"), [("acceleration", 1 / 9.80665, "in g"), ("angular_velocity", 180 / np.pi, "degrees")]
)
def test_units_of_an_imu_are_told_by_the_orientation(tmp_path: Path, name: str, factor: float, says: str) -> None:
    t, q, dq, ddq = motion(600)
    machine, R = robot(tmp_path), robot(tmp_path).sensor_pose(q)[:, :3, :3]
    omega = np.einsum("nji,nj->ni", R, machine.sensor_motion(q, dq, ddq).omega)
    seen = weights(tmp_path)
    columns = {k: v for k, v in seen.columns.items() if not k.startswith("joint.")} | {"time": t}
    columns |= {f"sensor.orientation.{a}": v for a, v in zip("xyzw", Rotation.from_matrix(R).as_quat().T, strict=True)}
    columns |= {f"imu.acceleration.{a}": v for a, v in zip("xyz", (R.transpose(0, 2, 1) @ -G).T, strict=True)}
    columns |= {f"imu.angular_velocity.{a}": v for a, v in zip("xyz", omega.T, strict=True)}
    right = Observations("wrench", columns, None, Belief(bias_free=True))
    assert not examined(right).remarks
    remark = only(replace(right, columns=columns | {k: v * factor for k, v in columns.items() if f"imu.{name}." in k}))
    assert (remark.premise, remark.action) == ("imu_units", Action.REPAIRED)
    assert says in remark.what


def test_check_says_what_is_wrong_with_the_model_and_not_its_consequence(tmp_path: Path, capsys) -> None:
    seen = efforts(tmp_path)
    np.savetxt(
        tmp_path / "recording.csv",
        seen.matrix(*seen.columns),
        delimiter=",",
        header=",".join(seen.columns),
        comments="",
    )
    (tmp_path / "recording.json").write_text('{"schema": 1, "robot": "four.urdf", "predict": "effort"}')
    (tmp_path / "four.urdf").write_text(urdf(mass=0.0))
    assert main(["check", str(tmp_path)]) == 1
    said = capsys.readouterr().out
    assert "none of the 4 links that move weighs anything" in said
    assert "efforts" not in said


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_tip_that_goes_against_the_push_says_that_it_is_the_reaction(tmp_path: Path, sign: float) -> None:
    """0.1 mm/N beside a joint's offset and a tracker's noise."""
    seen = poses(tmp_path)
    force = 10.0 * np.sin(np.outer(seen.columns["time"], [3.1, 2.3, 4.7]))
    columns = dict(seen.columns) | {f"applied.force.{a}": sign * force[:, k] for k, a in enumerate("xyz")}
    columns |= {n: seen.columns[n] + 1e-4 * force[:, k] for k, n in enumerate(POSITION)}
    columns["joint.lift.position"] = columns["joint.lift.position"] + 1e-3
    remarks = examined(replace(seen, columns=columns)).remarks
    assert [r.premise for r in remarks] == ["push_signs"] * (sign < 0.0)
    assert all("reaction" in r.what for r in remarks)


@pytest.mark.parametrize("make", [efforts, poses])
@pytest.mark.parametrize(("sign", "quarters"), [(1.0, 1), (-1.0, -1)])
def test_a_joint_that_counts_from_another_zero_is_read_from_the_model_s(
    tmp_path: Path, make, sign: float, quarters: int
) -> None:
    """The controller counts from upright, the file from level: for efforts gravity along another direction is no rival."""
    right = make(tmp_path)
    name = "joint.lift.position"
    told = {name: sign * right.columns[name] + quarters * np.pi / 2.0}
    if "joint.lift.velocity" in right.columns:
        told["joint.lift.velocity"] = sign * right.columns["joint.lift.velocity"]
    remark = only(replace(right, columns=dict(right.columns) | told))
    assert (remark.premise, remark.action) == ("joint_reading", Action.REPAIRED)
    assert f"{name} has its zero {abs(90 * quarters)} deg from the model's" in remark.what
    assert ("opposite sign" in remark.what) is (sign < 0.0)
    assert remark.repaired is not None
    missed = (remark.repaired.columns[name] - right.columns[name]) / (2.0 * np.pi)
    assert np.allclose(missed, np.round(missed))


def test_efforts_of_a_differential_are_refused(tmp_path: Path) -> None:
    """Two motors drive lift and elbow together: each joint's torque is their sum or their difference."""
    right = efforts(tmp_path)
    lift, elbow = (right.columns[f"joint.{n}.effort"] for n in ("lift", "elbow"))
    remark = only(spoilt(right, joint__lift__effort=(lift + elbow) / 2.0, joint__elbow__effort=(lift - elbow) / 2.0))
    assert (remark.premise, remark.action) == ("joint_reading", Action.REFUSED)
    assert remark.columns == ("joint.lift.effort", "joint.elbow.effort")
    assert "a differential" in remark.what


@pytest.mark.parametrize("flange", [False, True])
def test_a_tracked_flange_is_no_tip(tmp_path: Path, *, flange: bool) -> None:
    """The tip of the tool is named, and the place is that of the link's origin."""
    right = poses(tmp_path)
    tip = np.array([0.012, -0.031, 0.187])
    R = Rotation.from_quat(np.stack([right.columns[f"pose.orientation.{a}"] for a in "xyzw"], axis=1))
    moved = right.matrix(*POSITION) + (0.0 if flange else 1.0) * R.apply(tip)
    named = replace(right.belief, tip=tip)
    found = examined(replace(spoilt(right, **dict(zip(POSITION, moved.T, strict=True))), belief=named))
    assert [r.premise for r in found.remarks] == ["tracked_point"] * flange
    assert np.array_equal(found.observations.belief.tip, 0.0 * tip if flange else tip)

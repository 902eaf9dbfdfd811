"""Ordinary mistakes in quick motions of a known robot, and in efforts, injected one by one: mechanics are this file's own."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from galen_hw.cli import main
from galen_hw.diagnosis.pipeline import diagnose
from galen_hw.formats.own import expanded
from galen_hw.kinematics import GalenRobot, UrdfRobot
from galen_hw.physics.effects.registry import scene_of
from galen_hw.physics.observations import Belief, Observations
from galen_hw.physics.rigid import Body
from galen_hw.premises import Action, examined
from galen_hw.recording import Recording, read_recording
from galen_hw.recording.to_mcap import write_mcap
from tests.physics_scenes import URDF

ROBOT = GalenRobot()
G = np.array([0.0, 0.0, -9.80665])
MASS, COM = 0.64, np.array([0.012, -0.004, 0.05])
FORCE = [f"wrench.force.{a}" for a in "xyz"]
TORQUE = [f"wrench.torque.{a}" for a in "xyz"]
QUATERNION = [f"sensor.orientation.{a}" for a in "xyzw"]
Columns = dict[str, np.ndarray]


def swings(t: np.ndarray, amplitudes: dict[str, float], rate: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """q, dq, ddq (N, n) of sines, each joint with its own frequency (rad/s) and phase."""
    w = rate * (1.0 + 0.23 * np.arange(len(amplitudes)))
    a, phase = np.array(list(amplitudes.values())), np.arange(len(amplitudes))
    angle = np.outer(t, w) + phase
    return a * np.sin(angle), a * w * np.cos(angle), -a * w**2 * np.sin(angle)


def quick_wrench(gravity: np.ndarray = G, put_down_at: float | None = None) -> tuple[Columns, Observations]:
    """A point mass on the Galen's sensor, swung so quickly that its inertia is as large as its weight; 0.14 kg go at a time."""
    t = np.arange(1500) / 100.0
    amplitudes = {"carriage1": 0.02, "carriage2": 0.02, "carriage3": 0.02, "roll": 0.9, "tilt": 0.7}
    motion = ROBOT.sensor_motion(*swings(t, amplitudes, 4.0))
    R = motion.T[:, :3, :3]
    com = np.einsum("nij,j->ni", R, COM)
    a = motion.acceleration + np.cross(motion.alpha, com) + np.cross(motion.omega, np.cross(motion.omega, com))
    mass = np.where(t < (np.inf if put_down_at is None else put_down_at), MASS, MASS - 0.14)
    force = mass[:, None] * np.einsum("nji,nj->ni", R, gravity - a)
    wrench = np.concatenate([force, np.cross(COM, force)], axis=1)
    wrench += np.random.default_rng(0).normal(size=wrench.shape) * ([0.03] * 3 + [0.0012] * 3)
    columns = {"time": t} | dict(zip(FORCE + TORQUE, wrench.T, strict=True))
    columns |= {f"joint.{n}.position": q for n, q in zip(amplitudes, swings(t, amplitudes, 4.0)[0].T, strict=True)}
    belief = Belief(robot=ROBOT, tool=Body(MASS, COM), bias_free=True, dynamic=True)
    return columns, Observations("wrench", columns, None, belief)


def arm(tmp_path: Path) -> Observations:
    """Two joints of an arm of 5 kg in motion, with the efforts that it needs and their noise."""
    file = tmp_path / "arm.urdf"
    file.write_text(URDF)
    robot, t = UrdfRobot(file), np.arange(2000) / 100.0
    moved = swings(t, dict.fromkeys(robot.joint_names, 1.0), 1.3)
    effort = robot.inverse_dynamics(*moved) + 0.02 * np.random.default_rng(3).normal(size=(len(t), 2))
    columns = {"time": t}
    for k, name in enumerate(robot.joint_names):
        columns |= {f"joint.{name}.position": moved[0][:, k], f"joint.{name}.effort": effort[:, k]}
    return Observations("effort", columns, None, Belief(robot=robot, bias_free=True))


def spoilt(one: Observations, **columns: np.ndarray) -> Observations:
    return replace(one, columns=dict(one.columns) | {k.replace("__", "."): v for k, v in columns.items()})


def test_nothing_is_said_without_a_mistake(tmp_path: Path) -> None:
    assert not examined(quick_wrench()[1]).remarks
    assert not examined(arm(tmp_path)).remarks


def test_a_load_that_changes_in_a_quick_motion_is_found() -> None:
    """0.14 kg put down at 11 s where weight alone would not show it: within 2 g and two rows."""
    (remark,) = examined(quick_wrench(put_down_at=11.0)[1]).remarks
    assert remark.action is Action.REPAIRED
    assert remark.claim is not None
    assert remark.claim.parameters["mass"][0] == pytest.approx(-0.14, abs=2e-3)
    assert remark.claim.parameters["moment"][0] == pytest.approx(11.0, abs=0.02)


@pytest.mark.parametrize("mistake", ["gravity", "sign"])
def test_gravity_that_points_up_is_told_from_a_sign_by_what_accelerates(mistake: str) -> None:
    """Named the other way round, gravity leaves the inertia as it is; a reaction for an action turns that too."""
    columns, one = quick_wrench()
    if mistake == "gravity":
        one = replace(one, belief=replace(one.belief, gravity=-G))
    else:
        one = replace(one, columns=columns | {n: -columns[n] for n in FORCE + TORQUE})
    found = examined(one)
    (remark,) = found.remarks
    assert remark.action is Action.REPAIRED
    assert found.observations.belief.gravity == pytest.approx(G)
    assert found.observations.columns[FORCE[0]] == pytest.approx(columns[FORCE[0]])
    assert ("gravity points" in remark.what) is (mistake == "gravity")


def test_a_wrench_in_base_axes_is_that_though_the_sensor_turns_about_one_axis_alone() -> None:
    """There a turn of the sensor imitates it, with a weight that the named tool has not."""
    t = np.arange(600) / 100.0
    turn = Rotation.from_rotvec(np.outer(1.2 * np.sin(1.1 * t), [0.0, 1.0, 0.0]))
    force = MASS * turn.inv().apply(np.tile(G, (len(t), 1)))
    base = np.concatenate([turn.apply(force), turn.apply(np.cross(COM, force))], axis=1)
    base += np.random.default_rng(1).normal(size=base.shape) * ([0.02] * 3 + [0.001] * 3)
    base += np.concatenate([turn.apply(np.tile([3.0, 0.5, -2.0], (len(t), 1))), np.zeros((len(t), 3))], axis=1)
    columns = {"time": t} | dict(zip(QUATERNION + FORCE + TORQUE, (*turn.as_quat().T, *base.T), strict=True))
    found = examined(Observations("wrench", columns, None, Belief(tool=Body(MASS, COM), bias_free=True, dynamic=False)))
    (remark,) = found.remarks
    assert "axes of the base" in remark.what
    assert found.observations.belief.sensor_turn == pytest.approx(np.eye(3))


def test_joints_in_revolutions_break_no_limit_and_are_told_by_the_simulation() -> None:
    """Of the joints that turn; the carriages stay as they are."""
    t = np.arange(300) / 20.0
    amplitudes = {"carriage1": 0.02, "carriage2": 0.02, "carriage3": 0.02, "roll": 0.9, "tilt": 0.7}
    q = swings(t, amplitudes, 0.7)[0]
    T = ROBOT.sensor_pose(q)
    columns = {"time": t} | {f"pose.position.{a}": T[:, k, 3] for k, a in enumerate("xyz")}
    quaternion = Rotation.from_matrix(T[:, :3, :3]).as_quat()
    columns |= {f"pose.orientation.{a}": quaternion[:, k] for k, a in enumerate("xyzw")}
    columns |= {f"joint.{n}.position": v for n, v in zip(amplitudes, q.T, strict=True)}
    one = Observations("pose", columns, None, Belief(robot=ROBOT))
    turns = {f"joint__{n}__position": columns[f"joint.{n}.position"] / (2.0 * np.pi) for n in ("roll", "tilt")}
    found = examined(spoilt(one, **turns))
    (remark,) = found.remarks
    assert "revolutions" in remark.what
    assert found.observations.columns["joint.tilt.position"] == pytest.approx(columns["joint.tilt.position"])
    assert found.observations.columns["joint.carriage1.position"] is columns["joint.carriage1.position"]


def test_one_effort_in_another_unit_is_named(tmp_path: Path) -> None:
    one = arm(tmp_path)
    (remark,) = examined(spoilt(one, joint__elbow__effort=1e3 * one.columns["joint.elbow.effort"])).remarks
    assert remark.action is Action.REFUSED
    assert remark.columns == ("joint.elbow.effort",)
    assert "N mm" in remark.what


def test_one_effort_at_the_motors_side_of_its_gear_is_named(tmp_path: Path) -> None:
    one = arm(tmp_path)
    (remark,) = examined(spoilt(one, joint__elbow__effort=one.columns["joint.elbow.effort"] / 101.0)).remarks
    assert remark.action is Action.REFUSED
    assert "a gear of 101" in remark.what


def test_one_column_that_flickers_between_two_sharp_bands_was_read_as_unsigned(tmp_path: Path) -> None:
    """Floats about zero whose sign's bit, 8.192, was added: no counts, so that the bit is not known to the last digit."""
    one = arm(tmp_path)
    about_zero = np.random.default_rng(5).normal(0.0, 0.1, size=len(one))
    still = {"joint__elbow__effort": about_zero}
    bit = {"joint__elbow__effort": np.where(about_zero < 0.0, 8.192 - about_zero, about_zero)}
    assert "unsigned_integers" not in [r.premise for r in examined(spoilt(one, **still)).remarks]
    (remark,) = examined(spoilt(one, **bit)).remarks
    assert remark.premise == "unsigned_integers"
    assert remark.action is Action.REFUSED


def test_two_states_are_no_unsigned_numbers(tmp_path: Path) -> None:
    """A joint that is pulled to and fro between two loads, with the noise of a sensor about either."""
    one, rng = arm(tmp_path), np.random.default_rng(6)
    states = rng.choice([1.0, 9.0], size=len(one)) + 0.1 * rng.normal(size=len(one))
    found = examined(spoilt(one, joint__elbow__effort=states))
    assert "unsigned_integers" not in [r.premise for r in found.remarks]


def test_a_sign_that_does_not_explain_the_constant_is_not_turned(tmp_path: Path) -> None:
    one = arm(tmp_path)
    found = examined(spoilt(one, joint__shoulder__effort=80.0 - one.columns["joint.shoulder.effort"]))
    assert not {"joint_signs", "joint_reading"} & {r.premise for r in found.remarks}


def test_what_a_premise_refuses_gets_no_numbers(tmp_path: Path) -> None:
    """The diagnosis says what is wrong with it, and names nothing else: no bias, no gain, no friction of newton millimetres."""
    one = arm(tmp_path)
    wrong = spoilt(one, joint__elbow__effort=1e3 * one.columns["joint.elbow.effort"] + 50.0)
    found = diagnose(scene_of(wrong)).diagnosis
    assert [finding.effect for finding in found.findings] == ["unknown"]
    assert "N mm" in found.findings[0].says
    assert found.verdict == "unexplained"


@pytest.mark.parametrize(("factor", "status"), [(1.0, 0), (1e3, 1)])
def test_check_asks_the_premises_of_a_recording(tmp_path: Path, capsys, factor: float, status: int) -> None:
    """Lines for people, JSON for scripts, and 1 where a fit is refused."""
    one, folder = arm(tmp_path), tmp_path
    table = np.column_stack([factor * v if n == "joint.elbow.effort" else v for n, v in one.columns.items()])
    np.savetxt(folder / "recording.csv", table, delimiter=",", header=",".join(one.columns), comments="")
    (folder / "recording.json").write_text(
        json.dumps({"schema": 1, "robot": "arm.urdf", "predict": "effort", "model": {"bias": "free"}})
    )
    assert main(["check", str(folder)]) == status
    assert ("refused" if status else "ok") in capsys.readouterr().out
    assert main(["check", str(folder), "--json"]) == status
    (said,) = json.loads(capsys.readouterr().out)["recordings"]
    assert (said["predict"], said["rows"]) == ("effort", 2000)
    assert [p["premise"] for p in said["premises"] if p["action"] == "refused"] == ["effort_units"] * status


def test_check_of_a_folder_asks_each_recording_in_it(tmp_path: Path, capsys) -> None:
    """As `diagnose` takes a folder: tables and MCAP files of the recorder; one that is refused makes it 1, one unreadable 2."""
    one = arm(tmp_path)
    about = {"schema": 1, "robot": "arm.urdf", "predict": "effort", "model": {"bias": "free"}}
    for name, factor in (("good", 1.0), ("other", 1e3)):
        columns = {n: factor * v if n == "joint.elbow.effort" else v for n, v in one.columns.items()}
        folder = tmp_path / "all" / name
        folder.mkdir(parents=True)
        (folder / "arm.urdf").write_text((tmp_path / "arm.urdf").read_text())
        table = np.column_stack(list(columns.values()))
        np.savetxt(folder / "recording.csv", table, delimiter=",", header=",".join(columns), comments="")
        (folder / "recording.json").write_text(json.dumps(about))
    write_mcap(read_recording(tmp_path / "all" / "good"), tmp_path / "all" / "run.mcap")
    assert main(["check", str(tmp_path / "all"), "--json"]) == 1
    said = json.loads(capsys.readouterr().out)["recordings"]
    assert [Path(each["recording"]).name for each in said] == ["good", "other", "run.mcap"]
    refused = [[p["premise"] for p in each["premises"] if p["action"] == "refused"] for each in said]
    assert refused == [[], ["effort_units"], []]
    (tmp_path / "all" / "good" / "recording.csv").write_text("time\n")
    assert main(["check", str(tmp_path / "all")]) == 2
    said = capsys.readouterr()
    assert "good" in said.err
    assert str(tmp_path / "all" / "run.mcap") in said.out


def test_a_folder_of_the_recorders_files_is_no_bag(tmp_path: Path) -> None:
    """MCAP files alone in a folder are recordings one by one, not parts of one ROS bag."""
    recording = Recording({"time": np.arange(9) / 10.0, "wrench.force.x": np.arange(9.0)})
    (tmp_path / "day").mkdir()
    for name in ("a.mcap", "b.mcap"):
        write_mcap(recording, tmp_path / "day" / name)
    assert [p.name for p in expanded(tmp_path / "day")] == ["a.mcap", "b.mcap"]


def test_check_of_a_recording_that_is_not_there_is_wrong_use(tmp_path: Path, capsys) -> None:
    assert main(["check", str(tmp_path / "nowhere")]) == 2
    assert "nowhere" in capsys.readouterr().err

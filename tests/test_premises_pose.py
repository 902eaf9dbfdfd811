"""Trackers: units, axes, handedness and quaternions of a tracked pose and of tracked points, injected one by one."""

import itertools
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from galen_hw.kinematics import GalenRobot, UrdfRobot
from galen_hw.physics.observations import Belief, Observations
from galen_hw.premises import Action, examined
from tests.urdf_parts import joint, link, robot

ROBOT = GalenRobot()
TIP = np.array([0.045, 0.0, -0.14])
POSITION = [f"pose.position.{a}" for a in "xyz"]
QUATERNION = [f"pose.orientation.{a}" for a in "xyzw"]
Columns = dict[str, np.ndarray]


def joints(n: int = 300) -> Columns:
    """Smooth motions of all five joints within their limits, at 20 Hz."""
    t = np.arange(n) / 20.0
    q = {
        "carriage1": 0.10 * np.sin(0.9 * t),
        "carriage2": 0.09 * np.sin(0.7 * t + 1.0),
        "carriage3": 0.10 * np.sin(0.8 * t + 2.0),
        "roll": 0.9 * np.sin(0.5 * t),
        "tilt": 0.7 * np.sin(0.6 * t + 0.5),
    }
    return {"time": t} | {f"joint.{name}.position": values for name, values in q.items()}


def pose() -> Columns:
    """The tip as the joints say, with a tracker's noise."""
    columns, rng = joints(), np.random.default_rng(0)
    T = ROBOT.sensor_pose(np.stack([columns[f"joint.{n}.position"] for n in ROBOT.joint_names], axis=1))
    position = T[:, :3, 3] + T[:, :3, :3] @ TIP + 1e-4 * rng.normal(size=(len(T), 3))
    quaternion = (
        Rotation.from_matrix(T[:, :3, :3]) * Rotation.from_rotvec(1e-3 * rng.normal(size=(len(T), 3)))
    ).as_quat()
    return columns | dict(zip(POSITION + QUATERNION, (*position.T, *quaternion.T), strict=True))


def targets() -> Columns:
    """Three points on the moving body in a tracker's frame that nobody registered."""
    columns, rng = joints(), np.random.default_rng(1)
    T = ROBOT.sensor_pose(np.stack([columns[f"joint.{n}.position"] for n in ROBOT.joint_names], axis=1))
    R, t = Rotation.from_rotvec([0.4, -1.1, 0.7]).as_matrix(), np.array([0.5, 0.2, -2.0])
    for k, point in enumerate(([0.05, 0.0, 0.0], [0.0, 0.06, 0.01], [-0.02, 0.01, 0.07])):
        place = (T[:, :3, 3] + T[:, :3, :3] @ np.array(point)) @ R.T + t + 1e-4 * rng.normal(size=(len(T), 3))
        columns |= {f"target.{k}.position.{a}": place[:, i] for i, a in enumerate("xyz")}
    return columns


def seen(columns: Columns, predict: str = "pose") -> Observations:
    return Observations(predict, columns, None, Belief(robot=ROBOT, tip=TIP))


def matrix(columns: Columns, names: list[str]) -> np.ndarray:
    return np.stack([columns[n] for n in names], axis=1)


def turned(columns: Columns, Q: np.ndarray) -> Columns:
    """Positions and orientations in other axes; of a mirrored frame the body's axes are mirrored too."""
    position = matrix(columns, POSITION) @ Q.T
    R = Rotation.from_quat(matrix(columns, QUATERNION)).as_matrix()
    R = Q @ R @ (np.eye(3) if np.linalg.det(Q) > 0 else Q.T)
    return columns | dict(zip(POSITION + QUATERNION, (*position.T, *Rotation.from_matrix(R).as_quat().T), strict=True))


def same_as(found, original: Columns, tolerance: float) -> None:
    """Positions to a tolerance (m), orientations to 5 mrad."""
    back = dict(found.observations.columns)
    assert np.max(np.abs(matrix(back, POSITION) - matrix(original, POSITION))) < tolerance
    off = Rotation.from_quat(matrix(back, QUATERNION)).inv() * Rotation.from_quat(matrix(original, QUATERNION))
    assert np.max(off.magnitude()) < 5e-3


@pytest.mark.parametrize(("make", "predict"), [(pose, "pose"), (targets, "targets")])
def test_nothing_is_said_of_a_tracker_that_is_right(make, predict):
    """Neither of a pose in the base nor of points in any frame."""
    assert not examined(seen(make(), predict)).remarks


@pytest.mark.parametrize(("make", "predict"), [(pose, "pose"), (targets, "targets")])
def test_a_joint_that_is_counted_against_the_link_before_the_last_is_read_so(make, predict):
    """As a pendant shows the third joint of an industrial arm."""
    original = make()
    tilt, roll = (original[f"joint.{n}.position"] for n in ("tilt", "roll"))
    found = examined(seen(original | {"joint.tilt.position": tilt - roll}, predict))
    (remark,) = found.remarks
    assert remark.premise == "joint_reading"
    assert "the first is added to the second" in remark.what
    assert np.allclose(found.observations.columns["joint.tilt.position"], tilt)


@pytest.mark.parametrize(("unit", "factor"), [("mm", 1e3), ("cm", 1e2), ("inches", 1 / 0.0254)])
def test_units_of_a_position_are_found(unit, factor):
    """The arm says how far it went."""
    original = pose()
    found = examined(seen(original | {n: factor * original[n] for n in POSITION}))
    assert f"in {unit}" in found.remarks[0].what
    same_as(found, original, 1e-9)


@settings(max_examples=15, deadline=None)
@given(st.integers(0, 1000), st.floats(0.3, 3.1))
def test_a_pose_in_other_axes_is_registered_to_the_base(seed, angle):
    """Turned about any axis by any angle; y up among them."""
    axis = Rotation.random(random_state=seed).apply([1.0, 0.0, 0.0])
    original = pose()
    found = examined(seen(turned(original, Rotation.from_rotvec(angle * axis).as_matrix())))
    assert [r.premise for r in found.remarks] == ["pose_frames"]
    same_as(found, original, 2e-3)


def test_a_pose_without_any_orientation_is_registered_by_its_positions():
    """The columns are there, and hold nothing."""
    original = pose()
    columns = turned(original, Rotation.from_rotvec([0.6, -0.5, 1.2]).as_matrix())
    found = examined(seen(columns | {n: np.full(len(columns["time"]), np.nan) for n in QUATERNION}))
    assert [r.premise for r in found.remarks] == ["pose_frames"]
    assert np.max(np.abs(matrix(dict(found.observations.columns), POSITION) - matrix(original, POSITION))) < 2e-3


def test_y_up_is_said_by_its_axes():
    """As many trackers and games have it."""
    y_up = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])
    found = examined(seen(turned(pose(), y_up)))
    assert "x, y, z read like x, z, -y of the base" in found.remarks[0].what


@pytest.mark.parametrize("axis", range(3))
def test_a_left_handed_tracker_is_named(axis):
    """Mirrored along an axis, orientations with it."""
    mirror = np.diag([-1.0 if k == axis else 1.0 for k in range(3)])
    original = pose()
    found = examined(seen(turned(original, mirror)))
    assert "left-handed" in found.remarks[0].what
    same_as(found, original, 2e-3)


@pytest.mark.parametrize(
    ("order", "signs", "says"),
    [
        ([3, 0, 1, 2], [1.0, 1.0, 1.0, 1.0], "have w first"),
        ([0, 1, 2, 3], [-1.0, -1.0, -1.0, 1.0], "are the inverse"),
        ([3, 0, 1, 2], [1.0, -1.0, -1.0, -1.0], "have w first and are the inverse"),
    ],
)
def test_the_order_of_the_poses_quaternions_is_found(order, signs, says):
    """The positions are right and say nothing."""
    original = pose()
    spoilt = matrix(original, QUATERNION)[:, order] * signs
    found = examined(seen(original | dict(zip(QUATERNION, spoilt.T, strict=True))))
    assert [r.what for r in found.remarks] == [f"the pose's quaternions {says}"]
    same_as(found, original, 1e-9)


def test_a_body_turned_on_its_flange_is_a_mounting_of_that_angle():
    """Its origin stays: 60 degrees about x."""
    original = pose()
    spoilt = Rotation.from_quat(matrix(original, QUATERNION)) * Rotation.from_euler("x", np.pi / 3)
    found = examined(seen(original | dict(zip(QUATERNION, spoilt.as_quat().T, strict=True))))
    (claim,) = found.claims
    assert claim.effect == "sensor_mounting"
    assert claim.parameters["turn_x"][0] == pytest.approx(np.pi / 3, abs=2e-3)


@pytest.mark.parametrize(
    ("factor", "mirrored", "says"), [(1e3, 0, "in mm"), (1.0, 1, "left-handed"), (1e3, 1, "in mm; ")]
)
def test_units_and_hand_of_targets_are_found(factor, mirrored, says):
    """Registration is free, but no rotation turns a left hand into a right one."""
    original = targets()
    sign = {a: -1.0 if mirrored and a == "y" else 1.0 for a in "xyz"}
    spoilt = {n: factor * sign[n[-1]] * v if n.startswith("target.") else v for n, v in original.items()}
    (remark,) = examined(seen(spoilt, "targets")).remarks
    assert says in remark.what


def test_a_lost_tracker_reads_its_origin_or_its_last_value():
    """Twenty rows at zero with the identity, fifteen of the last pose: not measured."""
    columns = pose()
    for name in POSITION + QUATERNION:
        columns[name] = columns[name].copy()
        columns[name][50:70] = 1.0 if name.endswith(".w") else 0.0
        columns[name][200:215] = columns[name][199]
    found = examined(seen(columns))
    assert [r.premise for r in found.remarks] == ["lost_values"]
    lost = np.isnan(found.observations.columns[POSITION[0]])
    assert np.flatnonzero(lost).tolist() == [*range(50, 70), *range(200, 215)]


@pytest.mark.parametrize("names", [("roll", "tilt"), ("carriage1", "carriage2", "carriage3")])
def test_joints_in_degrees_or_millimetres_are_found_by_the_limits(names):
    """For the whole group at once."""
    original = pose()
    factor = 180.0 / np.pi if names[0] == "roll" else 1000.0
    spoilt = original | {f"joint.{n}.position": factor * original[f"joint.{n}.position"] for n in names}
    found = examined(seen(spoilt))
    assert [r.premise for r in found.remarks] == ["position_units"]
    for n in names:
        assert np.allclose(found.observations.columns[f"joint.{n}.position"], original[f"joint.{n}.position"])


def test_an_angle_of_a_whole_turn_more_is_the_same_angle():
    """Unwrapped to the other side of its limits: no degrees."""
    original = pose()
    turned_on = original | {"joint.roll.position": original["joint.roll.position"] - 2.0 * np.pi}
    assert not examined(seen(turned_on)).remarks


def test_an_angle_that_is_read_between_minus_and_plus_half_a_turn_is_the_same_angle():
    """Of a joint that moves about pi each row by itself is turned round: no degrees."""
    machine, t = sized(), np.arange(200) / 20.0
    low = {name: np.zeros_like(t) for name in machine.joint_names} | {"elbow": 3.0 + 0.6 * np.sin(t)}
    machine.lower[:], machine.upper[:] = 0.5, 5.8
    columns = {"time": t} | {f"joint.{n}.position": (v + np.pi) % (2.0 * np.pi) - np.pi for n, v in low.items()}
    one = Observations("wrench", columns, None, Belief(robot=machine))
    assert "position_units" not in [r.premise for r in examined(one).remarks]


def sized(size: float = 1.0) -> UrdfRobot:
    """Five joints; of another size the same axes, upper and lower arm as much longer."""
    parts = [
        *(link(name) for name in ("base", "turret", "upper", "lower", "palm", "hand")),
        joint("turn", "base", "turret", "0 0 1"),
        joint("shoulder", "turret", "upper", at="0 0.1 0.1"),
        joint("elbow", "upper", "lower", at=f"0 0 {0.24 * size}"),
        joint("wrist", "lower", "palm", "1 0 0", at=f"0 0 {0.21 * size}"),
        joint("roll", "palm", "hand", "0 0 1", at="0 0 0.08"),
    ]
    return UrdfRobot(robot(*parts), sensor_link="hand")


@pytest.mark.parametrize(("size", "longer"), [(1.75, True), (1.004, False)])
def test_the_model_of_another_size_is_named_by_its_links(size: float, longer: bool) -> None:
    """As a UR5's recording with the file of a UR3; what a calibration corrects is left to the search, as is another tip."""
    machine, believed, t = sized(size), sized(), np.arange(400) / 20.0
    q = np.stack([0.8 * np.sin((0.4 + 0.17 * k) * t + k) for k in range(5)], axis=1)
    T = machine.sensor_pose(q)
    place = (
        T[:, :3, 3] + T[:, :3, :3] @ np.array([0.0, 0.02, 0.15]) + 1e-4 * np.random.default_rng(3).normal(size=(400, 3))
    )
    columns = {"time": t} | {f"joint.{n}.position": q[:, k] for k, n in enumerate(believed.joint_names)}
    columns |= dict(zip(POSITION, place.T, strict=True))
    found = examined(Observations("pose", columns, None, Belief(robot=believed, tip=np.array([0.0, 0.0, 0.12]))))
    assert [r.premise for r in found.remarks] == ["link_lengths"] * longer
    for remark in found.refused:
        assert "shoulder to elbow 420 mm where the model has 240" in remark.what
        assert "elbow to wrist 367 mm where the model has 210" in remark.what


def test_a_constant_offset_and_a_bent_arm_are_no_frame():
    """A shift of 5 cm, and 2 mm and 10 mrad that go with the pose: for the search."""
    original = pose()
    bent = 2e-3 * np.sin(original["joint.roll.position"])
    spoilt = original | {POSITION[0]: original[POSITION[0]] + 0.05, POSITION[2]: original[POSITION[2]] + bent}
    assert not examined(seen(spoilt)).remarks
    assert not examined(replace(seen(spoilt), belief=Belief(robot=ROBOT, tip=TIP + 0.01))).remarks


@pytest.mark.parametrize(("unit", "factor"), [("mm", 1e3), ("cm", 1e2), ("", 1.0)])
def test_the_unit_of_an_arm_that_stands_is_told_by_its_place(unit: str, factor: float) -> None:
    """Pushed at its tip by 2 mm: no motion shows a scale, and the base is where it is."""
    columns, rng = pose(), np.random.default_rng(4)
    still = {n: v if n == "time" else np.full_like(v, v[0]) for n, v in columns.items() if n not in QUATERNION}
    still |= {n: factor * (still[n] + 2e-3 * rng.normal(size=len(still[n]))) for n in POSITION}
    found = examined(seen(still))
    assert [r.premise for r in found.remarks] == ["pose_frames"] * bool(unit)
    assert all(f"in {unit}" in r.what for r in found.remarks)
    assert found.observations.columns[POSITION[0]] == pytest.approx(still[POSITION[0]] / factor)


def test_one_column_in_another_unit_is_repaired() -> None:
    """Two axes in metres and one in mm."""
    original = pose()
    found = examined(seen(original | {POSITION[1]: 1e3 * original[POSITION[1]]}))
    (remark,) = found.remarks
    assert remark.columns == (POSITION[1],)
    assert "in mm" in remark.what
    same_as(found, original, 1e-9)


def test_a_registration_is_as_good_as_positions_and_orientations_together() -> None:
    """Along a line the positions say little of a turn about it: the orientations say the rest, to twice their mean's error."""
    columns, rng = joints(), np.random.default_rng(8)
    columns |= {f"joint.carriage{k}.position": 0.1 * np.sin(0.9 * columns["time"]) for k in (1, 2, 3)}
    columns["joint.roll.position"] = 0.02 * np.sin(columns["time"])
    columns["joint.tilt.position"] = 0.02 * np.cos(0.7 * columns["time"])
    T = ROBOT.sensor_pose(np.stack([columns[f"joint.{n}.position"] for n in ROBOT.joint_names], axis=1))
    position = T[:, :3, 3] + T[:, :3, :3] @ TIP + 2e-4 * rng.normal(size=(len(T), 3))
    R = Rotation.from_matrix(T[:, :3, :3]) * Rotation.from_rotvec(2e-4 * rng.normal(size=(len(T), 3)))
    original = columns | dict(zip(POSITION + QUATERNION, (*position.T, *R.as_quat().T), strict=True))
    found = examined(seen(turned(original, Rotation.from_rotvec([0.4, 1.1, -0.7]).as_matrix())))
    assert [r.premise for r in found.remarks] == ["pose_frames"]
    back = Rotation.from_quat(matrix(dict(found.observations.columns), QUATERNION))
    off = (back * Rotation.from_matrix(T[:, :3, :3]).inv()).as_rotvec().mean(axis=0)
    assert np.max(np.abs(off)) < 1e-4


def pushed(sign: float, mirror: tuple[float, float, float] = (1.0, 1.0, 1.0)) -> Observations:
    """An arm that stands and gives by 20 um/N under pushes to all sides, as a tracker sees it."""
    columns, rng = joints(600), np.random.default_rng(3)
    q = np.array([0.03, -0.02, 0.05, 0.4, -0.3])
    T = ROBOT.sensor_pose(q[None])
    force = 8.0 * np.stack([np.sin(w * columns["time"]) for w in (0.5, 0.8, 1.3)], axis=1)
    place = T[0, :3, 3] + T[0, :3, :3] @ TIP + 2e-5 * force + 1e-4 * rng.normal(size=force.shape)
    still = {"time": columns["time"]} | {
        f"joint.{n}.position": np.full(600, v) for n, v in zip(ROBOT.joint_names, q, strict=True)
    }
    still |= {f"applied.force.{a}": sign * force[:, k] for k, a in enumerate("xyz")}
    return seen(still | dict(zip(POSITION, (place * np.array(mirror)).T, strict=True)))


def test_a_push_of_the_wrong_sign_is_refused() -> None:
    """No structure gives against a push."""
    assert not examined(pushed(1.0)).remarks
    (remark,) = examined(pushed(-1.0)).remarks
    assert (remark.premise, remark.action) == ("push_signs", Action.REFUSED)


def test_a_mirrored_tracker_of_an_arm_that_stands_is_told_by_its_place() -> None:
    """One place in the base: where it would be with an axis mirrored, and far from where it is."""
    remarks = examined(pushed(1.0, mirror=(-1.0, 1.0, 1.0))).remarks
    assert "left-handed" in remarks[0].what
    assert remarks[0].action is Action.REFUSED


CONVENTIONS = {
    "a rotation vector": None,
    "roll, pitch, yaw about fixed x, y, z": "xyz",
    "turns about x, y, z, each moved by those before": "XYZ",
    "turns about z, y, x, each moved by those before": "ZYX",
    "turns about z, y, z, each moved by those before": "ZYZ",
}


@pytest.mark.parametrize(("written", "read"), list(itertools.permutations(CONVENTIONS, 2)))
@pytest.mark.filterwarnings("ignore:Gimbal lock")
def test_three_numbers_that_were_read_by_another_convention_are_named(written: str, read: str):
    """Of a body that is mounted turned, so that its numbers go far beyond a quarter turn; the two conventions are said."""
    original = pose()
    body = Rotation.from_quat(matrix(original, QUATERNION)) * Rotation.from_rotvec([2.4, -1.1, 0.6])
    belief = Belief(robot=ROBOT, tip=TIP, tip_rotation=Rotation.from_rotvec([2.4, -1.1, 0.6]).as_matrix())
    sequence = CONVENTIONS[written]
    numbers = body.as_rotvec() if sequence is None else body.as_euler(sequence)
    sequence = CONVENTIONS[read]
    wrong = Rotation.from_rotvec(numbers) if sequence is None else Rotation.from_euler(sequence, numbers)
    columns = original | dict(zip(QUATERNION, wrong.as_quat().T, strict=True))
    found = examined(Observations("pose", columns, None, belief))
    assert [r.action for r in found.remarks] == [Action.REFUSED]
    # The same numbers in reverse order: either may have been taken for the other.
    either = {CONVENTIONS[written], CONVENTIONS[read]} == {"xyz", "ZYX"}
    pairs = [(written, read), (read, written)] if either else [(written, read)]
    assert found.remarks[0].what in [f"the pose's orientation is {a} that was read as {b}" for a, b in pairs]
    columns |= dict(zip(QUATERNION, body.as_quat().T, strict=True))
    assert not examined(Observations("pose", columns, None, belief)).remarks


@pytest.mark.parametrize(("make", "predict", "names"), [(pose, "pose", POSITION), (targets, "targets", None)])
@pytest.mark.parametrize("row", [60, 200])
def test_a_tracker_that_was_moved_is_named_with_its_row(make, predict: str, names: list[str] | None, row: int):
    """Bumped by half a degree and some millimetres: told to a row or two, and brought back."""
    original = make()
    names = names or [n for n in original if n.startswith("target.")]
    G, shift = Rotation.from_rotvec([0.004, -0.006, 0.005]), np.array([0.003, -0.002, 0.004])
    columns = dict(original)
    points = matrix(original, names)[row:].reshape(-1, 3)
    values = matrix(original, names)
    values[row:] = (G.apply(points) + shift).reshape(-1, len(names))
    columns |= dict(zip(names, values.T, strict=True))
    if predict == "pose":
        q = matrix(original, QUATERNION)
        q[row:] = (G * Rotation.from_quat(q[row:])).as_quat()
        columns |= dict(zip(QUATERNION, q.T, strict=True))
    found = examined(seen(columns, predict))
    (remark,) = found.remarks
    assert (remark.premise, remark.action) == ("moved_tracker", Action.REPAIRED)
    said = int(remark.what.split("row ")[1].split()[0])
    assert abs(said - 1 - row) <= 2
    assert np.max(np.abs(matrix(dict(found.observations.columns), names) - matrix(original, names))) < 1e-3
    if predict == "pose":
        same_as(found, original, 1e-3)


@pytest.mark.parametrize("kind", ["ramp", "noise", "bend", "shift"])
def test_a_frame_that_moves_slowly_or_an_arm_that_bends_was_not_moved(kind: str):
    """Nothing is brought back; a shift alone is a step of the readings."""
    original, rng = pose(), np.random.default_rng(4)
    n = len(original["time"])
    error = {
        "ramp": np.linspace(0.0, 0.006, n)[:, None] * np.array([1.0, -0.5, 0.3]),
        "shift": (np.arange(n) > 120)[:, None] * np.array([0.0, 0.006, 0.0]),
        "noise": 0.002 * rng.normal(size=(n, 3)),
        "bend": 0.004 * np.sign(np.sin(0.6 * original["time"] + 0.5))[:, None] * np.array([0.2, 0.1, 1.0]),
    }[kind]
    columns = original | dict(zip(POSITION, (matrix(original, POSITION) + error).T, strict=True))
    assert not examined(seen(columns)).remarks

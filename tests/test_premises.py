"""Ordinary mistakes, injected one by one into recordings of a weight in closed form: each is named, and put right exactly.

Mechanics here are this file's own: f = R^T m g + offset, tau = c x f, R random or turning smoothly.
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from galen_hw.physics.observations import Belief, Observations
from galen_hw.physics.rigid import Body
from galen_hw.premises import PREMISES, Action, examined, premises
from galen_hw.premises.base import Stage
from galen_hw.premises.rotations import as_axes, as_turn, nearest_axes, signed_permutations, similarity

MASS, COM = 0.85, np.array([0.012, -0.004, 0.061])
G = np.array([0.0, 0.0, -9.80665])
OFFSET = np.array([3.1, -7.4, 12.0, 0.2, -0.11, 0.05])
FORCE = [f"wrench.force.{a}" for a in "xyz"]
TORQUE = [f"wrench.torque.{a}" for a in "xyz"]
QUATERNION = [f"sensor.orientation.{a}" for a in "xyzw"]
Columns = dict[str, np.ndarray]


def static(n: int = 30, seed: int = 0, gravity: np.ndarray = G) -> Columns:
    """Poses of random orientation, no clock."""
    rng = np.random.default_rng(seed)
    return reading(Rotation.random(n, random_state=seed), rng, gravity)


def moving(n: int = 1500, seed: int = 1) -> Columns:
    """A slow smooth turn at 50 Hz."""
    t = np.arange(n) / 50.0
    angles = np.stack([1.1 * np.sin(0.5 * t), 0.9 * np.sin(0.31 * t + 1.0), 0.7 * np.sin(0.77 * t + 2.0)], axis=1)
    return {"time": t} | reading(Rotation.from_euler("xyz", angles), np.random.default_rng(seed), G)


def reading(turn: Rotation, rng: np.random.Generator, gravity: np.ndarray) -> Columns:
    """What a sensor of that orientation reads, with noise."""
    n = len(turn)
    force = MASS * turn.inv().apply(np.tile(gravity, (n, 1)))
    wrench = np.concatenate([force, np.cross(COM, force)], axis=1) + OFFSET
    wrench += rng.normal(size=(n, 6)) * ([0.02] * 3 + [0.001] * 3)
    return dict(zip(QUATERNION, turn.as_quat().T, strict=True)) | dict(zip(FORCE + TORQUE, wrench.T, strict=True))


def seen(columns: Columns, *, named: bool = False, **belief: object) -> Observations:
    """The recording, with the tool named or not."""
    tool = Body(MASS, COM) if named else Body()
    return Observations("wrench", columns, None, replace(Belief(tool=tool, bias_free=True, dynamic=False), **belief))


def matrix(columns: Columns, names: list[str]) -> np.ndarray:
    return np.stack([columns[n] for n in names], axis=1)


def turned(columns: Columns, force: np.ndarray, torque: np.ndarray | None = None) -> Columns:
    """Force and torque columns multiplied by matrices."""
    f, t = matrix(columns, FORCE) @ force.T, matrix(columns, TORQUE) @ (force if torque is None else torque).T
    return columns | dict(zip(FORCE + TORQUE, (*f.T, *t.T), strict=True))


def keys(found) -> list[str]:
    return [r.premise for r in found.remarks]


# The table


def test_every_premise_of_the_table_has_a_key_of_its_own_and_the_stages_are_in_order():
    """cells, units, the model, frames, load; no key twice."""
    table = premises()
    assert len(table) == len(PREMISES)
    assert len({p.KEY for p in table}) == len(table)
    order = list(Stage)
    places = [order.index(p.STAGE) for p in table]
    assert places == sorted(places)


@pytest.mark.parametrize("named", [False, True])
@pytest.mark.parametrize("make", [static, moving])
def test_nothing_is_said_of_a_recording_without_a_mistake(make, named):
    """No remark at all, and the very same object comes back, for ten seeds each."""
    for seed in range(10):
        one = seen(make(seed=seed), named=named)
        found = examined(one)
        assert not found.remarks
        assert found.observations is one


def test_a_later_stage_is_not_asked_where_an_earlier_one_refuses():
    """Time that is no time refuses; a mirrored wrench in the same recording is its consequence or waits."""
    columns = turned(moving(), np.diag([-1.0, 1.0, 1.0]))
    columns["time"] = np.arange(1500.0)
    found = examined(seen(columns))
    assert keys(found) == ["clock_unit"]
    assert found.refused


# Frames and signs


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 47))
def test_any_order_and_sign_of_the_axes_is_found(which):
    """All 48 signed permutations of force and torque together; proper ones are a turned sensor, improper ones repaired.

    Without a named tool the sign of the torque cannot be told where the force has the opposite one: that is refused.
    """
    P = signed_permutations()[which]
    original = static()
    found = examined(seen(turned(original, P)))
    if np.allclose(P, np.eye(3)):
        assert not found.remarks
        return
    (remark,) = found.remarks
    if np.allclose(P, -np.eye(3)):
        assert "cannot be told" in remark.what
        assert remark.action is Action.REFUSED
        return
    assert remark.action is Action.REPAIRED
    if np.linalg.det(P) > 0.0:
        (claim,) = found.claims
        assert claim.effect == "sensor_mounting"
        vector = [claim.parameters[f"turn_{a}"][0] for a in "xyz"]
        assert np.allclose(Rotation.from_rotvec(vector).as_matrix(), P.T, atol=0.02)
    else:
        for name in FORCE + TORQUE:
            assert np.allclose(found.observations.columns[name], original[name])


@settings(max_examples=30, deadline=None)
@given(st.floats(0.3, 3.1), st.integers(0, 10_000))
def test_a_sensor_turned_by_any_angle_is_a_mounting_of_that_angle(angle, seed):
    """About any axis, in poses and in a motion; the turn is right within half a degree."""
    axis = Rotation.random(random_state=seed).apply([1.0, 0.0, 0.0])
    turn = Rotation.from_rotvec(angle * axis).as_matrix()
    for make in (static, moving):
        found = examined(seen(turned(make(), turn.T)))
        (claim,) = found.claims
        vector = np.array([claim.parameters[f"turn_{a}"][0] for a in "xyz"])
        off = Rotation.from_matrix(Rotation.from_rotvec(vector).as_matrix().T @ turn).magnitude()
        assert off < np.radians(0.5)


def test_with_the_tool_named_it_is_known_whether_the_tool_turned_with_the_sensor():
    """The same force; the moment of the named centre of mass tells the two apart."""
    turn = Rotation.from_euler("z", 0.9).as_matrix()
    alone = examined(seen(turned(static(), turn.T), named=True))
    force = matrix(static(), FORCE) @ turn
    with_it = static() | dict(zip(FORCE + TORQUE, (*force.T, *np.cross(COM, force).T), strict=True))
    whole = examined(seen(with_it, named=True))
    parts = [claim.terms[0]["parameters"]["part"] for found in (alone, whole) for claim in found.claims]
    assert parts == ["turn_alone", "turn"]


SIGNS: dict[str, tuple[np.ndarray, np.ndarray]] = {
    "force and torque have the opposite sign": (-np.eye(3), -np.eye(3)),
    "wrench.force has the opposite sign": (-np.eye(3), np.eye(3)),
    "wrench.torque has the opposite sign": (np.eye(3), -np.eye(3)),
    "x is mirrored: left-handed": (np.diag([-1.0, 1.0, 1.0]), np.diag([-1.0, 1.0, 1.0])),
    "wrench.torque: axes x, y, z read like y, x, z": (np.eye(3), np.eye(3)[[1, 0, 2]]),
}


@pytest.mark.parametrize("says", SIGNS)
def test_signs_of_force_and_of_moment_are_told_apart(says):
    """With a named tool; what comes back is the recording as it should have been."""
    original = static()
    found = examined(seen(turned(original, *SIGNS[says]), named=True))
    (remark,) = found.remarks
    assert says in remark.what
    for name in FORCE + TORQUE:
        assert np.allclose(found.observations.columns[name], original[name])


def test_moments_about_the_tip_are_moved_to_the_sensor():
    """As a robot that shifts its wrench to the tool's centre point writes them; no sign and no body makes up for it."""
    original, tip = static(), np.array([0.021, -0.034, 0.168])
    about_tip = matrix(original, TORQUE) - np.cross(tip, matrix(original, FORCE))
    found = examined(seen(original | dict(zip(TORQUE, about_tip.T, strict=True)), named=True, tip=tip))
    (remark,) = found.remarks
    assert "about the tool's tip" in remark.what
    for name in FORCE + TORQUE:
        assert np.allclose(found.observations.columns[name], original[name])


def test_a_tool_that_hangs_elsewhere_is_no_sign_of_its_moment():
    """Its centre of mass on the other side of the sensor: a body explains that completely, the other sign only nearly."""
    original = static()
    elsewhere = np.cross(np.array([-0.009, 0.030, -0.107]), matrix(original, FORCE))
    assert not examined(seen(original | dict(zip(TORQUE, elsewhere.T, strict=True)), named=True)).remarks


def test_a_torque_in_other_axes_is_refused_without_a_named_tool():
    """Its sign, and so the side of the centre of mass, could be either."""
    (remark,) = examined(seen(turned(static(), np.eye(3), np.eye(3)[[1, 0, 2]]))).remarks
    assert remark.action is Action.REFUSED
    assert "wrench.torque" in remark.what


def test_a_wrench_in_axes_of_the_base_is_turned_back():
    """As many robots publish it."""
    original = static()
    R = Rotation.from_quat(matrix(original, QUATERNION))
    spoilt = original | dict(zip(FORCE, R.apply(matrix(original, FORCE)).T, strict=True))
    spoilt |= dict(zip(TORQUE, R.apply(matrix(original, TORQUE)).T, strict=True))
    found = examined(seen(spoilt))
    assert "axes of the base" in found.remarks[0].what
    for name in FORCE + TORQUE:
        assert np.allclose(found.observations.columns[name], original[name])


def w_first(q: np.ndarray) -> np.ndarray:
    return q[:, [3, 0, 1, 2]]


def inverse(q: np.ndarray) -> np.ndarray:
    return q * np.array([-1.0, -1.0, -1.0, 1.0])


def exchanged(q: np.ndarray) -> np.ndarray:
    """Of Rz(c) Ry(b) Rx(a) where Rz(a) Ry(b) Rx(c) was meant, as of a pendant's A, B, C."""
    return Rotation.from_euler("ZYX", Rotation.from_quat(q).as_euler("ZYX")[:, ::-1]).as_quat()


@pytest.mark.parametrize(
    ("spoil", "says"),
    [
        (w_first, "w first"),
        (inverse, "the inverse"),
        (lambda q: w_first(inverse(q)), "w first and take base to sensor"),
        (exchanged, "roll and yaw that were exchanged"),
    ],
)
def test_the_order_of_a_quaternion_is_found(spoil: Callable[[np.ndarray], np.ndarray], says):
    """Told by how the weight turns."""
    original = static()
    spoilt = original | dict(zip(QUATERNION, spoil(matrix(original, QUATERNION)).T, strict=True))
    found = examined(seen(spoilt))
    assert says in found.remarks[0].what
    back = matrix(dict(found.observations.columns), QUATERNION)
    assert np.allclose(
        Rotation.from_quat(back).as_matrix(), Rotation.from_quat(matrix(original, QUATERNION)).as_matrix()
    )


@pytest.mark.parametrize(("factor", "premises"), [(1.0, []), (1e4, ["tool_size"]), (1e6, ["tool_size"])])
def test_an_inertia_in_other_units_is_refused(factor: float, premises: list[str]) -> None:
    """As kg cm^2 and kg mm^2: a tool of a kilogram is no metres wide."""
    tool = Body(MASS, COM, factor * np.diag([0.004, 0.003, 0.002]))
    assert [r.premise for r in examined(seen(static(), tool=tool)).refused] == premises


@settings(max_examples=20, deadline=None)
@given(st.floats(0.3, 2.8), st.floats(0.0, 6.28))
def test_gravity_along_any_direction_is_a_base_tilt_of_that_angle(angle, about):
    """A robot on a wall or anywhere near it; one on the ceiling reads as a wrench of the opposite sign, and that says so."""
    tilt = Rotation.from_rotvec(angle * np.array([np.cos(about), np.sin(about), 0.0]))
    found = examined(seen(static(gravity=tilt.apply(G))))
    (claim,) = found.claims
    assert claim.effect == "base_tilt"
    vector = np.array([claim.parameters["tilt_x"][0], claim.parameters["tilt_y"][0], 0.0])
    assert np.allclose(Rotation.from_rotvec(vector).apply(G), tilt.apply(G), atol=0.05)


def test_pushes_of_a_hand_are_no_frame():
    """Forces three times the weight that come and go: nothing is said."""
    columns = moving()
    rng = np.random.default_rng(4)
    push = np.repeat(rng.normal(size=(15, 3)) * 15.0, 100, axis=0)
    columns |= {n: columns[n] + push[:, k] for k, n in enumerate(FORCE)}
    assert not examined(seen(columns, named=True)).remarks


@pytest.mark.parametrize("mass", [0.5, 1.6])
def test_another_tool_than_the_named_one_is_no_unit(mass):
    """Half or twice the named weight is a payload, for the search to find."""
    columns = static()
    columns |= {n: columns[n] * mass / MASS for n in FORCE + TORQUE}
    assert not examined(seen(columns, named=True)).remarks


# Units


@pytest.mark.parametrize(
    ("force", "torque", "says"),
    [
        (1 / 9.80665, 1 / 9.80665, "kgf"),
        (1 / 4.4482216, 1 / 0.112984829, "lbf in"),
        (1.0, 1000.0, "N mm"),
        (1000.0, 1000.0, "mN"),
        (1.0, 100.0, "N cm"),
        (1 / 9.80665, 1000 / 9.80665, "torque is in kgf mm, force in kgf"),
    ],
)
def test_units_of_a_named_tools_wrench_are_named(force, torque, says):
    """Refused where a tool of that weight could be; repaired where only the unit can."""
    original = static()
    spoilt = original | {n: original[n] * force for n in FORCE} | {n: original[n] * torque for n in TORQUE}
    found = examined(seen(spoilt, named=True))
    (remark,) = found.remarks
    assert says in remark.what
    if remark.action is Action.REPAIRED:
        for name in FORCE + TORQUE:
            assert np.allclose(found.observations.columns[name], original[name], rtol=1e-3)


def test_newton_millimetres_are_noticed_without_a_named_tool():
    """No tool has its centre of mass 62 m away."""
    columns = static()
    columns |= {n: 1000.0 * columns[n] for n in TORQUE}
    (remark,) = examined(seen(columns)).remarks
    assert remark.action is Action.REFUSED
    assert "N mm" in remark.what


@pytest.mark.parametrize("name", [FORCE[1], TORQUE[0]])
def test_one_column_in_another_unit_is_named(name):
    """A factor that the other two axes do not have."""
    columns = static()
    factor = 1 / 9.80665 if name in FORCE else 1000.0
    columns[name] = columns[name] * factor
    (remark,) = examined(seen(columns, named=True)).remarks
    assert remark.columns == (name,)
    assert remark.action is Action.REPAIRED


# Cells and clocks


def test_a_huge_number_was_not_measured():
    """NDI writes -3.697314e28 for what it does not see."""
    columns = moving()
    columns[FORCE[0]][[5, 700]] = -3.697314e28
    found = examined(seen(columns))
    assert keys(found) == ["lost_values"]
    assert np.isnan(found.observations.columns[FORCE[0]][[5, 700]]).all()


@pytest.mark.parametrize(("bits", "step"), [(16, 0.001), (12, 0.02)])
def test_a_reading_that_runs_over_its_integer_is_counted_on(bits, step):
    """It comes back as it was, to a step; what is large and does not run over is left alone."""
    original = moving()
    size = 0.6 * 2**bits * step / np.max(np.abs(original[FORCE[2]]))
    counts = np.round(size * original[FORCE[2]] / step)
    wrapped = (counts + 2 ** (bits - 1)) % 2**bits - 2 ** (bits - 1)
    found = examined(seen(original | {FORCE[2]: step * wrapped}))
    assert f"ran over the end of {bits} bits of {step:.4g}" in found.remarks[0].what
    assert np.allclose(found.observations.columns[FORCE[2]], step * counts)
    assert "overflow" not in keys(examined(seen(original | {FORCE[2]: step * counts})))


def test_a_channel_that_is_stuck_from_a_moment_on_was_not_measured_then():
    """At its last value, while the weight turns on; what is recorded before stays."""
    columns = moving()
    late = columns["time"] >= 18.0
    first = int(np.argmax(late))
    stuck = np.where(late, columns[TORQUE[1]][first], columns[TORQUE[1]])
    found = examined(seen(columns | {TORQUE[1]: stuck}, named=True))
    (remark,) = found.remarks
    assert "is stuck at" in remark.what
    assert "from 18 to 29.98 s" in remark.what
    assert np.array_equal(np.isfinite(found.observations.columns[TORQUE[1]]), ~late | (np.arange(len(late)) == first))


def test_a_column_that_was_exported_twice_is_named():
    """Row by row the same as another."""
    columns = static()
    (remark,) = examined(seen(columns | {FORCE[1]: columns[FORCE[0]].copy()})).refused
    assert remark.columns == (FORCE[0], FORCE[1])


@pytest.mark.parametrize(("unit", "factor"), [("ms", 1e3), ("us", 1e6), ("ns", 1e9)])
def test_the_unit_of_the_clock_is_found(unit, factor):
    """Repaired to the original to rounding."""
    columns = moving()
    found = examined(seen(columns | {"time": columns["time"] * factor}))
    assert keys(found) == ["clock_unit"]
    assert f"in {unit}" in found.remarks[0].what
    assert np.allclose(found.observations.columns["time"], columns["time"])


def test_a_clock_that_was_set_back_begins_a_new_segment():
    """No row is lost, no motion crosses the cut."""
    columns = moving()
    columns["time"] = columns["time"] - 1.0 * (np.arange(1500) >= 600)
    found = examined(seen(columns))
    assert keys(found) == ["clock_steps"]
    assert [p.start for p in found.observations.segments] == [0, 600]
    assert np.all(np.diff(found.observations.columns["time"]) > 0.0)


@pytest.mark.parametrize("digits", [1.0, 0.1])
def test_rounded_stamps_are_spread(digits):
    """Whole seconds, or a spreadsheet's digits: within a row of the truth."""
    columns = moving()
    true = columns["time"]
    columns["time"] = np.floor(true / digits) * digits
    found = examined(seen(columns))
    assert keys(found) == ["rounded_clock"]
    assert np.max(np.abs(found.observations.columns["time"] - true)) < 0.021


def test_every_row_twice_is_told_by_its_noise():
    """With and without a clock."""
    for columns in (moving(), static()):
        double = {n: np.repeat(v, 2) for n, v in columns.items()}
        found = examined(seen(double))
        assert keys(found) == ["doubled_rows"]
        assert len(found.observations) == len(columns[FORCE[0]])


def test_raw_rows_of_poses_become_poses():
    """Twelve poses of 200 rows, and one that was averaged before: thirteen rows, with their counts."""
    rng = np.random.default_rng(3)
    turn = Rotation.random(13, random_state=5)
    many = Rotation.from_quat(np.concatenate([np.repeat(turn.as_quat()[:12], 200, axis=0), turn.as_quat()[12:]]))
    found = examined(seen(reading(many, rng, G)))
    assert keys(found) == ["pose_rows"]
    assert found.remarks[0].action is Action.REPAIRED
    assert len(found.observations) == 13
    assert found.observations.columns["covariate.samples"].tolist() == [200.0] * 12 + [1.0]


def test_raw_rows_of_every_pose_are_how_such_recordings_are_and_no_mistake():
    """They are poses for all that, whether repairs are wanted or not."""
    turn = Rotation.random(12, random_state=5)
    many = seen(reading(Rotation.from_quat(np.repeat(turn.as_quat(), 50, axis=0)), np.random.default_rng(3), G))
    for found in (examined(many), examined(many, repair=False)):
        assert [(r.premise, r.action) for r in found.remarks] == [("pose_rows", Action.NOTE)]
        assert len(found.observations) == 12


def test_raw_rows_with_the_stamp_of_their_pose_become_poses():
    """The clock of a sweep says when the pose was held, not when a row was read."""
    turn = Rotation.random(13, random_state=5)
    many = Rotation.from_quat(np.concatenate([np.repeat(turn.as_quat()[:3], 40, axis=0), turn.as_quat()[3:]]))
    columns = reading(many, np.random.default_rng(3), G) | {
        "time": np.array([*np.repeat([0.0, 6.0, 12.0], 40), *np.arange(18.0, 78.0, 6.0)])
    }
    found = examined(seen(columns))
    assert keys(found) == ["pose_rows"]
    assert found.observations.columns["time"].tolist() == np.arange(0.0, 78.0, 6.0).tolist()


def test_two_topics_on_rows_of_their_own_are_joined():
    """Orientations at 25 Hz between wrenches at 25 Hz."""
    columns = moving()
    odd = np.arange(1500) % 2 == 1
    spoilt = {n: np.where(odd, v, np.nan) if n in QUATERNION else np.where(odd, np.nan, v) for n, v in columns.items()}
    spoilt["time"] = columns["time"]
    found = examined(seen(spoilt))
    assert keys(found) == ["outer_join"]
    back = matrix(dict(found.observations.columns), QUATERNION)[1:]
    assert np.allclose(back, matrix(columns, QUATERNION)[2::2], atol=2e-3)


def test_a_staircase_is_interpolated():
    """An orientation that came at a quarter of the wrench's rate."""
    columns = moving()
    held = (np.arange(1500) // 4) * 4
    found = examined(seen(columns | {n: columns[n][held] for n in QUATERNION}))
    assert keys(found) == ["staircase"]
    n = len(found.observations)
    assert np.allclose(matrix(dict(found.observations.columns), QUATERNION), matrix(columns, QUATERNION)[:n], atol=1e-3)


@pytest.mark.parametrize("late", [0, 1])
def test_rows_that_repeat_a_reading_are_left_out(late):
    """A wrench at a tenth of the joints' rate, some a row early or late; also where the orientation is slow as well."""
    columns, rng = moving(), np.random.default_rng(4)
    fresh = np.arange(150) * 10 + rng.integers(-late, late + 1, 150) * (np.arange(150) > 0)
    at = np.searchsorted(fresh, np.arange(1500), side="right") - 1
    names = [n for n in columns if n.startswith("wrench.")]
    held = {n: columns[n][fresh[at]] for n in names}
    found = examined(seen(columns | held))
    assert keys(found) == ["slow_readings"]
    assert np.array_equal(found.observations.columns["time"], columns["time"][fresh])
    assert np.array_equal(matrix(dict(found.observations.columns), names), matrix(columns, names)[fresh])
    slower = np.clip((np.arange(1500) - 5) // 20 * 20 + 5, 0, None)
    both = examined(seen(columns | held | {n: columns[n][slower] for n in QUATERNION}))
    assert keys(both)[:2] == ["slow_readings", "staircase"]


def test_readings_that_wait_for_the_next_step_of_their_grid_are_no_slower_sensor():
    """A wrench in steps of its fifty reading, without noise, of a tool that turns evenly; and one that rests now and then."""
    columns = moving()
    names = [n for n in columns if n.startswith("wrench.")]
    turning = np.linspace(0.0, 0.4, 1500)
    coarse = {n: np.round((1.0 + 0.1 * k) * turning * 750.0) / 750.0 for k, n in enumerate(names)}
    resting = {n: columns[n][np.minimum(np.arange(1500) % 60, 30) + np.arange(1500) // 60 * 60] for n in names}
    for readings in (coarse, resting):
        assert "slow_readings" not in keys(examined(seen(columns | readings)))


def joints(n: int = 4000) -> Observations:
    """Two joints without a robot, efforts compared."""
    t = np.arange(n) / 100.0
    columns = {"time": t}
    for k, name in enumerate(("a", "b")):
        q = (2.0 + k) * np.sin((0.7 + 0.3 * k) * t)
        columns |= {f"joint.{name}.position": q, f"joint.{name}.velocity": np.gradient(q, t)}
        columns[f"joint.{name}.effort"] = np.sin(q) + 0.01 * np.random.default_rng(k).normal(size=n)
    simulation = {f"joint.{name}.effort": np.sin(columns[f"joint.{name}.position"]) for name in ("a", "b")}
    return Observations("effort", columns, simulation, Belief(bias_free=True))


@pytest.mark.parametrize(
    ("spoil", "says"),
    [
        (lambda v: 0.0 * v, "all zero"),
        (lambda v: -v, "opposite sign"),
        (np.degrees, "57.3 times"),
        (lambda v: np.random.default_rng(1).normal(size=len(v)), "not the change"),
    ],
)
def test_velocities_that_contradict_positions_are_left_out(spoil, says):
    """One joint's; the other's stay."""
    one = joints()
    columns = dict(one.columns) | {"joint.a.velocity": spoil(one.columns["joint.a.velocity"])}
    found = examined(replace(one, columns=columns))
    assert keys(found) == ["velocity_columns"]
    assert says in found.remarks[0].what
    assert "joint.a.velocity" not in found.observations.columns
    assert "joint.b.velocity" in found.observations.columns


def test_a_clock_that_runs_at_another_rate_than_the_motion_is_named():
    """All joints agree on the factor."""
    one = joints()
    found = examined(replace(one, columns=dict(one.columns) | {"time": 1.3 * one.columns["time"]}))
    assert keys(found) == ["clock_rate"]
    assert np.allclose(found.observations.columns["time"], one.columns["time"], rtol=0.01)


def test_wrapped_angles_are_unwrapped():
    """Beyond half a turn; to the last bit but rounding."""
    one = joints()
    q = one.columns["joint.b.position"] + 2.0
    wrapped = (q + np.pi) % (2.0 * np.pi) - np.pi
    found = examined(replace(one, columns=dict(one.columns) | {"joint.b.position": wrapped}))
    assert keys(found) == ["wrapped_joints"]
    assert np.allclose(np.diff(found.observations.columns["joint.b.position"]), np.diff(q))


@pytest.mark.parametrize("kind", ["sign and magnitude", "two's complement"])
def test_unsigned_integers_get_their_sign(kind):
    """Counts of 0.004, the sign in bit 10."""
    one = joints()
    true = np.round(one.columns["joint.a.effort"] / 0.004) * 0.004
    bit = 0.004 * 1024
    spoilt = np.where(true < 0.0, bit - true if kind == "sign and magnitude" else 2.0 * bit + true, true)
    found = examined(replace(one, columns=dict(one.columns) | {"joint.a.effort": spoilt}))
    assert keys(found) == ["unsigned_integers"]
    assert kind in found.remarks[0].what
    assert np.allclose(found.observations.columns["joint.a.effort"], true)


def test_folded_numbers_that_are_no_counts_are_refused():
    """Floats taken modulo 65.536 in both joints: what was folded is seen, at which number is not known to the last digit."""
    one = joints()
    columns = dict(one.columns) | {n: v % 65.536 for n, v in one.columns.items() if n.endswith(".effort")}
    (remark,) = examined(replace(one, columns=columns)).remarks
    assert remark.action is Action.REFUSED
    assert "unsigned" in remark.what


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_an_effort_with_the_other_sign_is_turned(sign):
    """Against the simulation; with the right sign nothing is said."""
    one = joints()
    found = examined(replace(one, columns=dict(one.columns) | {"joint.a.effort": sign * one.columns["joint.a.effort"]}))
    assert keys(found) == ([] if sign > 0.0 else ["joint_signs"])


# Load and zeroing


def test_a_part_that_was_picked_up_is_found_with_its_moment():
    """0.15 kg from 12 s on, within 2 g and two rows; put away again from the recording."""
    columns = moving()
    late = columns["time"] >= 12.0
    original = dict(columns)
    turn = Rotation.from_quat(matrix(columns, QUATERNION))
    extra = 0.15 * turn.inv().apply(np.tile(G, (1500, 1)))
    moment = np.cross([0.0, 0.02, 0.1], extra)
    columns |= {n: columns[n] + late * extra[:, k] for k, n in enumerate(FORCE)}
    columns |= {n: columns[n] + late * moment[:, k] for k, n in enumerate(TORQUE)}
    found = examined(seen(columns, named=True))
    (claim,) = found.claims
    assert claim.effect == "payload"
    assert claim.parameters["mass"][0] == pytest.approx(0.15, abs=0.002)
    assert claim.parameters["moment"][0] == pytest.approx(12.0, abs=0.041)
    left = matrix(dict(found.observations.columns), FORCE) - matrix(original, FORCE)
    assert np.sqrt(np.mean(left**2)) < 0.02


@pytest.mark.parametrize("hangs", [1, 2])
def test_a_tool_that_is_a_link_of_the_model_too_is_counted_once(hangs):
    """Where the wrench holds one of them; two that hang there are two."""
    columns = static(40)
    columns |= {n: hangs * columns[n] for n in FORCE + TORQUE}
    found = examined(seen(columns, named=True, distal=(Body(MASS, COM + 1e-4),)))
    assert keys(found) == ["tool_twice"] * (hangs == 1)
    assert len(found.observations.belief.distal) == hangs - 1


def test_a_sensor_zeroed_anew_between_poses_is_refused_with_the_pose():
    """Its offset jumps; two fits stand on either side."""
    columns = static(40)
    late = np.arange(40) >= 22
    columns |= {
        n: columns[n] + late * v for n, v in zip(FORCE + TORQUE, (2.0, -1.0, 3.0, 0.05, 0.0, 0.02), strict=True)
    }
    (remark,) = examined(seen(columns)).refused
    assert "zeroed anew before pose 23" in remark.what


def test_a_tool_changed_between_poses_is_refused_with_the_pose():
    """Half the weight from some pose on."""
    columns = static(40)
    turn = Rotation.from_quat(matrix(columns, QUATERNION))
    less = -0.4 * turn.inv().apply(np.tile(G, (40, 1)))
    late = np.arange(40) >= 15
    columns |= {n: columns[n] + late * less[:, k] for k, n in enumerate(FORCE)}
    columns |= {n: columns[n] + late * np.cross(COM, less)[:, k] for k, n in enumerate(TORQUE)}
    (remark,) = examined(seen(columns)).refused
    assert "before pose 16" in remark.what
    assert "the load changes by -0.39" in remark.what or "-0.40" in remark.what


@pytest.mark.parametrize("shape", ["drift", "step"])
def test_an_offset_that_drifts_or_jumps_in_a_motion_is_left_to_the_search(shape):
    """A drift is no load, and a step of the offset has a name of its own."""
    columns = moving()
    t = columns["time"]
    columns[FORCE[2]] = columns[FORCE[2]] + (0.1 * t if shape == "drift" else 2.0 * (t > 11.0))
    found = examined(seen(columns, named=True))
    assert [r.action for r in found.remarks] == ([] if shape == "drift" else [Action.NOTE])
    assert found.observations.columns is columns


# Rotations


@given(st.integers(0, 47))
def test_axes_read_as_they_are_written(which):
    """Rows say from which axis each comes."""
    P = signed_permutations()[which]
    nearest, away = nearest_axes(P)
    assert np.array_equal(nearest, P)
    assert away < 1e-6
    assert as_axes(np.diag([-1.0, 1.0, 1.0])) == "x, y, z read like -x, y, z"


@given(st.integers(0, 1000), st.floats(0.1, 10.0), st.sampled_from([1, -1]))
def test_procrustes_recovers_scale_and_axes_of_either_hand(seed, scale, hand):
    """Exactly, without noise."""
    rng = np.random.default_rng(seed)
    Q = Rotation.random(random_state=seed).as_matrix() @ np.diag([1.0, 1.0, hand])
    x = rng.normal(size=(20, 3))
    found = similarity(x, scale * x @ Q.T + rng.normal(size=3))
    assert found.scale == pytest.approx(scale)
    assert np.allclose(found.Q, Q)
    assert found.unexplained < 1e-12


def test_a_turn_is_said_by_axis_and_angle():
    """Degrees about the nearest axis, or about a vector."""
    assert as_turn(Rotation.from_euler("z", 0.785398).as_matrix()) == "45.0 deg about z"
    assert as_turn(Rotation.from_rotvec([0.6, 0.8, 0.0]).as_matrix()) == "57.3 deg about (0.60, 0.80, 0.00)"


@pytest.mark.parametrize(("unit", "factor"), [("degrees", 180.0 / np.pi), ("revolutions", 0.5 / np.pi)])
def test_positions_in_another_unit_than_their_simulation_are_repaired(unit, factor):
    """No robot is known: only the simulation says how far the joints went."""
    one = joints()
    columns = {n: v for n, v in one.columns.items() if not n.endswith(".effort")}
    simulation = {n: v for n, v in columns.items() if n.endswith(".position")}
    spoilt = {n: v if n == "time" else factor * v for n, v in columns.items()}
    found = examined(Observations("position", spoilt, simulation, Belief(bias_free=True)))
    assert keys(found) == ["position_units"]
    assert f"in {unit}" in found.remarks[0].what
    assert found.observations.columns["joint.a.velocity"] == pytest.approx(columns["joint.a.velocity"])


@pytest.mark.parametrize("make", [static, moving])
@pytest.mark.parametrize("named", [True, False])
def test_a_force_in_the_torques_columns_is_put_right(make: Callable[[], Columns], *, named: bool):
    """The order of spatial vectors: the moment first."""
    original = make()
    f, t = matrix(original, FORCE), matrix(original, TORQUE)
    found = examined(seen(original | dict(zip(FORCE + TORQUE, (*t.T, *f.T), strict=True)), named=named))
    assert keys(found) == ["wrench_frames"]
    assert "force and torque are exchanged" in found.remarks[0].what
    assert np.array_equal(matrix(dict(found.observations.columns), FORCE), f)


@pytest.mark.parametrize(("rows", "side"), [(1, "late"), (-1, "early")])
def test_a_wrench_beside_the_next_pose_is_refused(rows: int, side: str):
    """Two lists of which one begins at 0 and the other at 1."""
    original = static()
    wrench = np.roll(matrix(original, FORCE + TORQUE), rows, axis=0)
    found = examined(seen(original | dict(zip(FORCE + TORQUE, wrench.T, strict=True))))
    assert [r.action for r in found.remarks] == [Action.REFUSED]
    assert f"what is compared comes 1 row {side}" in found.remarks[0].what

"""Rows that do not belong together, columns that hold something else, and mistakes of one run or one target alone."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from galen_hw.physics.effects.registry import scene_of
from galen_hw.physics.observations import Belief, Observations
from galen_hw.premises import Action, examined
from galen_hw.premises.rotations import signed_permutations
from tests.test_premises import FORCE, TORQUE, keys, matrix, moving, seen, static
from tests.test_premises_efforts import arm
from tests.test_premises_lost_readings import efforts, motion
from tests.test_premises_streams import PLACE, tracked, with_place


def changed(one: Observations, columns: dict[str, np.ndarray]) -> Observations:
    return replace(one, columns=dict(one.columns) | columns)


# Orders of rows


def test_a_stream_that_runs_backwards_is_refused() -> None:
    """The newest first, beside joints whose oldest came first."""
    one = tracked()
    (found,) = examined(with_place(one, one.matrix(*PLACE)[::-1])).refused
    assert found.premise == "row_match"
    assert "from the last row to the first" in found.what


@pytest.mark.parametrize("late", [0.0, 0.3, 1.0])
def test_a_stream_that_is_late_runs_forward(late: float) -> None:
    assert "row_match" not in keys(examined(tracked(late)))


@pytest.mark.parametrize("named", [False, True])
@pytest.mark.parametrize("down", [False, True])
def test_a_column_that_was_sorted_by_itself_is_refused(named: bool, down: bool) -> None:
    columns = static(60)
    columns["wrench.force.z"] = np.sort(columns["wrench.force.z"])[:: -1 if down else 1]
    refused = [r for r in examined(seen(columns, named=named)).refused if r.premise == "row_match"]
    (found,) = refused
    assert found.columns == ("wrench.force.z",)
    assert f"the {'largest' if down else 'smallest'} first" in found.what


@settings(max_examples=15, deadline=None)
@given(st.integers(6, 40), st.sampled_from([-2, -1, 1, 2]))
def test_a_line_that_was_lost_in_one_of_two_files_is_refused(first: int, by: int) -> None:
    """From that pose on each wrench stands beside another pose; at which one, to within two."""
    columns = static(60)
    wrench = matrix(columns, FORCE + TORQUE)
    moved = np.concatenate([wrench[:first], np.roll(wrench, by, axis=0)[first:]])
    found = examined(seen(columns | dict(zip(FORCE + TORQUE, moved.T, strict=True)), named=True))
    (one,) = [r for r in found.refused if r.premise == "row_match"]
    assert f"{abs(by)} row{'s' if abs(by) > 1 else ''} {'late' if by > 0 else 'early'}" in one.what
    told = int(one.what.split("from row ")[1].split(" ")[0].rstrip(":")) if "from row" in one.what else 0
    assert abs(told - first) <= 3


@pytest.mark.parametrize("written", ["rows", "columns"])
def test_vectors_in_another_order_of_memory_are_refused(written: str) -> None:
    """As numpy's `reshape` does where `.T` was meant, and the other way round."""
    columns = static(60)
    f = matrix(columns, FORCE)
    wrong = f.ravel().reshape(3, -1).T if written == "rows" else f.T.ravel().reshape(-1, 3)
    found = examined(seen(columns | dict(zip(FORCE, wrong.T, strict=True)), named=True))
    assert [(r.premise, r.columns) for r in found.refused][:1] == [("row_match", tuple(FORCE))]


# Columns that hold something else


@pytest.mark.parametrize("how", ["mean and deviation", "range", "both ways"])
def test_columns_scaled_for_machine_learning_are_refused(how: str) -> None:
    one = efforts(*reversed(motion()))
    names = [n for n in one.columns if n.endswith(".effort")]

    def scaled(x: np.ndarray) -> np.ndarray:
        if how == "mean and deviation":
            return (x - x.mean()) / x.std()
        share = (x - x.min()) / np.ptp(x)
        return share if how == "range" else 2.0 * share - 1.0

    (found,) = examined(changed(one, {n: scaled(one.columns[n]) for n in names})).refused
    assert found.premise == "standardised"
    assert found.columns == tuple(names)


def commanded(by: str) -> Observations:
    """Two servos that follow within 20 ms what they are told: a position, or a speed that the log calls one."""
    t = np.arange(3000) / 50.0
    columns = {"time": t}
    for k, name in enumerate(("pan", "tilt")):
        w = 0.5 + 0.2 * k
        told = np.sin(w * t + k) if by == "position" else w * np.cos(w * t + k)
        columns |= {
            f"joint.{name}.command": told,
            f"joint.{name}.position": np.round(np.sin(w * (t - 0.02) + k) * 651.9) / 651.9,
        }
    return Observations("position", columns, None, Belief(bias_free=True))


def test_commands_that_are_speeds_are_refused() -> None:
    (found,) = examined(commanded("speed")).refused
    assert found.premise == "commanded_rates"
    assert found.columns == ("joint.pan.command", "joint.tilt.command")
    assert "commanded_rates" not in keys(examined(commanded("position")))


def test_a_simulation_that_ends_before_the_recording_is_asked_as_far_as_it_goes() -> None:
    """Rows beyond its end have no value; a joint's motion is then the simulated one."""
    one = commanded("position")
    simulated = {n: one.columns[n.replace("position", "command")].copy() for n in one.columns if n.endswith("position")}
    for values in simulated.values():
        values[-40:] = np.nan
    assert not examined(replace(one, simulation=simulated)).refused
    backwards = {n: values[-41::-1] for n, values in simulated.items()}
    padded = {n: np.append(values, np.full(40, np.nan)) for n, values in backwards.items()}
    assert [r.premise for r in examined(replace(one, simulation=padded)).refused] == ["row_match"]


def test_positions_exported_twice_are_refused_where_a_speed_belies_them() -> None:
    t, q = motion()
    one = efforts(q, t)
    first, second = one.joint_names[1:3]
    speed = {f"joint.{second}.velocity": np.gradient(q[:, 2], t)}
    copied = changed(one, {f"joint.{second}.position": q[:, 1]})
    assert "copied_positions" in [r.premise for r in examined(changed(copied, speed)).refused]
    # Without a speed, or with the right one, it may be a gantry's second motor.
    alike = {f"joint.{n}.velocity": np.gradient(q[:, 1], t) for n in (first, second)}
    for one_of in (copied, changed(copied, alike)):
        assert "copied_positions" not in keys(examined(one_of))


# One run, one target, one group alone


def test_a_run_in_other_units_is_named_alone() -> None:
    """Half of the recording in degrees: no reading of all rows is right."""
    t, q = motion()
    whole = efforts(q, t, friction=0.2)
    run = (np.arange(len(t)) >= len(t) // 2).astype(float)
    names = [n for n in whole.columns if n.endswith(".position")]
    degrees = {n: np.where(run > 0.0, np.degrees(whole.columns[n]), whole.columns[n]) for n in names}
    assert not examined(changed(whole, {"segment": run})).refused
    (found,) = examined(changed(whole, degrees | {"segment": run})).refused
    assert found.what.startswith(f"segment 1 (rows {len(t) // 2} to {len(t) - 1}) alone: ")


def test_efforts_exchanged_in_one_run_are_told_there_and_refuse_the_whole() -> None:
    t, q = motion()
    whole = efforts(q, t, friction=0.2)
    run = (np.arange(len(t)) >= len(t) // 2).astype(float)
    one, other = (f"joint.{n}.effort" for n in whole.joint_names[1:3])
    swapped = {a: np.where(run > 0.0, whole.columns[b], whole.columns[a]) for a, b in ((one, other), (other, one))}
    (found,) = examined(changed(whole, swapped | {"segment": run})).refused
    assert found.premise == "joint_reading"
    assert found.what.startswith("segment 1")
    assert {one, other} <= set(found.columns)


def test_a_run_of_poses_in_axes_of_the_base_is_told() -> None:
    columns = static(60)
    turn = Rotation.from_quat(np.stack([columns[f"sensor.orientation.{a}"] for a in "xyzw"], axis=1))
    for names in (FORCE, TORQUE):
        new = np.where(np.arange(60)[:, None] >= 33, turn.apply(matrix(columns, names)), matrix(columns, names))
        columns |= dict(zip(names, new.T, strict=True))
    columns["segment"] = (np.arange(60) >= 33).astype(float)
    (found,) = examined(seen(columns, named=True)).refused
    assert found.premise == "wrench_frames"
    assert found.what == "segment 1 (rows 33 to 59) alone: the wrench is in axes of the base"


def test_a_torque_in_the_base_beside_a_force_in_the_sensor_is_turned() -> None:
    """With a load that the model lacks: neither weight nor lever is what it says."""
    columns = static(60)
    turn = Rotation.from_quat(np.stack([columns[f"sensor.orientation.{a}"] for a in "xyzw"], axis=1))
    torque = matrix(columns, TORQUE)
    wrong = columns | dict(zip(TORQUE, turn.apply(torque).T, strict=True))
    found = examined(seen(wrong, named=True))
    assert [(r.premise, r.action) for r in found.remarks] == [("wrench_frames", Action.REPAIRED)]
    assert found.observations.matrix(*TORQUE) == pytest.approx(torque)


def targets(which: int, axes: np.ndarray, wobble: float = 0.0) -> Observations:
    """Three points of a moving body, the last of which is in axes of its own, or loose by so much, m."""
    t = np.arange(600) / 60.0
    turn = Rotation.from_euler("xyz", np.stack([np.sin(t), 0.6 * np.sin(0.7 * t), np.cos(0.5 * t)], axis=1))
    place = np.stack([0.3 * np.sin(0.9 * t), 0.2 * np.cos(t), 1.0 + 0.1 * np.sin(0.4 * t)], axis=1)
    rng, columns = np.random.default_rng(1), {"time": t}
    for k, point in enumerate(([0.05, 0.0, 0.02], [-0.04, 0.06, 0.0], [0.0, -0.05, 0.03])):
        at = place + turn.apply(point) + 3e-4 * rng.normal(size=place.shape)
        at = at @ axes + wobble * np.sin(3.0 * t)[:, None] if k == which else at
        columns |= {f"target.{k + 1}.position.{a}": x for a, x in zip("xyz", at.T, strict=True)}
    return Observations("targets", columns, None, Belief())


@pytest.mark.parametrize("which", [0, 1, 2])
def test_one_target_in_other_axes_is_named(which: int) -> None:
    (found,) = [r for r in examined(targets(which, signed_permutations()[11])).refused if r.premise == "rigid_targets"]
    assert found.columns == tuple(f"target.{which + 1}.position.{a}" for a in "xyz")
    assert "in other axes" in found.what


def test_a_loose_target_is_named_and_rigid_ones_are_not() -> None:
    (found,) = [r for r in examined(targets(2, np.eye(3), 0.02)).refused if r.premise == "rigid_targets"]
    assert "in other axes" not in found.what
    assert "another body" in found.todo
    assert "rigid_targets" not in keys(examined(targets(2, np.eye(3))))


@pytest.mark.parametrize("frame", ["tip", "base"])
def test_a_push_in_the_axes_of_the_tip_is_turned(frame: str) -> None:
    """Joints that give by amounts that nobody knows; the arm's own weight bends them too."""
    machine, rng = arm(load=0.0), np.random.default_rng(2)
    q = np.repeat(rng.uniform(-1.0, 1.0, size=(30, 4)), 10, axis=0)
    force = rng.uniform(-40.0, 40.0, size=(300, 3))
    belief = Belief(robot=machine, compliance={"turn": 4e-4, "shoulder": 2e-4, "elbow": 3e-4, "roll": 5e-4})
    columns = {f"joint.{n}.position": x for n, x in zip(machine.joint_names, q.T, strict=True)}
    columns |= {f"applied.force.{a}": f for a, f in zip("xyz", force.T, strict=True)}
    columns |= {name: np.zeros(300) for name in PLACE}
    true = scene_of(Observations("pose", columns, None, belief)).simulated[:, :3]
    one = Observations("pose", columns, None, Belief(robot=machine))
    one = with_place(one, true + 2e-5 * rng.normal(size=true.shape))
    R = machine.sensor_pose(q)[:, :3, :3]
    read = np.einsum("nji,nj->ni", R, force) if frame == "tip" else force
    found = examined(changed(one, {f"applied.force.{a}": f for a, f in zip("xyz", read.T, strict=True)}))
    assert [r.premise for r in found.remarks] == (["push_axes"] if frame == "tip" else [])
    assert found.observations.matrix(*(f"applied.force.{a}" for a in "xyz")) == pytest.approx(force)


def test_a_channel_that_is_stuck_for_a_while_in_one_run_does_not_refuse_the_others() -> None:
    """It is as long as a fiftieth of that run and not of the whole: not measured, and nothing is read otherwise."""
    columns = moving(6000)
    run = np.repeat(np.arange(4.0), 1500)
    stuck = columns["wrench.force.x"].copy()
    stuck[3300:3360] = stuck[3300]
    found = examined(seen(columns | {"wrench.force.x": stuck, "segment": run}, named=True))
    assert not found.refused

"""What loggers and tables write in the place of readings: means, zeros, commands, columns in an order of their own."""

from dataclasses import replace
from itertools import permutations

import numpy as np
import pytest

from galen_hw.physics.observations import Belief, Observations
from galen_hw.premises import Action, examined
from tests.test_premises import FORCE, TORQUE, keys, matrix, moving, seen, static
from tests.test_premises_lost_readings import efforts, motion
from tests.test_premises_rows import changed, commanded
from tests.test_premises_streams import PLACE, tracked, with_place


def test_rows_that_were_filled_with_the_mean_are_not_measured() -> None:
    """As `fillna(df.mean())` does; a reading that a device keeps while it stands is one."""
    columns, rows = moving(), np.r_[40:44, 300, 500:512, 700, 901:903, 1200, 1300:1306]
    at = np.arange(1500)
    filled = {n: np.where(np.isin(at, rows), columns[n].mean(), columns[n]) for n in FORCE + TORQUE}
    found = examined(seen(columns | filled, named=True))
    assert [(r.premise, r.action) for r in found.remarks] == [("blank_samples", Action.REPAIRED)]
    assert np.flatnonzero(np.isnan(found.observations.columns[FORCE[0]])).tolist() == rows.tolist()
    held = {n: np.where((at > 900) & (at < 960), columns[n][900], columns[n]) for n in FORCE + TORQUE}
    assert "blank_samples" not in keys(examined(seen(columns | held, named=True)))


def test_small_readings_that_were_set_to_zero_are_not_measured() -> None:
    columns = moving()
    for name in FORCE + TORQUE:
        columns[name] = columns[name] - columns[name].mean()
        band = 0.3 * columns[name].std()
        columns[name] = np.where(np.abs(columns[name]) < band, 0.0, columns[name])
    found = examined(seen(columns, named=True))
    (one,) = [r for r in found.remarks if r.premise == "dead_band"]
    assert one.action is Action.REPAIRED
    assert not np.any(found.observations.matrix(*one.columns) == 0.0)


@pytest.mark.parametrize("step", [0.0, 0.02, 0.5])
def test_readings_in_steps_have_no_dead_band(step: float) -> None:
    columns = moving()
    for name in FORCE:
        columns[name] = columns[name] - columns[name].mean()
        columns[name] = np.round(columns[name] / step) * step if step else columns[name]
    assert "dead_band" not in keys(examined(seen(columns, named=True)))


def reported(values: np.ndarray, band: float) -> np.ndarray:
    """Keep the last value (N,) until a reading differs from it by a dead band."""
    out, last = [], np.inf
    for value in values:
        last = value if abs(value - last) >= band else last
        out.append(last)
    return np.array(out)


def test_readings_that_were_reported_by_exception_are_refused() -> None:
    columns = moving()
    kept = {n: np.round(reported(columns[n], 0.3 * columns[n].std()), 4) for n in FORCE + TORQUE}
    (found,) = examined(seen(columns | kept, named=True)).refused
    assert found.premise == "reported_on_change"
    assert set(found.columns) == set(FORCE + TORQUE)


@pytest.mark.parametrize("rows", [1, 4])
@pytest.mark.parametrize("step", [0.0, 0.02, 0.5])
def test_readings_in_steps_or_held_for_some_rows_were_not_reported_by_exception(step: float, rows: int) -> None:
    columns = moving()
    for name in FORCE + TORQUE:
        held = columns[name][np.arange(1500) // rows * rows]
        columns[name] = np.round(held / step) * step if step else held
    assert "reported_on_change" not in keys(examined(seen(columns, named=True)))


def test_runs_that_were_tared_by_their_own_means_are_refused() -> None:
    columns = moving()
    run = np.repeat(np.arange(3.0), 500)
    tared = {
        n: columns[n] - np.array([columns[n][run == k].mean() for k in range(3)])[run.astype(int)]
        for n in FORCE + TORQUE
    }
    (found,) = examined(seen(columns | tared | {"segment": run}, named=True)).refused
    assert found.premise == "run_means"
    assert not examined(seen(columns | {"segment": run}, named=True)).refused


@pytest.mark.parametrize("order", [o for o in permutations(range(4)) if sum(k != at for at, k in enumerate(o)) > 2])
def test_efforts_in_any_other_order_are_refused(order: tuple[int, ...]) -> None:
    """As of names that were sorted; two that are exchanged have a test of their own."""
    t, q = motion()
    one = efforts(q, t, friction=0.2)
    names = [f"joint.{n}.effort" for n in one.joint_names]
    found = examined(changed(one, dict(zip(names, (one.columns[names[k]] for k in order), strict=True))))
    assert "joint_reading" in [r.premise for r in found.refused]
    moved = {names[k] for k in range(4) if order[k] != k}
    assert moved <= {name for r in found.refused for name in r.columns}


@pytest.mark.parametrize(("first", "then"), [(0.0, 0.24), (0.05, -0.15)])
def test_a_clock_that_was_set_in_the_midst_is_refused_with_both_delays(first: float, then: float) -> None:
    before, after = tracked(first), tracked(then)
    place = np.where(before.columns["time"][:, None] < 33.3, before.matrix(*PLACE), after.matrix(*PLACE))
    (found,) = examined(with_place(before, place)).refused
    assert found.premise == "apart_clocks"
    words = found.what.split("late by ")[1].split()
    assert float(words[0]) == pytest.approx(1e3 * first, abs=2.0)
    assert float(words[3]) == pytest.approx(33.3, abs=0.3)
    assert float(words[found.what.split("late by ")[1].split().index("from") - 2]) == pytest.approx(1e3 * then, abs=2.0)


@pytest.mark.parametrize("share", [0.15, 0.23])
def test_poses_averaged_from_before_the_arm_rested_are_refused(share: float) -> None:
    columns = static(60)
    wrench = matrix(columns, FORCE + TORQUE)
    mixed = np.concatenate([wrench[:1], (1.0 - share) * wrench[1:] + share * wrench[:-1]])
    (found,) = examined(seen(columns | dict(zip(FORCE + TORQUE, mixed.T, strict=True)), named=True)).refused
    assert found.premise == "row_match"
    assert f"{share:.0%} of the pose before" in found.what


def test_positions_that_are_the_commands_are_said() -> None:
    one = tracked()
    told = {n.replace(".position", ".command"): x for n, x in one.columns.items() if n.startswith("joint.")}
    (found,) = [r for r in examined(changed(one, told)).remarks if r.premise == "copied_commands"]
    assert found.action is Action.NOTE
    measured = {n: np.round(x, 4) for n, x in one.columns.items() if n.startswith("joint.")}
    assert "copied_commands" not in keys(examined(changed(one, told | measured)))


def test_a_command_exported_twice_is_refused_where_a_joint_does_not_follow_it() -> None:
    one = commanded("position")
    copied = changed(one, {"joint.tilt.command": one.columns["joint.pan.command"]})
    (found,) = examined(copied).refused
    assert found.premise == "copied_commands"
    both = changed(copied, {"joint.tilt.position": one.columns["joint.pan.position"]})
    assert "copied_commands" not in keys(examined(both))


def test_the_replaced_recording_is_not_changed() -> None:
    """A repair is made in memory, of another object."""
    columns = moving()
    columns["wrench.force.x"] = np.where(np.abs(columns["wrench.force.x"]) < 3.5, 0.0, columns["wrench.force.x"])
    one = seen(columns, named=True)
    before = {name: values.copy() for name, values in one.columns.items()}
    examined(one)
    assert all(np.array_equal(one.columns[name], values) for name, values in before.items())
    assert isinstance(replace(one, belief=Belief()), Observations)

"""Two streams that were not sampled alike: clocks that run apart, smoothing of one, bursts; and cells without their point."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import uniform_filter1d
from scipy.signal import butter, filtfilt, lfilter
from scipy.spatial.transform import Rotation

from galen_hw.physics.effects.load import Payload
from galen_hw.physics.effects.registry import scene_of
from galen_hw.physics.observations import Belief, Observations
from galen_hw.premises import Action, examined
from galen_hw.premises.points import DecimalPoints
from galen_hw.premises.streams import ApartClocks, SmoothedStream
from tests.test_premises_efforts import G, arm
from tests.test_premises_lost_readings import efforts, motion

PLACE = [f"pose.position.{a}" for a in "xyz"]


def tracked(late: float = 0.0, apart: float = 0.0, noise: float = 1e-4, rate: float = 100.0) -> Observations:
    """A tip on a tracker's clock that is late, s, and runs apart by a share, for a minute."""
    machine, t = arm(load=0.5), np.arange(int(60.0 * rate)) / rate

    def at(time: np.ndarray) -> np.ndarray:
        return 0.6 * np.stack(
            [np.sin((1.1 + 0.37 * k) * time + k) + 0.2 * np.sin(5.3 * time) for k in range(4)], axis=1
        )

    place = machine.sensor_pose(at(t * (1.0 - apart) - late))[:, :3, 3]
    place = place + noise * np.random.default_rng(0).normal(size=place.shape)
    columns = {"time": t} | {f"joint.{n}.position": q for n, q in zip(machine.joint_names, at(t).T, strict=True)}
    return Observations("pose", columns | dict(zip(PLACE, place.T, strict=True)), None, Belief(robot=machine))


def with_place(seen: Observations, place: np.ndarray) -> Observations:
    return replace(seen, columns=dict(seen.columns) | dict(zip(PLACE, place.T, strict=True)))


@pytest.mark.parametrize(("late", "apart"), [(0.0, 1e-3), (0.05, -2e-3), (-0.1, 5e-4)])
def test_clocks_that_run_apart_are_refused_with_both_ends(late: float, apart: float) -> None:
    (found,) = examined(tracked(late, apart)).refused
    assert found.premise == "apart_clocks"
    ends = [
        float(part.split(" ms")[0])
        for part in found.what.split("late by ")[1].replace("by ", "").split(" at first and ")
    ]
    assert ends == pytest.approx([1e3 * late, 1e3 * (late + 60.0 * apart)], abs=1.0)


@pytest.mark.parametrize("late", [0.0, 0.08])
def test_a_delay_and_a_filter_are_left_to_the_search(late: float) -> None:
    """Neither clock nor smoothing: one is the same all along, the other is late where it is smooth."""
    seen = tracked(late)
    lagged = lfilter([0.2], [1.0, -0.8], seen.matrix(*PLACE) - seen.matrix(*PLACE)[0], axis=0) + seen.matrix(*PLACE)[0]
    for one in (seen, with_place(seen, lagged)):
        assert not [*ApartClocks().examine(one), *SmoothedStream().examine(one)]


@pytest.mark.parametrize("how", ["forth and back", "mean"])
def test_what_was_smoothed_without_being_late_is_refused(how: str) -> None:
    seen = tracked()
    place = seen.matrix(*PLACE)
    smooth = (
        filtfilt(*butter(2, 2.0 / 50.0), place, axis=0)
        if how == "forth and back"
        else uniform_filter1d(place, 41, axis=0)
    )
    (found,) = examined(with_place(seen, smooth)).refused
    assert found.premise == "smoothed_stream"
    if how == "forth and back":
        assert float(found.what.split("low-pass of ")[1].split(" Hz")[0]) == pytest.approx(2.0, rel=0.05)


def test_a_wrench_late_by_blocks_is_spread_and_joints_stay_where_they_were_read() -> None:
    """Sixteen rows each 80 ms: stamps of the block's end; joints are those of the stamp."""
    t = np.arange(3200) / 200.0
    machine = arm(load=0.5)

    def at(time: np.ndarray) -> np.ndarray:
        return 0.5 * np.stack([np.sin((1.1 + 0.3 * k) * time + k) for k in range(4)], axis=1)

    rows = np.arange(len(t))
    stamp = t[rows // 16 * 16] + 0.08 + 1e-4 * (rows % 16)
    place = machine.sensor_pose(at(t))[:, :3, 3]
    columns = {"time": stamp} | {
        f"joint.{n}.position": q for n, q in zip(machine.joint_names, at(stamp).T, strict=True)
    }
    found = examined(
        Observations("pose", columns | dict(zip(PLACE, place.T, strict=True)), None, Belief(robot=machine))
    )
    (remark,) = found.remarks
    assert remark.action is Action.REPAIRED
    assert "in bursts 0.07" in remark.what
    new = found.observations.time
    assert np.diff(new) == pytest.approx(1.0 / 200.0, rel=1e-3)
    assert found.observations.columns["joint.turn.position"] == pytest.approx(at(new)[:, 0], abs=2e-3)


def test_points_that_a_spreadsheet_took_for_thousands_are_put_back() -> None:
    """Of 1.234 came 1234; what is below one and from ten on kept its point."""
    rng = np.random.default_rng(1)
    turn = Rotation.random(60, random_state=2)
    force = 1.4 * turn.inv().apply(np.tile(G, (60, 1))) + 0.01 * rng.normal(size=(60, 3))
    true = np.where(np.abs(force) < 10.0, np.round(force, 3), np.round(force, 2))
    lost = (np.abs(true) >= 1.0) & (np.abs(true) < 10.0)
    columns = {f"wrench.force.{a}": v for a, v in zip("xyz", np.where(lost, 1e3 * true, true).T, strict=True)}
    columns = {name: np.round(values, 3) for name, values in columns.items()}
    (found,) = DecimalPoints().examine(Observations("wrench", columns, None, Belief()))
    assert found.repaired is not None
    assert found.repaired.matrix(*columns) == pytest.approx(true, abs=1e-9)


def test_a_load_cell_of_kilonewtons_lost_no_points() -> None:
    """Whole newtons throughout, or large ones that go on where the others end."""
    force = np.linspace(-4000.0, 4000.0, 801)
    for values in (np.round(force), np.where(np.abs(force) < 1000.0, force + 0.123, np.round(force))):
        assert not list(DecimalPoints().examine(Observations("wrench", {"wrench.force.x": values}, None, Belief())))


@pytest.mark.parametrize("ways", [(1.0, -1.0), (1.0, 1.0)])
def test_two_zeros_a_quarter_off_are_put_right_beside_friction(ways: tuple[float, float]) -> None:
    """As a pendant counts an upright arm."""
    t, q = motion()
    seen = efforts(q, t, friction=0.8)
    names = [f"joint.{n}.position" for n in seen.joint_names[1:3]]
    off = {n: seen.columns[n] - way * np.pi / 2.0 for n, way in zip(names, ways, strict=True)}
    found = examined(replace(seen, columns=dict(seen.columns) | off))
    (remark,) = [one for one in found.remarks if one.premise == "joint_reading"]
    assert remark.columns == tuple(names)
    for name in names:
        assert found.observations.columns[name] == pytest.approx(seen.columns[name], abs=1e-9)


def test_no_link_is_lighter_than_nothing() -> None:
    """Of the arm's links and of what it carries; what a controller takes off may be more than the tool."""
    scene = scene_of(efforts(*motion()[::-1]))
    spread = np.full(4, 0.01)
    for joint in ("", scene.moved[1]):
        mass = scene.carried_mass(joint)
        assert mass > 0.0
        for share, real in ((-0.5, True), (-1.5, False)):
            theta = np.array([share * mass, 0.0, 0.0, 0.0])
            assert Payload("body", joint=joint).possible(scene, theta, spread) is real
    assert Payload("body", still=True).possible(scene, np.array([-9.0, 0.0, 0.0, 0.0]), spread)


def test_two_runs_merged_by_their_stamps_are_refused() -> None:
    """Rows alternate between two motions; a zigzag of one joint beside others that go on is none."""
    t, q = motion(3000)
    one, other = (efforts(q[part], t[:1500]) for part in (slice(0, 1500), slice(1500, 3000)))
    columns = {n: np.stack([one.columns[n], other.columns[n]], axis=1).ravel() for n in one.columns}
    columns["time"] = np.stack([t[:1500], t[:1500] + 0.004], axis=1).ravel()
    merged = replace(one, columns=columns)
    (found,) = examined(merged).refused
    assert found.premise == "interleaved_runs"
    zigzag = one.columns["joint.turn.position"] + 0.05 * np.where(np.arange(1500) % 2, 1.0, -1.0)
    seen = replace(one, columns=dict(one.columns) | {"joint.turn.position": zigzag})
    assert "interleaved_runs" not in {remark.premise for remark in examined(seen).remarks}


@pytest.mark.parametrize("order", [(0, 2, 3, 1), (0, 2, 1, 3)])
def test_joints_whose_columns_stand_in_another_order_are_refused(order: tuple[int, ...]) -> None:
    """Positions and efforts together, as a message has them that names its joints in an order of its own."""
    t, q = motion()
    seen = efforts(q, t, friction=0.3)
    columns = dict(seen.columns)
    for kind in ("position", "effort"):
        names = [f"joint.{n}.{kind}" for n in seen.joint_names]
        columns |= dict(zip(names, [seen.columns[names[k]] for k in order], strict=True))
    refused = [one for one in examined(replace(seen, columns=columns)).refused if one.premise == "joint_reading"]
    (found,) = refused
    moved = [seen.joint_names[k] for k in range(4) if order[k] != k]
    assert found.columns == tuple(f"joint.{n}.{kind}" for n in moved for kind in ("position", "effort"))


@pytest.mark.parametrize(("unit", "newtons"), [("kgf", 9.80665), ("lbf", 4.4482216), ("", 1.0), ("", 1.3)])
def test_a_push_in_another_unit_is_told_by_the_believed_compliance(unit: str, newtons: float) -> None:
    """By one factor of all joints, which a unit has; of joints that are softer than believed, none."""
    machine, rng = arm(load=0.0), np.random.default_rng(2)
    q = np.repeat(rng.uniform(-1.0, 1.0, size=(30, 4)), 10, axis=0)
    force = rng.uniform(-200.0, 200.0, size=(300, 3))
    belief = Belief(robot=machine, compliance={"shoulder": 2e-5, "elbow": 3e-5})
    columns = {f"joint.{n}.position": x for n, x in zip(machine.joint_names, q.T, strict=True)}
    columns |= {f"applied.force.{a}": f for a, f in zip("xyz", force.T, strict=True)}
    columns |= {name: np.zeros(300) for name in PLACE}
    true = scene_of(Observations("pose", columns, None, belief)).simulated[:, :3]
    seen = with_place(Observations("pose", columns, None, belief), true + 1e-5 * rng.normal(size=true.shape))
    read = {f"applied.force.{a}": f / newtons for a, f in zip("xyz", force.T, strict=True)}
    found = examined(replace(seen, columns=dict(seen.columns) | read))
    assert [one.premise for one in found.remarks] == (["push_units"] if unit else [])
    if unit:
        assert unit in found.remarks[0].what
        assert found.observations.matrix(*read) == pytest.approx(force)


def test_a_wrench_whose_rows_are_looked_at_far_apart_is_judged_at_rest() -> None:
    """Of 12000 rows one in thirty: a clock that was set between two of them makes no acceleration without end."""
    t = np.arange(12000) / 100.0
    machine, rng = arm(load=0.5), np.random.default_rng(6)
    q = 0.6 * np.sin(np.outer(t, 0.3 + 0.1 * np.arange(4)) + np.arange(4))
    columns = {"time": t - np.where(t > 60.0, 0.3, 0.0)}
    columns |= {f"joint.{n}.position": x for n, x in zip(machine.joint_names, q.T, strict=True)}
    columns |= {f"wrench.{kind}.{a}": rng.normal(size=12000) for kind in ("force", "torque") for a in "xyz"}
    belief = Belief(robot=machine, bias_free=True, dynamic=True)
    for time in (columns["time"], np.where(t > 60.0, t - 0.3 * np.round(t - 60.0), t)):
        found = examined(Observations("wrench", columns | {"time": time}, None, belief))
        assert all(isinstance(one.what, str) for one in found.remarks)


def test_two_poses_that_are_visited_in_turn_are_no_interleaved_runs() -> None:
    """A row a pose, three seconds apart, as a test of repeatability goes to and fro."""
    q = motion(1000)[1]
    seen = efforts(np.where(np.arange(1000)[:, None] % 2, q[100], q[500]) + 1e-5 * q, 3.0 * np.arange(1000.0))
    assert "interleaved_runs" not in {remark.premise for remark in examined(seen).remarks}

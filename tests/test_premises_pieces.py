"""Pieces cut out of a motion, samples that were not sent, a simulation of another motion, an inertia about another point.

Mechanics here are this file's own, as in `test_premises.py`.
"""

from dataclasses import replace

import numpy as np
import pytest

from galen_hw.kinematics import GalenRobot
from galen_hw.physics.effects.registry import scene_of
from galen_hw.physics.observations import Belief, Observations
from galen_hw.physics.rigid import Body
from galen_hw.premises import Action, examined
from galen_hw.premises.blanks import BlankSamples
from galen_hw.premises.cuts import CutMotion
from galen_hw.premises.simulated_motion import SimulatedMotion
from galen_hw.premises.tool_inertia import ToolInertia
from tests.test_premises import COM, FORCE, MASS, TORQUE, moving, seen

RATE = 50.0


def cut(columns: dict[str, np.ndarray], first: int, count: int) -> dict[str, np.ndarray]:
    """Rows gone, the clock closed up."""
    out = {name: np.delete(x, np.arange(first, first + count)) for name, x in columns.items() if name != "time"}
    return out | {"time": np.arange(len(next(iter(out.values())))) / RATE}


def test_a_motion_that_was_cut_is_two_segments() -> None:
    found = list(CutMotion().examine(seen(cut(moving(), 700, 120))))
    assert [one.action for one in found] == [Action.REPAIRED]
    assert "row 701" in found[0].what
    assert found[0].repaired is not None
    assert [(part.start, part.stop) for part in found[0].repaired.segments] == [(0, 700), (700, 1380)]


def test_rows_lost_on_a_clock_that_shows_it_are_no_cut() -> None:
    columns = moving()
    gone = {name: np.delete(x, np.arange(700, 820)) for name, x in columns.items()}
    assert not list(CutMotion().examine(seen(gone)))


def test_quaternions_of_the_other_sign_are_no_cut() -> None:
    columns = moving()
    for name in [name for name in columns if name.startswith("sensor.orientation")]:
        columns[name] = np.where(np.arange(len(columns[name])) > 800, -columns[name], columns[name])
    assert not list(CutMotion().examine(seen(columns)))


def test_a_reading_that_jumps_and_comes_back_is_no_cut() -> None:
    columns = moving()
    for name in [name for name in columns if name.startswith("sensor.orientation")][:3]:
        columns[name][700:702] += 0.3
    assert not list(CutMotion().examine(seen(columns)))


def test_samples_that_were_not_sent_are_not_measured() -> None:
    """Zeros in all six channels, far from what stands beside them."""
    columns, rows = moving(), np.r_[40, 300:304, 900, 1200:1206]
    for name in FORCE + TORQUE:
        columns[name][rows] = 0.0
    (found,) = BlankSamples().examine(seen(columns))
    assert "12 of 1500 rows" in found.what
    assert found.repaired is not None
    assert np.flatnonzero(np.isnan(found.repaired.columns[FORCE[0]])).tolist() == rows.tolist()


def test_a_sensor_without_load_that_reads_zeros_was_measured() -> None:
    """A simulated push from nothing and back: it rises from zero row by row."""
    columns = moving()
    push = np.maximum(np.sin(0.8 * columns["time"]), 0.0)
    for k, name in enumerate(FORCE + TORQUE):
        columns[name] = np.where(push > 0.0, (k + 1.0) * push, 0.0)
    assert not list(BlankSamples().examine(seen(columns)))


def arm(late: int = 0, *, other: bool = False) -> Observations:
    """Three joints, and a simulation of the same motion `late` rows later there, or of another one."""
    t = np.arange(2000) / RATE
    rng = np.random.default_rng(3)
    slow = rng.uniform(0.3, 1.1, 3)
    position = np.stack([np.sin(w * t) + 0.4 * np.sin(2.3 * w * t + 1.0) for w in slow], axis=1)
    shown = np.stack([np.cos(1.7 * w * t) for w in slow[::-1]], axis=1) if other else np.roll(position, late, axis=0)
    names = [f"joint.j{k}.position" for k in range(3)]
    effort = [f"joint.j{k}.effort" for k in range(3)]
    simulation = dict(zip(names + effort, np.concatenate([shown, 2.0 * shown], axis=1).T, strict=True))
    columns = {"time": t} | dict(zip(names + effort, np.concatenate([position, 2.0 * position], axis=1).T, strict=True))
    return Observations("effort", columns, simulation, Belief())


@pytest.mark.parametrize(
    ("seen_", "said"), [(arm(), ""), (arm(other=True), "another motion"), (arm(75), "1.5 s later")]
)
def test_a_simulation_is_of_the_motion_that_was_recorded(seen_: Observations, said: str) -> None:
    found = list(SimulatedMotion().examine(seen_))
    assert [one.action for one in found] == ([Action.REFUSED] if said else [])
    assert all(said in one.what for one in found)


@pytest.mark.parametrize("about_flange", [False, True])
def test_an_inertia_about_the_flange_is_taken_about_the_centre_of_mass(*, about_flange: bool) -> None:
    """A long tool that roll and tilt swing round; the wrench is that of the right inertia."""
    t, robot = np.arange(3000) / 100.0, GalenRobot()
    swung = {"roll": 0.4 * np.sin(4.1 * t), "tilt": 0.4 * np.sin(3.3 * t + 1.0)}
    joints = {f"joint.{n}.position": swung.get(n, 0.01 * np.sin(0.9 * t)) for n in robot.joint_names}
    com, inertia = 4.0 * COM, np.diag([0.004, 0.004, 0.001])
    belief = Belief(robot=robot, tool=Body(MASS, com, inertia), bias_free=True, dynamic=True)
    empty = Observations("wrench", {"time": t} | joints | dict.fromkeys(FORCE + TORQUE, 0.0 * t), None, belief)
    noise = np.random.default_rng(1).normal(size=(len(t), 6)) * ([0.02] * 3 + [0.001] * 3)
    wrench = scene_of(empty).simulated + noise
    steiner = MASS * (com @ com * np.eye(3) - np.outer(com, com))
    told = replace(belief, tool=Body(MASS, com, inertia + steiner * about_flange))
    given = replace(empty, belief=told, columns=dict(empty.columns) | dict(zip(FORCE + TORQUE, wrench.T, strict=True)))
    found = list(ToolInertia().examine(given))
    assert len(found) == about_flange
    for one in found:
        assert one.repaired is not None
        assert np.allclose(one.repaired.belief.tool.inertia, inertia)
    assert [r.premise for r in examined(given).remarks] == ["tool_inertia"] * about_flange

"""Rows between two measured ones that a program wrote: gaps filled by straight lines.

Injected here into a closed-form motion with noise, and found again row by row; silence on what only looks alike.
"""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation, Slerp

from galen_hw.physics.observations import Belief, Observations
from galen_hw.premises import Action, examined
from galen_hw.premises.gaps import FilledGaps

RATE = 50.0
ROWS = 3000
GAPS = ((200, 263), (900, 920), (1700, 1790), (2600, 2612))
"""First row and the one behind the last of each."""
POSITION = [f"pose.position.{a}" for a in "xyz"]
QUATERNION = [f"pose.orientation.{a}" for a in "xyzw"]
Drawn = tuple[np.ndarray, np.ndarray, Rotation]


def motion(*, noise: float = 2e-4, at: np.ndarray | None = None) -> Drawn:
    """Stamps (N,) that jitter, positions (N, 3) in m and orientations (N) of a tracked body."""
    rng = np.random.default_rng(4)
    t = (np.arange(ROWS) + 0.04 * rng.normal(size=ROWS)) / RATE if at is None else at
    position = np.stack([0.3 * np.sin(0.7 * t), 0.2 * np.cos(1.1 * t), 0.5 + 0.1 * np.sin(0.4 * t + 1.0)], axis=1)
    angles = np.stack([0.8 * np.sin(0.5 * t), 0.6 * np.sin(0.9 * t + 1.0), 0.5 * np.cos(0.6 * t)], axis=1)
    turn = Rotation.from_euler("xyz", angles) * Rotation.from_rotvec(noise * rng.normal(size=(len(t), 3)))
    return t, position + noise * rng.normal(size=position.shape), turn


def recording(drawn: Drawn, digits: int = 6) -> Observations:
    """The recording as a file has it, written to so many digits."""
    t, position, turn = drawn
    columns = dict(zip(POSITION, np.round(position, digits).T, strict=True))
    columns |= dict(zip(QUATERNION, np.round(turn.as_quat(), digits).T, strict=True))
    return Observations("pose", {"time": np.round(t, 6)} | columns, None, Belief())


def filled(drawn: Drawn, *, over_rows: bool = False, even_turn: bool = True, gaps=GAPS) -> Drawn:
    """The same with gaps filled by straight lines over stamps or rows, turning evenly or along a line made of length one."""
    t, position, turn = drawn
    position, q = position.copy(), turn.as_quat()
    clock = np.arange(len(t), dtype=float) if over_rows else t
    for first, stop in gaps:
        ends, inside = np.array([first - 1, stop]), np.arange(first, stop)
        for axis in range(3):
            position[inside, axis] = np.interp(clock[inside], clock[ends], position[ends, axis])
        if even_turn:
            q[inside] = Slerp(clock[ends], Rotation.from_quat(q[ends]))(clock[inside]).as_quat()
        else:
            end = q[ends] * np.array([[1.0], [np.sign(q[ends[0]] @ q[ends[1]])]])
            share = ((clock[inside] - clock[ends[0]]) / np.diff(clock[ends]))[:, None]
            q[inside] = (1.0 - share) * end[0] + share * end[1]
    return t, position, Rotation.from_quat(q)


@pytest.mark.parametrize("even_turn", [False, True])
@pytest.mark.parametrize("over_rows", [False, True])
@pytest.mark.parametrize("digits", [6, 9])
def test_gaps_filled_by_straight_lines_are_not_measured(digits: int, over_rows: bool, even_turn: bool):
    """Every filled row, and hardly any beside it."""
    (found,) = FilledGaps().examine(recording(filled(motion(), over_rows=over_rows, even_turn=even_turn), digits))
    assert found.action is Action.REPAIRED
    assert found.repaired is not None
    left_out = np.flatnonzero(np.isnan(found.repaired.columns["pose.position.x"]))
    assert np.array_equal(left_out, np.concatenate([np.arange(*gap) for gap in GAPS]))
    assert "185 of 3000 rows" in found.what
    assert found.todo
    assert set(found.columns) == {*POSITION, *QUATERNION}


def test_of_a_tracker_of_two_bodies_the_one_that_was_hidden_is_left_out():
    hidden, there = recording(filled(motion())), recording(motion())
    columns = {"time": hidden.columns["time"]}
    for name, one in (("a", hidden), ("b", there)):
        columns |= {f"target.{name}.{key.removeprefix('pose.')}": one.columns[key] for key in POSITION + QUATERNION}
    (found,) = FilledGaps().examine(Observations("targets", columns, None, Belief()))
    assert set(found.columns) == {name for name in columns if name.startswith("target.a.")}


def test_a_wrench_and_one_channel_alone_are_asked_too():
    """Efforts of one joint with noise; a gap of ten rows."""
    t, position, _ = filled(motion())
    effort = {"joint.a.effort": np.round(position[:, 0], 6)}
    (found,) = FilledGaps().examine(Observations("effort", {"time": t} | effort, None, Belief()))
    assert "185 of 3000 rows" in found.what
    wrench = {f"wrench.{kind}.{a}": position[:, k] for kind in ("force", "torque") for k, a in enumerate("xyz")}
    (found,) = FilledGaps().examine(Observations("wrench", {"time": t} | wrench, None, Belief()))
    assert "185 of 3000 rows (6.2 %) of wrench" in found.what


def test_without_repair_they_refuse():
    found = examined(recording(filled(motion())), repair=False)
    assert [remark.premise for remark in found.refused] == ["filled_gaps"]


# Silence


def held(drawn: Drawn) -> Drawn:
    """The last value again, in gaps: an existing matter."""
    t, position, turn = drawn
    source = np.arange(len(t))
    for first, stop in GAPS:
        source[first:stop] = first - 1
    return t, position[source], turn[source]


def stands(drawn: Drawn) -> Drawn:
    """A body that stands for a third of the time."""
    t = drawn[0]
    at = np.where((t > 20.0) & (t < 40.0), 20.0, t)
    _, position, turn = motion(at=at)
    return t, position, turn


def resampled(rate: float, drawn: Drawn) -> Drawn:
    """All of it drawn by straight lines from a log of another rate (Hz)."""
    t = drawn[0]
    slow = np.arange(t[0], t[-1] + 1.0 / rate, 1.0 / rate)
    _, theirs, turns = motion(at=slow)
    at = np.clip(t, slow[0], slow[-1])
    lines = np.stack([np.interp(at, slow, column) for column in theirs.T], axis=1)
    return t, lines, Slerp(slow, turns)(at)


@pytest.mark.parametrize(
    "drawn",
    [
        motion(),
        motion(noise=0.0),
        held(motion()),
        stands(motion()),
        *(resampled(rate, motion()) for rate in (2.0, 5.0, 8.0, 12.0, 16.0, 20.0, 33.0, 45.0)),
    ],
    ids=["noise", "without", "held", "stands", *(f"{rate} Hz" for rate in (2, 5, 8, 12, 16, 20, 33, 45))],
)
@pytest.mark.parametrize("digits", [3, 6, 9])
def test_nothing_is_said_of_what_was_measured_held_or_resampled_throughout(drawn: Drawn, digits: int):
    assert not list(FilledGaps().examine(recording(drawn, digits)))


def trapezoids(noise: float) -> np.ndarray:
    """Positions (N,) of a joint that goes to and fro at even speeds: lines without noise, and corners."""
    rng = np.random.default_rng(7)
    speed = np.repeat(rng.choice([-0.5, -0.02, 0.0, 0.02, 0.5], ROWS // 60), 60)
    smooth = np.convolve(speed, np.ones(9) / 9.0, mode="same")
    jitter = (1.0 + noise * rng.normal(size=ROWS)) / RATE
    return np.cumsum(smooth * jitter)


@pytest.mark.parametrize("noise", [0.0, 1e-4, 0.05])
@pytest.mark.parametrize("digits", [3, 5, 8])
def test_even_speeds_are_no_filled_gaps(noise: float, digits: int):
    """A simulation's lines, an encoder's steps, and stamps that jitter in proportion to the speed."""
    t = np.arange(ROWS) / RATE
    columns = {"time": t, "joint.a.position": np.round(trapezoids(noise), digits)}
    assert not list(FilledGaps().examine(Observations("position", columns, None, Belief())))


def test_a_filter_that_leaves_no_noise_tells_nothing():
    t, position, turn = filled(motion())
    kernel = np.hanning(31) / np.hanning(31).sum()
    low = np.stack([np.convolve(column, kernel, mode="same") for column in position.T], axis=1)
    assert not list(FilledGaps().examine(recording((t, low, turn[np.zeros(ROWS, dtype=int)]))))


def test_rows_of_poses_without_a_clock_are_no_lines():
    one = recording(filled(motion()))
    without = replace(one, columns={name: x for name, x in one.columns.items() if name != "time"})
    assert not list(FilledGaps().examine(without))

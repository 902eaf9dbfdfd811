"""What a late stream answers to before its recording begins."""

import itertools
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

sys.path.insert(0, str(Path(__file__).parent))

from physics_scenes import scene

from galen_hw.physics.effects.creep import Creep
from galen_hw.physics.operators.filters import LagState, lag
from galen_hw.physics.scenes.initial_state import FEW, GONE, MOST_UNKNOWN, Beginning, Lagging, fading


@given(st.floats(0.0, 30.0), st.floats(0.0, 30.0), st.lists(st.integers(5, 60), min_size=1, max_size=4))
def test_rows_that_answer_to_the_unknown(after: float, before: float, lengths: list[int]) -> None:
    """At both ends of every segment, as long as the stream is late or early, and no more than a quarter of it."""
    edges = np.cumsum([0, *lengths])
    segments = [slice(int(a), int(b)) for a, b in itertools.pairwise(edges)]
    time = 0.1 * np.arange(edges[-1])
    out = Beginning(after, before).unknown(time, segments)
    for part in segments:
        t, most = time[part], MOST_UNKNOWN * (time[part][-1] - time[part][0])
        expected = (t - t[0] < min(after, most)) | (t[-1] - t < min(before, most))
        differs = out[part] != expected
        near = np.minimum(np.abs(t - t[0] - min(after, most)), np.abs(t[-1] - t - min(before, most))) < 1e-9
        assert not np.any(differs & ~near)


def test_what_fades_is_what_another_beginning_leaves() -> None:
    """The difference of two lags of one signal that began in two states, channel by channel and segment by segment."""
    time, segments = np.concatenate([0.02 * np.arange(50), 5.0 + 0.02 * np.arange(30)]), [slice(0, 50), slice(50, 80)]
    columns = Beginning(lags=(Lagging((0, 2), 0.3),)).columns(time, segments)
    assert [one.channels for one, _ in columns] == [(0, 2), (0, 2)]
    x = np.sin(time)[:, None]
    for part, (_, column) in zip(segments, columns, strict=True):
        t, one = time[part], x[part]
        states = (LagState(float(t[0]), one[0] + offset, one[0]) for offset in (0.0, 1.0))
        settled, begun = (lag(t, one, np.array([0.3]), state)[0] for state in states)
        np.testing.assert_allclose(column[part], (begun - settled)[:, 0], atol=GONE)
        assert not column[: part.start].any()
        assert not column[part.stop :].any()
    assert not Beginning(lags=(Lagging((0,), 0.3),)).columns(np.arange(99.0), [slice(k, k + 1) for k in range(FEW + 1)])


def test_what_a_joint_s_creep_leaves_shows_where_the_joint_moves_what() -> None:
    """A creep that began rested and one that had settled differ by the load at the start, which fades through the joint."""
    pose, one = scene("pose", np.random.default_rng(2)), np.ones(1)
    settled = Creep(3.0, joint="tilt")
    begun = pose.begun(Beginning(lags=settled.lags(pose)))
    load = pose.load("tilt")
    assert load is not None
    assert abs(load[0]) > 0.0
    ((channels, fades),) = fading(begun)
    differs = settled.change(pose, one) - replace(settled, rested=True).change(pose, one)
    np.testing.assert_allclose(load[0] * fades, differs[:, list(channels)], atol=GONE * np.abs(differs).max())
    assert not np.delete(differs, list(channels), axis=1).any()

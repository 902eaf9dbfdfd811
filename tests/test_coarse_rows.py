"""What is smooth along the motion is computed on some of the rows, run by run, and brought to all of them."""

from dataclasses import replace

import numpy as np
import pytest

from galen_hw.physics.effects.registry import scene_of
from galen_hw.physics.observations import Observations
from galen_hw.physics.scenes.joint import EffortScene
from galen_hw.physics.signals.differentiation import low_passed, smoothed
from tests.physics_scenes import scene

ROWS, GAP = 4600, 1501


def with_a_gap() -> EffortScene:
    """Efforts of two joints over 46 s, with a gap after the first third, and a run of three rows behind it."""
    whole = scene("effort", np.random.default_rng(4), ROWS, 100.0).observations
    segment = np.searchsorted([GAP, GAP + 3], np.arange(ROWS), side="right").astype(float)
    columns = whole.columns | {"segment": segment}
    made = scene_of(Observations("effort", columns, None, whole.belief))
    assert isinstance(made, EffortScene)
    assert [s.stop - s.start for s in made.segments] == [GAP, 3, ROWS - GAP - 3]
    return made


def test_a_misread_joint_across_gaps_is_what_every_row_by_itself_gives() -> None:
    """The rows of a run are told from that run alone: nothing is drawn across a gap."""
    made = with_a_gap()
    told = made.misread("shoulder", offset=0.02)
    exact = type(made)(replace(made.observations))
    exact._coarse = lambda run, **_: np.asarray(run(np.arange(ROWS)))  # type: ignore[method-assign]
    every = exact.misread("shoulder", offset=0.02)
    assert told is not None
    assert every is not None
    inside = ~made.ends
    assert np.abs(every).max() > 0.01
    assert told[inside] == pytest.approx(every[inside], abs=1e-4 * np.abs(every).max())


def test_a_channel_without_a_change_is_not_filtered_and_the_others_are_as_alone() -> None:
    """Most effects act in one channel of many."""
    t = np.arange(2000) / 100.0
    x = np.stack([np.zeros(2000), np.sin(40.0 * t) + np.sin(t)], axis=-1)
    both = smoothed(t, x, [slice(0, 2000)], 2.0)
    assert not both[:, 0].any()
    assert both[:, 1] == pytest.approx(low_passed(x[:, 1], 0.01, 2.0), abs=1e-9)

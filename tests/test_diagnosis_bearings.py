"""A bearing that rubs: what its joint does besides, it does behind the friction."""

import sys
from collections.abc import Callable
from pathlib import Path
from typing import Final

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parent))

from diagnosis_cases import Array, played, tracked

from galen_hw.diagnosis.pipeline import diagnose
from galen_hw.diagnosis.report.effect_curves import axis_of
from galen_hw.diagnosis.result import Finding
from galen_hw.diagnosis.work import Work
from galen_hw.physics.effects.backlash import Backlash
from galen_hw.physics.effects.registry import scene_of

ROWS: Final = 2400
FRICTION: Final = 0.1
"""N m, of a load that reaches about ten times as much."""


def rubbing_and_loose(_t: Array, moment: Array) -> Array:
    """The joint has play, and lies on the side that the load says once it has overcome the friction."""
    felt = played(moment, FRICTION)
    return 2e-3 * (felt - moment) + 8e-4 * np.tanh(felt / 0.02)


def explained(law: Callable[[Array, Array], Array]) -> tuple[Work, dict[str, Finding]]:
    """The diagnosis of one motion, judged on another, and its findings by name; it must leave nothing."""
    learnt, other = (scene_of(tracked(seed=seed, rows=ROWS, law=law)) for seed in (3, 4))
    work = diagnose(learnt, holdout=other)
    assert work.diagnosis.verdict == "explained"
    return work, {f.effect: f for f in work.diagnosis.findings}


def test_play_behind_friction_is_play_and_friction() -> None:
    work, found = explained(rubbing_and_loose)
    assert set(found) == {"backlash", "hysteresis"}
    assert found["backlash"].parameters["half_play"].value == pytest.approx(8e-4, rel=0.05)
    assert found["hysteresis"].parameters["reach"].unit == "N m"
    (play,) = [h.effect for h in work.model.effects if isinstance(h.effect, Backlash)]
    assert play.friction == pytest.approx(FRICTION, rel=0.1)
    curve = axis_of(work, play, 0, np.zeros(ROWS), [])
    assert (curve.label, curve.unit, curve.loop) == ("tilt load", "N m", True), "its page shows it over what throws it"


def test_a_play_narrower_than_the_noise_of_its_joint_is_none() -> None:
    """A dead band in noisy readings makes them quieter, which the recording likes whatever its joint does."""
    scene = scene_of(tracked(seed=3, rows=ROWS))
    noisy = np.random.default_rng(1).normal(scale=1e-3, size=ROWS)
    scene.q[:, scene.joint_index("tilt")] += noisy
    assert not Backlash("tilt", 1e-3).at_work(scene)
    assert Backlash("tilt", 1e-2).at_work(scene)
    assert Backlash("roll", 1e-3).at_work(scene)


def test_poses_one_after_the_other_are_not_taken_for_noise() -> None:
    scene = scene_of(tracked(seed=3, rows=ROWS))
    scene.q[:] = np.random.default_rng(1).permutation(scene.q)
    assert Backlash("tilt", 1e-3).at_work(scene)

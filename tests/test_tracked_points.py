"""Tracked points of which no pose shows all, and poses that somebody else has simulated: nobody's robot is needed for these."""

import numpy as np
import pytest

from galen_hw.diagnosis.pipeline import diagnose
from galen_hw.errors import UsageError
from galen_hw.physics.effects.registry import scene_of
from galen_hw.physics.observations import Belief, Observations
from tests import physics_scenes


def test_targets_of_which_no_row_shows_all_are_refused_in_one_line() -> None:
    """Three reflectors and one tracker: each pose shows one. It had been an index out of bounds."""
    seen = physics_scenes.scene("targets", np.random.default_rng(1), 40, 10.0).observations
    columns = {name: np.array(values, dtype=float) for name, values in seen.columns.items()}
    targets = sorted({name.split(".")[1] for name in columns if name.startswith("target.")})
    assert len(targets) > 1
    for k, target in enumerate(targets):
        for axis in "xyz":
            columns[f"target.{target}.position.{axis}"][np.arange(40) % len(targets) != k] = np.nan
    with pytest.raises(UsageError, match=r"no row shows all \d targets.*one at a time"):
        diagnose(scene_of(Observations("targets", columns, None, seen.belief)))


def test_a_pose_that_somebody_else_simulated_needs_no_robot() -> None:
    """As efforts and positions do not; what of it is an arm's cannot be asked."""
    rng = np.random.default_rng(4)
    names = [f"pose.position.{axis}" for axis in "xyz"]
    place = rng.uniform(-0.3, 0.3, (60, 3))
    columns = dict(zip(names, (place + 1e-4 * rng.standard_normal(place.shape)).T, strict=True))
    simulation = dict(zip(names, place.T, strict=True))
    found = diagnose(scene_of(Observations("pose", columns, simulation, Belief(bias_free=True)))).diagnosis
    assert found.verdict == "agrees"

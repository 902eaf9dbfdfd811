"""Errors of geometry that stand for each other in twos."""

import sys
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

sys.path.insert(0, str(Path(__file__).parent))

from diagnosis_cases import Bench, hanging, rotation

from galen_hw.diagnosis.estimation.normal_equations import Scorer
from galen_hw.diagnosis.pipeline import diagnose
from galen_hw.diagnosis.selection.moves import exchange
from galen_hw.diagnosis.selection.search_state import Selection
from galen_hw.physics.effects.geometry import JointOffset
from galen_hw.physics.effects.load import Payload
from galen_hw.physics.effects.registry import scene_of


def turned(bench: Bench, angle: float, offset: float) -> Bench:
    """The tilt joint turns about an axis that leans towards z, and its zero is off."""
    axis = np.array([0.0, np.cos(angle), np.sin(angle)])
    tilt = Rotation.from_rotvec((bench.q[:, 4] + offset)[:, None] * axis).as_matrix()
    bench.wrench = hanging(rotation(bench.q[:, 3], np.zeros(len(bench.t))) @ tilt)
    return bench


@pytest.mark.inject
def test_a_turned_axis_and_a_zero_are_not_a_tilted_base_and_a_turned_sensor() -> None:
    """Five numbers do what two do; each of the five looks best while the others are there."""
    learnt, other = (scene_of(turned(Bench(seed, rows=4000), 0.025, 0.011).observations()) for seed in (5, 6))
    work = diagnose(learnt, holdout=other)
    found = {f.effect: f for f in work.diagnosis.findings}
    assert work.diagnosis.verdict == "explained"
    assert set(found) == {"link_geometry", "joint_offset"}
    assert found["link_geometry"].parameters["axis_tilt.x"].value == pytest.approx(0.025, rel=0.02)
    assert found["joint_offset"].joints == ["tilt"]
    assert found["joint_offset"].parameters["offset"].value == pytest.approx(0.011, rel=0.05)


def test_a_model_that_does_not_come_to_rest_is_compared_with_no_other() -> None:
    """What one part undoes of another grows round after round: it has no optimum."""
    bench = Bench(5, rows=1500)
    fitted = diagnose(scene_of(bench.observations())).bench
    scorer = Scorer(fitted, [fitted.hypothesis(Payload("body")), fitted.hypothesis(JointOffset("tilt"))])
    out = Selection(scorer, chosen=[len(scorer.base), len(scorer.base) + 1])
    fitted.update_state(diverging=True)
    assert not exchange.regrouped(out)
    assert not out.regrouped
    fitted.update_state(diverging=False)
    exchange.regrouped(out)
    assert out.regrouped

"""What is proposed as a ripple along a joint's way."""

import numpy as np
import pytest

from galen_hw.diagnosis.detection.spectral_lines import ripples
from galen_hw.diagnosis.stats.sampling import Rows
from galen_hw.physics.effects.registry import scene_of
from tests.diagnosis_cases import Beam


@pytest.mark.parametrize("steps", [2, 40])
def test_no_ripple_is_finer_than_two_steps_in_which_the_position_is_read(steps: int) -> None:
    """A UR10e that stood and was pushed moved by 26 steps of 0.1 mrad, and had a ripple of 0.107 mrad."""
    beam = Beam()
    beam.q = np.round(steps * 0.5e-4 * np.sin(0.3 * beam.t) / 1e-4) * 1e-4
    scene = scene_of(beam.observations())
    rest = np.random.default_rng(0).standard_normal((len(scene), len(scene.channels)))
    found = ripples(scene, rest, Rows(tuple(scene.segments)), np.zeros(len(scene.channels)))
    periods = [2.0 * np.pi / one.effect.wave_number for one in found]  # type: ignore[attr-defined]
    assert all(period > 2e-4 for period in periods)
    assert bool(periods) is (steps == 40)

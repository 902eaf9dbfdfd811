"""What is told of rounded readings: no effect that their rounding makes of a machine that stands."""

from dataclasses import replace

import numpy as np
import pytest

from galen_hw.diagnosis.estimation.dataset import Bench as Dataset
from galen_hw.diagnosis.estimation.model import Model
from galen_hw.diagnosis.estimation.normal_equations import Scorer
from galen_hw.diagnosis.noise.spectrum import Noise
from galen_hw.diagnosis.stats.sampling import Rows
from galen_hw.physics.effects.events import Step
from galen_hw.physics.effects.registry import scene_of
from galen_hw.spatial import Array
from tests.diagnosis_cases import SIGMA, WRENCH, Bench, hanging, rotation

STEP = 2.4 * SIGMA


def readings(jump: float, *, rounded: bool) -> Array:
    """A tool that is held at 25 orientations, for 3 s each, and a force that jumps by so many standard deviations."""
    case = Bench(3, rows=3750, rate=50.0)
    held = np.repeat(case.rng.uniform(-0.5, 0.5, (25, 2)), 150, axis=0)
    true = hanging(rotation(*held.T))
    true[case.t > 40.0] += jump * SIGMA
    if not rounded:
        return true + case.noise
    dither = np.sqrt(SIGMA**2 - STEP**2 / 12.0)
    return np.round((true + dither * case.rng.normal(size=true.shape)) / STEP) * STEP


def clearness(wrench: Array) -> float:
    """Of a jump at 40 s in the first force, given what is read of a tool that is held."""
    case = Bench(3, rows=3750, rate=50.0)
    held = np.repeat(case.rng.uniform(-0.5, 0.5, (25, 2)), 150, axis=0)
    case.q[:, 3:] = held
    seen = case.observations()
    scene = scene_of(replace(seen, columns=dict(seen.columns) | dict(zip(WRENCH, wrench.T, strict=True))))
    bench = Dataset(scene)
    bench.learn_noise([])
    jump = bench.hypothesis(Step(WRENCH[:1], 40.0))
    return Model(bench, list(Scorer(bench, [jump]).base), [jump], bench.whitened(bench.whole)).clearness(jump)


@pytest.mark.parametrize(("jump", "rounded", "told"), [(0.08, True, False), (0.15, False, True), (0.5, True, True)])
def test_a_jump_below_what_the_rounding_follows_has_no_size(jump: float, *, rounded: bool, told: bool) -> None:
    """Six of 24 recordings of a rounded pose in which nothing was concealed had had a step or a hardening."""
    assert (clearness(readings(jump, rounded=rounded)) >= 2.0) is told


@pytest.mark.parametrize("stride", [1, 2, 10])
def test_what_follows_the_signal_is_that_of_single_readings_however_many_are_averaged(stride: int) -> None:
    rows = Rows((slice(0, 400),), stride)
    sigma = SIGMA / np.sqrt(stride)
    noise = Noise(rows, np.empty(0), np.empty((0, 6)), sigma, 300.0, np.eye(6), STEP)
    # Ch. 6 of Widrow and Kollar: the noise before the rounding is 0.3 steps, the mean error a sine of 0.054 steps.
    assert np.sqrt(noise.blurred_rounding) == pytest.approx(0.054 / np.sqrt(2.0) * STEP, rel=0.01)
    assert np.all(noise.followed_rounding >= noise.blurred_rounding * (1.0 - 1e-9))

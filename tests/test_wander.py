"""The frequency of a hum is as uncertain as the walk of its phase makes it, seen or not."""

import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parent))

from diagnosis_cases import SIGMA, WRENCH, Array
from diagnosis_cases import Bench as Run

from galen_hw.diagnosis.estimation.dataset import Bench
from galen_hw.diagnosis.estimation.line_frequency import mean_frequency
from galen_hw.diagnosis.estimation.model import Model
from galen_hw.physics.effects.events import Vibration
from galen_hw.physics.effects.registry import scene_of

RATE, ROWS, FREQUENCY = 100.0, 6000, 11.3


def told(size: float, walk: float, seed: int) -> tuple[float, float]:
    """Frequency and its deviation by the walk, of a hum of `size` noises whose phase walks by `walk` rad in all, rms."""
    run = Run(seed, rows=ROWS, rate=RATE)
    phase = np.cumsum(run.rng.normal(size=ROWS)) * walk / np.sqrt(ROWS)
    hum = np.sin(2.0 * np.pi * FREQUENCY * run.t + phase)
    run.wrench[:, 0] += size * SIGMA[0] * np.sqrt(2.0) * hum
    bench = Bench(scene_of(run.observations()), 0.0, 0)
    bench.learn_noise((), ())
    nuisances = [bench.hypothesis_of(None, columns) for columns in bench.constants()]
    found = bench.hypothesis(Vibration(WRENCH[:1], loudest(run.t, bench.y[:, 0])))
    assert isinstance(found.effect, Vibration)
    model = Model(bench, nuisances, [found], bench.whitened(bench.whole))
    return mean_frequency(model, found, found.effect.line(bench.scene))


def loudest(t: Array, x: Array) -> float:
    """Where a sine takes most, within two lines of the spectrum."""
    near = FREQUENCY + np.linspace(-2.0, 2.0, 401) / t[-1]
    return float(near[np.argmax(np.abs(np.exp(-2j * np.pi * np.outer(near, t)) @ (x - x.mean())))])


@pytest.mark.parametrize(("size", "walk"), [(0.1, 2.0), (1.0, 2.0)])
def test_a_walk_of_the_phase_is_in_the_error_though_noise_may_hide_it(size: float, walk: float) -> None:
    """Of 40 hums, from one that hardly stands above the noise to a plain one."""
    errors = [(f - FREQUENCY) / d for f, d in (told(size, walk, seed) for seed in range(40))]
    assert np.mean(np.abs(errors) < 1.96) >= 0.875
    assert np.sqrt(np.mean(np.square(errors))) > 0.4, "nor is it made wide for nothing"


def test_a_steady_line_that_is_plain_has_hardly_an_error() -> None:
    """A tenth of a line's breadth in the spectrum would be much."""
    f, deviation = told(3.0, 0.0, 1)
    assert deviation < 0.1 * RATE / ROWS
    assert f == pytest.approx(FREQUENCY, abs=0.1 * RATE / ROWS)

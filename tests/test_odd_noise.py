"""Recordings that agree, with noise that is no textbook's: nothing is found."""

import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parent))

from diagnosis_cases import SIGMA, Bench

from galen_hw.diagnosis.pipeline import diagnose
from galen_hw.physics.effects.registry import scene_of


def stamped_unevenly(bench: Bench) -> None:
    """Joints and sensor read together on an even clock, the row stamped up to a third of a sample off."""
    bench.t = bench.t + 0.3 * (bench.t[1] - bench.t[0]) * bench.rng.uniform(-1.0, 1.0, len(bench.t))


def heavy_tails(bench: Bench) -> None:
    """Student's t of three degrees of freedom."""
    bench.noise = bench.rng.standard_t(3, size=bench.noise.shape) * SIGMA / np.sqrt(3.0)


def louder_in_motion(bench: Bench) -> None:
    """Half as loud at rest as on average, and several times as loud at speed."""
    speed = np.abs(np.gradient(bench.q[:, 3:], axis=0)).sum(axis=1)
    bench.noise *= (0.5 + 1.5 * speed / speed.mean())[:, None]


def shared(bench: Bench) -> None:
    """Nearly as much noise in common as each channel has of its own."""
    bench.noise = bench.noise + 0.8 * bench.rng.normal(size=(len(bench.t), 1)) * SIGMA


def on_a_coarse_grid(bench: Bench) -> None:
    """A converter whose step is four times the noise."""
    bench.wrench = np.round((bench.wrench + bench.noise) / (4.0 * SIGMA)) * 4.0 * SIGMA
    bench.noise[:] = 0.0


@pytest.mark.inject
@pytest.mark.parametrize("made", [stamped_unevenly, heavy_tails, louder_in_motion, shared, on_a_coarse_grid])
@pytest.mark.parametrize("seed", [100, 101])
def test_odd_noise_is_noise(made: Callable[[Bench], None], seed: int) -> None:
    """A minute at 100 Hz."""
    bench = Bench(seed, rows=6000, rate=100.0)
    made(bench)
    answer = diagnose(scene_of(bench.observations())).diagnosis
    assert answer.verdict == "agrees", [finding.says for finding in answer.findings]

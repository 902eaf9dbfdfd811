"""Knocks of a tenth of a second: told one by one, or at least not taken for noise."""

import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parent))

from diagnosis_cases import SIGMA, Bench

from galen_hw.diagnosis.pipeline import diagnose
from galen_hw.physics.effects.registry import scene_of


def knocked(rows: list[int], size: float) -> Bench:
    """A minute at 100 Hz, its vertical force pulled for ten samples from each of the rows on, by so many times the noise."""
    bench = Bench(4, rows=6000, rate=100.0)
    for row in rows:
        bench.wrench[row : row + 10, 2] += size * SIGMA[2]
    return bench


@pytest.mark.inject
@pytest.mark.parametrize("size", [30.0, 100.0])
def test_a_knock_is_a_contact_with_sharp_edges(size: float) -> None:
    """Three of them had been loud noise: nothing was found, and all agreed."""
    rows = [800, 2500, 4100]
    work = diagnose(scene_of(knocked(rows, size).observations()))
    (finding,) = work.diagnosis.findings
    assert finding.effect == "contact"
    assert finding.channels == ["wrench.force.z"]
    assert work.diagnosis.verdict == "explained"
    found = [start for start, _ in work.diagnosis.when]
    np.testing.assert_allclose(found, np.array(rows) / 100.0, atol=0.05)
    assert work.diagnosis.fit["noise_floor"]["wrench.force.z"] == pytest.approx(SIGMA[2], rel=0.1)


def test_many_knocks_are_no_noise() -> None:
    """Twenty, more than are told as touches: what few samples hold is said, and that nothing named explains it."""
    rows = np.random.default_rng(1).choice(5800, 20, replace=False).tolist()
    work = diagnose(scene_of(knocked(rows, 100.0).observations()))
    assert work.diagnosis.verdict == "unexplained"
    (finding,) = work.diagnosis.findings
    assert finding.effect == "unknown"
    assert finding.channels == ["wrench.force.z"]
    assert "Few samples" in finding.says

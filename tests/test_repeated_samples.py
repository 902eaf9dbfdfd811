"""A sensor that hangs: its samples come again, and are left out; readings that come again by themselves are not."""

import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parent))

from diagnosis_cases import SIGMA, WRENCH, Bench

from galen_hw.diagnosis.engine import diagnose
from galen_hw.diagnosis.seek import repeated
from galen_hw.physics.observations import Observations
from galen_hw.physics.scene import Scene
from galen_hw.physics.table import scene_of

ROWS = (300, 900, 1500)


def hung(bench: Bench, length: int) -> Bench:
    """The same, its sensor at rest three times for so many rows, noise included."""
    for first in ROWS:
        for x in (bench.wrench, bench.noise):
            x[first : first + length] = x[first]
    return bench


def read(bench: Bench) -> Scene:
    """The recording as a scene."""
    return scene_of(bench.observations())


def steadied(bench: Bench) -> Bench:
    """The same, its joints and its wrench at rest in the first tenth of the rows."""
    for x in (bench.q, bench.wrench):
        x[: len(x) // 10] = x[len(x) // 10]
    return bench


def test_every_sample_that_comes_again_is_told() -> None:
    """All but the first of each stretch, and no other."""
    expected = np.concatenate([np.arange(first + 1, first + 15) for first in ROWS])
    np.testing.assert_array_equal(np.flatnonzero(repeated(read(hung(Bench(), 15)))), expected)
    assert not repeated(read(Bench())).any()


def test_readings_that_come_again_by_themselves_are_no_fault() -> None:
    """Without noise at rest, on a coarse grid, and from a sensor slower than its record."""
    clean = steadied(Bench())
    clean.noise[:] = 0.0
    assert not repeated(read(clean)).any()
    slow = Bench()
    for x in (slow.wrench, slow.noise):
        x[1::2] = x[::2]
    assert not repeated(read(slow)).any()
    coarse = Bench().observations()
    rounded = {n: np.round(coarse.columns[n] / (20.0 * s)) * 20.0 * s for n, s in zip(WRENCH, SIGMA, strict=True)}
    made = Observations("wrench", {**coarse.columns, **rounded}, None, coarse.belief)
    again = np.all(np.diff(np.stack([rounded[n] for n in WRENCH], axis=1), axis=0) == 0.0, axis=1)
    assert again.sum() > 100
    assert not repeated(scene_of(made)).any()


def test_on_a_grid_what_should_have_moved_hangs() -> None:
    """Thirty rows of a coarse converter that stand while the tool turns."""
    bench = hung(Bench(), 30)
    bench.wrench = np.round((bench.wrench + bench.noise) / (2.0 * SIGMA)) * 2.0 * SIGMA
    bench.noise[:] = 0.0
    found = np.flatnonzero(repeated(read(bench)))
    assert set(found) == {row for first in ROWS for row in range(first + 1, first + 30)}


@pytest.mark.inject
@pytest.mark.parametrize("length", [10, 40])
def test_a_sensor_that_hangs_is_no_touch(length: int) -> None:
    """Half a second and two: rows that are left out, not an outside force."""
    work = diagnose(read(hung(Bench(4), length)))
    (finding,) = work.diagnosis.findings
    assert finding.effect == "glitches"
    assert finding.parameters["count"].value == 3 * (length - 1)
    assert work.diagnosis.verdict == "explained"

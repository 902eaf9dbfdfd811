"""A sensor that hangs: its samples come again, and are left out; readings that come again by themselves are not."""

import itertools
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parent))

from diagnosis_cases import SIGMA, WRENCH, Bench

from galen_hw.diagnosis.detection.stuck_samples import repeated
from galen_hw.diagnosis.pipeline import diagnose
from galen_hw.physics.effects.registry import scene_of
from galen_hw.physics.observations import Observations
from galen_hw.physics.scenes.base import Scene

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
    """All of each stretch, in all channels, and no other; of two alike the second."""
    expected = np.concatenate([np.arange(first, first + 15) for first in ROWS])
    found = repeated(read(hung(Bench(), 15)))
    np.testing.assert_array_equal(np.flatnonzero(found.all(axis=1)), expected)
    np.testing.assert_array_equal(found.any(axis=1), found.all(axis=1))
    np.testing.assert_array_equal(np.flatnonzero(repeated(read(hung(Bench(), 2)))[:, 3]), np.add(ROWS, 1))
    assert not repeated(read(Bench())).any()


def test_a_channel_that_drops_out_is_told_and_one_at_its_limit_is_not() -> None:
    """Zero for half a second, which no force of this channel goes beyond; and clipped readings, equal for as long."""
    bench, limit = Bench(), Bench()
    for first in ROWS:
        for x in (bench.wrench, bench.noise):
            x[first : first + 10, 2] = 0.0
    found = repeated(read(bench))
    assert {int(row) for row in np.flatnonzero(found[:, 2])} == {
        row for first in ROWS for row in range(first, first + 10)
    }
    assert not found[:, [0, 1, 3, 4, 5]].any()
    most = np.quantile(limit.wrench[:, 0], 0.9)
    limit.wrench[:, 0] = np.minimum(limit.wrench[:, 0] + limit.noise[:, 0], most)
    limit.noise[:, 0] = 0.0
    assert np.sum(np.diff(limit.wrench[:, 0]) == 0.0) > 100
    assert not repeated(read(limit)).any()


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
    found = np.flatnonzero(repeated(read(bench)).all(axis=1))
    assert {int(row) for row in found} == {row for first in ROWS for row in range(first, first + 30)}


@pytest.mark.inject
@pytest.mark.parametrize(("length", "channels"), [(10, range(6)), (40, range(6)), (10, [2])])
def test_a_sensor_that_hangs_is_no_touch(length: int, channels: Sequence[int]) -> None:
    """Half a second and two: rows that are left out, not an outside force, and no noise; a channel that drops out too."""
    bench = Bench(4)
    if len(channels) == 6:
        hung(bench, length)
    else:
        for first, x, c in itertools.product(ROWS, (bench.wrench, bench.noise), channels):
            x[first : first + length, c] = 0.0
    work = diagnose(read(bench))
    (finding,) = work.diagnosis.findings
    assert finding.effect == "glitches"
    assert finding.parameters["count"].value == 3 * length
    assert finding.channels == [WRENCH[c] for c in channels]
    assert work.diagnosis.verdict == "explained"
    floor = [work.diagnosis.fit["noise_floor"][name] for name in WRENCH]
    np.testing.assert_allclose(floor, SIGMA, rtol=0.1)

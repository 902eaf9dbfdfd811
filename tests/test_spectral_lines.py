"""What is proposed as a line of the spectrum, and as a ripple along a joint's way."""

from dataclasses import replace

import numpy as np
import pytest

from galen_hw.diagnosis.detection.spectral_lines import lines, ripples
from galen_hw.diagnosis.pipeline import diagnose
from galen_hw.diagnosis.stats.aliasing import Aliases, folded
from galen_hw.diagnosis.stats.sampling import Rows
from galen_hw.physics.effects.registry import scene_of
from galen_hw.physics.scenes.base import Scene
from galen_hw.spatial import Array
from tests.diagnosis_cases import Beam, Bench


def with_residual(scene: Scene, residual: Array) -> Scene:
    """The same scene, that read this much (N, C) more than is simulated."""
    columns = dict(scene.observations.columns) | dict(zip(scene.channels, (scene.simulated + residual).T, strict=True))
    return scene_of(replace(scene.observations, columns=columns))


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


@pytest.mark.parametrize("frequency", [4.3, 18.0, 32.0, 43.1, 68.0, 82.0, 96.2])
def test_a_line_faster_than_the_averaged_rows_has_the_frequency_that_was_recorded(frequency: float) -> None:
    """Four rows of 200 Hz averaged: 32, 68 and 82 Hz show at 18 Hz, with a share of their amplitude."""
    scene = scene_of(Bench(5, rows=9000, rate=200.0).observations())
    rows, rng = Rows(tuple(scene.segments), 4), np.random.default_rng(1)
    hum = 0.5 * np.sin(2.0 * np.pi * frequency * scene.time)[:, None] * np.eye(6)[1]
    heard = with_residual(scene, hum + 0.3 * rng.normal(size=(len(scene), 6)))
    left_out = np.zeros(len(scene), dtype=bool)
    left_out[4000:4003] = True
    heard.measured[left_out] += 300.0
    aliases = Aliases(heard, rows, left_out)
    residual = rows.average(np.where(left_out[:, None], 0.0, heard.residual))
    found = [one.effect for one in lines(heard, residual, rows, aliases) if "wrench.force.y" in one.effect.channels]
    assert [one.frequency for one in found] == pytest.approx([frequency] * len(found), abs=0.02)  # type: ignore[attr-defined]
    assert found
    shown = rows.average(hum[:, 1])
    assert aliases.passed(frequency) == pytest.approx(np.std(shown[:-1]) / (0.5 / np.sqrt(2.0)), rel=0.02)
    assert folded(frequency, 50.0) == pytest.approx(min(abs(frequency - 50.0 * k) for k in range(3)))


def test_no_line_is_sought_where_the_motion_takes_up_the_whole_band() -> None:
    """Encoders that are all noise: there was no line to be found, and its alias at the rate of the averages was proposed."""
    bench = Bench(5, rows=9000, rate=200.0)
    bench.q += np.random.default_rng(2).normal(size=bench.q.shape)
    scene = scene_of(bench.observations())
    rows = Rows(tuple(scene.segments), 4)
    aliases = Aliases(scene, rows, np.zeros(len(scene), dtype=bool))
    assert lines(scene, rows.average(scene.residual), rows, aliases) == []


@pytest.mark.inject
@pytest.mark.parametrize("frequency", [18.3, 32.1])
def test_a_hum_is_told_by_the_frequency_and_the_size_that_were_recorded(frequency: float) -> None:
    """A search works on means of two rows; what is quicker than these was told by its alias, and as half of what it is."""
    case = Bench(6, rows=12000, rate=100.0)
    case.wrench[:, 1] += 0.03 * np.sin(2.0 * np.pi * frequency * case.t + 0.4)
    work = diagnose(scene_of(case.observations()))
    (finding,) = work.diagnosis.findings
    assert work.bench.rows.stride == 2
    assert finding.effect == "vibration"
    assert finding.parameters["frequency"].value == pytest.approx(frequency, abs=2e-3)
    assert finding.parameters["rms_signal"].value == pytest.approx(0.03 / np.sqrt(2.0), rel=0.1)

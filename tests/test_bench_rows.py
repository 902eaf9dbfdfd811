"""What the bench counts and where its averaged rows lie: channels without data, segments, spectral lines, generic inputs."""

from collections import Counter
from dataclasses import replace

import numpy as np
import pytest

from galen_hw.diagnosis.detection.proposal import moment
from galen_hw.diagnosis.detection.spectral_lines import lines
from galen_hw.diagnosis.estimation.dataset import Bench as Dataset
from galen_hw.diagnosis.estimation.normal_equations import Scorer
from galen_hw.diagnosis.findings.quantities import readable
from galen_hw.diagnosis.identifiability.motions import recipes
from galen_hw.diagnosis.lack_of_fit.basis_functions import Inputs
from galen_hw.diagnosis.stats.aliasing import Aliases
from galen_hw.diagnosis.stats.sampling import Rows
from galen_hw.physics.effects.registry import scene_of
from galen_hw.physics.effects.sensor import Gain
from galen_hw.physics.effects.timing import TimeDelay
from galen_hw.physics.effects.traits import Line
from galen_hw.physics.observations import Observations
from galen_hw.physics.scenes.base import Scene
from tests.diagnosis_cases import WRENCH, Bench


def measured(*, torques: bool) -> Observations:
    """A tool that turns, with twice the noise later on; `torques` false: the sensor has none, and nothing would turn it."""
    case = Bench(3, rows=2000)
    seen = case.observations()
    if torques:
        return seen
    still = {name: np.zeros(len(case.t)) for name in WRENCH[3:]}
    simulation = {name: case.wrench[:, k] * (k < 3) for k, name in enumerate(WRENCH)}
    return replace(seen, columns=dict(seen.columns) | still, simulation=simulation)


def scored(seen: Observations) -> Scorer:
    """Noise learnt from the recording itself, then a residual twice as large."""
    bench = Dataset(scene_of(seen))
    bench.learn_noise([])
    bench.update_state(y=2.0 * bench.whole)
    return Scorer(bench, [])


def test_channels_without_data_do_not_dilute_the_misfit() -> None:
    all_six, forces = (scored(measured(torques=there)) for there in (True, False))
    assert forces.bench.without_data.tolist() == [False] * 3 + [True] * 3
    assert all_six.misfit([]) == pytest.approx(4.0, rel=0.1)
    assert forces.misfit([]) == pytest.approx(4.0, rel=0.1)
    assert forces.bench.noise.effective == pytest.approx(all_six.bench.noise.effective / 2.0, rel=0.2)
    assert forces.bench.noise.degrees == pytest.approx(all_six.bench.noise.degrees / 2.0, rel=0.01)


def in_segments(count: int, length: int) -> Scene:
    """A still recording of so many segments."""
    case = Bench(4, rows=count * length)
    seen = case.observations()
    return scene_of(replace(seen, columns=dict(seen.columns) | {"segment": np.repeat(np.arange(float(count)), length)}))


def test_a_row_of_the_average_begins_where_its_group_does() -> None:
    scene = in_segments(20, 101)
    rows = Rows(tuple(scene.segments), 10)
    for row in (0, 11, 57, len(rows) - 1):
        assert moment(scene, rows, row) == scene.time[rows.starts[row]]


@pytest.mark.parametrize("stride", [1, 16])
def test_a_line_has_its_frequency_whatever_rows_are_averaged(stride: int) -> None:
    case = Bench(5, rows=8000, rate=200.0)
    scene = scene_of(case.observations())
    rows = Rows(tuple(scene.segments), stride)
    hum = np.sin(2.0 * np.pi * 4.3 * scene.time)[:, None] * np.ones(6)
    rest = rows.average(hum) + 0.1 * np.random.default_rng(1).normal(size=(len(rows), 6))
    columns = dict(scene.observations.columns) | dict(zip(WRENCH, (scene.simulated + hum).T, strict=True))
    heard = scene_of(replace(scene.observations, columns=columns))
    aliases = Aliases(heard, rows, np.zeros(len(scene), dtype=bool))
    found = [one.effect.line(scene) for one in lines(scene, rest, rows, aliases)]
    assert found
    assert all(isinstance(line, Line) for line in found)
    # A twentieth of a cycle over the recording.
    assert [line.frequency for line in found if line] == pytest.approx(
        [4.3] * len(found), abs=0.05 / np.ptp(scene.time)
    )


def test_inputs_are_differentiated_within_segments() -> None:
    scene = in_segments(2, 800)
    scene.q[800:] += 1.0
    inputs = Inputs.of(scene, Rows(tuple(scene.segments)))
    plain = Inputs.of(in_segments(2, 800), Rows((slice(0, 800), slice(800, 1600))))
    assert np.abs(inputs.rate).max() < 1.5 * np.abs(plain.rate).max()
    assert not inputs.past[800:802].any() or np.abs(inputs.past[800]).max() == 0.0
    assert np.abs(inputs.past[800]).max() == 0.0


def test_recipes_accelerate_as_the_robot_did_whatever_the_grid() -> None:
    scene = scene_of(Bench(6, rows=3000).observations())

    def quickest(step: float) -> float:
        found = next(r for r in recipes(scene, step, ()) if r.name.startswith("quick starts"))
        (part,) = found.parts
        return float(np.abs(np.gradient(np.gradient(part.q, part.time, axis=0), part.time, axis=0)).max())

    coarse, fine = quickest(0.1), quickest(0.05)
    assert fine < 1.5 * coarse


def test_a_value_is_shown_in_the_unit_of_its_error_where_that_is_larger() -> None:
    assert readable(1e-5, 0.3, "rad").unit == "deg"
    assert readable(0.0, 0.01, "m").unit == "mm"
    assert readable(1e-5, np.inf, "rad").unit == "urad"


def test_hypotheses_of_a_family_are_counted_whatever_becomes_of_them() -> None:
    """Renamed, tried and made anew: what a place among so many costs is by those that are there."""
    bench = Dataset(scene_of(Bench(3, rows=1500).observations()))
    bench.learn_noise([])
    scorer = Scorer(bench, [bench.hypothesis(TimeDelay()), bench.hypothesis(Gain(WRENCH[0]))])
    with scorer.trying([bench.hypothesis(TimeDelay())]):
        scorer.rename(len(scorer.base), TimeDelay(between="bows"))
        assert +scorer.families == Counter(h.family for h in scorer.library)
    assert +scorer.families == Counter(h.family for h in scorer.library)
    scorer.rename(len(scorer.base), TimeDelay(between="steps"))
    scorer.retime()
    assert +scorer.families == Counter(h.family for h in scorer.library)

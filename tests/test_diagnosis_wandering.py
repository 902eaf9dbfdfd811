"""Offsets that walk or jump again and again are drifts and steps; noise that forgets is noise, and what passes for it is told."""

import sys
from pathlib import Path

import numpy as np
import pytest
from scipy.signal import lfilter

sys.path.insert(0, str(Path(__file__).parent))

from diagnosis_cases import Array, Bench
from test_diagnosis_sweeps import AVERAGED, sweep

from galen_hw.diagnosis.pipeline import diagnose
from galen_hw.diagnosis.result import Diagnosis
from galen_hw.physics.effects.registry import scene_of

pytestmark = pytest.mark.inject

ROWS, RATE = 6000, 50.0
X, Z = "wrench.force.x", "wrench.force.z"


def told(bench: Bench) -> tuple[Diagnosis, list[tuple[str, list[str]]]]:
    """The answer, and what was found where."""
    diagnosis = diagnose(scene_of(bench.observations())).diagnosis
    return diagnosis, [(f.effect, f.channels) for f in diagnosis.findings]


def walk(seed: int, rows: int = ROWS) -> Array:
    """Sum of white steps, rms 1."""
    x = np.cumsum(np.random.default_rng(seed).normal(size=rows))
    return np.asarray((x - x.mean()) / x.std())


@pytest.mark.parametrize("size", [1.0, 8.0])
@pytest.mark.parametrize("seed", [21, 23, 24])
def test_a_walk_is_a_drift(size: float, seed: int) -> None:
    """Every step of it is white: nothing parts its slow end from the noise of its quick one but that it never forgets."""
    bench = Bench(seed, ROWS, RATE)
    bench.wrench[:, 2] += size * bench.noise[:, 2].std() * walk(seed)
    diagnosis, found = told(bench)
    assert (diagnosis.verdict, found) == ("explained", [("drift", [Z])])


@pytest.mark.parametrize("memory", [0.5, 2.0])
def test_noise_that_forgets_is_no_drift_but_told(memory: float) -> None:
    """Of so many seconds: an effect that is as slow would have to be larger to be seen, and the answer says so."""
    bench = Bench(31, ROWS, RATE)
    plain, _ = told(bench)
    keeps = np.exp(-1.0 / (RATE * memory))
    slow = lfilter([np.sqrt(1.0 - keeps**2)], [1.0, -keeps], np.random.default_rng(5).normal(size=ROWS))
    bench = Bench(31, ROWS, RATE)
    bench.noise[:, 2] += 3.0 * bench.noise[:, 2].std() * slow
    diagnosis, found = told(bench)
    assert (diagnosis.verdict, found) == ("agrees", [])
    assert seen(diagnosis) > 3.0 * seen(plain)


def test_noise_that_forgets_is_no_step_where_the_recording_has_gaps() -> None:
    """No run is long enough by itself to show how slow the noise is: all together are."""
    keeps = np.exp(-1.0 / (RATE * 2.0))
    slow = lfilter([np.sqrt(1.0 - keeps**2)], [1.0, -keeps], np.random.default_rng(6).normal(size=(ROWS, 6)), axis=0)
    bench = Bench(33, ROWS, RATE)
    bench.noise += 0.5 * bench.noise.std(axis=0) * slow
    whole = bench.observations()
    kept = whole.taken(np.flatnonzero((bench.t % 20.0 < 6.0) | (bench.t % 20.0 > 9.0)))
    diagnosis = diagnose(scene_of(kept)).diagnosis
    assert (diagnosis.verdict, [f.effect for f in diagnosis.findings]) == ("agrees", [])
    assert any("gaps, the longest of 3.04 s" in note for note in diagnosis.notes)


def seen(diagnosis: Diagnosis) -> float:
    """The smallest effect that would have been seen in force z, N."""
    note = next(n for n in diagnosis.notes if n.startswith("an effect of this rms"))
    return float(note.split(Z)[1].split(",")[0])


@pytest.mark.parametrize("size", [1.5, 15.0])
def test_bumps_of_which_none_pays_alone_are_steps(size: float) -> None:
    """One of three takes a quarter of what is there; together they take all."""
    bench = Bench(9, ROWS, RATE)
    bumps = ((30.0, 1.0), (61.0, -2.0), (90.0, 1.5))
    for moment, jump in bumps:
        bench.wrench[:, 0] += size * jump * bench.noise[:, 0].std() * (bench.t > moment)
    diagnosis, found = told(bench)
    assert (diagnosis.verdict, found) == ("explained", [("step", [X])])
    moments = sorted(p.value for name, p in diagnosis.findings[0].parameters.items() if name.endswith("moment"))
    assert moments == pytest.approx([moment for moment, _ in bumps], abs=0.2)


@pytest.mark.parametrize("seed", [21, 22])
def test_many_bumps_are_no_drift(seed: int) -> None:
    bench = Bench(seed, ROWS, RATE)
    for moment, jump in ((15, 1.0), (33, -1.3), (50, 1.7), (71, -2.0), (88, 0.8), (104, 1.2)):
        bench.wrench[:, 0] += 3.0 * jump * bench.noise[:, 0].std() * (bench.t > moment)
    diagnosis, found = told(bench)
    assert (diagnosis.verdict, found) == ("explained", [("step", [X])])


def test_a_zero_that_walks_during_a_sweep_of_poses_is_mostly_a_drift() -> None:
    """Fifty-six rows have no spectrum; but noise of one pose knows nothing of the next. Some walks are more of a jump."""
    found = []
    for seed in range(10, 22):
        moved = np.zeros((56, 6))
        moved[:, 2] = 6.0 * AVERAGED[2] * walk(seed, 56)
        found.append({f.effect for f in sweep(np.random.default_rng(seed), moved).findings})
    assert sum(one == {"drift"} for one in found) >= 8
    assert all(one & {"drift", "step"} for one in found)


def test_sweeps_of_poses_that_only_read_noise_agree() -> None:
    verdicts = [sweep(np.random.default_rng(seed)).verdict for seed in range(100, 112)]
    assert verdicts == ["agrees"] * 12

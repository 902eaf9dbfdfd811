"""The noise of a channel: what it colours it whitens, on runs of any length; empty columns cost nothing and change nothing."""

import itertools
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.fft import dct
from scipy.signal import lfilter

sys.path.insert(0, str(Path(__file__).parent))

import diagnosis_parts as parts
from diagnosis_cases import SIGMA, WRENCH
from diagnosis_cases import Bench as Cases

from galen_hw.diagnosis.detection.contacts import contacts
from galen_hw.diagnosis.detection.steps import _jumps
from galen_hw.diagnosis.estimation.dataset import Bench as DiagnosisBench
from galen_hw.diagnosis.estimation.model import Model
from galen_hw.diagnosis.noise.estimator import estimate
from galen_hw.diagnosis.noise.low_frequency import deviances, plateaus, whitest
from galen_hw.diagnosis.noise.spectrum import Noise
from galen_hw.diagnosis.stats.sampling import Rows
from galen_hw.diagnosis.validation.other_recording import noise_ratio
from galen_hw.physics.effects.columns import Columns
from galen_hw.physics.effects.drift import WALK
from galen_hw.physics.effects.events import Contact, Vibration
from galen_hw.physics.effects.registry import scene_of


def noise(*lengths: int) -> Noise:
    """Slow noise beside white in two channels, on runs of these lengths."""
    ends = np.cumsum([0, *lengths]).tolist()
    rows = Rows(tuple(slice(a, b) for a, b in itertools.pairwise(ends)))
    edges = np.geomspace(1e-3, 0.5, 20)
    middle = np.sqrt(edges[1:] * edges[:-1])
    levels = np.stack([1.0 + 0.02 / middle, np.ones_like(middle)], axis=-1)
    return Noise(rows, edges, levels, np.ones(2), 1e4, np.eye(2), np.zeros(2))


@pytest.mark.parametrize("lengths", [(4000,), (3989,), (2000, 1999, 50), (1009, 997)])
def test_what_is_coloured_is_whitened_again(lengths):
    """Even, prime and short runs: white noise comes back, and what is slow is slow."""
    model = noise(*lengths)
    white = np.random.default_rng(3).normal(size=(sum(lengths), 2))
    coloured = model.colour(white, 0)
    assert coloured.shape == white.shape
    back = model.whiten(coloured, 0)
    inner = slice(20, lengths[0] - 20)
    assert np.max(np.abs((back - white)[inner])) < (1e-9 if lengths[0] == 4000 else 0.2)
    assert np.std((back - white)[: lengths[0]]) < 0.02
    assert np.std(np.convolve(coloured[: lengths[0], 0], np.ones(50) / 50.0, "valid")) > 1.5 * np.std(
        np.convolve(white[: lengths[0], 0], np.ones(50) / 50.0, "valid")
    )


def slowest(kind: str, n: int = 12_000, channels: int = 20, *, together: bool = True) -> np.ndarray:
    """(channels,) estimated over true level at a fifth of the slowest measured frequency; learnt together or one by one."""
    rng = np.random.default_rng(8)
    white, f = rng.normal(size=(n, channels)), np.fft.rfftfreq(n)
    true = {
        "white": np.ones_like(f),
        "flicker": 1e-3 / np.maximum(f, f[1]),
        "memory": 0.5 + 20.0 / (1.0 + (f / 0.008) ** 2),
    }
    rest = np.fft.irfft(np.fft.rfft(white, axis=0) * np.sqrt(true[kind])[:, None], n, axis=0)
    rows = Rows((slice(0, n),))
    constant, found = np.ones((n, 1)) / np.sqrt(n), []
    for part in (rest,) if together else np.split(rest, channels, axis=1):
        width = part.shape[1]
        learnt = estimate(part, [constant] * width, rows, ordered=True, steps=np.zeros(width))
        found.append(learnt.spectrum(np.array([2.0 / n]))[0])
    return np.concatenate(found) / true[kind][2]


@pytest.mark.parametrize("kind", ["white", "flicker", "memory"])
def test_the_spectrum_goes_on_below_what_is_measured_as_it_came(kind):
    """Flat below the corner of noise with a memory, where a line would go on rising; rising where all of it rises."""
    assert 0.7 < np.median(slowest(kind)) < 1.4


def test_a_corner_shows_in_one_channel_and_flicker_noise_never_passes_for_one():
    """A drift in noise with a memory is seen only where its shelf is known; one in flicker noise must not be made up."""
    assert np.mean(np.abs(np.log(slowest("memory", together=False))) < np.log(2.0)) > 0.8
    assert np.mean(slowest("flicker", 6_000, 40, together=False) > 0.25) > 0.9


def shaped(kind: str, n: int = 6_000, channels: int = 40) -> np.ndarray:
    """(n, channels) white noise beside as much again of another kind, which it meets at a hundredth of the rate."""
    rng = np.random.default_rng(9)
    white, slow = rng.normal(size=(2, n, channels))
    if kind == "walk":
        return white + 0.06 * np.cumsum(slow, axis=0)
    if kind == "forgets":  # within a fiftieth
        return white + 0.06 * lfilter([1.0], [1.0, -np.exp(-50.0 / n)], slow, axis=0)
    f = np.fft.rfftfreq(n)
    return white + np.fft.irfft(np.fft.rfft(slow, axis=0) * np.sqrt(0.01 / np.maximum(f, f[1]))[:, None], n, axis=0)


@pytest.mark.parametrize(
    ("kind", "least", "most"), [("walk", 0.6, 1.0), ("forgets", 0.0, 0.05), ("flicker", 0.0, 0.05)]
)
def test_what_walks_and_what_only_is_slow(kind: str, least: float, most: float) -> None:
    """Of walks seven in ten are known for certain: by chance one may hardly wander in its slowest waves."""
    rest = shaped(kind)
    rest = rest - rest.mean(axis=0)
    constant = np.ones((len(rest), 1)) / np.sqrt(len(rest))
    width = rest.shape[1]
    learnt = estimate(rest, [constant] * width, Rows((slice(0, len(rest)),)), ordered=True, steps=np.zeros(width))
    assert least <= float(np.mean(learnt.random_walks(rest, WALK))) <= most


@pytest.mark.parametrize("apart", [False, True])
def test_what_neighbouring_poses_share_is_no_noise(apart: bool) -> None:
    """A walk of 56 poses; of white noise one channel in a hundred at most is thought smaller."""
    rng, rows = np.random.default_rng(10), Rows((slice(0, 56),))
    white = rng.normal(size=(56, 200))
    rest = np.concatenate([white, white + np.cumsum(rng.normal(size=(56, 200)), axis=0)], axis=1)
    rest = rest - rest.mean(axis=0)
    basis = [np.ones((56, 1)) / np.sqrt(56.0)] * 400
    sigma = estimate(rest, basis, rows, ordered=True, steps=np.zeros(400), static_poses=apart).sigma
    plain = rest.std(axis=0, ddof=1)
    assert np.mean(sigma[:200] < 0.99 * plain[:200]) <= 0.02
    assert np.median(sigma[200:] / plain[200:]) < (0.5 if apart else 1.01)
    assert np.median(sigma[200:]) > 1.0


def test_an_awkward_length_is_whitened_like_the_length_beside_it():
    """A prime of rows goes on into its mirror image: all but the last rows are those of a run that is one row longer."""
    x = np.cumsum(np.random.default_rng(5).normal(size=(4000, 1)), axis=0) * 0.1
    even, prime = noise(4000).whiten(x, 0), noise(3989).whiten(x[:3989], 0)
    assert np.max(np.abs(even[:3800] - prime[:3800])) < 0.02 * np.std(even)


def test_several_channels_at_once_are_each_by_itself():
    """(M, c, k) columns, channels in any order."""
    model = noise(1013)
    x = np.random.default_rng(6).normal(size=(1013, 2, 3))
    both = model.whitened_each(model.transformed(x), (1, 0))
    assert np.allclose(both[:, 0], model.whiten(x[:, 0], 1))
    assert np.allclose(both[:, 1], model.whiten(x[:, 1], 0))


def test_columns_that_stay_empty_are_left_empty():
    """A hum with coefficients of its own in every channel: whitened as if each channel stood alone."""
    bench = parts.diagnosed("nothing").bench
    names = bench.scene.channels
    together, alone = bench.hypothesis(Vibration(names, 7.0, 2)), bench.hypothesis(Vibration(names[2:3], 7.0, 2))
    assert together.raw.live().sum() == len(names) * alone.count
    at, own = together.nonzero_columns(2)
    assert at.tolist() == list(range(2 * alone.count, 3 * alone.count))
    assert np.allclose(own, alone.nonzero_columns(2)[1])
    assert not together.white.values[:, 2, : 2 * alone.count].any()


def test_a_column_with_few_values_is_not_empty():
    """The rows that are looked at first need not hold one."""
    values = np.zeros((1000, 2, 2))
    values[501, 1, 0] = 1.0
    assert Columns((0, 1), values).live().tolist() == [[False, False], [True, False]]


def test_the_gain_of_a_jump_in_slow_noise_is_that_of_generalised_least_squares():
    """All moments by two transforms, against the covariance matrix of the same noise, constants free."""
    n, model = 300, noise(300)
    rest = np.random.default_rng(9).normal(size=(n, 2)) + 0.8 * (np.arange(n) >= 130)[:, None]
    gain = _jumps(rest, model)
    line = np.arange(n) / (2.0 * n)
    basis = dct(np.eye(n), axis=0, norm="ortho")
    for c in range(2):
        inverse = basis.T @ np.diag(1.0 / model.spectrum(line)[:, c]) @ basis
        for moment in (40, 130, 250):
            X = np.stack([np.ones(n), np.arange(n) >= moment], axis=-1)
            one = X[:, :1]
            full, bare = (
                rest[:, c] @ inverse @ A @ np.linalg.solve(A.T @ inverse @ A, A.T @ inverse @ rest[:, c])
                for A in (X, one)
            )
            assert gain[moment - 1, c] == pytest.approx(full - bare, rel=1e-9)
    assert abs(int(np.argmax(gain[:, 1])) + 1 - 130) < 5


def test_a_touch_too_weak_for_its_single_samples_names_the_channels_that_feel_it():
    """A fiftieth of the time in two channels: by the squares of single samples one of them seems to have no part in it."""
    scene = parts.diagnosed("nothing").bench.scene
    n, rng = len(scene), np.random.default_rng(4)
    rest = rng.normal(size=(n, len(scene.channels)))
    rest[n // 3 : n // 3 + n // 50, :2] += 1.2
    found = [s.effect.channels for s in contacts(scene, rest, Rows(tuple(scene.segments)))]
    assert scene.channels[:2] in [tuple(names) for names in found]


@pytest.mark.parametrize("runs", [(3000,), (1200, 1800), (1000, 500, 1500)])
def test_noise_with_a_memory_passes_for_jumps_and_jumps_do_not_pass_for_it(runs):
    """A staircase of six jumps that fits slow noise best is worth less than that noise; a jump in white noise is worth more."""
    rng, rows = np.random.default_rng(8), sum(runs)
    ends = np.cumsum([0, *runs]).tolist()
    parts_ = [slice(a, b) for a, b in itertools.pairwise(ends)]
    keeps = np.exp(-1.0 / 60.0)
    slow = lfilter([np.sqrt(1.0 - keeps**2)], [1.0, -keeps], rng.normal(size=rows)) + rng.normal(size=rows)
    edges = [0, rows]
    for _ in range(6):
        gains = {}
        for k in range(20, rows - 20, 5):
            a, b = max(e for e in edges if e <= k), min(e for e in edges if e > k)
            if k > a:
                gains[k] = (k - a) * (b - k) / (b - a) * (slow[a:k].mean() - slow[k:b].mean()) ** 2
        edges = sorted([*edges, max(gains, key=lambda k: gains[k])])
    stairs = np.concatenate([np.full(b - a, slow[a:b].mean()) for a, b in itertools.pairwise(edges)])
    after = np.arange(rows) >= rows // 3
    jump = rng.normal(size=rows) + 1.0 * after
    level = np.where(after, jump[after].mean(), jump[~after].mean())
    residuals = np.stack([slow - slow.mean(), slow - stairs, jump - jump.mean(), jump - level], axis=-1)
    as_noise, with_stairs, as_noise_too, with_jump = deviances(residuals, parts_, 30.0 / (2.0 * np.pi * rows))
    one = np.log(rows) + 2.0 * np.log(rows / 4.0)
    assert as_noise - with_stairs < 6.0 * one
    assert as_noise_too - with_jump > one


def test_what_has_humps_is_no_noise_with_a_corner():
    """The corner of physics that a model leaves says nothing of the noise below it."""
    centres, lines = np.geomspace(1e-3, 0.45, 15), np.geomspace(18.0, 4000.0, 15)
    corner = 0.01 + 20.0 / (1.0 + (centres / 0.02) ** 2)
    humps = corner + 3.0 * np.exp(-(np.log(centres / 0.15) ** 2) / 0.1)
    plateau = plateaus(centres, np.stack([corner, humps], axis=-1), lines, 3e-4)
    assert plateau[0] == pytest.approx(20.0, rel=0.3)
    assert np.isnan(plateau[1])


def test_rounding_that_hides_the_noise_of_another_recording_is_not_less_noise() -> None:
    """A sensor that rests between two steps reads the same all along; by its second differences it had no noise at all."""
    case = Cases(4)
    step = 2.0 * SIGMA[0]
    read = np.round((case.wrench + case.noise)[:, 0] / step) * step
    columns = dict(case.observations().columns) | {WRENCH[0]: read}
    bench = DiagnosisBench(scene_of(replace(case.observations(), columns=columns)), 0.3, 0)
    bench.learn_noise([])
    model = Model(bench, [bench.hypothesis_of(None, c) for c in bench.constants()], [], bench.whitened(bench.whole))
    quiet = 0.1 * model.residual()
    quiet[:, 0] = step * (np.arange(len(quiet)) == 1000)
    ratio = noise_ratio(model, quiet)
    assert ratio[0] == 1.0
    assert ratio[1:] == pytest.approx(0.01, rel=0.05)


def test_the_edges_of_a_touch_are_not_the_first_recording_s_noise() -> None:
    """It sets in at once, and no smooth shape does: what is left of its edges had made another recording seem quieter."""
    case = Cases(4)
    case.wrench[(case.t > 30.0) & (case.t < 36.0), 2] += 100.0 * SIGMA[2]
    bench = DiagnosisBench(scene_of(case.observations()), 0.0, 0)
    bench.learn_noise([])
    touch = bench.hypothesis(Contact((WRENCH[2],), ((29.5, 36.5),), 4))
    model = Model(
        bench, [bench.hypothesis_of(None, c) for c in bench.constants()], [touch], bench.whitened(bench.whole)
    )
    assert noise_ratio(model, Cases(5, rows=len(bench.rows)).noise)[2] == pytest.approx(1.0, rel=0.2)


def test_few_bands_that_scatter_as_white_noise_does_are_white() -> None:
    """A level twice too low in eighteen lines is luck; eight times too high it is colour."""
    lines = np.array([18.0, 18.0, 20.0, 37.0])
    levels = np.array([[0.5, 8.0], [1.3, 1.0], [1.1, 1.0], [1.0, 1.0]])
    told = whitest(levels, lines)
    assert told[:, 0] == pytest.approx(np.full(4, lines @ levels[:, 0] / lines.sum()))
    assert told[:, 1] == pytest.approx(levels[:, 1])

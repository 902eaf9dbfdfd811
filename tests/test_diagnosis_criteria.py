"""What a finding must show: the paired test on held-out errors and the share that is worth telling."""

from dataclasses import replace

import numpy as np
import pytest

from galen_hw.diagnosis.stats.criteria import Criteria
from galen_hw.diagnosis.stats.paired_test import Gain, paired

ROWS = 4000


def gain(
    effect: float, *, learnt: float = 1.0, when: slice = slice(None), other: float = 3.0, parameters: int = 0
) -> Gain:
    """Of an effect (rms in units of the noise) that is learnt `learnt` times its size, beside another in two channels."""
    rng = np.random.default_rng(4)
    noise, shape = rng.normal(size=(ROWS, 2)), np.zeros((ROWS, 2))
    shape[when, 0] = np.sqrt(2.0) * np.sin(np.arange(ROWS)[when] / 17.0)
    without = noise + effect * shape
    return paired(without, without - learnt * effect * shape, np.array([effect**2, other**2]), parameters=parameters)


@pytest.mark.parametrize(
    ("effect", "learnt", "other", "told"),
    [
        (1.0, 1.0, 3.0, True),
        (1.0, 1.0, 0.0, True),
        (0.2, 1.0, 0.0, True),
        (0.2, -1.0, 0.0, False),
        (0.0, 1.0, 3.0, False),
    ],
)
def test_what_is_there_is_told(effect: float, learnt: float, other: float, told: bool) -> None:
    """By size and by sign; nothing has no share, and what was learnt the wrong way round has less than none."""
    assert gain(effect, learnt=learnt, other=other).credible() is told


def test_a_share_that_nobody_cares_for_is_not_told() -> None:
    """Surely there, half a hundredth of the excess: the level is an argument."""
    small = gain(0.3, other=4.0)
    assert 0.0001 < small.share < 0.01
    assert small.fall > Criteria().standard_errors() * small.error
    assert not small.credible()
    assert small.credible(Criteria(least_share=0.0001))
    assert replace(small, completes=True).credible(), "with it noise alone is left: no law beside it is rough"


def test_one_piece_of_many_is_enough() -> None:
    """A touch lives in one block: that all others are silent makes it no less sure."""
    touch = gain(3.0, when=slice(1000, 1100), other=0.0)
    assert touch.credible()


def test_noise_that_was_fitted_is_not_told() -> None:
    """On the rows that it was learnt on, what is learnt takes as many squares as it has parameters; it owes twice as many."""
    rng = np.random.default_rng(5)
    noise, X = rng.normal(size=(ROWS, 1)), rng.normal(size=(ROWS, 60))
    rest = noise - X @ np.linalg.lstsq(X, noise, rcond=None)[0]
    fitted = paired(noise, rest, np.zeros(1), parameters=60)
    assert fitted.fall < 0.0
    assert not fitted.credible()


def test_a_name_beside_much_that_stays_unexplained_must_take_a_tenth_of_that() -> None:
    """Three hundredths of the excess: told where hardly anything is left, not where nearly all of it is."""
    small = gain(0.7, other=4.0)
    assert 0.02 < small.share < 0.05
    assert small.credible(unexplained=0.1)
    assert not small.credible(unexplained=0.95)

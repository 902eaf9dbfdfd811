"""A place of a kind is dropped only where held-out rows could have wanted it."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from galen_hw.diagnosis.validation.holdout import _places
from galen_hw.diagnosis.validation.support import HoldoutTest
from galen_hw.physics.effects.compliance import Hardening

ROWS = 4000


class Holding:
    """A model of effects that stand in joints; what it leaves on held-out rows are those that it does not hold."""

    def __init__(self, effects: list[Any], shapes: list[np.ndarray], noise: np.ndarray) -> None:
        self.effects, self._shapes, self._noise = effects, shapes, noise
        dead = np.zeros(noise.shape[1], dtype=bool)
        self.bench = SimpleNamespace(scene=SimpleNamespace(clock=True), without_data=dead)

    def without(self, left: list[Any]) -> "Holding":
        return Holding([e for e in self.effects if e not in left], self._shapes, self._noise)

    def residual(self) -> np.ndarray:
        return self._noise + sum(s for k, s in enumerate(self._shapes) if k not in {e.place for e in self.effects})


def hardening(place: int) -> SimpleNamespace:
    return SimpleNamespace(effect=Hardening("tilt"), place=place, raw=SimpleNamespace(channels=[0]))


@pytest.mark.parametrize(("sigmas", "asked"), [(2.0, False), (20.0, True)])
def test_a_place_that_the_held_out_motion_hardly_rouses_is_not_refused_by_it(sigmas: float, asked: bool) -> None:
    rng = np.random.default_rng(2)
    wave = np.sin(np.linspace(0.0, 60.0, ROWS))[:, None]
    wave *= 1.0 / np.sqrt(float(np.sum(wave**2)))
    noise = rng.normal(size=(ROWS, 1))
    model: Any = Holding([hardening(0), hardening(1)], [40.0 * wave, sigmas * np.roll(wave, 700, axis=0)], noise)
    places = _places(model, comparison_of(model), 1)
    assert 0 in places, "what the motion rouses is asked about"
    assert any(one.credible() for one in places[0])
    assert (1 in places) is asked


def comparison_of(model: Any) -> HoldoutTest:
    """On rows of white noise of unit size."""

    def rest(part: Any) -> np.ndarray:
        return np.asarray(part.residual())

    return HoldoutTest(np.ones(rest(model).shape[1]), rest, rest, model, model.without(model.effects))


@pytest.mark.parametrize("slow", [False, True])
@pytest.mark.parametrize(
    ("there", "belied", "why"),
    [
        ([1.0, 1.0], False, "it is there"),
        ([1.0, 0.0], True, "it is not there in the second channel"),
        ([0.8, 0.8], False, "its size is wrong"),
        ([0.45, 0.45], False, "half as large as it was learnt"),
    ],
)
def test_what_held_out_rows_do_not_show_in_one_channel_is_belied_by_it(
    slow: bool, there: list[float], belied: bool, why: str
) -> None:
    """It does in both channels what was learnt, or in the first alone, or there less than it might; noise white or slow."""
    rng = np.random.default_rng(4)
    noise = rng.normal(size=(ROWS, 2))
    if slow:
        noise = np.cumsum(noise - 0.05 * np.cumsum(noise, axis=0) / np.arange(1, ROWS + 1)[:, None], axis=0)
        noise /= noise.std(axis=0)
    wave = np.sqrt(2.0) * np.sin(np.linspace(0.0, 160.0, ROWS))
    learnt = 0.7 * np.stack([wave, np.roll(wave, 9)], axis=1)
    model: Any = Holding([hardening(0)], [learnt], noise + learnt * (np.array(there) - 1.0))
    assert comparison_of(model).belied(model.without(model.effects), [0, 1], 1) is belied, why

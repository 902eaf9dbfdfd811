"""Links with momentum in the gap of a play."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from galen_hw.physics.operators.filters import impulse, play
from galen_hw.physics.operators.gap_dynamics import gap

COASTING = np.array([0.003, 0.05, 0.4])


def loads(seed: int, rows: int = 600) -> tuple[np.ndarray, np.ndarray]:
    """A clock that is not even, and loads (N, 3) that take a link from stop to stop and leave it between them."""
    rng = np.random.default_rng(seed)
    t = np.cumsum(rng.uniform(0.004, 0.012, rows))
    phase = rng.uniform(0.0, 2.0 * np.pi, (3, 3))
    waves = np.sin(np.array([2.0, 5.0, 11.0]) * t[:, None, None] + phase) * np.array([4.0, 6.0, 12.0])
    return t, waves.sum(axis=2)


def test_a_link_moves_as_its_equation_says():
    """Against steps of a fiftieth of a row, straight loads between the rows, stops that throw nothing back."""
    t, u = loads(1)
    fine = np.interp(np.arange(0, len(t) - 1, 0.02), np.arange(len(t)), t)
    y, v, at = np.zeros(3), np.zeros(3), [np.zeros(3)]
    forces = np.stack([np.interp(fine, t, u[:, j]) for j in range(3)], axis=-1)
    for k in range(1, len(fine)):
        dt = fine[k] - fine[k - 1]
        kept = np.exp(-dt / COASTING)
        mean = 0.5 * (forces[k - 1] + forces[k])
        was, v = v, kept * v + (1.0 - kept) * mean
        y = y + mean * dt - COASTING * (v - was)
        v = np.where(np.abs(y) > 1.0, 0.0, v)
        y = np.clip(y, -1.0, 1.0)
        if k % 50 == 0:
            at.append(y)
    placed = gap(t, u, COASTING, None)[0][: len(at)]
    assert np.sqrt(np.mean((placed - np.array(at)) ** 2)) < 0.01
    held = np.mean(np.abs(placed) == 1.0, axis=0)
    assert np.all((held > 0.1) & (held < 0.9))


def test_without_momentum_it_is_the_stop_operator_of_the_impulse():
    """What a link that stops at once does is given less its play."""
    t, u = loads(2)
    given_ = impulse(t, u, None)[0]
    stop = given_ - play(given_, np.ones(3), None)[0]
    np.testing.assert_allclose(gap(t, u, np.full(3, 1e-9), None)[0], stop, atol=1e-6)


@given(st.integers(1, 599), st.integers(0, 5))
def test_a_stream_goes_on_where_it_was_cut(cut: int, seed: int):
    """The same numbers, wherever."""
    t, u = loads(seed)
    whole, last = gap(t, u, COASTING, None)
    first, between = gap(t[:cut], u[:cut], COASTING, None)
    rest, end = gap(t[cut:], u[cut:], COASTING, between)
    np.testing.assert_allclose(np.concatenate([first, rest]), whole, atol=1e-12)
    np.testing.assert_allclose(end.speed, last.speed, atol=1e-12)

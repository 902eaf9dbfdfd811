"""Operators with memory against their definitions, row by row, however a batch is cut."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from galen_hw.physics.operators.bouc_wen import wear
from galen_hw.physics.operators.filters import LagState, bow, delay, impulse, lag, play, second_order
from galen_hw.physics.operators.stick_slip_servo import MANY_SERVOS, ServoState, servo


def play_by_definition(x: np.ndarray, half_width: np.ndarray, state: np.ndarray | None) -> np.ndarray:
    """p_k = min(max(p_{k-1}, x_k - r), x_k + r)."""
    out, last = [], x[0] if state is None else state
    for row in x:
        last = np.minimum(np.maximum(last, row - half_width), row + half_width)
        out.append(last)
    return np.array(out)


@st.composite
def signals(draw: st.DrawFn) -> np.ndarray:
    """(N, m): slow or jittery, smooth or in steps with plateaus, long enough for either way of computing play."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    n, m = draw(st.integers(1, 1200)), draw(st.integers(1, 3))
    x = np.sin(np.linspace(0.0, draw(st.floats(0.1, 30.0)), n))[:, None] * rng.uniform(0.1, 2.0, m)
    if draw(st.booleans()):
        x = x + 0.01 * rng.normal(size=x.shape)
    return np.round(x, 1) if draw(st.booleans()) else x


@given(signals(), st.lists(st.floats(0.0, 1.0), min_size=3, max_size=3), st.booleans(), st.floats(0.0, 1.0))
def test_play_is_its_definition_to_the_last_bit_wherever_it_is_cut(x, widths, started, where):
    """Corners, doubling and the definition agree, and so does a stream that was cut anywhere."""
    r = np.array(widths[: x.shape[1]])
    state = np.linspace(-0.5, 0.5, x.shape[1]) if started else None
    whole, last = play(x, r, state)
    assert np.array_equal(whole, play_by_definition(x, r, state))
    assert np.array_equal(last, whole[-1])
    cut = int(where * len(x))
    if 0 < cut < len(x):
        first, between = play(x[:cut], r, state)
        assert np.array_equal(np.concatenate([first, play(x[cut:], r, between)[0]]), whole)


def test_play_walks_corners_where_there_are_few_and_doubles_where_there_are_many(monkeypatch):
    """Both ways are taken, and give the same."""
    from galen_hw.physics.operators import filters

    x = np.sin(np.linspace(0.0, 20.0, 1000))[:, None]
    walked = []
    along = filters._along
    monkeypatch.setattr(filters, "_along", lambda *a: walked.append(1) or along(*a))
    slow = play(x, np.array([0.2]), None)[0]
    assert walked
    walked.clear()
    jittery = x + 1e-3 * np.random.default_rng(0).normal(size=x.shape)
    quick = play(jittery, np.array([0.2]), None)[0]
    assert not walked
    assert np.max(np.abs(slow - quick)) < 0.02


@given(signals(), st.booleans(), st.floats(0.0, 1.0))
def test_an_impulse_is_the_area_below_wherever_it_is_cut(x, uneven, where):
    """Trapezia from zero, and a stream that was cut anywhere goes on."""
    t = np.cumsum(np.random.default_rng(len(x)).uniform(0.005, 0.015, len(x))) if uneven else np.arange(len(x)) * 0.01
    whole, last = impulse(t, x, None)
    np.testing.assert_allclose(whole[-1], np.trapezoid(x, t, axis=0), atol=1e-12)
    assert not whole[0].any()
    cut = int(where * len(x))
    if 0 < cut < len(x):
        first, between = impulse(t[:cut], x[:cut], None)
        rest, end = impulse(t[cut:], x[cut:], between)
        np.testing.assert_allclose(np.concatenate([first, rest]), whole, atol=1e-12)
        np.testing.assert_allclose(end.sum, last.sum, atol=1e-12)


CLOCKS = pytest.mark.parametrize("uneven", [False, True])


def clock(uneven: bool) -> np.ndarray:
    steps = np.random.default_rng(0).uniform(0.005, 0.015, 500)
    return np.cumsum(steps) if uneven else np.arange(500) * 0.01


@CLOCKS
def test_a_lag_settles_as_its_equation_says(uneven):
    """A straight line is followed by T behind, all but exp(-t / T) of that at once; even where T is shorter than a row."""
    t = clock(uneven)
    for constant in (0.7, 0.003):
        out, state = lag(t, 3.0 * t[:, None] + 1.0, np.array([constant]), None)
        since = t - t[0]
        exact = 3.0 * t + 1.0 - 3.0 * constant * -np.expm1(-since / constant)
        assert np.allclose(out[:, 0], exact, atol=1e-12)
        assert state.output == pytest.approx(out[-1])
        assert lag(t, np.ones((500, 1)), np.array([constant]), None)[0] == pytest.approx(np.ones((500, 1)))


@CLOCKS
def test_a_second_order_response_is_that_of_its_equation(uneven):
    """Of a ramp from rest: the equation solved by hand (Ogata, Modern Control Engineering, 5-3), on either clock."""
    t, constant, damping = clock(uneven), 0.08, 0.35
    out, _ = second_order(t, 2.0 * (t - t[0])[:, None] + 1.0, constant, damping, None)
    since = (t - t[0]) / constant
    swing = np.sqrt(1.0 - damping**2)
    free = 2.0 * damping * np.cos(swing * since) + (2.0 * damping**2 - 1.0) / swing * np.sin(swing * since)
    exact = 1.0 + 2.0 * constant * (since - 2.0 * damping + np.exp(-damping * since) * free)
    assert np.allclose(out[:, 0], exact, atol=1e-12)
    commands = np.where(since > 0.0, 1.0, 0.0)[:, None]
    held, _ = second_order(t, commands, constant, damping, None, held=True)
    free = np.cos(swing * since) + damping / swing * np.sin(swing * since)
    assert np.allclose(held[:, 0], 1.0 - np.exp(-damping * since) * free, atol=1e-12), "a step, from the first row on"


@given(signals(), st.floats(0.002, 2.0), st.floats(0.1, 0.98), st.booleans(), st.booleans(), st.floats(0.0, 1.0))
def test_responses_go_on_from_any_row(x, constant, damping, even, held, where):
    """A batch cut anywhere gives the same numbers, of a lag and of a second-order response."""
    steps = np.ones(len(x)) if even else np.random.default_rng(len(x)).uniform(0.5, 1.5, len(x))
    t = np.cumsum(steps) * 0.01
    size = 1.0 + np.max(np.abs(x))
    cut = int(where * len(x))
    for run in (
        lambda t, x, state: lag(t, x, np.full(x.shape[1], constant), state, held=held),
        lambda t, x, state: second_order(t, x, constant, damping, state, held=held),
    ):
        whole, last = run(t, x, None)
        assert np.array_equal(last.output, whole[-1])
        if 0 < cut < len(x):
            first, between = run(t[:cut], x[:cut], None)
            then, end = run(t[cut:], x[cut:], between)
            assert np.allclose(np.concatenate([first, then]), whole, atol=1e-9 * size)
            assert np.allclose(end.output, last.output, atol=1e-9 * size)


def test_a_delay_is_the_past():
    """A straight line comes later by the delay, and its first value stands before."""
    t = np.arange(200) * 0.01
    out, _ = delay(t, 3.0 * t[:, None], 0.025, None)
    assert np.allclose(out[:, 0], 3.0 * np.maximum(t - 0.025, 0.0), atol=1e-12)


@given(signals(), st.floats(0.0, 0.5), st.floats(0.01, 2.0), st.floats(1.5, 30.0), st.booleans(), st.floats(0.0, 1.0))
def test_a_servo_that_sticks_goes_on_from_any_row(x, band, constant, slower, holds, where):
    """A batch cut anywhere gives the same numbers, and the joint never stands further off than friction and lag allow."""
    t = np.cumsum(np.random.default_rng(len(x)).uniform(0.5, 1.5, len(x))) * 0.01
    m = x.shape[1]
    r, quick = np.full(m, band), np.full(m, constant)
    slow = np.full(m, np.inf if holds else constant * slower)
    whole, last = servo(t, x, r, quick, slow, None)
    assert np.array_equal(last.output, whole[-1])
    assert np.all(whole <= np.maximum.accumulate(x, axis=0) + 1e-12)
    assert np.all(whole >= np.minimum.accumulate(x, axis=0) - 1e-12)
    cut = int(where * len(x))
    if 0 < cut < len(x):
        first, between = servo(t[:cut], x[:cut], r, quick, slow, None)
        assert np.array_equal(np.concatenate([first, servo(t[cut:], x[cut:], r, quick, slow, between)[0]]), whole)


def servo_by_definition(
    x: np.ndarray, band: float, step: float, constant: float, settling: float, q: float
) -> np.ndarray:
    """Row after row, from q before a step to the first row."""
    share, little = -np.expm1(-step / constant), -np.expm1(-step / settling)
    breaks = band * settling / (settling - constant) if np.isfinite(settling) else band
    out = []
    for c in x.tolist():
        error = c - q
        q += share * (error - np.copysign(band, error)) if abs(error) > breaks else little * error
        out.append(q)
    return np.array(out)


@st.composite
def commands(draw: st.DrawFn) -> np.ndarray:
    """(N,): slow, still, in steps, or full of noise, and from one to the other on the way."""
    rng, parts = np.random.default_rng(draw(st.integers(0, 2**32 - 1))), []
    for _ in range(draw(st.integers(1, 4))):
        n = draw(st.integers(1, 3000))
        slow = draw(st.floats(0.0, 2.0)) * np.sin(
            np.linspace(0.0, draw(st.floats(0.0, 60.0)), n) + rng.uniform(0.0, 6.0)
        )
        noise = draw(st.sampled_from([0.0, 1e-4, 1e-2, 1.0])) * rng.normal(size=n)
        digits = draw(st.sampled_from([1, 3, 12]))
        parts.append(np.round(slow + noise, digits))
    return np.concatenate(parts)


@given(
    commands(), st.floats(0.0, 0.5), st.floats(1e-4, 2.0), st.floats(1.01, 30.0), st.booleans(), st.floats(-1.0, 1.0)
)
def test_a_servo_on_an_even_clock_slips_and_sticks_as_row_by_row(x, band, constant, slower, holds, begun):
    """Phase by phase on an even clock, whatever the command, also beside others and cut somewhere."""
    settling = np.inf if holds else constant * slower
    t, given_ = 0.002 * np.arange(len(x)), [np.array([one]) for one in (band, constant, settling)]
    start = x[0] + begun * band
    out, last = servo(t, x[:, None], *given_, ServoState(-0.002, np.array([start])))
    assert np.allclose(out[:, 0], servo_by_definition(x, band, 0.002, constant, settling, start), rtol=0.0, atol=1e-9)
    assert np.array_equal(last.output, out[-1])
    cut = len(x) // 3
    if cut:
        first, between = servo(t[:cut], x[:cut, None], *given_, ServoState(-0.002, np.array([start])))
        then, _ = servo(t[cut:], x[cut:, None], *given_, between)
        assert np.allclose(np.concatenate([first, then]), out, rtol=0.0, atol=1e-9)


def test_servos_side_by_side_do_what_each_does_by_itself() -> None:
    rng = np.random.default_rng(3)
    count, t = MANY_SERVOS, np.cumsum(rng.uniform(0.001, 0.02, 300))
    x = np.cumsum(rng.normal(size=(300, count)), axis=0)
    r, quick = rng.uniform(0.0, 2.0, count), rng.uniform(1e-3, 0.1, count)
    slow = np.where(np.arange(count) % 2, np.inf, 4.0 * quick)
    for state in (None, ServoState(0.0, rng.normal(size=count))):
        together, last = servo(t, x, r, quick, slow, state)
        for j in range(count):
            own = None if state is None else ServoState(state.time, state.output[j : j + 1])
            one = [v[j : j + 1] for v in (r, quick, slow)]
            assert np.allclose(servo(t, x[:, j : j + 1], *one, own)[0][:, 0], together[:, j], rtol=0.0, atol=1e-12)
        assert np.array_equal(last.output, together[-1])


def test_a_servo_is_play_when_quick_and_a_lag_without_friction():
    """The two limits, by the operators for them; in between it sticks, and creeps where friction is viscous at rest."""
    t = np.arange(2000) * 0.01
    x, none = np.sin(t)[:, None], np.array([np.inf])
    quick = servo(t, x, np.array([0.2]), np.array([1e-6]), none, None)[0]
    assert np.max(np.abs(quick - play(x, np.array([0.2]), None)[0])) < 1e-12
    smooth = servo(t, x, np.zeros(1), np.array([0.3]), none, None)[0]
    assert np.max(np.abs(smooth - lag(t, x, np.array([0.3]), None, held=True)[0])) < 1e-12
    step = np.where(t < 1.0, 0.0, 1.0)[:, None]
    holds, creeps = (servo(t, step, np.array([0.2]), np.array([0.05]), np.array([s]), None)[0] for s in (np.inf, 1.0))
    assert holds[-1] == pytest.approx(0.8)
    assert creeps[-1] == pytest.approx(1.0, abs=1e-6)
    # Where it begins to stick, friction over its creeping speed and stiffness sets the pace: 37 % left after `settling`.
    at = 100 + int(np.argmax(creeps[100:, 0] > 0.8))
    assert (1.0 - creeps[at + 100, 0]) / (1.0 - creeps[at, 0]) == pytest.approx(np.exp(-1.0), rel=0.02)


@given(st.floats(0.0, 0.05), st.floats(0.0, 0.9), st.integers(1, 39), st.booleans())
def test_what_bows_is_delayed_along_its_parabola(late, jitter, cut, even):
    """Exactly for a parabola, at any delay and clock, and the same in pieces."""
    steps = np.full(40, 0.01) if even else 0.01 * (1.0 + jitter * np.random.default_rng(cut).uniform(-0.9, 0.9, 40))
    t = np.cumsum(steps)
    x = np.stack([1.0 + t - 40.0 * t**2, t], axis=1)
    out, _ = delay(t, x, late, None, bowed=True)
    known = t - late >= t[1]
    at = t[known] - late
    np.testing.assert_allclose(out[known], np.stack([1.0 + at - 40.0 * at**2, at], axis=1), atol=1e-12)
    first, state = delay(t[:cut], x[:cut], late, None, bowed=True)
    np.testing.assert_allclose(
        np.concatenate([first, delay(t[cut:], x[cut:], late, state, bowed=True)[0]]), out, atol=1e-12
    )
    np.testing.assert_allclose(bow(t, x, None)[0][2:, 0], -80.0 * steps[2:] ** 2, atol=1e-12)
    first, held = bow(t[:cut], x[:cut], None)
    np.testing.assert_allclose(np.concatenate([first, bow(t[cut:], x[cut:], held)[0]]), bow(t, x, None)[0], atol=1e-14)


@pytest.mark.parametrize("constant", [1e-5, 0.0005, 0.004, 0.01, 0.03])
def test_a_lag_of_what_bows_has_its_constant(constant: float) -> None:
    """A sine through a lag, in closed form: straight lines between the rows had a twelfth of a step squared of another lag."""
    t, w = 0.01 * np.arange(3000), 2.0 * np.pi * 1.3
    x, reply = np.sin(w * t), (np.exp(1j * w * t) / (1.0 + 1j * w * constant)).imag
    straight = lag(t, x[:, None], np.array([constant]), None)[0][:, 0]
    bowed = lag(t, x[:, None], np.array([constant]), None, bows=bow(t, x[:, None], None)[0])[0][:, 0]
    assert np.abs(bowed - reply)[100:].max() < 0.15 * np.abs(straight - reply)[100:].max()


@given(st.floats(1e-4, 10.0), st.integers(1, 39), st.booleans())
def test_a_lag_of_a_parabola_is_its_closed_form(constant, cut, even):
    """y = a + b (t - T) + c (t^2 - 2 T t + 2 T^2) once it has settled, and the same in pieces."""
    steps = np.full(40, 0.01) if even else 0.01 * (1.0 + np.random.default_rng(cut).uniform(-0.8, 0.8, 40))
    t, given_ = np.cumsum(steps), np.array([constant])
    x = (1.0 + t - 40.0 * t**2)[:, None]
    reply = 1.0 + (t - constant) - 40.0 * (t**2 - 2.0 * constant * t + 2.0 * constant**2)
    bows = bow(t, x, None)[0]
    settled = LagState(float(t[1]), reply[1:2], x[1])
    out = lag(t[2:], x[2:], given_, settled, bows=bows[2:])[0]
    np.testing.assert_allclose(out[:, 0], reply[2:], rtol=1e-9, atol=1e-9)
    whole = lag(t, x, given_, None, bows=bows)[0]
    first, state = lag(t[:cut], x[:cut], given_, None, bows=bows[:cut])
    then = lag(t[cut:], x[cut:], given_, state, bows=bows[cut:])[0]
    np.testing.assert_allclose(np.concatenate([first, then]), whole, rtol=1e-7, atol=1e-8)


def worn_step_by_step(x: np.ndarray, reach: float, beta: float, parts: int) -> np.ndarray:
    """dz = dx / reach (1 - |z| (beta sgn(z dx) + 1 - beta)) in small steps."""
    z, out = 0.0, [0.0]
    for d in np.diff(x) / reach / parts:
        for _ in range(parts):
            z += d * (1.0 - abs(z) * (beta * np.sign(d * z) + 1.0 - beta))
        out.append(z)
    return np.array(out)


@pytest.mark.parametrize("beta", [0.1, 0.5, 0.8, 1.0])
def test_a_slope_wears_off_as_its_equation_says(beta):
    x = np.cumsum(np.random.default_rng(3).normal(size=60)) * 0.2
    z, _ = wear(x, 0.7, beta, None)
    assert np.max(np.abs(z)) > 0.5
    assert z == pytest.approx(worn_step_by_step(x, 0.7, beta, 2000), abs=2e-3)


@given(signals(), st.floats(0.01, 3.0), st.floats(0.0, 1.0), st.floats(0.0, 1.0))
def test_what_wears_off_goes_on_from_any_row(x, reach, beta, where):
    whole, last = wear(x[:, 0], reach, beta, None)
    assert np.all(np.abs(whole) <= 1.0 + 1e-12)
    assert last.output == whole[-1]
    cut = int(where * len(x))
    if 0 < cut < len(x):
        first, state = wear(x[:cut, 0], reach, beta, None)
        rest, _ = wear(x[cut:, 0], reach, beta, state)
        assert np.concatenate([first, rest]) == pytest.approx(whole, abs=1e-9)

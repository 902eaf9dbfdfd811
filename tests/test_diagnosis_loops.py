"""Loops of other makers: plays that add up on top of a load, slopes that wear off (Bouc-Wen, Dahl), beside a gain or alone."""

import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parent))

from diagnosis_cases import Array, Bench, Servo, tracked

from galen_hw.diagnosis.pipeline import diagnose
from galen_hw.physics.effects.registry import scene_of

pytestmark = pytest.mark.inject

Y = "wrench.force.y"


def plays(x: Array) -> Array:
    """Ten plays of falling weight, on top of the load (Prandtl-Ishlinskii as Kuhnen writes it, 2003, without its linear part)."""
    reach, out = 0.5 * np.ptp(x), np.zeros_like(x)
    for share in np.linspace(0.05, 0.95, 10):
        y = 0.0
        for i, value in enumerate(x):
            y = min(max(y, value - share * reach), value + share * reach)
            out[i] += np.exp(-3.0 * share) * y
    return out


def wears_off(x: Array, beta: float, power: int) -> Array:
    """Bouc-Wen, of unit height and a quarter of the amplitude long; Dahl's model where beta is 1."""
    reach, z, out = 0.125 * np.ptp(x), 0.0, np.zeros_like(x)
    for i in range(1, len(x)):
        for _ in range(4):
            d = (x[i] - x[i - 1]) / reach / 4.0
            z += d * (1.0 - abs(z) ** power * (beta * np.sign(d * z) + 1.0 - beta))
        out[i] = z
    return out


def bouc_wen(x: Array) -> Array:
    return wears_off(x, 0.5, 1)


def sharper(x: Array) -> Array:
    return wears_off(x, 0.5, 2)


def dahl(x: Array) -> Array:
    return wears_off(x, 1.0, 1)


def found(loop: Callable[[Array], Array], size: float, gain: float = 0.0) -> set[tuple[str, tuple[str, ...]]]:
    """What is found of a loop so many times the noise, and of a gain."""
    bench = Bench(7, 5000, 50.0)
    x, noise = bench.wrench[:, 1].copy(), bench.noise[:, 1].std()
    bench.wrench[:, 1] = (1.0 + gain) * x + size * noise * loop(x) / loop(x).std()
    work = diagnose(scene_of(bench.observations()))
    assert work.diagnosis.verdict == "explained"
    return {(f.effect, tuple(f.channels)) for f in work.diagnosis.findings}


@pytest.mark.parametrize("size", [1.0, 6.0])
@pytest.mark.parametrize("loop", [plays, bouc_wen, sharper, dahl])
def test_a_loop_is_hysteresis_and_nothing_beside(loop: Callable[[Array], Array], size: float) -> None:
    """Plays on top of a load were a creep of many constants, or a gain with something missing."""
    assert found(loop, size) == {("hysteresis", (Y,))}


@pytest.mark.parametrize("gain", [0.03, 0.1])
def test_a_gain_beside_a_loop_stays_one(gain: float) -> None:
    """Weights of both signs are no plays: one of them is the gain."""
    assert found(bouc_wen, 4.0, gain) == {("hysteresis", (Y,)), ("gain", (Y,))}


@pytest.mark.parametrize(("size", "scale"), [(1.0, 0.0), (10.0, 0.0), (3.0, -0.02)])
def test_plays_on_top_of_a_joint_s_motion_are_no_scale(size: float, scale: float) -> None:
    """They had been a gear's scale with something missing; a scale that is there is told beside them."""
    servo = Servo(1, 6000, 50.0)
    x = servo.command[:, 0]
    servo.position[:, 0] = (1.0 + scale) * x + size * servo.sigma * plays(x) / plays(x).std()
    findings = diagnose(scene_of(servo.observations())).diagnosis.findings
    assert {(f.effect, tuple(f.joints)) for f in findings} == {
        (effect, ("pan",)) for effect in ("hysteresis", *(["joint_scale"] if scale else []))
    }


@pytest.mark.parametrize("loop", [bouc_wen, dahl])
def test_a_loud_loop_is_told_with_its_own_shape(loop: Callable[[Array], Array]) -> None:
    """No sum of plays turns round so: what one misses was a contact."""
    bench = Bench(5, 5000, 50.0)
    x, noise = bench.wrench[:, 1].copy(), bench.noise[:, 1].std()
    bench.wrench[:, 1] = x + 20.0 * noise * loop(x) / loop(x).std()
    (finding,) = diagnose(scene_of(bench.observations())).diagnosis.findings
    assert finding.effect == "hysteresis"
    assert finding.parameters["wear"].value == pytest.approx(1.0 if loop is dahl else 0.5, abs=0.05)
    assert finding.parameters["reach"].value == pytest.approx(0.125 * np.ptp(x), rel=0.03)


@pytest.mark.parametrize(("loop", "give"), [(dahl, 0.0), (bouc_wen, 1.5e-3)])
def test_a_joint_s_loop_has_no_creep_beside_it(loop: Callable[[Array], Array], give: float) -> None:
    """Of its load, four times a tracker's noise, beside its own give (rad / (N m)) or alone."""

    def law(_t: Array, moment: Array) -> Array:
        z = loop(moment)
        return np.asarray(give * moment + 1.9e-3 * z / z.std())

    work = diagnose(scene_of(tracked(seed=5, rows=2400, law=law)))
    found = {f.effect: f for f in work.diagnosis.findings}
    assert set(found) == ({"hysteresis", "compliance"} if give else {"hysteresis"})
    if give:
        assert found["compliance"].parameters["compliance"].value == pytest.approx(give, rel=0.05)

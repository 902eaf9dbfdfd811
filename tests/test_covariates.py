"""A covariate that explains a residual is told; one that only counts, or that this program computed, is not asked."""

import numpy as np
import pytest

from galen_hw.diagnosis.lack_of_fit.basis_functions import covariates
from galen_hw.diagnosis.pipeline import diagnose
from galen_hw.physics.effects.registry import scene_of
from galen_hw.recording.observations import observations_of
from galen_hw.recording.recording import Recording, RecordingInfo

ROWS = 600


def pulled_servo(give: float, pull_name: str = "covariate.pull") -> Recording:
    """A servo that is commanded to stand, at 20 Hz, and gives by so many rad while it is pulled to one side or the other."""
    rng = np.random.default_rng(5)
    time, pull = 0.05 * np.arange(ROWS), np.repeat(rng.normal(size=ROWS // 10), 10)
    measured = 1.0 + 1e-3 * rng.normal(size=ROWS) + give * pull
    simulated = {"time": time, "joint.servo.position": np.full(ROWS, 1.0)}
    info = RecordingInfo(robot=None, predict="position")
    columns = {
        "time": time,
        "joint.servo.position": measured,
        pull_name: pull,
        "covariate.count": np.arange(ROWS) / 7.0,
    }
    return Recording(columns, info, simulation=Recording(simulated))


def test_what_follows_a_covariate_is_not_taken_for_noise() -> None:
    """Nothing in the simulation moves: the covariate is the only cause that is known, and it is named."""
    (unknown,) = diagnose(scene_of(observations_of(pulled_servo(0.01)))).diagnosis.findings
    assert unknown.effect == "unknown"
    assert "covariate.pull" in unknown.says


def test_a_servo_that_stands_gives_by_what_its_load_register_says() -> None:
    """The stiffness of its loop, in units of the register."""
    (found,) = diagnose(scene_of(observations_of(pulled_servo(0.01, "covariate.present_load")))).diagnosis.findings
    assert (found.effect, found.joints) == ("compliance", ["servo"])
    size = found.parameters["compliance"]
    assert abs(size.value - 0.01) < 4.0 * size.std < 1e-3


def test_a_covariate_without_effect_says_nothing() -> None:
    """The same servo, stiff: noise is noise, however the covariate moves."""
    assert diagnose(scene_of(observations_of(pulled_servo(0.0)))).diagnosis.verdict == "agrees"


@pytest.mark.parametrize(
    ("name", "values", "asked"),
    [
        ("covariate.humidity", np.sin(np.arange(50.0)), True),
        ("covariate.frame", np.arange(50.0), False),
        ("covariate.constant", np.ones(50), False),
        ("covariate.lost", np.where(np.arange(50) == 7, np.nan, np.sin(np.arange(50.0))), False),
        ("covariate.compensated.force.x", np.sin(np.arange(50.0)), False),
        ("temperature.sensor", np.sin(np.arange(50.0)), False),
    ],
)
def test_what_counts_as_a_covariate(name: str, values: np.ndarray, asked: bool) -> None:
    """Counts and clocks are time by another name; what was computed from the compared group explains it trivially."""
    assert covariates({name: values}) == ((name,) if asked else ())


def standing_servo(pushed: bool) -> Recording:
    """A servo that is commanded to stand, at 20 Hz, with coloured noise; pushed to and fro in bursts, or left alone."""
    rng = np.random.default_rng(7)
    time = 0.05 * np.arange(ROWS)
    noise = np.convolve(rng.normal(size=ROWS + 19), np.ones(20) / 20**0.5, mode="valid")
    bursts = np.isin(np.arange(ROWS) // 60, [2, 3, 6, 8])
    measured = 1.0 + 1e-3 * noise * np.where(bursts & pushed, 8.0, 1.0)
    simulated = {"time": time, "joint.servo.position": np.full(ROWS, 1.0)}
    columns = {"time": time, "joint.servo.position": measured}
    return Recording(columns, RecordingInfo(robot=None, predict="position"), simulation=Recording(simulated))


def test_what_comes_and_goes_while_nothing_is_commanded_is_no_noise() -> None:
    """Noise of one kind has one size, however slow it is; nothing that was simulated can tell of a push."""
    found = diagnose(scene_of(observations_of(standing_servo(pushed=True)))).diagnosis
    assert found.verdict != "agrees"
    assert diagnose(scene_of(observations_of(standing_servo(pushed=False)))).diagnosis.verdict == "agrees"


def test_a_link_that_hangs_on_one_servo_sags_by_its_angle() -> None:
    """No model of weights is needed: sine and cosine of the joint, not a drift that happens to go with it."""
    rng = np.random.default_rng(2)
    time = 0.02 * np.arange(1500)
    command = 0.8 * np.sin(0.35 * time) + 0.3 * np.sin(1.1 * time)
    measured = command - 0.02 * np.sin(command) + 5e-4 * rng.normal(size=len(time))
    columns = {"time": time, "joint.servo.position": measured, "joint.servo.command": command}
    simulation = Recording({"time": time, "joint.servo.position": command})
    info = RecordingInfo(robot=None, predict="position")
    found = diagnose(scene_of(observations_of(Recording(columns, info, simulation=simulation)))).diagnosis
    assert [f.effect for f in found.findings] == ["compliance"]

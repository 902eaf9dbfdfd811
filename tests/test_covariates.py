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

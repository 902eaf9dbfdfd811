"""What a second recording cannot tell, what it contradicts, and small hums beside what is large, in efforts, positions, poses."""

import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parent))

from diagnosis_cases import Beam, Servo, friction, heavier, slow_servo, tracked

from galen_hw.diagnosis.pipeline import diagnose
from galen_hw.diagnosis.work import Work
from galen_hw.physics.effects.registry import scene_of
from galen_hw.physics.observations import Observations

TRACKER_NOISE = 7e-5
PER_KELVIN = 1.2 * TRACKER_NOISE


def warmed(seed: int, phase: float | None, per_kelvin: float = PER_KELVIN) -> Observations:
    """A tip whose first coordinate follows a temperature (m/K) that swings by 2 K, or stays where it is (None)."""
    out = tracked(seed=seed, rows=2000)
    t = out.columns["time"]
    kelvin = 22.0 + (np.zeros_like(t) if phase is None else 2.0 * np.sin(t / 4.0 + phase))
    out.columns["temperature.sensor"] = kelvin
    out.columns["pose.position.x"] = out.columns["pose.position.x"] + per_kelvin * (kelvin - 22.0)
    return out


def judged_by(first: Observations, other: Observations) -> Work:
    return diagnose(scene_of(first), holdout=scene_of(other))


def test_what_the_other_recording_does_not_rouse_is_told_by_blocks_left_out() -> None:
    """A temperature that stays where it is says nothing for a coefficient and nothing against it."""
    diagnosis = judged_by(warmed(781, 81.0), warmed(1381, None)).diagnosis
    (finding,) = diagnosis.findings
    assert finding.effect == "temperature"
    assert any(note.startswith("the recording held out hardly rouses temperature") for note in diagnosis.notes)
    assert finding.parameters["coefficient"].value == pytest.approx(PER_KELVIN, rel=0.05)
    assert finding.evidence["heldout_gain"] > 0.9
    assert "The other recording hardly rouses it" in finding.says


def test_what_the_other_recording_contradicts_is_no_agreement() -> None:
    """The temperature swings there too and does nothing: no name for what the first recording shows, which is still there."""
    work = judged_by(warmed(781, 81.0), warmed(1381, 0.3, per_kelvin=0.0))
    (finding,) = work.diagnosis.findings
    assert work.diagnosis.verdict == "unexplained"
    assert (finding.effect, finding.channels) == ("unknown", ["pose.position.x"])
    assert finding.says.startswith("In the recording itself the error in pose.position.x is ")


def test_two_recordings_without_anything_agree() -> None:
    assert judged_by(warmed(782, 1.0, 0.0), warmed(1382, None)).diagnosis.verdict == "agrees"


def hum(t: np.ndarray, size: float, phase: float) -> np.ndarray:
    return size * np.sin(2.0 * np.pi * 3.3 * t + phase)


def rubbing(seed: int) -> Observations:
    beam = Beam(seed)
    friction(beam)
    beam.effort = beam.effort + hum(beam.t, beam.sigma, seed)
    return beam.observations()


def lagging(seed: int) -> Observations:
    servo = Servo(seed)
    slow_servo(servo)
    servo.position[:, 0] += hum(servo.t, servo.sigma, seed)
    return servo.observations()


@pytest.mark.parametrize(("recording", "loud"), [(rubbing, "friction"), (lagging, "lag")])
def test_a_hum_smaller_than_the_noise_is_nothing_else_beside_what_is_large(
    recording: Callable[[int], Observations], loud: str
) -> None:
    """Ten times and several hundred times the hum: its share is too small for a name, and no other name takes it."""
    work = judged_by(recording(716), recording(1316))
    assert work.diagnosis.findings[0].effect == loud
    assert {f.effect for f in work.diagnosis.findings} <= {loud, "vibration", "unknown"}


@pytest.mark.parametrize("seed", [725, 734])
def test_a_heavier_arm_is_no_gain_and_half_a_body(seed: int) -> None:
    """A gain does most of what a mass at the end of a single link does: a body alone does all of it.

    The drift beside it takes some thousandths of the excess: it is told as one or has no name.
    """
    beam = Beam(seed)
    heavier(beam)
    beam.effort = beam.effort - 3.0 * beam.sigma * beam.t / beam.t[-1]
    work = diagnose(scene_of(beam.observations()))
    assert work.diagnosis.findings[0].effect == "payload"
    assert {f.effect for f in work.diagnosis.findings} <= {"payload", "drift", "unknown"}

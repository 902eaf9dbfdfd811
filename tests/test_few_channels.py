"""A bench of a sensor alone: six channels without an orientation, three without torques, a dozen poses.

Each ended with an internal error, as recordings by strangers showed.
"""

import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parent))

from diagnosis_cases import COM, MASS, SIGMA, WRENCH
from test_diagnosis_odd_places import seen, turning

from galen_hw.diagnosis.pipeline import diagnose
from galen_hw.physics.effects.registry import scene_of
from galen_hw.premises import examined
from galen_hw.recording.observations import observations_of
from galen_hw.recording.recording import Recording, RecordingInfo

LEAK = 0.08


def on_a_bench(*, without_torques: bool = False) -> Recording:
    """Sixty loads, one after the other on a table: a torque about y leaks into the force along x."""
    rng = np.random.default_rng(3)
    load = rng.normal(size=(60, 6)) * (10.0, 10.0, 10.0, 1.0, 1.0, 1.0)
    read = load + rng.normal(size=load.shape) * SIGMA
    read[:, 0] += 10.0 * LEAK * load[:, 4]
    if without_torques:
        read[:, 0] = 1.05 * load[:, 0] + rng.normal(size=60) * SIGMA[0]
        read[:, 3:] = load[:, 3:] = 0.0
    columns, given = (dict(zip(WRENCH, x.T, strict=True)) for x in (read, load))
    return Recording(columns, RecordingInfo(robot=None, predict="wrench"), simulation=Recording(given))


def test_a_leak_between_channels_is_told_where_no_orientation_is_known() -> None:
    """What another weight would read nobody knows there: it is not asked, and nothing else goes without its answer."""
    (found,) = diagnose(scene_of(observations_of(on_a_bench()))).diagnosis.findings
    assert found.effect == "cross_talk"
    (leak,) = [p for name, p in found.parameters.items() if name != "rms_signal"]
    assert leak.value == pytest.approx(10.0 * LEAK, abs=4.0 * (leak.std or np.inf))


def test_channels_that_read_nothing_count_for_nothing_and_are_said() -> None:
    """Torques of a sensor of forces stand at zero: they are no noise of zero, against which all is certain."""
    diagnosis = diagnose(scene_of(observations_of(on_a_bench(without_torques=True)))).diagnosis
    (found,) = diagnosis.findings
    assert found.effect == "gain"
    assert found.parameters["gain_error"].value == pytest.approx(0.05, abs=0.001)
    assert all(any(f"{name} is constant" in line for line in diagnosis.notes) for name in WRENCH[3:])


def test_as_few_rows_as_two_loads_need_are_asked_for_one() -> None:
    """There is no row between the first three and the last three at which a load could change."""
    rng, t, R = turning(4, rows=6)
    weight = -9.81 * MASS * R[:, 2, :]
    examination = examined(seen(t, R, np.concatenate([weight, np.cross(COM, weight)], axis=1), rng))
    assert not [r for r in examination.remarks if r.key == "load_change"]

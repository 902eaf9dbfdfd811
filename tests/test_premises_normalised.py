"""Joint positions that were normalised to each joint's calibrated range: in no common unit; degrees stay what they were."""

from collections.abc import Sequence

import numpy as np
import pytest

from galen_hw.diagnosis.pipeline import diagnose
from galen_hw.physics.effects.registry import scene_of
from galen_hw.physics.observations import Belief, Observations
from galen_hw.premises import Action, examined
from galen_hw.premises.normalised import CommonUnit

T = np.arange(3000) / 50.0
JOINTS = ("pan", "lift", "elbow", "flex")
RANGES = ((-2.1, 1.8), (-1.5, 1.9), (-1.6, 1.7), (-3.0, 2.6))
"""rad; they become -100 to 100."""
DEGREES = 180.0 / np.pi


def motion() -> np.ndarray:
    """Positions (N, 4) in rad."""
    return np.stack([(0.6 + 0.2 * k) * np.sin((0.5 + 0.17 * k) * T + k) for k in range(4)], axis=1)


def recording(factor: Sequence[float], zero: Sequence[float] = (0.0,) * 4, predict: str = "position") -> Observations:
    """Positions times factors (4,) beside zeros (4,), with play and noise, and the simulation in rad."""
    q = motion()
    rng = np.random.default_rng(1)
    real = q + 0.005 * np.sign(np.gradient(q, axis=0)) + 0.001 * rng.normal(size=q.shape)
    columns = {"time": T} | {f"joint.{n}.position": factor[k] * real[:, k] + zero[k] for k, n in enumerate(JOINTS)}
    simulation = {f"joint.{n}.position": q[:, k] for k, n in enumerate(JOINTS)}
    if predict == "effort":
        columns |= {f"joint.{n}.effort": q[:, k] for k, n in enumerate(JOINTS)}
        simulation |= {f"joint.{n}.effort": q[:, k] for k, n in enumerate(JOINTS)}
    else:
        columns |= {f"joint.{n}.command": factor[k] * q[:, k] + zero[k] for k, n in enumerate(JOINTS)}
    return Observations(predict, columns, simulation, Belief(bias_free=True))


def normalised(predict: str = "position") -> Observations:
    """Each joint's range is -100 to 100."""
    factor = [200.0 / (high - low) for low, high in RANGES]
    zero = [-100.0 - f * low for f, (low, _) in zip(factor, RANGES, strict=True)]
    return recording(factor, zero, predict)


@pytest.mark.parametrize("predict", ["position", "effort"])
def test_positions_in_no_common_unit_are_refused(predict: str):
    """Factor and zero of each joint are said as they were injected."""
    (found,) = CommonUnit().examine(normalised(predict))
    assert found.action is Action.REFUSED
    assert found.columns == tuple(f"joint.{n}.position" for n in JOINTS)
    for name, (low, high) in zip(JOINTS, RANGES, strict=True):
        factor, zero = found.what.split(f"{name} ")[1].split(",")[0].split(" and ")
        assert float(factor) == pytest.approx(200.0 / (high - low), rel=0.01)
        assert float(zero) == pytest.approx(-100.0 - 200.0 / (high - low) * low, abs=0.5)
    assert "\n" not in found.line


def test_a_joint_that_stands_still_hides_nothing():
    one = normalised()
    columns = dict(one.columns) | {"joint.flex.position": np.full(len(T), 3.0)}
    (found,) = CommonUnit().examine(Observations("position", columns, one.simulation, one.belief))
    assert len(found.columns) == 3


def test_no_physics_is_named_of_them():
    answer = diagnose(scene_of(normalised())).diagnosis
    assert answer.verdict == "unexplained"
    assert [one.effect for one in answer.findings] == ["unknown"]
    assert [(one["premise"], one["action"]) for one in answer.premises] == [("common_unit", "refused")]


@pytest.mark.parametrize(
    "factor",
    [
        (1.0,) * 4,
        (DEGREES,) * 4,
        (200.0 / np.pi,) * 4,
        (0.97 * DEGREES, DEGREES, 1.02 * DEGREES, DEGREES),
        (0.8, 1.0, 1.3, 2.0),
        (DEGREES, 1.0, 1.0, 1.0),
        (-1.0, 1.0, 1.0, -1.0),
    ],
    ids=["rad", "degrees", "gradians", "scale errors in degrees", "scale errors", "one in degrees", "signs"],
)
@pytest.mark.parametrize("predict", ["position", "effort"])
def test_of_one_unit_nothing_is_said(factor: tuple[float, ...], predict: str):
    """Nor of errors that physics makes."""
    assert not list(CommonUnit().examine(recording(factor, predict=predict)))


def test_degrees_are_still_repaired():
    found = examined(recording((DEGREES,) * 4))
    assert [remark.premise for remark in found.remarks] == ["position_units"]


def test_a_joint_that_does_not_follow_leaves_the_rest_unsaid():
    """Then more is wrong than a unit."""
    one = normalised()
    columns = dict(one.columns) | {"joint.pan.position": np.cos(2.0 * T)}
    assert not list(CommonUnit().examine(Observations("position", columns, one.simulation, one.belief)))

"""Loads that motors bear from a moment on: a part that an arm without a force sensor picks up, and a push that is none."""

import numpy as np
import pytest

from galen_hw.diagnosis.pipeline import diagnose
from galen_hw.diagnosis.result import Diagnosis
from galen_hw.kinematics import UrdfRobot
from galen_hw.physics.effects.registry import scene_of
from galen_hw.physics.observations import Belief, Observations
from tests.urdf_parts import joint, link, robot

NAMES = ("shoulder", "elbow")


def arm(load: float = 0.0) -> UrdfRobot:
    """Two links in a vertical plane, perhaps with a part 0.3 m beyond the elbow."""
    parts = [
        link("base"),
        link("upper", 3.0, com="0 0 0.15"),
        joint("shoulder", "base", "upper", "0 1 0"),
        link("lower", 1.5, com="0 0 0.12"),
        joint("elbow", "upper", "lower", "0 1 0", at="0 0 0.35"),
        link("sensor", load or None, com="0 0 0"),
        joint("mount", "lower", "sensor", kind="fixed", at="0 0 0.3"),
    ]
    return UrdfRobot(robot(*parts), sensor_link="sensor")


def answer(effort: np.ndarray, q: np.ndarray, t: np.ndarray) -> Diagnosis:
    """Return what is said of efforts (N, 2) in a motion (N, 2)."""
    columns = {"time": t}
    for k, name in enumerate(NAMES):
        columns |= {f"joint.{name}.position": q[:, k], f"joint.{name}.effort": effort[:, k]}
    return diagnose(
        scene_of(Observations("effort", columns, None, Belief(robot=arm(), bias_free=True, dynamic=True)))
    ).diagnosis


def motion() -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """90 s at 20 Hz: clock, positions, speeds and accelerations (N, 2)."""
    t = np.arange(1800) / 20.0
    w, size, phase = np.array([0.7, 1.1]), np.array([0.9, 1.1]), np.array([0.3, 1.7])
    angle = np.outer(t, w) + phase
    return t, size * np.sin(angle), size * w * np.cos(angle), -size * w**2 * np.sin(angle)


@pytest.mark.parametrize("mass", [0.3, 0.05])
def test_a_part_that_is_picked_up_is_found_with_mass_and_moment(mass: float) -> None:
    """To a second and a seventh, beside noise of a tenth of a newton metre."""
    t, *moved = motion()
    free, laden = (arm(load).inverse_dynamics(*moved) for load in (0.0, mass))
    noise = 0.1 * np.random.default_rng(7).normal(size=free.shape)
    found = answer(np.where((t > 40.0)[:, None], laden, free) + noise, moved[0], t)
    (payload,) = found.findings
    assert payload.effect == "payload"
    moment = next(v.value for name, v in payload.parameters.items() if name.endswith("moment"))
    assert moment == pytest.approx(40.0, abs=1.0)
    assert payload.parameters["moment_z"].value == pytest.approx(0.3 * mass, rel=0.15)


def test_a_push_on_an_arm_that_stands_is_no_load() -> None:
    """Another offset of each motor is as much: nothing says that it weighs."""
    t, *_ = motion()
    rng = np.random.default_rng(8)
    q = np.array([0.4, -0.7]) + 1e-4 * np.sin(np.outer(t, [0.7, 1.1]))
    effort = arm().inverse_dynamics(q, np.zeros_like(q), np.zeros_like(q)) + 0.1 * rng.normal(size=q.shape)
    effort[(t > 30.0) & (t < 45.0)] += [3.0, -1.0]
    assert "payload" not in [one.effect for one in answer(effort, q, t).findings]

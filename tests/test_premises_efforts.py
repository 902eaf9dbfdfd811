"""Efforts against the rigid model: gravity along any direction, and a link whose body the file leaves out."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from galen_hw.kinematics import UrdfRobot
from galen_hw.physics.observations import Belief, Observations
from galen_hw.premises import Action, Examination, examined
from galen_hw.premises.criteria import CRITERIA
from galen_hw.premises.gravity import tilt_between
from tests.urdf_parts import joint, link, robot

G = np.array([0.0, 0.0, -9.80665])
MASSES = {"turret": 4.0, "upper": 3.0, "lower": 1.5, "wrist": 0.4}


def arm(without: Sequence[str] = (), load: float = 0.0) -> UrdfRobot:
    """Four joints, the first about the vertical, without the bodies of some links; a load beside the last axis."""
    bodies = {
        name: link(name, None if name in without else mass, com="0.01 0.02 0.12") for name, mass in MASSES.items()
    }
    parts = [
        link("base"),
        bodies["turret"],
        joint("turn", "base", "turret", "0 0 1"),
        bodies["upper"],
        joint("shoulder", "turret", "upper"),
        bodies["lower"],
        joint("elbow", "upper", "lower"),
        bodies["wrist"],
        joint("roll", "lower", "wrist", "0 0 1"),
        link("sensor", load or None, com="0.06 0.03 0.05"),
        joint("mount", "wrist", "sensor", kind="fixed", at="0 0 0.05"),
    ]
    return UrdfRobot(robot(*parts), sensor_link="sensor")


def recorded(machine: UrdfRobot, believed: UrdfRobot, gravity: np.ndarray = G, friction: float = 0.0) -> Examination:
    """What the premises say of 20 s of a machine's efforts beside a believed model under a named gravity."""
    t = np.arange(1000) / 50.0
    w, phase = 0.9 + 0.31 * np.arange(4), np.arange(4)
    q, dq, ddq = (
        np.stack(x, axis=1) for x in zip(*(_sine(t, *one) for one in zip(w, phase, strict=True)), strict=True)
    )
    effort = machine.inverse_dynamics(q, dq, ddq) + friction * np.tanh(dq / 0.02)
    effort += 0.02 * np.random.default_rng(2).normal(size=effort.shape)
    columns = {"time": t}
    for k, name in enumerate(believed.joint_names):
        columns |= {f"joint.{name}.position": q[:, k], f"joint.{name}.effort": effort[:, k]}
    belief = Belief(robot=believed.under(gravity), gravity=gravity, bias_free=True, dynamic=True)
    return examined(Observations("effort", columns, None, belief))


def _sine(t: np.ndarray, w: float, phase: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    return 0.9 * np.sin(w * t + phase), 0.9 * w * np.cos(w * t + phase), -0.9 * w**2 * np.sin(w * t + phase)


@settings(max_examples=15, deadline=None)
@given(st.integers(0, 10_000), st.floats(0.3, 3.1))
@example(seed=864, angle=3.0)
def test_gravity_along_any_direction_is_found(seed: int, angle: float) -> None:
    """Turned about any axis: the direction to half a degree; nearly upside down it is turned over, the rest is an effect's."""
    named = Rotation.from_rotvec(angle * Rotation.random(random_state=seed).apply([1.0, 0.0, 0.0])).apply(G)
    away = float(np.arccos(np.clip(named @ G / (G @ G), -1.0, 1.0)))
    found = recorded(arm(), arm(), named, friction=0.5)
    if away < 0.25:
        return  # a small turn is an effect's
    assert [r.premise for r in found.remarks] == ["effort_gravity"]
    expected = -named if np.pi - away < CRITERIA.least_turn else G
    assert found.observations.belief.gravity == pytest.approx(expected, abs=0.1)
    (claim,) = found.claims
    assert claim.effect == "base_tilt"
    tilt = [claim.parameters[f"tilt_{a}"][0] for a in "xy"]
    assert Rotation.from_rotvec([*tilt, 0.0]).apply(named) == pytest.approx(expected, abs=0.1)


@pytest.mark.parametrize("friction", [0.0, 0.5])
def test_efforts_from_which_a_driver_has_taken_gravity_are_compared_without_it(friction: float) -> None:
    """An arm that weighs nothing: said, and all that is left is friction."""
    found = recorded(arm().under(np.zeros(3)), arm(), friction=friction)
    (remark,) = found.remarks
    assert "hold no gravity" in remark.what
    assert not found.refused
    assert not np.any(found.observations.belief.gravity)


@given(st.integers(0, 10_000))
def test_a_tilt_about_an_axis_of_the_plane_takes_any_direction_to_any_other(seed: int) -> None:
    """Straight up to straight down, and from one axis of the plane to the other, among them."""
    rng = np.random.default_rng(seed)
    axes = np.concatenate([np.eye(3), -np.eye(3), rng.normal(size=(6, 3))])
    a, b = axes[rng.integers(12)], axes[rng.integers(12)]
    turn = tilt_between(a, b)
    assert turn[2] == 0.0
    moved = Rotation.from_rotvec(turn).apply(a / np.linalg.norm(a))
    assert moved == pytest.approx(b / np.linalg.norm(b), abs=1e-9)


@pytest.mark.parametrize("missing", ["upper", "lower"])
def test_a_link_without_a_body_is_named(missing: str) -> None:
    """The file has no <inertial> for it, and the efforts say that it weighs something."""
    (remark,) = recorded(arm(), arm(without=[missing]), friction=0.3).remarks
    assert remark.premise == "missing_body"
    assert remark.action is Action.REFUSED
    assert f"link {missing}: no <inertial>" in remark.what


@pytest.mark.parametrize(
    ("machine", "believed", "friction"),
    [
        (arm(), arm(), 3.0),
        (arm(without=["turret"]), arm(without=["turret"]), 0.3),
        (arm(without=["wrist"], load=0.8), arm(without=["wrist"]), 0.3),
    ],
    ids=["friction", "weightless", "payload"],
)
def test_what_is_no_missing_body_is_left_to_the_search(
    machine: UrdfRobot, believed: UrdfRobot, friction: float
) -> None:
    """Friction, a link that does weigh nothing, and a load at the sensor beyond such a link."""
    assert not recorded(machine, believed, friction=friction).remarks


def test_external_torques_hold_nothing_of_the_model() -> None:
    """Constants and noise alone, as an observer gives them that takes off the whole model; a unit is no observer."""
    machine = arm(load=0.8)
    seen = recorded(machine, machine).observations
    names = [f"joint.{name}.effort" for name in machine.joint_names]
    rng = np.random.default_rng(5)
    bare = {name: 0.2 + 0.02 * rng.normal(size=len(seen)) for name in names}
    (found,) = examined(replace(seen, columns=dict(seen.columns) | bare)).refused
    assert found.premise == "effort_gravity"
    assert "external torques" in found.what
    small = {name: 1e-3 * seen.columns[name] for name in names}
    said = examined(replace(seen, columns=dict(seen.columns) | small)).remarks
    assert not any("external torques" in one.what for one in said)

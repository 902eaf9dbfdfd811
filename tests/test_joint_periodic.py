"""Errors that repeat with a joint's position: a gear's in each turn of its motor, an encoder's in each of its own."""

from collections.abc import Callable

import numpy as np
import pytest

from galen_hw.diagnosis.detection.spectral_lines import ripples
from galen_hw.diagnosis.stats.sampling import Rows
from galen_hw.kinematics import UrdfRobot
from galen_hw.physics.effects.registry import scene_of
from galen_hw.physics.observations import Belief, Observations
from galen_hw.spatial import Array, quaternion_from_rotation
from tests.test_diagnosis import answer, named
from tests.test_premises_processed import URDF


def servo(numbers: dict[float, float]) -> Observations:
    """One axis of a bench, its own encoder beside the motor's, with so many rad at so many cycles a turn."""
    t = np.arange(12_000) / 200.0
    q = 1.4 * np.sin(0.31 * t) + 0.6 * np.sin(0.83 * t + 1.0)
    error = sum((size * np.sin(number * q + 0.4) for number, size in numbers.items()), np.zeros(len(t)))
    noise = 4e-5 * np.random.default_rng(7).normal(size=len(t))
    columns = {"time": t, "joint.axis.position": q + error + noise}
    return Observations("position", columns, {"time": t, "joint.axis.position": q}, Belief(bias_free=True))


def test_a_gear_that_errs_twice_and_four_times_in_each_turn_of_its_motor_has_both_periods() -> None:
    found = answer(servo({160.0: 1.2e-4, 320.0: 5e-5}))
    assert named(found) == ["torque_ripple"]
    (finding,) = found.findings
    told = sorted(v.value for name, v in finding.parameters.items() if name.endswith("wave_number"))
    assert told == pytest.approx([160.0, 320.0], rel=1e-3)
    sizes = [finding.parameters[f"axis{mark}: sine"].value for mark in ("", " 2")]
    assert np.all(np.abs(sizes) > 1e-5)


def test_no_ripple_is_finer_than_two_rows_of_the_motion() -> None:
    scene = scene_of(servo({}))
    rest = np.random.default_rng(0).standard_normal((len(scene), 1))
    (one,) = ripples(scene, rest, Rows(tuple(scene.segments)), np.zeros(len(scene.channels)))
    step = np.quantile(np.abs(np.diff(scene.q[:, 0])), 0.9)
    assert one.effect.wave_number < np.pi / step  # type: ignore[attr-defined]


def test_a_joint_that_moves_between_segments_alone_has_no_ripple() -> None:
    """Within a segment it stands still, so that no period can be told from a step of the zero."""
    t = np.arange(2000) / 100.0
    q = np.where(t < 10.0, 0.2, 0.9)
    columns = {"time": t, "joint.axis.position": q, "segment": (t >= 10.0).astype(float)}
    scene = scene_of(Observations("position", columns, {"time": t, "joint.axis.position": q}, Belief(bias_free=True)))
    rest = np.random.default_rng(0).standard_normal((len(scene), 1))
    assert scene.moved == ("axis",)
    assert not ripples(scene, rest, Rows(tuple(scene.segments)), np.zeros(len(scene.channels)))


def tracked(error: Callable[[Array], Array]) -> Observations:
    """Poses of an arm whose joints are where they read plus an error (N, 4) of the readings (N, 4)."""
    t, robot = np.arange(6000) / 60.0, UrdfRobot(URDF, sensor_link="hand")
    read = np.stack([(2.2 if k == 0 else 0.8) * np.sin((0.4 + 0.17 * k) * t + k) for k in range(4)], axis=1)
    rng, T = np.random.default_rng(3), robot.sensor_pose(read + error(read))
    place = T[:, :3, 3] + 1e-4 * rng.normal(size=(len(t), 3))
    turn = quaternion_from_rotation(T[:, :3, :3])
    columns = {"time": t} | {f"joint.{n}.position": read[:, k] for k, n in enumerate(robot.joint_names)}
    columns |= {f"pose.position.{a}": place[:, k] for k, a in enumerate("xyz")}
    columns |= {f"pose.orientation.{a}": turn[:, k] + 2e-4 * rng.normal(size=len(t)) for k, a in enumerate("xyzw")}
    return Observations("pose", columns, None, Belief(robot=robot))


def test_an_eccentric_encoder_errs_once_a_turn() -> None:
    """The true position is the reading plus 0.8 mrad times a sine of it; poses are tracked."""
    found = answer(tracked(lambda read: 8e-4 * np.sin(read + 0.9) * np.array([1.0, 0.0, 0.0, 0.0])))
    assert named(found) == ["joint_scale"]
    parameters = found.findings[0].parameters
    for name, true_value in (("sine", 8e-4 * np.cos(0.9)), ("cosine", 8e-4 * np.sin(0.9))):
        assert abs(parameters[name].value - true_value) < 4.0 * parameters[name].std
        assert parameters[name].std < 5e-5
    assert "once a turn" in found.findings[0].says


@pytest.mark.parametrize(("joint", "source"), [(3, 2), (2, 0)])
def test_a_joint_that_goes_along_with_one_before_it(joint: int, source: int) -> None:
    """The motor of a wrist sits before the joints that it passes, and counts their turns too."""
    found = answer(tracked(lambda read: 0.004 * read[:, [source]] * np.eye(4)[joint]))
    assert named(found) == ["joint_scale"]
    (finding,) = found.findings
    names = UrdfRobot(URDF, sensor_link="hand").joint_names
    assert finding.joints == [names[joint]]
    assert f"goes along with {names[source]}" in finding.says
    coupling = finding.parameters["coupling"]
    assert abs(coupling.value - 0.004) < 4.0 * coupling.std
    assert coupling.std < 1e-4

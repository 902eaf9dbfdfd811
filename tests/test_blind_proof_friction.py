"""The blind proof's own friction: what sticks stands still, to the bit, wherever it is held off its command."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from galen_hw.tools.blind_proof.generator import arm
from galen_hw.tools.blind_proof.generator.case import Case

MOVE_S, DWELL_S = 1.4, 1.6
LOSS = np.array([0.4, 0.4, 0.24])


def swept(*, group: str = "position", **machine: object) -> arm.ArmScene:
    """An arm that goes from pose to pose and rests for 1.6 s at each."""
    scene = arm.make_scene(np.random.default_rng(1), Case("x", 1, group, "single", motion="sweep", duration_s=9.0))
    for name, value in machine.items():
        setattr(scene.machine, name, value)
    return scene


def rests(scene: arm.ArmScene, x: np.ndarray) -> list[np.ndarray]:
    """The second half of each rest but the first, which the arm begins in."""
    phase = scene.path.t % (MOVE_S + DWELL_S)
    late = (phase > 0.6 * DWELL_S) & (phase < 0.98 * DWELL_S)
    return [x[late & (scene.path.t // (MOVE_S + DWELL_S) == k)] for k in (1, 2)]


def test_what_friction_holds_stands_still() -> None:
    """Held by friction off its command, within what friction can hold: MuJoCo's own creeps by half the noise in a rest."""
    scene = swept(loss=LOSS)
    for q, command in zip(rests(scene, arm.positions(scene)), rests(scene, scene.path.q), strict=True):
        assert np.ptp(q, axis=0).max() == 0.0
        off = np.abs(q - command)[0]
        assert np.all(off <= LOSS / arm.SPRINGS)
        assert off.max() > 2e-4


def test_without_friction_the_servo_reaches_its_command() -> None:
    """The same steps without friction end where the command is."""
    scene = swept()
    for q, command in zip(rests(scene, arm.positions(scene)), rests(scene, scene.path.q), strict=True):
        assert_allclose(q, command, atol=1e-6)


def test_a_link_in_its_play_comes_to_rest_between_the_stops() -> None:
    """It never leaves the gap, uses all of it under way, and its damping brings it to rest."""
    play = np.array([0.0, 1e-3, 1e-3])
    scene, free = swept(play=play, loss=LOSS), swept(loss=LOSS)
    q = arm.positions(scene)
    off = q - arm.positions(free)
    assert np.abs(off[:, 1:]).max() > 0.9e-3
    for part in rests(scene, q):
        assert np.ptp(part[len(part) // 2 :], axis=0).max() < 2e-5


@pytest.mark.parametrize("joint", range(3))
def test_efforts_of_friction_are_constant_at_rest(joint: int) -> None:
    """Along a path that is given nothing can creep: friction is there while a joint turns, and all of it."""
    loss = LOSS * (np.arange(3) == joint)
    scene = swept(group="effort", loss=loss)
    friction = arm.efforts(scene) - arm.efforts(swept(group="effort"))
    assert_allclose(np.abs(friction).max(axis=0), loss, atol=1e-9)
    assert all(np.ptp(part, axis=0).max() < 1e-12 for part in rests(scene, friction))

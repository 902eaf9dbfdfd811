"""Links that cross the gap of a play: thrown, dragged through grease, or sunk by a weight that is not quite balanced."""

import sys
from pathlib import Path
from typing import Final

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parent))

from diagnosis_cases import Array, carriage, sines

from galen_hw.diagnosis.pipeline import diagnose
from galen_hw.kinematics import UrdfRobot
from galen_hw.physics.effects.backlash import Backlash
from galen_hw.physics.effects.registry import scene_of
from galen_hw.physics.observations import Belief, Observations

MASS: Final = 4.0
HALF_GAP: Final = 1e-3
DRAG: Final = 250.0
"""N s/m: the carriage is dragged along within 16 ms, and takes longer to cross the gap."""


def moves(rng: np.random.Generator, t: Array) -> Array:
    """(N,) places, m: a second from one to the next without a jerk, and as long a rest."""
    count = int(t[-1] / 2.0) + 2
    places = np.cumsum(rng.choice([-1.0, 1.0], size=count) * rng.uniform(0.05, 0.2, size=count))
    u = np.clip(t % 2.0, 0.0, 1.0)
    k = (t / 2.0).astype(int)
    return np.asarray(places[k] + (places[k + 1] - places[k]) * u**3 * (10.0 - 15.0 * u + 6.0 * u**2))


def in_grease(folder: Path, seed: int, unborne: float | None = None) -> Observations:
    """A carriage between two stops of a nut that follows its command; grease in the gap drags it along. Integrated at 5 kHz.

    `unborne`: it goes up and down, in moves with rests between, and this share of its weight is left by its balance.
    """
    robot, level = folder / "slide.urdf", carriage(MASS)
    robot.write_text(level if unborne is None else level.replace('axis xyz="1 0 0"', 'axis xyz="0 0 1"'))
    rng, fine, rows = np.random.default_rng(seed), 50, 3000
    t = np.arange(rows * fine) * 0.01 / fine
    nut = sines(rng, t, 0.05, 0.05, 0.5) if unborne is None else moves(rng, t)
    falling = 9.80665 * (unborne or 0.0)
    dt = 0.01 / fine
    place, speed, read = float(nut[0]), float(nut[1] - nut[0]) / dt, []
    for k, at in enumerate(nut.tolist()):
        following = (at - nut[max(k - 1, 0)]) / dt
        speed += -(DRAG * (speed - following) / MASS + falling) * dt
        place += speed * dt
        if abs(place - at) > HALF_GAP:
            place, speed = at + float(np.clip(place - at, -HALF_GAP, HALF_GAP)), following
        if k % fine == 0:
            read.append(place)
    columns = {
        "time": t[::fine],
        "joint.axis.command": nut[::fine],
        "joint.axis.position": np.array(read) + 1e-4 * rng.normal(size=rows),
    }
    return Observations("position", columns, None, Belief(robot=UrdfRobot(robot)))


def test_a_link_that_grease_drags_through_its_gap_has_play(tmp_path: Path) -> None:
    """It neither rests until the nut has crossed the gap nor is thrown at once: ten times the noise, and its size is told."""
    learnt, other = (scene_of(in_grease(tmp_path, seed)) for seed in (1, 2))
    work = diagnose(learnt, holdout=other)
    assert [f.effect for f in work.diagnosis.findings] == ["backlash"]
    told = work.diagnosis.findings[0].parameters
    assert told["half_play"].value == pytest.approx(HALF_GAP, rel=0.05)
    assert told["impulse"].value == pytest.approx(HALF_GAP * DRAG, rel=0.15)
    assert told["impulse"].unit == "N s"


@pytest.mark.parametrize("unborne", [0.03, -0.03])
def test_a_link_that_its_balance_lets_sink_has_play(tmp_path: Path, unborne: float) -> None:
    """At rest it sinks to one side of its gap, or rises where the balance lifts too much: no offset, and nothing unknown."""
    learnt, other = (scene_of(in_grease(tmp_path, seed, unborne)) for seed in (1, 2))
    work = diagnose(learnt, holdout=other)
    assert [f.effect for f in work.diagnosis.findings] == ["backlash"]
    told = work.diagnosis.findings[0].parameters
    assert told["half_play"].value == pytest.approx(HALF_GAP, rel=0.05)
    assert told["unborne"].value == pytest.approx(abs(unborne), rel=0.15)
    assert told["unborne"].unit == "1"
    (play,) = [h.effect for h in work.model.effects if isinstance(h.effect, Backlash)]
    assert play.lifted == (unborne < 0.0)


def test_an_impulse_throws_a_link_that_nothing_drags(tmp_path: Path) -> None:
    """The less grease, the nearer to a play that the load throws from stop to stop; all of it is one stop operator."""
    scene = scene_of(in_grease(tmp_path, 1))
    thrown = Backlash("axis", None, 1e-3, balanced=True).columns(scene).values[:, 0, 0]
    quick = Backlash("axis", None, None, balanced=True, impulse=1e-5).columns(scene).values[:, 0, 0]
    assert np.mean(np.abs(thrown - quick) < 1e-6) > 0.98
    slow = Backlash("axis", None, None, balanced=True, impulse=1e3).columns(scene).values[:, 0, 0]
    load = scene.inertia_load("axis")
    assert load is not None
    summed = np.concatenate([[0.0], np.cumsum(0.5 * (load[1:] + load[:-1]) * np.diff(scene.time))])
    np.testing.assert_allclose(slow, summed / 1e3, atol=1e-9)


def test_a_link_does_not_lie_where_its_load_does_not_take_it(tmp_path: Path) -> None:
    """Half a gap that is below nothing is none, where a robot's file says which way the load pulls."""
    scene = scene_of(in_grease(tmp_path, 1))
    spread = np.array([1e-5])
    for balanced, real in ((True, False), (False, True)):
        play = Backlash("axis", None, None, balanced, impulse=0.25)
        assert play.possible(scene, np.array([HALF_GAP]), spread)
        assert play.possible(scene, np.array([-HALF_GAP]), spread) == real

"""What slips on the arm, pushes with a course of their own, a sensor turned under its tool, and a pull that knows the heading."""

import sys
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

sys.path.insert(0, str(Path(__file__).parent))

from diagnosis_cases import COM, MASS, SIGMA, WRENCH, hanging, sines
from physics_scenes import scene

from galen_hw.diagnosis.detection import spectral_lines
from galen_hw.diagnosis.pipeline import diagnose
from galen_hw.diagnosis.stats.aliasing import Aliases
from galen_hw.diagnosis.stats.sampling import Rows
from galen_hw.diagnosis.work import Work
from galen_hw.physics.effects.events import Vibration
from galen_hw.physics.effects.registry import scene_of
from galen_hw.physics.observations import Belief, Observations
from galen_hw.physics.rigid import Body
from galen_hw.physics.scenes.base import Scene


def turning(seed: int, rows: int = 3000, rate: float = 50.0) -> tuple[np.random.Generator, np.ndarray, np.ndarray]:
    """Time and orientations (N, 3, 3) of a sensor of which no joints are known."""
    rng = np.random.default_rng(seed)
    t = np.arange(rows) / rate
    angles = np.stack([sines(rng, t, size) for size in (0.5, 0.4, 0.6)], axis=1)
    return rng, t, Rotation.from_euler("xyz", angles).as_matrix()


def seen(t: np.ndarray, R: np.ndarray, wrench: np.ndarray, rng: np.random.Generator) -> Observations:
    """A wrench recording with orientations alone."""
    columns = {"time": t}
    columns |= {f"sensor.orientation.{a}": q for a, q in zip("xyzw", Rotation.from_matrix(R).as_quat().T, strict=True)}
    columns |= dict(zip(WRENCH, (wrench + rng.normal(size=wrench.shape) * SIGMA).T, strict=True))
    return Observations("wrench", columns, None, Belief(tool=Body(MASS, COM), dynamic=False, bias_free=True))


def jumped(rng: np.random.Generator, jumps: np.ndarray, rows: np.ndarray, *, clock: bool) -> Scene:
    """Three tracked targets, read to 50 um in some rows (M,) of a motion, that jump by (M, 3, 3) m."""
    still = scene("targets", np.random.default_rng(3), rows=1500)
    columns = {n: v[rows] for n, v in still.observations.columns.items() if clock or n != "time"}
    for k in range(3):
        names = [f"target.{k}.position.{a}" for a in "xyz"]
        points = still.observations.matrix(*names)[rows] + rng.normal(size=(len(rows), 3)) * 5e-5
        columns |= dict(zip(names, (points + jumps[:, k]).T, strict=True))
    return scene_of(Observations("targets", columns, None, still.belief))


def step_found(work: Work, carried: str, jump: np.ndarray) -> None:
    """The one finding is a step of what is carried, by (3,) m."""
    (found,) = work.diagnosis.findings
    assert (work.diagnosis.verdict, found.effect) == ("explained", "step")
    for axis, true in zip("xyz", jump, strict=True):
        told = found.parameters[f"jump_{carried}_shift_{axis}"]
        assert abs(told.value - true) < 4.0 * told.std
        assert told.std < 5e-5


@pytest.mark.inject
def test_a_marker_that_moves_on_the_body_is_a_step_in_the_axes_of_the_body() -> None:
    """Its jump turns with the arm: no offset of a channel says what it does."""
    still = scene("targets", np.random.default_rng(3), rows=1500)
    moment, slip = 41.3, np.array([0.0, 6e-4, -2e-4])
    jumps = np.zeros((1500, 3, 3))
    jumps[:, 1] = (still.time >= moment)[:, None] * (still.T_sensor[:, :3, :3] @ slip)  # type: ignore[attr-defined]
    work = diagnose(jumped(np.random.default_rng(8), jumps, np.arange(1500), clock=True))
    step_found(work, "target.1", slip)
    (step,) = [h.effect for h in work.model.effects]
    assert abs(step.moment - moment) < 0.5  # type: ignore[union-attr]


@pytest.mark.inject
def test_a_tracker_that_shifts_is_one_step_in_its_own_axes() -> None:
    """Three numbers for all targets, wherever the arm is: nine of single channels, few rows would not pay for."""
    rows, shift = np.random.default_rng(2).permutation(1500)[:60], np.array([-3e-4, 1.2e-3, 1e-4])
    jumps = np.where(np.arange(60)[:, None, None] >= 22, shift, 0.0) * np.ones((60, 3, 3))
    step_found(diagnose(jumped(np.random.default_rng(9), jumps, rows, clock=False)), "tracker", shift)


@pytest.mark.inject
def test_a_push_that_swells_and_turns_is_one_contact_and_nothing_beside() -> None:
    """The hand holds its direction in the room while the sensor turns: a level and a bow are not its course."""
    rng, t, R = turning(3)
    wrench = hanging(R)
    for start, end, force in ((11.0, 14.0, [2.0, 0.0, 5.0]), (40.0, 45.5, [1.0, -3.0, -2.0])):
        during = (t > start) & (t < end)
        swell = np.sin(np.pi * (t[during] - start) / (end - start))[:, None] ** 2
        push = 0.2 * swell * np.einsum("nji,j->ni", R[during], np.array(force))
        wrench[during] += np.concatenate([push, np.cross([0.0, 0.0, -0.14], push)], axis=1)
    work = diagnose(scene_of(seen(t, R, wrench, rng)))
    assert (work.diagnosis.verdict, [f.effect for f in work.diagnosis.findings]) == ("explained", ["contact"])
    assert np.allclose(work.diagnosis.when, [[11.0, 14.0], [40.0, 45.5]], atol=0.3)


def test_a_sensor_turned_under_a_tool_that_stays_turns_the_whole_reading() -> None:
    """The lever of the weight turns with the axes too; it had been told as a moved centre of mass beside the turn."""
    rng, t, R = turning(5)
    turn = np.array([0.0, 0.0, 0.04])
    Q = Rotation.from_rotvec(turn).as_matrix()
    wrench = hanging(R)
    work = diagnose(scene_of(seen(t, R, np.concatenate([wrench[:, :3] @ Q, wrench[:, 3:] @ Q], axis=1), rng)))
    (found,) = work.diagnosis.findings
    assert (work.diagnosis.verdict, found.effect) == ("explained", "sensor_mounting")
    for axis, true in zip("xyz", turn, strict=True):
        told = found.parameters[f"turn_{axis}"]
        assert abs(told.value - true) < 4.0 * told.std


@pytest.mark.inject
def test_what_follows_the_heading_is_unknown_and_no_leak_of_the_weight() -> None:
    """Gravity in the sensor does not show where north is; the orientation, which was recorded, does."""
    rng, t, R = turning(7)
    wrench = hanging(R)
    pull = R[:, 0, 0] * R[:, 2, 1]
    wrench[:, 0] += 4.0 * SIGMA[0] * pull / pull.std()
    work = diagnose(scene_of(seen(t, R, wrench, rng)))
    assert work.diagnosis.verdict in ("unexplained", "partly_explained")
    says = next(f.says for f in work.diagnosis.findings if f.effect == "unknown")
    assert "input " not in says


def test_nothing_is_told_of_a_sensor_that_reads_what_it_should() -> None:
    """A control: orientations alone, weight alone, noise alone."""
    rng, t, R = turning(9)
    assert diagnose(scene_of(seen(t, R, hanging(R), rng))).diagnosis.verdict == "agrees"


def test_a_line_that_may_wander_as_far_as_it_is_high_is_no_vibration() -> None:
    """In a short recording fifteen slow waves beside a low line follow nearly anything; a high line may have them."""
    rng, t, R = turning(11, rows=1400, rate=100.0)
    made = scene_of(seen(t, R, hanging(R), rng))
    rest = rng.normal(size=(len(t), 6)) + np.sin(2.0 * np.pi * 11.0 * t)[:, None]
    runs = Rows((slice(0, len(t)),))
    aliases = Aliases(made, runs, np.zeros(len(t), dtype=bool))
    for narrow in (0.1, 0.02):
        found = spectral_lines.lines(made, rest, runs, aliases, narrow=narrow)
        hums = [one.effect for one in found]
        assert all(isinstance(h, Vibration) and h.breadth(made) <= 0.1 * h.frequency for h in hums)
        assert any(abs(h.frequency - 11.0) < 0.1 for h in hums)  # type: ignore[union-attr]
    slow = 8.0 * np.sin(2.0 * np.pi * 4.0 * t)[:, None] + rng.normal(size=(len(t), 6))
    wanders = {
        one.effect.wander
        for one in spectral_lines.lines(made, slow, runs, aliases)
        if abs(one.effect.frequency - 4.0) < 0.1
    }  # type: ignore[attr-defined]
    assert wanders == {0, 5}

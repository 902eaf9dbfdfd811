"""A cable is the tendon that it is: found with its clip, its anchor and its friction, and with what hides behind it."""

import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parent))

import diagnosis_cases as cases
from diagnosis_cases import Bench, rotation
from physics_scenes import scene

from galen_hw.diagnosis.estimation.levenberg_marquardt import ConditionalGain, descended
from galen_hw.diagnosis.estimation.linearisation import tangent
from galen_hw.diagnosis.estimation.model import Model
from galen_hw.diagnosis.pipeline import diagnose
from galen_hw.diagnosis.stats.paired_test import Gain
from galen_hw.diagnosis.validation.holdout import backward_eliminated
from galen_hw.diagnosis.validation.judgement import Judged
from galen_hw.diagnosis.work import Work
from galen_hw.kinematics import GalenRobot
from galen_hw.physics.effects.cable import CableDrag
from galen_hw.physics.effects.registry import scene_of
from galen_hw.physics.scenes.joint import EffortScene
from galen_hw.physics.scenes.wrench import WrenchScene

CLIP, ANCHOR = np.array([0.02, 0.0, -0.03]), np.array([0.2, 0.05, 0.45])


def pulled(bench: Bench, stiffness: float, residual: float, friction: float = 0.0) -> None:
    """A taut cable on the sensor's body, its friction overcome before it follows; written row by row."""
    pose = GalenRobot().sensor_pose(bench.q)
    tension = 0.0
    for k, (R, p) in enumerate(zip(pose[:, :3, :3], pose[:, :3, 3], strict=True)):
        span = ANCHOR - p - R @ CLIP
        required = stiffness * max(float(np.linalg.norm(span)) - residual, 0.0)
        start = required if k == 0 else tension
        tension = max(min(max(start, required - friction), required + friction), 0.0)
        force = R.T @ (tension * span / np.linalg.norm(span))
        bench.wrench[k] += np.concatenate([force, np.cross(CLIP, force)])


def diagnosed(bench: Bench) -> Work:
    return diagnose(scene_of(bench.observations()))


def named(work: Work) -> set[str]:
    return {f.effect for f in work.diagnosis.findings}


def found_cable(work: Work) -> dict[str, tuple[float, float]]:
    """Parameters of the cable with their standard deviations."""
    (one,) = [f for f in work.diagnosis.findings if f.effect == "cable_drag"]
    return {name: (value.value, value.std) for name, value in one.parameters.items()}


@pytest.mark.parametrize("friction", [0.0, 0.03])
def test_a_tendon_pulls_as_a_taut_cable_does(friction: float) -> None:
    """Slack for part of the way, and with friction in its conduit."""
    bench = Bench(rows=600)
    scene = scene_of(bench.observations())
    assert isinstance(scene, WrenchScene)
    pose = GalenRobot().sensor_pose(bench.q)
    lengths = np.linalg.norm(ANCHOR - pose[:, :3, 3] - pose[:, :3, :3] @ CLIP, axis=1)
    residual = float(np.quantile(lengths, 0.3))
    before = bench.wrench.copy()
    pulled(bench, 7.0, residual, friction)
    theta = np.array([7.0, *ANCHOR, residual, *CLIP, friction])
    effect = CableDrag("tendon_dry" if friction else "tendon")
    change = effect.change(scene, theta if friction else theta[:8])
    assert 0.1 < np.mean(~(bench.wrench - before).any(axis=1)) < 0.5 or friction
    np.testing.assert_allclose(change, bench.wrench - before, atol=1e-12)


def drawn(bench: Bench, stiffness: float, residual: float, friction: float) -> None:
    """The same through an eye that rubs: more while it is drawn out, less while it goes back."""
    pose = GalenRobot().sensor_pose(bench.q)
    R, p = pose[:, :3, :3], pose[:, :3, 3]
    span = ANCHOR - p - R @ CLIP
    length = np.linalg.norm(span, axis=1)
    tension = stiffness * (length - residual) + friction * np.tanh(np.gradient(length, bench.t) / 5e-4)
    force = np.einsum("nji,nj->ni", R, span * (tension / length)[:, None])
    bench.wrench += np.concatenate([force, np.cross(CLIP, force)], axis=1)


@pytest.mark.inject
def test_a_cable_through_an_eye_that_rubs_is_told() -> None:
    """Several times the noise: two joints' friction, a contact and something unknown had stood beside its spring."""
    bench = Bench(rows=4000)
    drawn(bench, 4.0, 0.2, 0.05)
    work = diagnosed(bench)
    assert named(work) == {"cable_drag"}
    assert work.diagnosis.verdict == "explained"
    told = found_cable(work)
    assert told["eye_friction"][0] == pytest.approx(0.05, rel=0.1)
    assert told["stiffness"][0] == pytest.approx(4.0, rel=0.1)
    assert told["stroke"][0] < 0.01


@pytest.mark.inject
@pytest.mark.parametrize("friction", [0.0, 0.04])
def test_a_cable_is_told_with_its_place_and_its_friction(friction: float) -> None:
    """Every parameter within four of its standard deviations, and the stiffness to a twentieth or so."""
    bench = Bench(rows=4000)
    pulled(bench, 4.0, 0.2, friction)
    work = diagnosed(bench)
    assert named(work) == {"cable_drag"}
    told = found_cable(work)
    true = {"stiffness": 4.0, "rest_length": 0.2, **({"dry_friction": friction} if friction else {})}
    true |= {f"anchor_{a}": x for a, x in zip("xyz", ANCHOR, strict=True)}
    true |= {f"clip_{a}": x for a, x in zip("xyz", CLIP, strict=True)}
    assert ("dry_friction" in told) == bool(friction)
    for name, value in true.items():
        assert told[name][0] == pytest.approx(value, abs=4.0 * told[name][1]), name
    assert told["stiffness"][1] < 0.1 * 4.0
    assert work.model.residual(white=True)[work.bench.train].std() < 1.03


@pytest.mark.inject
@pytest.mark.parametrize("hidden", [cases.base_tilt, cases.gain, cases.joint_offset])
def test_what_is_beside_a_cable_is_not_taken_for_a_part_of_it(hidden) -> None:
    """A spring that is linear in all that is unknown has parameters enough for both."""
    bench = Bench(rows=4000)
    hidden(bench)
    pulled(bench, 1.0, 0.2, 0.005)
    assert named(diagnosed(bench)) == {"cable_drag", hidden.__name__}


@pytest.mark.inject
def test_a_cable_that_is_tied_to_the_platform_is_told_from_there() -> None:
    """It knows nothing of where the platform is: seen from the base nothing stretches as it does."""
    bench = Bench(rows=4000)
    platform = np.array([0.0, 0.05, 0.3])
    Rr = rotation(bench.q[:, 3], np.zeros(len(bench.q)))
    p = np.array([0.0, 0.0, 0.045]) + Rr @ [0.210, 0.0, 0.035] + bench.R @ [0.055, 0.0, 0.0]
    for k, (R, at) in enumerate(zip(bench.R, p, strict=True)):
        span = platform - at - R @ CLIP
        felt = R.T @ (4.0 * (np.linalg.norm(span) - 0.2) * span / np.linalg.norm(span))
        bench.wrench[k] += np.concatenate([felt, np.cross(CLIP, felt)])
    work = diagnosed(bench)
    assert named(work) == {"cable_drag"}
    (effect,) = [h.effect for h in work.model.effects]
    assert isinstance(effect, CableDrag)
    assert effect.anchored == "carriage3"
    assert "tied to the link that carriage3 moves" in work.diagnosis.findings[0].says
    told = found_cable(work)
    for name, value in {"stiffness": 4.0, **{f"anchor_{a}": x for a, x in zip("xyz", platform, strict=True)}}.items():
        assert told[name][0] == pytest.approx(value, abs=4.0 * told[name][1]), name


def test_a_cable_pulls_at_the_link_that_it_is_clipped_to() -> None:
    """Of an arm's efforts: what is beyond the clip holds nothing of it. By virtual work, of the length by small steps."""
    effort = scene("effort", np.random.default_rng(1))
    assert isinstance(effort, EffortScene)
    anchor, clip, stiffness, residual = np.array([0.5, 0.1, 0.2]), np.array([0.05, 0.0, 0.3]), 40.0, 0.1
    cable = CableDrag("tendon", clipped="shoulder")

    def energy(shoulder: np.ndarray) -> np.ndarray:
        c, s = np.cos(shoulder), np.sin(shoulder)
        at = np.stack([c * clip[0] + s * clip[2], np.full_like(c, clip[1]), c * clip[2] - s * clip[0]], axis=-1)
        return 0.5 * stiffness * (np.linalg.norm(anchor - at, axis=1) - residual) ** 2

    step = 1e-5
    held = (energy(effort.q[:, 0] + step) - energy(effort.q[:, 0] - step)) / (2.0 * step)
    change = cable.change(effort, np.array([stiffness, *anchor, residual, *clip]))
    np.testing.assert_allclose(change[:, 0], held, atol=1e-6 * np.abs(held).max())
    np.testing.assert_allclose(change[:, 1], 0.0, atol=1e-12)
    assert cable.family != CableDrag("tendon").family
    assert "shoulder" in {e.clipped for e in CableDrag.propose(effort)}


@pytest.mark.inject
def test_a_pull_that_nothing_stretches_is_no_cable() -> None:
    """A forgotten weight pulls at its point too, the same way everywhere."""
    bench = Bench(rows=4000)
    cases.payload(bench)
    cases.gain(bench)
    assert named(diagnosed(bench)) == {"payload", "gain"}


@pytest.mark.inject
def test_no_cable_hangs_from_thirty_metres_away() -> None:
    """A search that leads far away, or begins there, ends where a cable of an arm can be."""
    bench = Bench(rows=1000)
    bench.wrench[:, 5] += 2.0 * cases.SIGMA[5] * np.maximum(bench.q[:, 4] - 0.2, 0.0) / 0.1
    work = diagnosed(bench)
    beside, tendon = ConditionalGain(work.bench, work.selection.scorer, []), work.bench.hypothesis(CableDrag("tendon"))
    for begun in ([1.0, *ANCHOR, 0.2, *CLIP], [5e-5, -30.0, 2.0, 1.6, 43.0, -1.9, 33.0, 3.3]):
        found = descended(work.bench, beside, tendon, np.array(begun))[1]
        assert found.theta is not None
        assert np.all(np.abs(found.theta[1:5]) <= 10.0)
        assert np.all(np.abs(found.theta[5:8]) <= 1.0)


@pytest.mark.parametrize("stiffness", [0.0, 4.0])
def test_a_tendon_whose_stiffness_is_not_known_is_no_cable(stiffness: float, monkeypatch: pytest.MonkeyPatch) -> None:
    """However much it takes of held-out data: a magnet's pull had been one of 0.0001 N/m, known to 0.003."""
    clean, case = Bench(7, rows=1000), Bench(7, rows=1000)
    pulled(case, stiffness, 0.2)
    bench = diagnose(scene_of(clean.observations())).bench
    bench.whole = bench.whole + bench.rows.average(case.wrench - clean.wrench)
    tendon = tangent(
        bench, bench.hypothesis(CableDrag("tendon")), np.array([max(stiffness, 1e-4), *ANCHOR, 0.2, *CLIP])
    )
    nuisances = [bench.hypothesis_of(None, columns) for columns in bench.constants()]
    model = Model(bench, nuisances, [tendon], bench.whitened(bench.whole - tendon.nonlinear))

    def required(asked: Model, *_: object) -> Judged:
        keys, floor = [h.effect.KEY for h in asked.effects if h.effect is not None], bench.noise.sigma**2
        without = dict.fromkeys(keys, floor)
        surely = Gain(1.0, 0.01, 1.0, 100.0)
        return Judged("", floor, floor, without, floor, dict.fromkeys(keys, surely), {key: [surely] for key in keys})

    monkeypatch.setattr("galen_hw.diagnosis.validation.holdout.judge", required)
    assert backward_eliminated(model, None)[0].effects == ([tendon] if stiffness else [])


def test_what_pushes_off_or_turns_without_a_force_is_no_cable() -> None:
    """A spring draws towards where it hangs; of its numbers a force must be there, not a moment alone."""
    pulls = scene_of(Bench(rows=200).observations())
    spring, pull = CableDrag("spring"), CableDrag("pull")
    taut, spread = np.array([2.0, 0.1, 0.3, 0.2, *12 * [0.0]]), np.full(16, 0.1)
    assert spring.known(taut, spread)
    assert spring.possible(pulls, taut, spread)
    assert not spring.possible(pulls, -taut, spread)
    moment = np.array([0.1, 0.05, -0.2, 0.1, *12 * [5.0]])
    assert not spring.known(moment, spread)
    assert not pull.known(moment[1:13], spread[1:13])
    assert pull.known(np.array([0.0, 0.4, *10 * [0.0]]), spread[:12])


def test_one_channel_with_one_joint_is_a_cable_alone_and_a_patch_beside_a_tendon() -> None:
    """Of a wrench. A joint's own effort may have a hose of its own."""
    alone, tendon = CableDrag("joint", "wrench.torque.x", "tilt"), CableDrag("tendon")
    assert alone.known(np.array([0.01]), np.array([0.02]))
    assert not alone.patches([alone, CableDrag("joint", "wrench.torque.y", "roll")])
    assert alone.patches([alone, tendon])
    assert not tendon.patches([alone, tendon])
    assert not CableDrag("joint", "joint.shoulder.effort", "shoulder").patches([tendon])

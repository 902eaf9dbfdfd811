"""The blind proof's parts: the generator's physics against closed forms, severities, seal, scores, a small share."""

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from galen_hw import spatial
from galen_hw.diagnosis.pipeline import diagnose
from galen_hw.diagnosis.preprocessing.checks import quiet
from galen_hw.kinematics import GalenRobot, UrdfRobot
from galen_hw.physics.effects.registry import scene_of
from galen_hw.physics.scenes.base import Scene
from galen_hw.recording import read_recording
from galen_hw.recording.observations import observations_of

pytest.importorskip("mujoco", reason="the generator needs MuJoCo: pip install mujoco")

from galen_hw.tools.blind_proof import judge, real, report, rivals, score, seal, tables
from galen_hw.tools.blind_proof.generator import arm, build, galen, look_alikes, motion, signal, wrench
from galen_hw.tools.blind_proof.generator import noise as noise_of
from galen_hw.tools.blind_proof.generator.case import Case, Injected
from galen_hw.tools.blind_proof.generator.plan import plan


def weight(mass: float, com: tuple[float, ...], Rt: np.ndarray) -> np.ndarray:
    """Closed form of a hanging weight, by this test."""
    force = mass * (Rt @ np.array([0.0, 0.0, -9.80665]))
    return np.concatenate([force, np.cross(com, force)], axis=-1)


def test_generated_wrench_is_the_hanging_weight_of_the_recording_format() -> None:
    """At rest MuJoCo's sensor reads R^T w, c x R^T w of tool and bias body less the zero, as the format says."""
    t = np.arange(50) / 10.0
    path = motion.sines(np.random.default_rng(0), t, np.array([0.04, 0.04, 0.04, 0.8, 0.5]))
    still = motion.Path(path.t, path.q, 0 * path.dq, 0 * path.ddq)
    reading = galen.wrench_along(still, "retractor", galen.Mechanics())
    q = np.hstack([galen.carriages(path.q[:, :3]), path.q[:, 3:]])
    Rt = GalenRobot().sensor_rotation(q).swapaxes(1, 2)
    bias = galen.BIAS_MASS, galen.BIAS_COM
    tool = galen.TOOLS["retractor"]
    expected = weight(tool.mass, tool.com, Rt) + weight(*bias, Rt) - weight(*bias, np.eye(3))
    assert_allclose(reading, expected, atol=1e-9)
    assert_allclose(GalenRobot().delta.platform(q[:, :3]), path.q[:, :3], atol=1e-12)


def test_generated_efforts_are_those_of_the_urdf() -> None:
    """The nominal arm of MuJoCo and the URDF in the recording's folder are the same machine."""
    scene = arm.make_scene(np.random.default_rng(1), Case("x", 1, "effort", "null", duration_s=5.0))
    expected = UrdfRobot(arm.urdf()).inverse_dynamics(scene.path.q, scene.path.dq, scene.path.ddq)
    assert_allclose(arm.efforts(scene), expected, atol=1e-6)


@pytest.mark.parametrize(("group", "key"), [("wrench", "payload"), ("wrench", "hysteresis"), ("effort", "friction")])
def test_severity_is_what_was_asked_for(group: str, key: str, tmp_path: Path) -> None:
    """The amplitude search meets the wanted SNR within 5 %, measured on the written files against a null twin."""
    case = Case("hidden", 3, group, "single", duration_s=30.0, bias_free=False, effects=[Injected(key, key, 0.8)])
    build.build(case, tmp_path / "hidden")
    excess = build._excess(case, case.effects[0], 0, case.effects[0].amplitude)
    assert_allclose(build._severity(excess)[0], 0.8, rtol=0.05)
    written = pd.read_csv(tmp_path / "hidden/train/recording.csv")[list(build.CHANNELS[group])].to_numpy()
    residual = (written - build.nominal(case, 0)) / build.SIGMA[group]
    touched = [c in case.effects[0].channels for c in build.CHANNELS[group]]
    power = np.mean(residual[:, touched] ** 2, axis=0) - 1.0
    assert_allclose(np.sqrt(np.mean(power)), 0.8, rtol=0.15)


@pytest.mark.parametrize("seed", range(4))
def test_a_sensor_clips_at_the_same_limit_in_every_run(seed: int) -> None:
    """Another run of the same machine moves otherwise; its limit is the first run's."""
    case = Case("x", seed, "wrench", "single", duration_s=20.0, effects=[Injected("saturation", "saturation")])
    (hidden,) = case.effects
    readings = []
    for run in (0, 1):
        scene = build._scene(case, run)
        build._hide(case, scene, hidden, 0, 20.0)
        readings.append((wrench.simulate(scene), wrench.simulate(build._scene(case, run))))
    clipped = [(read != free).any(axis=0) for read, free in readings]
    assert clipped[0].sum() == 1
    (channel,) = np.flatnonzero(clipped[0])
    for read, free in readings:
        cut = read[:, channel] != free[:, channel]
        assert set(read[cut, channel]) <= {hidden.machine["limit"]}


@pytest.mark.parametrize("kind", ["quadratic_gauge", "eddy_pick_up"])
def test_physics_without_a_name_is_one_law_in_every_run(kind: str) -> None:
    """What the first run teaches holds in the second: another motion does not change the machine."""
    case = Case("x", 3, "wrench", "outside", duration_s=20.0, effects=[Injected("unknown", kind)])
    (hidden,) = case.effects
    laws = []
    for run in (0, 1):
        scene, hidden.kind = build._scene(case, run), kind
        build._hide(case, scene, hidden, 0, 1.0)
        read, free = wrench.simulate(scene), wrench.simulate(build._scene(case, run))
        (channel,) = np.flatnonzero((read != free).any(axis=0))
        x = free[:, channel] if kind == "quadratic_gauge" else np.prod(scene.path.dq[:, 3:], axis=1)
        laws.append(np.polyfit(x, (read - free)[:, channel], 2))
        assert_allclose(np.polyval(laws[-1], x), (read - free)[:, channel], atol=1e-9)
    assert_allclose(laws[1], laws[0], rtol=1e-6, atol=1e-9)


def test_a_plan_keeps_its_promised_shares_and_depends_on_its_seed_alone() -> None:
    """400 cases: 25 % null, 40 % single, 20 % several, 10 % outside, 5 % premise; every single effect occurs."""
    cases = plan(11, 400)
    shares = {s: sum(c.share == s for c in cases) for s in ("null", "single", "several", "outside", "premise")}
    assert shares == {"null": 100, "single": 160, "several": 80, "outside": 40, "premise": 20}
    assert [c.as_dict() for c in cases] == [c.as_dict() for c in plan(11, 400)]
    assert [c.as_dict() for c in cases] != [c.as_dict() for c in plan(12, 400)]
    assert len({(c.group, c.effects[0].key) for c in cases if c.share == "single"}) >= 40


def test_the_seal_holds_until_every_verdict_is_there(tmp_path: Path) -> None:
    """No truth on disk before; a changed truth does not open."""
    text = seal.seal(plan(1, 3), tmp_path)
    verdict = tmp_path / "verdict.json"
    with pytest.raises(RuntimeError, match="stays sealed"):
        seal.unseal(text, tmp_path, [verdict])
    assert not (tmp_path / "truth.json").exists()
    verdict.write_text("{}")
    with pytest.raises(RuntimeError, match="not the one"):
        seal.unseal(text.replace("null", "single"), tmp_path, [verdict])
    assert len(seal.unseal(text, tmp_path, [verdict])) == 3


def test_a_run_that_was_cut_off_goes_on_with_the_same_truth_and_keeps_its_verdicts(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Only what is missing is asked; a folder with the digest of another truth is refused."""
    asked: list[str] = []

    def ask(case: Path, *, second_run: bool) -> dict[str, object]:
        asked.append(f"{case.name} {second_run}")
        return {"exit": 0}

    monkeypatch.setattr(judge, "_ask", ask)
    plans = [{"name": name, "second_run": False} for name in ("case-0", "case-1")]
    (tmp_path / "verdicts").mkdir()
    (tmp_path / "verdicts" / "case-0.json").write_text('{"exit": 1}')
    paths = judge.verdicts(tmp_path, plans, tmp_path / "verdicts", workers=1)
    assert asked == ["case-1 False"]
    assert [json.loads(path.read_text())["exit"] for path in paths] == [1, 0]
    assert sorted(p.name for p in (tmp_path / "verdicts").iterdir()) == ["case-0.json", "case-1.json"]
    text = seal.seal(plan(1, 3), tmp_path)
    assert seal.seal(plan(1, 3), tmp_path) == text
    with pytest.raises(RuntimeError, match="another truth"):
        seal.seal(plan(2, 3), tmp_path)


def test_a_case_that_takes_for_ever_has_no_answer_and_does_not_end_the_proof(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It counts as not right, whatever an answer of a run before says, and the others are asked all the same."""
    monkeypatch.setattr(judge, "PATIENCE_S", 0.05)
    cases = plan(3, 2)
    for case in cases:
        (tmp_path / case.name).mkdir()
        (tmp_path / case.name / "answer.json").write_text('{"verdict": "agrees", "findings": []}')
    plans = [{"name": case.name, "second_run": False} for case in cases]
    paths = judge.verdicts(tmp_path, plans, tmp_path / "verdicts", workers=1)
    assert len(paths) == 2
    for case, path in zip(cases, paths, strict=True):
        scored = score.score(case.as_dict(), json.loads(path.read_text()))
        assert not scored.right
        assert "no answer after 0.05 s" in scored.why


def test_what_was_judged_when_the_time_was_over_is_a_mixed_sample_and_is_counted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """No case is begun after it; the truth of all is unsealed, and the report says of how many it speaks."""
    clock = [0.0]

    def ask(case: Path, *, second_run: bool) -> dict[str, object]:
        clock[0] += 20.0
        return {"exit": 0}

    monkeypatch.setattr(judge, "_ask", ask)
    monkeypatch.setattr(judge.time, "monotonic", lambda: clock[0])
    cases = plan(3, 40)
    text = seal.seal(cases, tmp_path)
    plans = [{"name": c.name, "second_run": False} for c in cases]
    paths = judge.verdicts(tmp_path, plans, tmp_path / "verdicts", workers=1, minutes=4.0)
    assert len(paths) == 12
    judged = {path.stem for path in paths}
    assert len({c.share for c in cases if c.name in judged}) >= 3
    assert len(seal.unseal(text, tmp_path, paths)) == 40
    assert report._count(12, 40).startswith("12 of 40 recordings")
    assert report._count(40, 40) == "40 recordings"


@pytest.mark.parametrize("tau", [1e-3, 1e-2, 0.1])
def test_a_filter_is_late_by_its_time_constant_however_quick_it_is(tau: float) -> None:
    """Behind a ramp, at a sample every 10 ms."""
    ramp = 3.0 * 0.01 * np.arange(500.0)[:, None]
    assert_allclose((ramp - signal.lagged(ramp, 0.01, tau))[200:], 3.0 * tau, rtol=1e-6)


def test_how_far_a_lag_is_from_a_delay_of_one_sine() -> None:
    """A delay gives the phase of a first-order lag, and not its amplitude A / sqrt(1 + (w T)^2)."""
    t, w, T, sigma = np.arange(20000) / 100.0, 2 * np.pi * 0.5, 0.1, np.array([0.3])
    x = np.sin(w * t)[:, None]
    expected = np.sqrt(len(t) / 2) * (1 - 1 / np.hypot(1, w * T)) / sigma[0]
    measured = look_alikes.apart("lag", t, x, signal.lagged(x, 0.01, T), sigma, "white")
    assert_allclose(measured, expected, rtol=0.02)
    assert look_alikes.apart("lag", t, x, signal.lagged(x, 0.01, T), sigma, "coloured") < 0.5 * measured
    assert look_alikes.apart("time_delay", t, x, signal.delayed(t, x, 1e-3), sigma, "white") < 0.01


def test_a_guess_is_not_held_against_the_tool_nor_for_it() -> None:
    """It counts in the promised row; the row below leaves it out."""
    cases = []
    for name, away in (("lag", 0.2), ("lag", 40.0)):
        truth = Case("s", 1, "wrench", "single", effects=[Injected("lag", "lag", 0.8, apart=away)]).as_dict()
        cases.append(score.score(truth, verdict("time_delay" if away < 1.0 else name)))
    rows = {f.what: f.reached for f in tables.figures(cases, []) if "first" in f.what or "same" in f.what}
    assert rows["right effect first, SNR 0.8"].startswith("0.500 (1 of 2;")
    assert rows["the same without 1 that no test could tell from a look-alike"].startswith("1.000 (1 of 1;")


def test_how_far_it_is_from_its_look_alike_is_known_of_each_effect_of_a_pair() -> None:
    """A set with a lag that no test tells from a delay is counted, and left out in the row below."""
    case = Case("p", 5, "wrench", "several", duration_s=20.0)
    case.effects = [Injected("payload", "payload", 0.8), Injected("lag", "lag", 0.8)]
    build._scaled(case)
    build._measured_apart(case)
    assert case.effects[0].apart is None
    assert case.effects[1].apart is not None
    cases = []
    for away in (0.2, 40.0):
        case.effects[1].apart = away
        cases.append(score.score(case.as_dict(), verdict("payload", "lag" if away > 1.0 else "time_delay")))
    rows = {f.what: f.reached for f in tables.figures(cases, []) if "exact set" in f.what}
    assert [r.split(";")[0] for r in rows.values()] == ["0.500 (1 of 2", "1.000 (1 of 1"]


def verdict(*effects: str, kind: str = "explained") -> dict[str, object]:
    """An answer of the tool."""
    findings = [{"effect": e, "channels": [], "parameters": {}, "confounded_with": []} for e in effects]
    return {"exit": 1, "said": "", "seconds": 1.0, "json": {"verdict": kind, "findings": findings}}


def test_scores_know_right_from_wrong() -> None:
    """Null, single, several and outside cases, each answered rightly and wrongly."""
    null = Case("n", 1, "wrench", "null").as_dict()
    single = Case("s", 1, "wrench", "single", effects=[Injected("drift", "linear", 0.8)]).as_dict()
    pair = Case("p", 1, "wrench", "several", effects=[Injected("drift", "x"), Injected("gain", "y")]).as_dict()
    outside = Case("o", 1, "wrench", "outside", effects=[Injected("unknown", "air_drag", 1.0)]).as_dict()
    assert score.score(null, verdict(kind="agrees")).right
    assert not score.score(null, verdict("drift")).right
    assert score.score(single, verdict("drift")).right
    assert not score.score(single, verdict("temperature", "drift")).right
    assert score.score(pair, verdict("gain", "drift")).right
    assert score.score(pair, verdict("gain")).jaccard == 0.5
    assert score.score(outside, verdict("unknown", kind="unexplained")).right
    assert not score.score(outside, verdict("gain")).right
    assert not score.score(null, {"exit": 1, "said": "Traceback", "seconds": 1.0, "json": None}).right


@pytest.mark.parametrize("group", ["wrench", "position"])
def test_tool_and_rivals_are_judged_on_the_same_rows(group: str, tmp_path: Path) -> None:
    """The tool leaves out as many of the ends as its rates need, of joints without their encoders' noise."""
    build.build(Case("c", 5, group, "null", duration_s=20.0), tmp_path / "c")

    def scene(run: str) -> Scene:
        return scene_of(observations_of(read_recording(tmp_path / "c" / run)))

    good = diagnose(scene("train"), holdout=scene("test")).judged.good
    assert_array_equal(good, rivals.judged_rows(quiet(scene("test"))))


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_a_small_share_of_the_proof(tmp_path: Path) -> None:
    """Through the command line: a null agrees, one strong effect a group is named first."""
    cases = [
        Case("null-quantised", 22, "wrench", "null", duration_s=50.0, noise="quantised"),
        Case("payload", 23, "wrench", "single", duration_s=50.0, effects=[Injected("payload", "payload", 1.6)]),
        Case("friction", 24, "effort", "single", duration_s=50.0, effects=[Injected("friction", "friction", 1.6)]),
    ]
    for case in cases:
        build.build(case, tmp_path / case.name)
    plans = [{"name": c.name, "second_run": True} for c in cases]
    paths = judge.verdicts(tmp_path, plans, tmp_path / "verdicts", workers=2)
    for case, path in zip(cases, paths, strict=True):
        scored = score.score(case.as_dict(), json.loads(path.read_text()))
        assert scored.right, scored.why


def test_weight_turns_with_the_sensor() -> None:
    """A check of this file's own closed form: upside down the weight reads the other way."""
    upright, down = np.eye(3), spatial.rotation_about(0, np.pi)
    assert_allclose(weight(1.0, (0, 0, 0), upright)[2], -weight(1.0, (0, 0, 0), down.T)[2])


def test_answers_that_another_engine_gave_are_said_to_be_so(tmp_path):
    """One line a commit; what this commit's engine has answered needs none."""
    for real_set, commit in zip(real.SETS[:3], ("new", "old", "old"), strict=True):
        path = real._path(tmp_path, real_set)
        path.write_text("{}")
        path.with_suffix(".commit").write_text(commit)
    titles = "; ".join(real_set.title for real_set in real.SETS[1:3])
    assert real._made_before(tmp_path, "new") == [f"Answered by the engine of commit old: {titles}."]


@pytest.mark.parametrize("kind", ["white", "coloured", "quantised"])
@pytest.mark.parametrize("rows", [2, 5])
def test_noise_of_means_is_what_a_tool_that_averages_can_reach(kind: str, rows: int) -> None:
    """Against means of the noise itself."""
    clean, sigma = np.linspace(0.0, 3.0, 200_000)[:, None], np.array([0.01])
    noise = noise_of.add_noise(np.random.default_rng(6), clean, sigma, kind) - clean
    means = noise.reshape(-1, rows).mean(axis=1)
    assert np.std(means) / np.std(noise) == pytest.approx(noise_of.averaged(kind, rows), rel=0.03)

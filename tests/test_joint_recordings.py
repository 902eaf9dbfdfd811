"""Recordings of joints as real machines give them: several runs as one, noisy encoders, sticking joints, loose dampers."""

import json
import sys
from pathlib import Path

import numpy as np
import pytest
from scipy.signal import butter, sosfiltfilt

sys.path.insert(0, str(Path(__file__).parent))

from diagnosis_cases import carriage

from galen_hw.cli import main
from galen_hw.diagnosis.pipeline import diagnose
from galen_hw.errors import UsageError
from galen_hw.kinematics import UrdfRobot
from galen_hw.physics.concatenate import PAUSE, joined
from galen_hw.physics.effects.backlash import Backlash
from galen_hw.physics.effects.compliance import Compliance
from galen_hw.physics.effects.drift import Drift
from galen_hw.physics.effects.friction import Friction
from galen_hw.physics.effects.hysteresis import Hysteresis
from galen_hw.physics.effects.registry import scene_of
from galen_hw.physics.effects.timing import Lag, TimeDelay
from galen_hw.physics.observations import Belief, Observations
from galen_hw.physics.signals.differentiation import at_rest, denoised, derivatives, ends, has_line, isolated
from galen_hw.physics.signals.splines import motion_band


def run(rows: int, start: float = 0.0, **columns: np.ndarray) -> Observations:
    t = start + np.arange(rows) * 0.01
    named = {"time": t, "joint.a.position": np.sin(t), "joint.a.command": np.sin(t)}
    return Observations("position", named | columns)


def test_runs_laid_end_to_end_stay_apart():
    """The clock goes on after a pause, every run is a segment of its own, a column that one run lacks is not measured."""
    first = run(50, 7.0)
    second = run(30, **{"segment": np.repeat([0.0, 1.0], 15), "temperature.motor": np.full(30, 31.0)})
    whole, begins = joined([first, second], ["first", "second"])
    assert [(s.start, s.stop) for s in whole.segments] == [(0, 50), (50, 65), (65, 80)]
    assert begins == [7.0, pytest.approx(7.49 + PAUSE)]
    assert np.all(np.diff(whole.columns["time"]) > 0.0)
    assert np.isnan(whole.columns["temperature.motor"][:50]).all()
    assert (whole.columns["temperature.motor"][50:] == 31.0).all()


def test_no_drift_is_sought_over_hours_that_nobody_knows():
    """The clock between recordings is made up, in each of them it is not."""
    first, second = run(600), run(600)
    whole, _ = joined([first, second], ["first", "second"])
    assert not list(Drift.propose(scene_of(whole)))
    assert list(Drift.propose(scene_of(first)))
    assert whole.taken(slice(0, 900)).apart


def test_runs_of_different_machines_are_refused():
    """One line that says in what they differ."""
    other = Observations("position", {k.replace(".a.", ".b."): v for k, v in run(30).columns.items()})
    with pytest.raises(UsageError, match=r"together with first: they differ in the joints"):
        joined([run(30), other], ["first", "second"])
    clockless = Observations("position", {k: v for k, v in run(30).columns.items() if k != "time"})
    with pytest.raises(UsageError, match="presence of a time column"):
        joined([run(30), clockless], ["first", "second"])


def servo(folder: Path, seed: int, rows: int = 900) -> Path:
    """Two joints at 50 Hz that answer a smooth command, from rest, 40 ms late; read with 0.2 mrad of noise."""
    rng = np.random.default_rng(seed)
    t = np.arange(rows) * 0.02
    lines = [t]
    for _ in "ab":
        f, phase = rng.uniform(0.1, 0.9, 4), rng.uniform(0.0, 6.28, 4)
        command, late = (
            0.2 * np.clip(x / 3.0, 0.0, 1.0) ** 2 * np.sin(2 * np.pi * np.outer(x, f) + phase).sum(axis=1)
            for x in (t, t - 0.04)
        )
        lines += [command, late + 2e-4 * rng.normal(size=rows)]
    folder.mkdir()
    names = ["time", *(f"joint.{j}.{k}" for j in "ab" for k in ("command", "position"))]
    np.savetxt(folder / "recording.csv", np.stack(lines, axis=1), "%.7f", ",", header=",".join(names), comments="")
    (folder / "recording.json").write_text(json.dumps({"schema": 1, "robot": None, "predict": "position"}))
    return folder


def test_several_runs_fitted_as_one_and_judged_on_several(tmp_path, capsys):
    """One answer for all runs, which says where each begins, judged on both others together."""
    runs = [servo(tmp_path / name, seed) for seed, name in enumerate(("one", "two", "three", "four"))]
    out = tmp_path / "answer.json"
    asked = ["diagnose", "--together", *map(str, runs[:2]), "--holdout", str(runs[2]), "--holdout", str(runs[3])]
    assert main([*asked, "-o", str(out)]) == 1
    answer = json.loads(out.read_text())
    assert [f["effect"] for f in answer["findings"]] == ["time_delay"]
    assert answer["findings"][0]["parameters"]["delay"]["value"] == pytest.approx(0.04, abs=5e-4)
    assert answer["holdout"] == f"{runs[2]}, {runs[3]}"
    assert f"{runs[1]} begins at 18.98 s" in capsys.readouterr().out


def test_a_holdout_of_other_channels_is_refused(tmp_path, capsys):
    """Naming what does not fit, before anything is fitted."""
    one, other = servo(tmp_path / "one", 1), servo(tmp_path / "other", 2)
    text = (other / "recording.csv").read_text()
    (other / "recording.csv").write_text(text.replace("joint.b", "joint.c"))
    assert main(["diagnose", str(one), "--holdout", str(other)]) == 2
    assert "does not compare the channels of" in capsys.readouterr().err


def slide(rng: np.random.Generator) -> Observations:
    """Bang-bang force on a mass with dry friction, 1 kHz, integrated here; the encoder has 2 um of noise."""
    dt, rows = 1e-3, 12000
    t = np.arange(rows) * dt
    force = 80.0 * np.sign(np.sin(2 * np.pi * 0.7 * t)) * (np.sin(2 * np.pi * 0.11 * t) > -0.6)
    x = v = 0.0
    place = np.empty(rows)
    for k, f in enumerate(force.tolist()):
        place[k] = x
        rest = -v / dt * 95.0 - f
        friction = float(np.clip(rest, -20.0, 20.0)) - 200.0 * v
        v += (f + friction) / 95.0 * dt
        x += v * dt
    columns = {"time": t, "joint.axis.position": place + 2e-6 * rng.normal(size=rows), "joint.axis.effort": force}
    return Observations("effort", columns, None, Belief(robot=UrdfRobot(carriage(95.0))))


def test_jumps_of_force_are_not_smeared_on_one_side_alone():
    """With the motion low-passed, measured forces pass the same filter: what is left beside the true friction is small."""
    scene = scene_of(slide(np.random.default_rng(0)))
    friction = Friction("axis", "coulomb_viscous", 1e-3).change(scene, np.array([20.0, 200.0]))
    inner = slice(500, -500)
    filtered = (scene.residual - friction)[inner]
    plain = (scene.raw_residual - friction)[inner]
    assert scene.band is not None
    assert scene.grain > 1
    assert np.std(filtered) < 0.5 * np.std(plain)
    assert np.max(np.abs(filtered)) < 0.4 * np.max(np.abs(plain))


def test_isolated_samples_and_what_only_looks_like_them():
    """Single spikes and pairs are found exactly; white noise, walks, steps, slopes and rounded readings hold none."""
    rng = np.random.default_rng(1)
    t = np.arange(20000) / 100.0
    spiked = np.sin(t) + 0.01 * rng.normal(size=len(t))
    spiked[[500, 501, 9000]] += 0.3
    assert np.flatnonzero(isolated(spiked)).tolist() == [500, 501, 9000]
    clean = [
        rng.normal(size=len(t)),
        np.cumsum(rng.normal(size=len(t))),
        np.sign(np.sin(t)) + 0.02 * rng.normal(size=len(t)),
    ]
    clean += [0.1 * np.abs(np.sin(t)), np.round(np.sin(t) / 0.002) * 0.002]
    assert not any(isolated(x).any() for x in clean)


def test_rows_at_the_ends_are_those_whose_acceleration_is_a_guess():
    """A noisy encoder: what is left out holds the large errors, and no segment loses more than a tenth of its rows."""
    t, w = np.arange(6000) * 0.01, 2.0 * np.pi * 0.7
    parts, error, out = [slice(0, 5000), slice(5000, 6000)], [], []
    for seed in range(10):
        rng = np.random.default_rng(seed)
        x = (np.sin(w * t + seed) + 2e-4 * rng.normal(size=len(t)))[:, None]
        error.append(derivatives(t, x, parts)[1] + w**2 * np.sin(w * t + seed)[:, None])
        out.append(ends(t, x, parts))
        assert all(0 < np.count_nonzero(out[-1][part]) <= 0.1 * (part.stop - part.start) + 2 for part in parts)
    inside, outside = (
        np.sqrt(np.mean(np.array(error)[:, :, 0][mask] ** 2)) for mask in (~np.array(out), np.array(out))
    )
    assert outside > 5.0 * inside


def test_a_joint_that_sticks_starts_where_it_stood():
    """A servo with play: two runs that begin on either side of the band and first move inside it are met to the end."""
    half, offset, runs = 0.03, 0.02, []
    for side in (-0.8, 0.7):
        t = np.arange(1500) * 0.02
        u = 0.4 * np.sin(0.9 * t) * np.minimum(t / 10.0, 1.0) * (t > 1.0)
        q, out = side * half, np.empty(len(t))
        for k, command in enumerate(u.tolist()):
            q = min(max(q, command - half), command + half)
            out[k] = q + offset
        runs.append(Observations("position", {"time": t, "joint.a.position": out, "joint.a.command": u}))
    scene = scene_of(joined(runs, ["left", "right"])[0])
    assert np.sqrt(np.mean(scene.residual**2)) > half / 2.0
    for sticks in (Backlash("a", half), Friction("a", "servo", coulomb=half, response=1e-3)):
        rest = scene.residual - offset - sticks.change(scene, np.ones(1))
        assert np.max(np.abs(rest)) < 1e-3


def test_a_damper_that_sticks_slips_and_has_a_gap():
    """A spring that takes hold beyond a gap and slips at a force, stepped here by itself, lies in the element's columns."""
    t = np.arange(4000) * 0.005
    x = 0.02 * np.sin(2.0 * t) * np.minimum(t / 5.0, 1.0)
    reach, gap, slip = 0.004, 0.5, 9000.0
    anchor, force = 0.0, np.empty(len(t))
    for k, place in enumerate(x.tolist()):
        anchor = min(max(anchor, place - reach), place + reach)
        beyond = max(abs(place - anchor) - gap * reach, 0.0)
        force[k] = slip * np.sign(place - anchor) * beyond / (reach - gap * reach)
    columns = {"time": t, "joint.d.position": x, "joint.d.effort": force}
    scene = scene_of(Observations("effort", columns, {"joint.d.effort": np.zeros(len(t))}))
    effects = list(Hysteresis.propose(scene))
    assert any(e.reach is not None and e.gap is not None for e in effects)
    element = Hysteresis("joint.d.effort", "joint:d", 0.02, (), linear=True, reach=reach, gap=gap)
    X = element.columns(scene).values[:, 0]
    theta = np.linalg.lstsq(X, force, rcond=None)[0]
    np.testing.assert_allclose(X @ theta, force, atol=1e-6 * slip)
    named = {p.name: v for p, v in zip(element.parameters(scene), theta, strict=True)}
    assert named["closed_gap_force"] == pytest.approx(slip, rel=1e-6)


def test_sag_holds_the_weight_of_the_link_beyond_a_joint():
    """The moment of a mass at any place on the link lies in the columns, constant part included."""
    t = np.arange(400) * 0.05
    columns = {"time": t}
    for k, name in enumerate("abc"):
        columns |= {f"joint.{name}.{kind}": np.sin((0.3 + 0.1 * k) * t + k) for kind in ("position", "command")}
    scene = scene_of(Observations("position", columns))
    sag = next(
        e
        for e in Compliance.propose(scene)
        if e.form == "weight" and e.joint == "b" and e.first == "a" and e.links == 1
    )
    angle = scene.q[:, 0] + scene.q[:, 1]
    X = sag.columns(scene).values[:, 0]
    moment = 0.3 * np.cos(angle + 0.7)
    np.testing.assert_allclose(X @ np.linalg.lstsq(X, moment, rcond=None)[0], moment, atol=1e-9)


def test_a_late_joint_delivers_everything_late():
    """What other effects do in a channel passes through its delay or lag; other channels stay as they are."""
    t = np.arange(300) * 0.02
    columns = {"time": t}
    for name in "ab":
        columns |= {f"joint.{name}.{kind}": np.sin(t) for kind in ("position", "command")}
    scene = scene_of(Observations("position", columns))
    play = Backlash("a", 0.1).columns(scene)
    late = TimeDelay("a").delivered(scene, play, np.array([0.1]))
    np.testing.assert_allclose(late.values[5:, 0], play.values[:-5, 0], atol=1e-12)
    np.testing.assert_array_equal(
        TimeDelay("b").delivered(scene, play, np.array([0.1])).values[:, 0], play.values[:, 0]
    )
    lagged = Lag(0.2, "a").delivered(scene, play, np.ones(1)).values[:, 0, 0]
    slow, expected = play.values[0, 0, 0], []
    for k, value in enumerate(play.values[:, 0, 0].tolist()):
        slow += (0.0 if k == 0 else -np.expm1(-0.02 / 0.2)) * (value - slow)
        expected.append(slow)
    np.testing.assert_allclose(lagged, expected, atol=1e-12)


def test_a_noisy_encoder_is_differentiated_twice_as_well_as_its_motion_allows():
    """A spline leaves a third of what a low-pass of the same band leaves, and the motion itself; at its ends too."""
    t, w = np.arange(6000) * 0.01, 2.0 * np.pi * 0.7
    left, ends_of = {"plain": [], "fine": []}, []
    for seed in range(5):
        rng = np.random.default_rng(seed)
        x = (np.sin(w * t + seed) + 2e-4 * rng.normal(size=len(t)))[:, None]
        for name, band in (("plain", motion_band(x[:, 0], 0.01)), ("fine", None)):
            second = derivatives(t, x, [slice(0, 6000)], band=band)[1]
            left[name].append((second + w**2 * np.sin(w * t + seed)[:, None])[1000:-1000])
        quiet = denoised(t, x, [slice(0, 6000)])[:, 0] - np.sin(w * t + seed)
        ends_of.append(np.concatenate([quiet[:50], quiet[-50:]]))
    plain, fine = (np.sqrt(np.mean(np.square(left[name]))) for name in ("plain", "fine"))
    assert fine < 0.33 * plain
    assert fine < 0.01 * w**2
    assert np.sqrt(np.mean(np.square(ends_of))) < 2e-4, (
        "no filter may bend the ends by more than the noise that it takes away"
    )


def test_noise_of_a_motion_without_a_sharp_band_is_not_differentiated_up_to_its_end():
    """Motion that fades above 0.8 Hz: by knots alone, 1.4 % of its acceleration was noise just below the end of its band."""
    error, size = [], []
    for seed in range(3):
        rng = np.random.default_rng(seed)
        long = sosfiltfilt(butter(3, 0.8 / 500.0, output="sos"), rng.normal(size=124_000))
        long = long / np.std(long)
        truth = np.gradient(np.gradient(long, 1e-3), 1e-3)[2000:-2000:10]
        t = np.arange(12_000) * 0.01
        seen = long[2000:-2000:10] + 1e-3 * rng.normal(size=len(t))
        second = derivatives(t, seen[:, None], [slice(0, len(t))])[1][:, 0]
        error.append((second - truth)[20:-20])
        size.append(truth)
    assert np.std(error) < 0.009 * np.std(size)


def test_a_resting_joint_stands_and_a_slow_one_keeps_its_place():
    """Noise alone is no motion, whatever its law; a slow motion under noise is left as it was measured."""
    t = np.arange(4000) * 0.025
    rng = np.random.default_rng(3)
    clean = np.stack([np.full_like(t, 0.3), 2e-5 * np.sin(0.6 * t), 0.4 * np.sin(1.3 * t) * np.cos(0.21 * t)], axis=1)
    seen = clean + 1e-5 * rng.standard_t(4, size=clean.shape)
    parts = [slice(0, 2500), slice(2500, 2530), slice(2530, 4000)]
    still = at_rest(t, seen, parts)
    error, without = (np.std((denoised(t, x, parts) - clean)[:, 1]) for x in (still, seen))
    assert error < 1.2 * without, "a slow motion under noise may not become steps"
    assert np.array_equal(still[:, 2], seen[:, 2])
    assert np.array_equal(still[parts[1]], seen[parts[1]]), "too short to tell"
    for part in (parts[0], parts[2]):
        assert np.ptp(still[part, 0]) == 0.0
        assert still[part.start, 0] == pytest.approx(0.3, abs=2e-6)
    assert np.abs(denoised(t, clean, parts) - clean)[:, 2].max() < 1e-6


def test_rests_between_moves_hold_no_noise_of_the_encoder():
    """What is left of it there a narrow dead band would take for its own; the moves keep their places."""
    rng = np.random.default_rng(5)
    t = np.arange(7200) / 60.0
    into = np.clip((t % 10.0 - 8.5) / 1.5, 0.0, 1.0)
    places = rng.uniform(-0.5, 0.5, 13)
    k = (t // 10.0).astype(int)
    clean = places[k] + (places[k + 1] - places[k]) * (10.0 * into**3 - 15.0 * into**4 + 6.0 * into**5)
    seen = (clean + 1e-4 * rng.normal(size=t.shape))[:, None]
    still = at_rest(t, seen, [slice(0, 7200)])
    assert np.mean(still != seen) > 0.6
    assert not np.any((still != seen)[(into > 0.2) & (into < 0.8)])
    error, without = (np.std(denoised(t, x, [slice(0, 7200)])[:, 0] - clean) for x in (still, seen))
    assert error < 0.75 * without


def sticking(rng: np.random.Generator, friction: float, rows: int = 6000) -> Observations:
    """A servo of 60 ms with a mass and dry friction, integrated here at 2 kHz; simulated by the same without the friction."""
    stiffness, damping, mass, fine = 200.0, 12.0, 0.05, 20
    dt, t = 0.01 / fine, np.arange(rows) * 0.01
    f, phase = rng.uniform(0.1, 0.6, 4), rng.uniform(0.0, 6.28, 4)
    command = 0.15 * np.sin(2 * np.pi * np.outer(t, f) + phase).sum(axis=1)
    answers = []
    for loss in (friction, 0.0):
        q, v, out = float(command[0]), 0.0, []
        for c in command.tolist():
            for _ in range(fine):
                push = stiffness * (c - q) - damping * v
                held = float(np.clip(-mass * v / dt - push, -loss, loss))
                v += (push + held) / mass * dt
                q += v * dt
            out.append(q)
        answers.append(np.array(out))
    name = "joint.axis.position"
    columns = {"time": t, "joint.axis.command": command, name: answers[0] + 4e-4 * rng.normal(size=rows)}
    return Observations("position", columns, {name: answers[1]})


def test_a_servo_that_sticks_rubs_and_has_no_play():
    """Friction of 0.4 mrad behind a servo of 60 ms: named, with its size; a play as wide would turn round at once."""
    scene = scene_of(sticking(np.random.default_rng(3), 0.08))
    assert scene.response("axis") == pytest.approx(0.06, rel=0.15)
    found = diagnose(scene).diagnosis.findings
    assert [f.effect for f in found] == ["friction"]
    assert found[0].parameters["coulomb"].value == pytest.approx(4e-4, rel=0.1)


def test_friction_that_never_breaks_loose_is_none():
    """A servo that gives way within a band which its error never leaves is a lag of its settling."""
    scene = scene_of(sticking(np.random.default_rng(3), 0.08, 1000))
    small = Friction("axis", "creeping_servo", coulomb=1e-3, response=0.02, settling=0.1)
    wide = Friction("axis", "creeping_servo", coulomb=0.2, response=0.02, settling=0.1)
    assert small.at_work(scene)
    assert not wide.at_work(scene)
    assert Friction("axis", "servo", coulomb=0.2, response=0.02).at_work(scene), "play as wide as that is a play"
    slow = scene.lag("slow", scene.q, 0.1, held=True) - scene.lag("quick", scene.q, 0.02, held=True)
    settled = scene.time > 2.0
    assert np.allclose(wide.columns(scene).values[settled, 0], slow[settled], atol=1e-6)


@pytest.mark.inject
def test_a_dead_time_and_a_lag_behind_it_are_found_together():
    """Beside friction, one by one: the first takes the place of both, and what is wrong about it goes to whatever bends."""
    rng, t = np.random.default_rng(5), np.arange(6000) * 0.02
    command = np.zeros(len(t))
    for place in range(0, len(t), 150):
        command[place:] += rng.uniform(-0.2, 0.2) * np.clip((t[place:] - t[place]) / 0.3, 0.0, 1.0)
    command += 0.1 * np.sin(2 * np.pi * 0.05 * t**1.4)
    late, out, q = np.interp(t - 0.05, t, command), np.empty(len(t)), 0.0
    for k, c in enumerate(late.tolist()):
        q += (1.0 - np.exp(-0.02 / 0.06)) * (c - q - float(np.clip(c - q, -0.01, 0.01)))
        out[k] = q
    name = "joint.axis.position"
    columns = {"time": t, "joint.axis.command": command, name: out + 4e-4 * rng.normal(size=len(t))}
    work = diagnose(scene_of(Observations("position", columns)))
    found = {f.effect: f.parameters for f in work.diagnosis.findings}
    assert {"time_delay", "friction"} <= set(found) <= {"time_delay", "friction", "lag"}
    assert found["time_delay"]["delay"].value == pytest.approx(0.05, abs=2e-3)
    assert found["friction"]["coulomb"].value == pytest.approx(0.01, rel=0.1)
    constant = found["lag"]["constant"] if "lag" in found else found["friction"]["response"]
    assert constant.value == pytest.approx(0.06, rel=0.1)


def test_one_line_above_the_motion_and_no_row_of_them():
    """A vibration is a line; a periodic motion's friction is a row of them, noise is none."""
    rng, t = np.random.default_rng(2), np.arange(4000) * 0.01
    noise = rng.normal(size=len(t))
    hum = 0.5 * np.sin(2 * np.pi * 24.04 * t)
    comb = 2.0 * np.sign(np.sin(2 * np.pi * 1.1 * t))
    assert has_line(noise + hum, 0.01, 15.0)
    assert not has_line(noise + hum, 0.01, 30.0)
    assert not has_line(noise + comb, 0.01, 15.0)
    assert not any(has_line(rng.normal(size=len(t)), 0.01, 15.0) for _ in range(200))


@pytest.mark.parametrize(
    "effect",
    [
        Friction("axis", "coulomb_viscous", 1e-3),
        Friction("axis", "servo_viscous", coulomb=3e-4, simulated=0.06),
        Friction("axis", "creeping_servo", coulomb=3e-4, response=0.03, settling=0.2),
    ],
)
def test_friction_of_every_form_comes_back_from_its_term(effect):
    """A servo's stand-off is a searched value, a motor's friction a linear one: both are called coulomb."""
    scene = scene_of(sticking(np.random.default_rng(3), 0.08, 200))
    theta = np.arange(1.0, 1.0 + len(effect.parameters(scene)))
    term = effect.to_term(scene, theta)["parameters"]
    assert Friction.from_term(term) == effect
    assert np.array_equal(effect.theta_of(scene, term), theta)

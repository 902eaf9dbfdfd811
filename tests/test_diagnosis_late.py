"""Streams that answer late: filters of one pole and of two are told from delays, with the constants of continuous time."""

import sys
from pathlib import Path

import numpy as np
import pytest
from scipy.interpolate import CubicSpline
from scipy.signal import lsim

sys.path.insert(0, str(Path(__file__).parent))

from diagnosis_cases import COM, MASS, Bench, G, Servo, hanging, lagged, rotation

from galen_hw.diagnosis.pipeline import diagnose
from galen_hw.diagnosis.work import Work
from galen_hw.kinematics import GalenRobot
from galen_hw.physics.effects.registry import scene_of
from galen_hw.physics.observations import Observations


def late(constant: float, damping: float | None, between: str, quiet: float) -> Work:
    """Two runs whose whole wrench answers so, 20 rows a second, their noise so many times the usual."""
    runs = [Bench(seed, rows=4000) for seed in (5, 6)]
    for run in runs:
        run.wrench = np.stack([_answered(run.t, x, constant, damping, between) for x in run.wrench.T], axis=1)
        run.noise *= quiet
    learnt, other = (scene_of(run.observations()) for run in runs)
    return diagnose(learnt, holdout=other)


def _answered(
    t: np.ndarray, x: np.ndarray, constant: float, damping: float | None, between: str = "bows"
) -> np.ndarray:
    """What a filter makes of a signal that is smooth between its rows, runs in straight lines, or stands from row to row."""
    parts, rows = 20, len(t)
    fine = np.linspace(t[0], t[-1], parts * (rows - 1) + 1)
    system = [1.0], [constant, 1.0] if damping is None else [constant**2, 2.0 * damping * constant, 1.0]
    later = np.minimum(np.arange(len(fine)) // parts + 1, rows - 1)
    signal = {"bows": CubicSpline(t, x)(fine), "lines": np.interp(fine, t, x), "steps": x[later]}[between]
    return x[0] + lsim(system, signal - x[0], fine - t[0], interp=between != "steps")[1][::parts]


@pytest.mark.inject
@pytest.mark.parametrize(
    ("constant", "damping", "between", "quiet"),
    [
        (0.06, None, "bows", 1.0),
        (0.06, None, "bows", 0.05),
        (0.06, None, "lines", 0.05),
        (0.06, None, "steps", 1.0),
        (0.3, None, "steps", 0.2),
        (0.35, 0.4, "bows", 1.0),
        (0.35, 0.4, "steps", 1.0),
        (0.2, 0.71, "bows", 1.0),
        (0.2, 0.71, "lines", 1.0),
    ],
)
def test_a_filter_is_a_lag_of_its_order(constant: float, damping: float | None, between: str, quiet: float) -> None:
    """Hardly more than a row long, a servo that rings, and Butterworth's: one name, its constants, and nothing beside it.

    Whatever lies between two rows: a machine is smooth, a logger that fills in rows draws straight lines, and a filter of samples
    takes each for the time before it. By lines alone the first had a delay beside it and the last an advance, or `unknown`.
    """
    work = late(constant, damping, between, quiet)
    assert [f.effect for f in work.diagnosis.findings] == ["lag"]
    assert work.diagnosis.verdict == "explained"
    told = work.diagnosis.findings[0].parameters
    assert told["constant"].value == pytest.approx(constant, rel=0.02)
    assert ("damping" in told) == (damping is not None)
    if damping is not None:
        assert told["damping"].value == pytest.approx(damping, rel=0.03)


@pytest.mark.inject
def test_a_lag_far_shorter_than_a_row_is_named_beside_the_delay() -> None:
    """A twentieth of a row: no data tell the two apart, and the answer says so, whichever stands first."""
    constant, bench = 0.0025, Bench(seed=5, rows=4000)
    bench.wrench = np.stack([_answered(bench.t, x, constant, None) for x in bench.wrench.T], axis=1)
    bench.noise *= 0.05
    (finding,) = diagnose(scene_of(bench.observations())).diagnosis.findings
    assert {finding.effect, *(c.effect for c in finding.confounded_with)} >= {"lag", "time_delay"}
    told = finding.parameters["delay" if finding.effect == "time_delay" else "constant"]
    assert told.value == pytest.approx(constant, rel=0.05)


@pytest.mark.inject
def test_a_lag_is_not_preferred_to_a_delay_for_quietening_the_encoders() -> None:
    """One row late, and joints read to a tenth of a milliradian: the simulation is as noisy as they are."""
    runs = [Bench(seed, rows=6000, rate=100.0) for seed in (5, 6)]
    for run in runs:
        run.wrench = np.concatenate([run.wrench[:1], run.wrench[:-1]])
        run.q = run.q + 1e-4 * run.rng.normal(size=run.q.shape)
    learnt, other = (scene_of(run.observations()) for run in runs)
    (finding,) = diagnose(learnt, holdout=other).diagnosis.findings
    assert finding.effect == "time_delay"
    assert finding.parameters["delay"].value == pytest.approx(0.01, rel=0.05)


def servos(delays: list[float], constants: list[float]) -> Observations:
    """Two minutes of joints from rest, of which each answers its command in its own time, a thousand times the noise."""
    rng, t, columns = np.random.default_rng(2), np.arange(6000) / 50.0, dict[str, np.ndarray]()
    for name, delay, constant in zip("abcd", delays, constants, strict=True):
        frequency, phase, size = rng.uniform(0.05, 0.8, 5), rng.uniform(0.0, 6.0, 5), rng.uniform(0.1, 0.4, 5)
        command, behind = (
            np.clip(s / 3.0, 0.0, 1.0) ** 2 * (np.sin(2.0 * np.pi * np.outer(s, frequency) + phase) @ size)
            for s in (t, t - delay)
        )
        columns[f"joint.{name}.command"] = command
        columns[f"joint.{name}.position"] = lagged(t, behind, constant) + 2e-4 * rng.normal(size=len(t))
    return Observations("position", {"time": t, **columns})


@pytest.mark.inject
def test_joints_that_answer_each_in_their_own_time_have_each_their_own_clocks() -> None:
    """Not one delay of all and whatever bends beside it: a delay and a lag of each joint, and nothing else."""
    delays, constants = [0.02, 0.04, 0.06, 0.08], [0.05, 0.07, 0.09, 0.11]
    answer = diagnose(scene_of(servos(delays, constants))).diagnosis
    assert {f.effect for f in answer.findings} == {"time_delay", "lag"}
    told = {name: p.value for f in answer.findings for name, p in f.parameters.items()}
    for name, delay, constant in zip("abcd", delays, constants, strict=True):
        assert told[f"{name}: delay"] + told[f"{name}: constant"] == pytest.approx(delay + constant, rel=0.01)
        assert told[f"{name}: constant"] == pytest.approx(constant, rel=0.05)


@pytest.mark.inject
def test_a_servo_that_rings_is_no_delay() -> None:
    """Slow motion shows it as late alone; its commands stand from row to row, as one who integrates by hand has them."""
    servo, frequency, damping, parts = Servo(), 2.0 * np.pi * 3.0, 0.35, 200
    dt = float(servo.t[1]) / parts
    x, v = servo.command[0].copy(), np.zeros(2)
    for k, command in enumerate(servo.command):
        for _ in range(parts):
            v += dt * (frequency**2 * (command - x) - 2.0 * damping * frequency * v)
            x += dt * v
        servo.position[k] = x
    servo.sigma = 1e-4
    work = diagnose(scene_of(servo.observations()))
    assert [f.effect for f in work.diagnosis.findings] == ["lag"]
    assert work.diagnosis.verdict == "explained"
    told = work.diagnosis.findings[0].parameters
    assert told["constant"].value == pytest.approx(1.0 / frequency, rel=0.02)
    assert told["damping"].value == pytest.approx(damping, rel=0.03)


def off_by(seconds: float, bench: Bench) -> Bench:
    """The same, its wrench stamped so many seconds late."""
    bench.wrench = np.stack([np.interp(bench.t - seconds, bench.t, x) for x in bench.wrench.T], axis=1)
    return bench


def test_a_clock_off_by_more_than_the_motion_s_own_time_is_a_delay() -> None:
    """75 s of motions of some seconds, stamped 1.7 s early: a payload and a gain had explained half of it."""
    (finding,) = diagnose(scene_of(off_by(-1.7, Bench(seed=1, rows=1500)).observations())).diagnosis.findings
    assert finding.effect == "time_delay"
    assert finding.parameters["delay"].value == pytest.approx(-1.7, abs=1e-3)


@pytest.mark.inject
@pytest.mark.parametrize("seconds", [-2.6, 0.6, 2.1])
def test_a_clock_that_is_off_hides_nothing_else(seconds: float) -> None:
    """A body that nobody entered, and a sensor that drifts."""
    bench = Bench(seed=12, rows=1500)
    bench.wrench = hanging(bench.R, MASS + 0.15, COM + np.array([0.0, 0.0, 0.01]))
    off_by(seconds, bench).wrench[:, 2] += np.linspace(0.0, 0.5, len(bench.t))
    work = diagnose(scene_of(bench.observations()))
    assert {f.effect for f in work.diagnosis.findings} == {"time_delay", "payload", "drift"}
    assert work.diagnosis.verdict == "explained"


@pytest.mark.parametrize("delay", [0.01, 0.04])
def test_a_scale_beside_a_delay_makes_no_response_of_second_order(delay: float) -> None:
    """A servo that rings is larger than its command too: beside a delay thirty times the noise it had been that."""
    runs = []
    for seed in (1, 2):
        servo = Servo(seed, rows=6000, rate=100.0)
        late = [np.interp(servo.t - delay, servo.t, command) for command in servo.command.T]
        servo.position = 1.003 * np.stack(late, axis=1)
        runs.append(scene_of(servo.observations()))
    work = diagnose(runs[0], holdout=runs[1])
    assert [f.effect for f in work.diagnosis.findings] == ["time_delay", "joint_scale"]
    assert work.diagnosis.verdict == "explained"
    late, scale = (f.parameters for f in work.diagnosis.findings)
    assert late["delay"].value == pytest.approx(delay, rel=0.01)
    assert [scale[f"{name}: scale_error"].value for name in ("pan", "lift")] == pytest.approx([0.003] * 2, rel=0.1)


def swept(seed: int, late: float) -> Observations:
    """A sweep of poses with a tool that is flung from one to the next, its wrench late by so many seconds, quiet sensors."""
    bench, rng = Bench(seed, rows=12000, rate=100.0), np.random.default_rng(seed + 100)
    places = np.zeros((len(bench.t) // 210 + 2, 5))
    places[:, 3:] = rng.uniform(-0.7, 0.7, (len(places), 2))

    def q(t: np.ndarray) -> np.ndarray:
        k = np.maximum(t // 2.1, 0.0).astype(int)
        part = np.clip((t - 2.1 * k - 1.203) / 0.871, 0.0, 1.0)[:, None]
        return places[k] + (places[k + 1] - places[k]) * part**3 * (10.0 - 15.0 * part + 6.0 * part**2)

    def centre(t: np.ndarray) -> np.ndarray:
        T = GalenRobot().sensor_pose(q(t))
        return T[:, :3, 3] + T[:, :3, :3] @ COM

    when, h = bench.t - late, 1e-4
    pulled = np.array([0.0, 0.0, -G]) - (centre(when + h) - 2.0 * centre(when) + centre(when - h)) / h**2
    force = MASS * np.einsum("nji,nj->ni", rotation(*q(when)[:, 3:].T), pulled)
    bench.wrench = np.concatenate([force, np.cross(COM, force)], axis=1)
    bench.q = np.round(q(bench.t) / 1e-5) * 1e-5
    bench.noise *= 0.2
    bench.belief["dynamic"] = True
    return bench.observations()


@pytest.mark.inject
@pytest.mark.parametrize("late", [0.007, 0.01])
def test_a_delay_in_a_sweep_of_poses_is_no_lag(late: float) -> None:
    """An arm that starts from rest has a corner in its acceleration: rounded, it looks like the one less the other."""
    learnt, other = (scene_of(swept(seed, late)) for seed in (2, 52))
    (finding,) = diagnose(learnt, holdout=other).diagnosis.findings
    assert finding.effect == "time_delay"
    assert finding.parameters["delay"].value == pytest.approx(late, rel=0.02)


def begun_in_motion(effect: str, seed: int, cut: int = 400) -> Observations:
    """A minute and a half out of a longer run: what comes first answers to what was not recorded."""
    bench = Bench(seed, rows=2000 + cut)
    if effect == "time_delay":
        bench.wrench = CubicSpline(bench.t, bench.wrench)(np.maximum(bench.t - 0.3, 0.0))
    elif effect == "creep":
        bench.wrench[:, 1] += 0.1 * _answered(bench.t, bench.wrench[:, 1], 5.0, None)
    else:
        bench.wrench = np.stack([_answered(bench.t, x, 0.8, None) for x in bench.wrench.T], axis=1)
    bench.t = bench.t[cut:] - bench.t[cut]
    for name in ("q", "R", "wrench", "noise"):
        setattr(bench, name, getattr(bench, name)[cut:])
    return bench.observations()


@pytest.mark.inject
@pytest.mark.parametrize(
    ("effect", "name", "value", "within"),
    [("lag", "constant", 0.8, 0.02), ("time_delay", "delay", 0.3, 0.02), ("creep", "constant", 5.0, 0.1)],
)
def test_what_came_before_a_recording_is_no_effect(effect: str, name: str, value: float, within: float) -> None:
    """What fades from an unknown beginning had been a drift beside a lag or a creep, and `unknown` beside a delay."""
    learnt, other = (scene_of(begun_in_motion(effect, seed)) for seed in (4, 5))
    work = diagnose(learnt, holdout=other)
    (finding,) = work.diagnosis.findings
    assert work.diagnosis.verdict == "explained"
    assert finding.effect == effect
    assert finding.parameters[name].value == pytest.approx(value, rel=within)

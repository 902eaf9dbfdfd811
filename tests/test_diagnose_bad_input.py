"""`galen-hw diagnose` on what people really hand in: one line each, never a traceback, never a confident finding."""

import csv
import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from galen_hw.cli import main
from galen_hw.diagnosis.preprocessing.checks import screened
from galen_hw.physics.effects.registry import scene_of
from galen_hw.physics.signals.differentiation import derivatives
from galen_hw.premises import examined
from galen_hw.tools.check_recording import _lines
from tests import physics_scenes
from tests.diagnosis_cases import Bench

ROWS, RATE = 400, 10.0
MASS, COM = 0.287, np.array([0.031, 0.004, -0.063])
JOINTS = ("carriage1", "carriage2", "carriage3", "roll", "tilt")
INFO: dict[str, Any] = {
    "schema": 1,
    "robot": "galen",
    "predict": "wrench",
    "tool": {"name": "retractor", "mass": MASS, "com": COM.tolist()},
    "model": {"bias": "free", "dynamics": "static"},
}
FORCES = [f"wrench.force.{a}" for a in "xyz"]
TORQUES = [f"wrench.torque.{a}" for a in "xyz"]
Columns = dict[str, np.ndarray]


def recording() -> Columns:
    """A hanging weight in closed form, R = Rx(roll) Ry(tilt), by this test."""
    rng = np.random.default_rng(8)
    t = np.arange(ROWS) / RATE
    roll = 0.5 * np.sin(2 * np.pi * 0.11 * t) + 0.3 * np.sin(2 * np.pi * 0.047 * t + 1.0)
    tilt = 0.4 * np.sin(2 * np.pi * 0.083 * t + 0.5) + 0.2 * np.sin(2 * np.pi * 0.19 * t)
    columns = {"time": t} | {f"joint.{n}.position": np.zeros(ROWS) for n in JOINTS}
    columns |= {"joint.roll.position": roll, "joint.tilt.position": tilt}
    weight = MASS * 9.80665
    force = weight * np.stack([np.cos(roll) * np.sin(tilt), -np.sin(roll), -np.cos(roll) * np.cos(tilt)], axis=1)
    torque = np.cross(COM, force)
    force = force + 0.015 * rng.normal(size=force.shape)
    torque = torque + 2.5e-4 * rng.normal(size=torque.shape)
    return columns | dict(zip(FORCES, force.T, strict=True)) | dict(zip(TORQUES, torque.T, strict=True))


def write(folder: Path, columns: Columns, info: dict[str, Any] | None = None) -> Path:
    """A table folder; NaN cells stay empty."""
    folder.mkdir(parents=True)
    with (folder / "recording.csv").open("w", newline="") as file:
        table = csv.writer(file)
        table.writerow(columns)
        table.writerows(
            [["" if x != x else repr(float(x)) for x in row] for row in zip(*columns.values(), strict=True)]
        )
    if info is not None:
        (folder / "recording.json").write_text(json.dumps(info))
    return folder


def diagnose(folder: Path, *words: str) -> tuple[int, dict[str, Any]]:
    """Exit status and answer."""
    out = folder.parent / "answer.json"
    status = main(["diagnose", str(folder), "-o", str(out), *words])
    return status, json.loads(out.read_text()) if out.exists() else {}


def missing_joint(c: Columns, i: dict[str, Any]) -> None:
    del c["joint.tilt.position"]


def missing_channel(c: Columns, i: dict[str, Any]) -> None:
    del c["wrench.torque.y"]


def empty_channel(c: Columns, i: dict[str, Any]) -> None:
    c["wrench.force.x"] = np.full(ROWS, np.nan)


def too_short(c: Columns, i: dict[str, Any]) -> None:
    c.update({k: v[:5] for k, v in c.items()})


def shuffled(c: Columns) -> None:
    order = np.random.default_rng(0).permutation(ROWS)
    c.update({name: values[order] for name, values in c.items()})


def standing(c: Columns, i: dict[str, Any]) -> None:
    c["time"] = np.zeros(ROWS)


def no_robot(c: Columns, i: dict[str, Any]) -> None:
    i["robot"] = None


def robot_not_there(c: Columns, i: dict[str, Any]) -> None:
    i["robot"] = "arm.urdf"


def nothing_to_compare(c: Columns, i: dict[str, Any]) -> None:
    del i["predict"]


def wrong_group(c: Columns, i: dict[str, Any]) -> None:
    i["predict"] = "pose"


def negative_mass(c: Columns, i: dict[str, Any]) -> None:
    i["tool"] = {"mass": -1.0, "com": [0, 0, 0]}


REFUSED = {
    missing_joint: "joints have no position, first tilt",
    missing_channel: "wrench.torque.y has no value",
    empty_channel: "wrench.force.x has no value",
    too_short: "only 5 of 5 rows can be compared",
    standing: "only 1 of 1 rows",
    no_robot: "there is nothing to simulate from",
    robot_not_there: "the robot's file is not there",
    nothing_to_compare: "nothing is named to compare",
    wrong_group: "pose.position.x has no value",
    negative_mass: "tool.mass",
}


@pytest.mark.parametrize("spoil", REFUSED, ids=lambda f: f.__name__)
def test_what_cannot_be_compared_is_refused_in_one_line(spoil, tmp_path, capsys):
    """Exit status 2; the line says what, where and what to do; no answer is written."""
    columns, info = recording(), json.loads(json.dumps(INFO))
    spoil(columns, info)
    status, answer = diagnose(write(tmp_path / "run", columns, info))
    lines = capsys.readouterr().err.splitlines()
    assert (status, answer) == (2, {})
    assert len(lines) == 1
    assert lines[0].startswith("galen-hw diagnose: ")
    assert REFUSED[spoil] in lines[0]
    assert ";" in lines[0]


def test_files_that_are_not_there_or_broken(tmp_path, capsys):
    """Missing paths, broken JSON, no JSON, another kind of file, an unknown tool, a share that is none, an output folder
    that is not there: one line each."""
    good = write(tmp_path / "good", recording(), INFO)
    broken = write(tmp_path / "broken", recording(), INFO)
    (broken / "recording.json").write_text('{"schema": 1,')
    alone = write(tmp_path / "alone", recording())
    junk = tmp_path / "junk.mcap"
    junk.write_bytes(b"\x00\x01 not a recording")
    (tmp_path / "empty").mkdir()
    (tmp_path / "damaged.json").write_text("[]")
    header = tmp_path / "head.csv"
    header.write_text((good / "recording.csv").read_text().partition("\n")[0] + "\n")
    cases = {
        ("nowhere",): "there is no such recording",
        (str(broken),): "not JSON",
        (str(alone),): "there is no recording.json",
        (str(junk),): "not a format that is known",
        (str(header),): f"{header}: there are no rows",
        (
            str(tmp_path / "empty"),
        ): "there is no recording.csv or recording.parquet; give the folder that holds it, an MCAP",
        (str(good), "--holdout", "nowhere"): "there is no such recording",
        (str(good), "--holdout", "1.5"): "not a share",
        (str(good), "--simulation", "nowhere"): "nowhere",
        (str(good), "--tool", "hammer"): "no tool 'hammer'",
        (str(good), "--tool", str(tmp_path / "damaged.json")): "not a tool's file",
        (str(good), "-o", str(tmp_path / "no" / "where.json")): "no such folder",
        (str(good), "--report", str(tmp_path / "no" / "where.html")): "no such folder",
        (str(good), "--save-model", str(tmp_path / "empty")): "is a folder",
    }
    for words, text in cases.items():
        assert main(["diagnose", *words]) == 2, words
        lines = capsys.readouterr().err.splitlines()
        assert len(lines) == 1, (words, lines)
        assert text in lines[0], words


def test_a_simulation_that_does_not_overlap_is_refused(tmp_path, capsys):
    """Another time altogether; half of it is a note."""
    columns = recording()
    folder = write(tmp_path / "run", columns, INFO)
    simulated = {"time": columns["time"] + 1e4} | {n: columns[n] for n in (*FORCES, *TORQUES)}
    write(folder / "simulation", simulated, INFO)
    assert diagnose(folder)[0] == 2
    assert "does not overlap" in capsys.readouterr().err


def swapped(c: Columns) -> None:
    c["wrench.force.x"], c["wrench.force.y"] = c["wrench.force.y"], c["wrench.force.x"]


def wrong_sign(c: Columns) -> None:
    c.update({n: -c[n] for n in (*FORCES, *TORQUES)})


def newton_millimetres(c: Columns) -> None:
    c.update({n: 1000.0 * c[n] for n in TORQUES})


def degrees(c: Columns) -> None:
    c.update({f"joint.{n}.position": np.degrees(c[f"joint.{n}.position"]) for n in ("roll", "tilt")})


def dead_channel(c: Columns) -> None:
    c["wrench.force.y"] = np.full(ROWS, 0.25)


def degrees_per_second(c: Columns) -> None:
    c["joint.roll.velocity"] = np.degrees(np.gradient(c["joint.roll.position"], c["time"]))


def milliseconds(c: Columns) -> None:
    c["joint.roll.velocity"] = np.gradient(c["joint.roll.position"], c["time"])
    c["time"] = 1000.0 * c["time"]


REPAIRED: dict[Callable[[Columns], None], str] = {
    swapped: "wrench.force: axes x, y, z read like y, x, z of the sensor: left-handed axes; repaired",
    wrong_sign: "force and torque have the opposite sign (reaction instead of action), or the robot hangs upside down; repaired",
    newton_millimetres: "torque is in N mm",
    degrees: "joints are in degrees; repaired",
    degrees_per_second: "times the position's change (is it in degrees a second?)",
    milliseconds: "it is in ms; repaired",
}
WRONG: dict[Callable[[Columns], None], str] = {
    dead_channel: "wrench.force.y stands still at 0.25 while its simulation moves",
}


@pytest.mark.parametrize("spoil", REPAIRED, ids=lambda f: f.__name__)
def test_a_certain_mistake_is_repaired_and_said(spoil, tmp_path, capsys):
    """Exit status 0: the same recording as without the mistake; the note names the mistake."""
    columns = recording()
    spoil(columns)
    status, answer = diagnose(write(tmp_path / "run", columns, INFO))
    assert (status, answer["verdict"], answer["findings"]) == (0, "agrees", [])
    assert REPAIRED[spoil] in capsys.readouterr().out
    assert [p["action"] for p in answer["premises"]] == ["repaired"]


@pytest.mark.parametrize("spoil", REPAIRED, ids=lambda f: f.__name__)
def test_without_repair_the_same_mistake_is_refused(spoil, tmp_path, capsys):
    """Exit status 1, unexplained, the cause in one line, `unknown` the only finding."""
    columns = recording()
    spoil(columns)
    status, answer = diagnose(write(tmp_path / "run", columns, INFO), "--no-repair")
    assert (status, answer["verdict"]) == (1, "unexplained")
    assert [f["effect"] for f in answer["findings"]] == ["unknown"]
    assert REPAIRED[spoil].removesuffix("; repaired") in capsys.readouterr().out


def test_rows_out_of_order_are_sorted_by_their_stamps(tmp_path, capsys):
    """The same recording; without the repair its clock runs backwards, and nothing is compared."""
    columns = recording()
    shuffled(columns)
    status, answer = diagnose(write(tmp_path / "run", columns, INFO))
    assert (status, answer["verdict"]) == (0, "agrees")
    assert "rows are not in the order of their stamps" in capsys.readouterr().out
    assert diagnose(write(tmp_path / "as_it_is", columns, INFO), "--no-repair")[0] == 2
    assert "sort the rows" in capsys.readouterr().err


@pytest.mark.parametrize("spoil", WRONG, ids=lambda f: f.__name__)
def test_a_wrong_premise_is_said_and_nothing_else_claimed(spoil, tmp_path, capsys):
    """Exit status 1, unexplained, the reason in one line, `unknown` the only finding."""
    columns = recording()
    spoil(columns)
    status, answer = diagnose(write(tmp_path / "run", columns, INFO))
    assert status == 1
    assert answer["verdict"] == "unexplained"
    said = capsys.readouterr().out
    assert WRONG[spoil] in said
    assert [f["effect"] for f in answer["findings"]] == ["unknown"]


def test_a_centre_of_mass_in_millimetres_is_no_payload(tmp_path, capsys):
    """The tool's file is wrong, not the tool."""
    tool = INFO["tool"] | {"com": (1000.0 * COM).tolist()}
    status, answer = diagnose(write(tmp_path / "run", recording(), INFO | {"tool": tool}))
    assert status == 1
    assert "tool.com lies 70.33 m from the sensor: is it in mm?" in capsys.readouterr().out
    assert [f["effect"] for f in answer["findings"]] == ["unknown"]


def repeated_and_backward(c: Columns) -> None:
    c["time"][[50, 120]] = c["time"][[49, 119]]
    c["time"][200] = c["time"][190]


def one_leap(c: Columns) -> None:
    c["time"][100] += 1e6


def gap(c: Columns) -> None:
    c["time"][200:] += 3600.0


def empty_cells(c: Columns) -> None:
    c["wrench.force.z"][[10, 11, 300]] = np.nan
    c["joint.roll.position"][[40, 41]] = np.nan


def empty_stretch(c: Columns) -> None:
    """Longer than a motion can be guessed over."""
    c["wrench.force.z"][200:320] = np.nan


NOTED: dict[Callable[[Columns], None], tuple[str, ...]] = {
    repeated_and_backward: ("repeats or runs backwards in 3 rows",),
    one_leap: ("repeats or runs backwards in 1 rows",),
    gap: ("1 gaps, the longest of 3.6e+03 s",),
    empty_stretch: ("120 rows have no value to compare", "time has 1 gaps"),
    empty_cells: ("2 rows have no joint position", "3 rows have no value to compare"),
}


@pytest.mark.parametrize("spoil", NOTED, ids=lambda f: f.__name__)
def test_small_faults_are_noted_and_the_rest_agrees(spoil, tmp_path, capsys):
    """Exit status 0, one note for each kind of fault, no finding."""
    columns = recording()
    spoil(columns)
    status, answer = diagnose(write(tmp_path / "run", columns, INFO))
    assert (status, answer["verdict"], answer["findings"]) == (0, "agrees", [])
    said = capsys.readouterr().out
    for text in NOTED[spoil]:
        assert text in said


@pytest.mark.parametrize(("group", "column"), [("effort", "joint.elbow.effort"), ("pose", "pose.orientation.y")])
def test_what_was_not_measured_is_left_out_and_the_rest_compared(group: Any, column: str) -> None:
    """An empty column is a channel that nobody measured: said, and no reason to stop."""
    scene = physics_scenes.scene(group, np.random.default_rng(3), 400)
    columns = dict(scene.observations.columns) | {column: np.full(400, np.nan)}
    out = screened(scene_of(replace(scene.observations, columns=columns)))
    assert f"{column} was not measured and is left out" in out.notes
    assert out.scene.channels
    assert not any("elbow" in name or "orientation" in name for name in out.scene.channels)
    assert np.isfinite(out.scene.measured).all()


def test_a_far_heavier_tool_is_no_change_of_units() -> None:
    """2.2 times the believed weight is a payload, 4.2 times is asked about, and 1 / 4.448 of it may be in pounds-force."""
    heavier, far, pounds = Bench(1), Bench(1), Bench(1)
    heavier.wrench *= 2.2
    far.wrench *= 4.2
    pounds.wrench /= 4.44822
    assert not examined(heavier.observations()).remarks
    assert "another tool, or other units?" in examined(far.observations()).refused[0].what
    assert "lbf" in examined(pounds.observations()).refused[0].what


def holed(seed: int, **more: np.ndarray) -> Columns:
    """The recording with one cell of fifty empty, of a column each."""
    rng, columns = np.random.default_rng(seed), recording() | more
    for name in (*FORCES, *TORQUES, "joint.roll.position"):
        columns[name] = np.where(rng.random(len(columns[name])) < 0.02, np.nan, columns[name])
    return columns


def test_empty_cells_of_the_recording_that_is_judged_on_hide_nothing(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A heavier tool is found, judged on another recording with holes: its rows are left out and counted, no figure is NaN."""
    heavier = INFO | {"tool": {"name": "retractor", "mass": 0.25, "com": COM.tolist()}}
    a, b = write(tmp_path / "a", holed(1), heavier), write(tmp_path / "b", holed(2), heavier)
    assert main(["diagnose", str(a), "--holdout", str(b), "-o", str(tmp_path / "out.json")]) == 1
    answer = json.loads((tmp_path / "out.json").read_text())
    assert [f["effect"] for f in answer["findings"]] == ["payload"]
    assert all(x is not None for figures in answer["fit"].values() for x in figures.values())
    assert "held-out recording: " in capsys.readouterr().out


def test_servos_are_compared_though_some_joints_were_not_recorded(tmp_path: Path) -> None:
    """Two joints of the Galen's five, their commands and a late reading, of a third the command alone: a delay."""
    rng, t = np.random.default_rng(3), np.arange(2000) / 100.0
    for name in ("a", "b"):
        columns: Columns = {"time": t}
        for joint, hz in (("roll", 0.31), ("tilt", 0.47)):
            phase = rng.uniform(0.0, 6.0)
            columns[f"joint.{joint}.command"] = 0.4 * np.sin(2 * np.pi * hz * t + phase)
            late = 0.4 * np.sin(2 * np.pi * hz * (t - 0.03) + phase)
            columns[f"joint.{joint}.position"] = late + 1e-3 * rng.normal(size=len(t))
        columns["joint.carriage1.command"] = 1e-3 * np.sin(t)
        write(tmp_path / name, columns, {"schema": 1, "robot": "galen", "predict": "position"})
    words = ["diagnose", str(tmp_path / "a"), "--holdout", str(tmp_path / "b"), "-o", str(tmp_path / "out.json")]
    assert main(words) == 1
    assert [f["effect"] for f in json.loads((tmp_path / "out.json").read_text())["findings"]] == ["time_delay"]


def test_a_zeroing_at_joints_without_a_robot_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Without a robot nobody knows how the sensor stood; the bias body's weight would be missing in silence."""
    columns = {k: v for k, v in recording().items() if not k.startswith("joint.")}
    columns |= {f"sensor.orientation.{a}": np.full(ROWS, float(a == "w")) for a in "xyzw"}
    info = INFO | {"robot": None, "bias_body": {"mass": 0.08, "com": [0, 0, 0.01]}, "zeroed_at": {"roll": 0.0}}
    assert main(["diagnose", str(write(tmp_path / "a", columns, info))]) == 2
    assert "zeroed_at" in capsys.readouterr().err


def test_missing_rows_do_not_turn_an_encoders_rounding_into_acceleration() -> None:
    """Steps of 0.1 mrad at 250 Hz, a fifth of the rows left out: acceleration within a tenth of the true one's rms."""
    t = np.arange(4000) / 250.0
    u = np.clip((t[:, None] - np.array([1.0, 5.0, 9.0, 13.0])) / 1.5, 0.0, 1.0)
    ways = np.array([0.7, -1.1, 0.9, -0.6])
    q, ddq = (10 * u**3 - 15 * u**4 + 6 * u**5) @ ways, (60 * u - 180 * u**2 + 120 * u**3) @ ways / 1.5**2
    for seed in (12, 22, 23, 27, 33, 34):  # Of forty those in which a peak of the noise had passed for motion.
        rng = np.random.default_rng(seed)
        x = np.round((q + 3e-5 * rng.normal(size=len(t))) / 1e-4) * 1e-4
        kept = np.sort(rng.choice(len(t), 3200, replace=False))
        found = derivatives(t[kept], x[kept, None], [slice(0, 3200)])[1][:, 0]
        assert np.std(found - ddq[kept]) < 0.1 * np.std(ddq)


def test_json_may_go_where_the_summary_goes_otherwise(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A script reads the answer and nothing else; whoever sits before the screen still sees the summary."""
    heavier = INFO | {"tool": {"name": "retractor", "mass": 0.25, "com": COM.tolist()}}
    folder = write(tmp_path / "run", recording(), heavier)
    assert main(["diagnose", str(folder), "--json"]) == 1
    out, err = capsys.readouterr()
    assert [f["effect"] for f in json.loads(out)["findings"]] == ["payload"]
    assert "named physics explains it" in " ".join(err.split())
    assert not (tmp_path / "-").exists()


def test_check_and_import_say_how_far_they_are(tmp_path, capsys):
    """On stderr, as diagnose does; what is refused while it is read stays one line."""
    folder = write(tmp_path / "run", recording(), INFO)
    assert main(["check", str(folder), "--json"]) == 0
    out, err = capsys.readouterr()
    assert json.loads(out)["recordings"]
    assert err == "examining run\n"
    assert main(["import", str(folder), "-o", str(tmp_path / "out.mcap")]) == 0
    assert capsys.readouterr().err == "examining out.mcap\n"
    assert main(["check", str(tmp_path / "none")]) == 2
    assert len(capsys.readouterr().err.splitlines()) == 1


def test_check_says_once_what_was_repaired():
    """The action stands in front of the line."""
    answer = {"recording": "run", "rows": 2, "predict": "pose", "premises": [{"action": "repaired"}]}
    assert _lines(answer | {"lines": ["2 cells: taken as not measured; repaired"]})[1:] == [
        "  repaired  2 cells: taken as not measured"
    ]

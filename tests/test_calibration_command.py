"""`galen-hw calibrate --from` and `galen-hw tool`, as an operator meets them."""

import io
import json
import re
import sys
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console

sys.path.insert(0, str(Path(__file__).parent))

from calibration_plant import Plant
from calibration_sim import BIAS, body, sweep

from galen_hw.cli import main
from galen_hw.identification.report import two_step
from galen_hw.messages import CalibrationProgress
from galen_hw.recording import Recording, RecordingInfo, write_table
from galen_hw.recording.recording import SENSOR_ORIENTATION, WRENCH
from galen_hw.recording.session import Session
from galen_hw.services.calibration.settings import AxisSettings, CalibrationSettings
from galen_hw.spatial import quaternion_from_rotation
from galen_hw.tools.calibration.command import _can_be_fitted
from galen_hw.tools.calibration.sweep import Display, patience

SETTINGS = CalibrationSettings(
    axes={"tilt": AxisSettings(low=-0.6, high=0.6, count=4), "roll": AxisSettings(low=-0.9, high=0.9, count=5)},
    samples=100,
    zero_samples=100,
)


VIRTUAL = ["calibrate", "--virtual", "--tool", "pointer"]


@pytest.fixture(autouse=True)
def _own_state(tmp_path, monkeypatch):
    monkeypatch.setenv("GALEN_HW_STATE", str(tmp_path / "state"))
    monkeypatch.setenv("GALEN_HW_RUNTIME", str(tmp_path / "run"))


def table(folder, R, wrench, **info):
    """A table of static poses with the sensor's orientation."""
    columns = dict(zip(SENSOR_ORIENTATION, quaternion_from_rotation(R).T, strict=True))
    columns |= dict(zip(WRENCH, wrench.T, strict=True))
    return write_table(Recording(columns, RecordingInfo.model_validate({"schema": 1, "robot": None} | info)), folder)


def as_json(capsys, *words):
    """Run a command and read its JSON; (status, object)."""
    capsys.readouterr()
    status = main([*map(str, words), "--json"])
    return status, json.loads(capsys.readouterr().out)


def calibrated(capsys, folder, *words):
    return as_json(capsys, "calibrate", "--from", folder, "--yes", *words)


@pytest.fixture
def poses(tmp_path):
    """A table of the nominal sweep, tool poses only, whose zeroing is known."""
    found = sweep(np.random.default_rng(0), bare=0)
    known = {"mass": BIAS.mass, "com": BIAS.com.tolist()}
    return table(tmp_path / "poses", found.R, found.wrench, zeroed_at=[0.0, 0.0, 0.0, 1.0], bias_body=known)


def test_a_table_with_quaternions_is_fitted_accepted_and_shown(capsys, poses):
    """Mass and centre of mass of the tool alone (the bias body is given), shown by `tool show` with their origin."""
    status, found = calibrated(capsys, poses, "--tool", "retractor")
    _, shown = as_json(capsys, "tool", "show", "retractor")

    assert status == 0
    assert shown["mass"] == pytest.approx(body().mass, abs=4 * shown["std"]["mass"])
    assert shown["com"] == pytest.approx(body().com, abs=4 * max(shown["std"]["com"]))
    assert shown["origin"]["sweep"] == str(poses)
    assert shown["calibration"] == found["tool"]["origin"]["id"]
    assert (shown["schema"], shown["calibrated"], shown["tip"]) == (1, True, [0.045, 0.0, -0.14])


def test_the_report_holds_everything_in_one_file(capsys, poses, tmp_path):
    """Figures as PNG, and one page that loads nothing from elsewhere."""
    calibrated(capsys, poses, "--tool", "retractor", "--report", tmp_path / "out")
    page = (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    names = sorted(p.name for p in (tmp_path / "out").iterdir())

    assert names == ["candidates.png", "compensation.png", "poses.png", "report.html", "residuals.png"]
    assert page.count("data:image/png;base64,") == 4
    assert not re.search(r"""(src|href)=["'](?!data:)""", page)


def test_a_page_that_cannot_be_written_is_one_line_and_says_what_is_active(capsys, poses, tmp_path):
    """After the activation: the calibration is in use and in the JSON, the line says so, exit 1; before: nothing is."""
    (tmp_path / "out" / "report.html").mkdir(parents=True)
    words = ["calibrate", "--from", str(poses), "--tool", "retractor", "--report", str(tmp_path / "out"), "--json"]
    assert main([*words, "--yes"]) == 1
    said = capsys.readouterr()
    found = json.loads(said.out)
    (line,) = (line for line in said.err.splitlines() if line.startswith("galen-hw calibrate:"))
    assert (found["accepted"], found["report"]) == (True, None)
    assert "the page cannot be written" in line
    assert f"{found['tool']['origin']['id']} is active all the same" in line
    assert as_json(capsys, "tool", "show", "retractor")[1]["calibrated"]

    assert main(words) == 4
    assert "nothing has changed" in capsys.readouterr().err


def test_numbers_that_are_impossible_are_one_line(capsys, tmp_path):
    """Readings in mN and mN m, whose mass of hundreds of kilograms no tool's file takes: no traceback is shown."""
    found = sweep(np.random.default_rng(0), bare=0)
    folder = table(tmp_path / "poses", found.R, 1e3 * found.wrench, zeroed_at=[0.0, 0.0, 0.0, 1.0])
    capsys.readouterr()
    assert main(["calibrate", "--from", str(folder), "--tool", "retractor", "--yes"]) == 2
    error = capsys.readouterr().err
    assert "impossible" in error
    assert error.count("\n") == 1


def test_a_stopped_sweep_is_offered_for_a_fit_only_if_it_is_enough_for_one(tmp_path):
    """Bare poses alone are not, a dozen with the tool are: the advice is what the fit itself says."""
    plant = Plant(tmp_path, SETTINGS)
    plant.begin()
    plant.until("waiting")
    (folder,) = (tmp_path / "sweeps").iterdir()
    assert (folder / "recording.csv").exists()
    assert not _can_be_fitted("retractor", folder)
    plant.world.attach("retractor")
    plant.ask("resume")
    for _ in range(14):
        plant.until("averaging")
    plant.ask("stop")
    assert _can_be_fitted("retractor", folder)
    assert not _can_be_fitted("retractor", tmp_path / "nowhere")


def test_nothing_is_active_until_it_is_accepted(capsys, poses):
    """Without --yes and without a terminal to ask at: exit 4, and the tool is as before; what to type is one line."""
    poses = poses.rename(poses.with_name(f"poses of a {'long ' * 30}day"))
    assert main(["calibrate", "--from", str(poses), "--tool", "retractor"]) == 4
    said = capsys.readouterr().out
    assert "not accepted: nothing has changed" in said
    assert f"galen-hw calibrate --tool retractor --from '{poses}'\n" in said
    assert main(["calibrate", "--from", str(poses), "--yes", "--tool", "pointer"]) == 0
    assert re.search(
        r"^accepted: pointer/0001\S+  mass [0-9.]+ g, centre of mass .* mm\n/.*/0001.json$",
        capsys.readouterr().out,
        re.MULTILINE,
    )
    _, shown = as_json(capsys, "tool", "show", "retractor")
    assert not shown["calibrated"]


def test_candidates_are_all_there_with_one_recommendation(capsys, poses):
    """The report's two steps, the joint fits and the added unknowns, each with residuals and BIC."""
    _, found = calibrated(capsys, poses, "--tool", "retractor")
    keys = [c["key"] for c in found["candidates"]]

    assert keys[:3] == ["report", "joint", "robust"]
    assert {"tilt", "mount"} <= set(keys)
    assert found["recommended"] in keys
    assert all(len(c["residual"]) == 6 for c in found["candidates"])


def test_an_mcap_recording_of_the_motion_gives_the_same(capsys, tmp_path):
    """Continuous joints and wrench of a sweep: poses at rest are found in it, and what hangs on the sensor."""
    plant, wrote = Plant(tmp_path, SETTINGS), tmp_path / "motion.mcap"
    with wrote.open("wb") as stream:
        session = Session(stream, robot="galen")
        heard = plant.service.handle

        def handle(topic, message, now):
            if plant.world.tool is not None:
                session.add(topic, message, now)
            return heard(topic, message, now)

        plant.service.handle = handle
        plant.sweep("pointer")
        session.finish()
    status, found = calibrated(capsys, wrote, "--tool", "pointer")

    total = body("pointer").mass + BIAS.mass
    assert status == 0
    assert found["tool"]["mass"] == pytest.approx(total, abs=0.002)
    assert found["tool"]["origin"]["sensor_serial"] in ("", "FT12345")
    assert found["tool"]["origin"]["fit_poses"] >= 20


def test_a_raw_sweep_can_be_fitted_again(capsys, tmp_path):
    """The sweep that the service wrote, stopped half-way, is a recording like any other."""
    plant = Plant(tmp_path, SETTINGS)
    plant.begin()
    plant.until("waiting")
    plant.world.attach("retractor")
    plant.ask("resume")
    for _ in range(14):
        plant.until("averaging")
    plant.ask("stop")
    (folder,) = (tmp_path / "sweeps").iterdir()
    status, found = calibrated(capsys, folder, "--tool", "retractor")

    assert status == 0
    assert found["tool"]["mass"] == pytest.approx(body().mass, abs=1e-3)
    assert found["tool"]["bias_body"]["mass"] == pytest.approx(BIAS.mass, abs=1e-3)
    assert found["tool"]["origin"]["sensor_serial"] == "FT12345"
    assert found["tool"]["zeroed_at"]["roll"] == 0.0


def test_the_reports_equations_are_a_candidate_of_their_own_numbers(capsys, poses):
    """What the table says of the report's two steps is what equations (1) to (8) give."""
    _, found = calibrated(capsys, poses, "--tool", "retractor")
    rows = sweep(np.random.default_rng(0), bare=0)
    known = type("W", (), {"force": BIAS.mass * rows.gravity, "com": BIAS.com})
    _, tool = two_step(rows.R, rows.wrench, zero=rows.zero, body=known)

    assert found["candidates"][0]["mass"] == pytest.approx(tool.mass, rel=1e-9)


def test_a_table_that_cannot_excite_the_mass_is_refused(capsys, tmp_path):
    """Exit 2, the poses are counted, nothing saved: twenty equal rows are one pose."""
    R, wrench = np.broadcast_to(np.eye(3), (20, 3, 3)), np.zeros((20, 6))
    folder = table(tmp_path / "poses", R, wrench)

    assert main(["calibrate", "--from", str(folder), "--tool", "retractor", "--yes"]) == 2
    assert "1 pose for the fit, 4 are the least; measure more orientations" in capsys.readouterr().err
    assert not (tmp_path / "state").exists()


def test_without_a_daemon_it_says_so(capsys):
    """How to start one, or to add --virtual; exit 3."""
    assert main(["calibrate", "--tool", "retractor"]) == 3
    error = capsys.readouterr().err

    assert "no daemon runs here" in error
    assert "galen-hw run" in error
    assert "--virtual" in error


@pytest.mark.parametrize(
    ("words", "text"),
    [
        (["calibrate"], "which tool?"),
        (["calibrate", "--from", "nowhere", "--yes"], "nowhere"),
        (["calibrate", "--from", "nowhere", "--tool", "A b"], "'A b' cannot be a tool's name"),
        (["calibrate", "--from", "nowhere", "--robot", "none.urdf"], "none.urdf: no such file"),
        (["calibrate", "--tool", "pointer", "--sensor-link", "tool0"], "--sensor-link: only of a recording"),
        (["calibrate", "--virtual", "--tool", "../../evil"], "'../../evil' cannot be a tool's name"),
        (["calibrate", "--virtual", "--tool", "pointer", "--report", __file__], "is a file, not a folder"),
        ([*VIRTUAL, "--report", "no where/a.html"], "there is no such folder; mkdir 'no where'"),
        (["calibrate", "--virtual", "--tool", "retracter"], "no tool 'retracter'"),
        (["calibrate", "--virtual", "--tool", "pointer", "--config", "none.toml"], "none.toml: no such file"),
        ([*VIRTUAL, "--poses", "7"], "--poses: 2 counts are asked for, one each for tilt, roll; e.g. 7x8"),
        ([*VIRTUAL, "--poses", "7 8"], "--poses: '7 8' is not TILTSxROLLS"),
        ([*VIRTUAL, "--poses", "0x8"], "--poses: should be greater than or equal to 1 (it is 0)"),
        ([*VIRTUAL, "--poses", "50x50"], "--poses: 2500 poses are more than 1000"),
        ([*VIRTUAL, "--poses", "1x1"], "--poses 1x1: 3 poses for the fit, 4 are the least"),
        (
            [*VIRTUAL, "--samples", "0"],
            "--samples: should be greater than or equal to 10 (it is 0); e.g. samples = 300",
        ),
        ([*VIRTUAL, "--seed", "-1"], "--seed: should be greater than or equal to 0 (it is -1)"),
        (["record", "--virtual", "-o", "/proc/x.mcap"], "/proc/x.mcap: cannot be written"),
        (["collect", "deflection", "--virtual", "-o", __file__], "is a file, not a folder"),
        (["collect", "deflection", "--virtual", "-o", f"{__file__}/session"], "is a file, not a folder"),
        (["tool", "show", "hammer"], "no tool 'hammer'"),
        (["tool", "show", "../x"], "cannot be a tool's name"),
        (["tool", "select", "retractor"], "never calibrated"),
        (["tool", "select"], "which tool?"),
        (["tool", "rollback", "retractor"], "no earlier calibration"),
        (["tool", "import", "nowhere.json"], "cannot be read"),
    ],
)
def test_wrong_use_is_one_line(capsys, monkeypatch, words, text):
    """Exit 2 and one line that says what to do, before any robot is started."""
    monkeypatch.setattr("galen_hw.daemon.session.own_daemon", lambda **_: pytest.fail("a robot was started"))
    assert main(words) == 2
    error = capsys.readouterr().err
    assert text in error
    assert error.count("\n") == 1


def test_the_tools_life(capsys, poses, tmp_path):
    """Calibrated twice, listed, selected, rolled back, exported, imported elsewhere."""
    for _ in range(2):
        calibrated(capsys, poses, "--tool", "retractor")
    assert [r["generation"] for r in as_json(capsys, "tool", "history", "retractor")[1]["history"]] == [1, 2]
    assert as_json(capsys, "tool", "select", "retractor")[1]["selected"] == "retractor"
    listed = {row["name"]: row for row in as_json(capsys, "tool", "list")[1]["tools"]}
    assert listed["retractor"]["selected"]
    assert not listed["pointer"]["calibrated"]
    as_json(capsys, "tool", "rollback", "retractor")
    assert [r["active"] for r in as_json(capsys, "tool", "history", "retractor")[1]["history"]] == [True, False]

    file = tmp_path / "retractor.json"
    as_json(capsys, "tool", "export", "retractor", file)
    assert as_json(capsys, "tool", "import", file)[1]["name"] == "retractor"
    assert [r["active"] for r in as_json(capsys, "tool", "history", "retractor")[1]["history"]] == [False, False, True]
    for part in (["list"], ["show", "retractor"], ["history", "retractor"]):
        assert main(["tool", *part]) == 0
        assert "retractor/0003-" in capsys.readouterr().out


def test_the_list_tells_virtual_from_real(capsys, poses):
    """A calibration from a virtual robot's recording is marked; beside the real one it has a row of its own."""
    info = json.loads((poses / "recording.json").read_text())
    (poses / "recording.json").write_text(json.dumps(info | {"virtual": True, "sensor_serial": "FT28417"}))
    _, found = calibrated(capsys, poses, "--tool", "retractor")
    assert (found["tool"]["origin"]["virtual"], found["tool"]["origin"]["sensor_serial"]) == (True, "FT28417")
    rows = [r for r in as_json(capsys, "tool", "list")[1]["tools"] if r["name"] == "retractor"]
    assert [(r["virtual"], r["calibrated"]) for r in rows] == [(True, True)]
    as_json(capsys, "tool", "select", "retractor")

    (poses / "recording.json").write_text(json.dumps(info))
    calibrated(capsys, poses, "--tool", "retractor")
    rows = [r for r in as_json(capsys, "tool", "list")[1]["tools"] if r["name"] == "retractor"]
    assert [(r["virtual"], r["selected"]) for r in rows] == [(False, False), (True, True)]
    assert main(["tool", "list"]) == 0
    assert capsys.readouterr().out.count("virtual ") == 1


def test_an_impossible_file_is_not_imported(capsys, tmp_path):
    """One line with file and key; the history stays empty."""
    file = tmp_path / "bad.json"
    file.write_text('{"schema": 1, "name": "retractor", "tip": [0, 0, 0], "mass": -1, "com": [0, 0, 0]}')

    assert main(["tool", "import", str(file)]) == 2
    assert "bad.json: mass: a mass of -1 kg is impossible" in capsys.readouterr().err
    assert as_json(capsys, "tool", "history", "retractor")[1]["history"] == []


REAL = Path(__file__).parents[2] / "shared" / "data" / "ft-kuka-ati-static"


@pytest.mark.skipif(not REAL.is_dir(), reason="the real poses may not be redistributed")
def test_real_poses_of_a_real_sensor_give_the_known_numbers(capsys):
    """24 poses of an ATI Gamma on a KUKA: 0.932 to 0.934 kg at (0, 0, 44) mm, and Fx is said to be above noise."""
    _, found = calibrated(capsys, REAL)
    plain = next(c for c in found["candidates"] if c["key"] == "joint")

    assert 0.932 <= found["tool"]["mass"] <= 0.934
    assert found["tool"]["com"] == pytest.approx([0.0, 0.0, 0.044], abs=5e-4)
    assert plain["residual"][:3] == pytest.approx([0.131, 0.047, 0.057], abs=2e-3)
    (remark,) = (line for line in found["remarks"] if line.startswith("Fx"))
    assert "above noise" in remark
    assert "no cause in weight, gain, cross-talk or mounting" in remark


def test_a_simulated_robot_on_a_busy_machine_is_slow_and_not_silent():
    """Progress comes by the robot's own time; beside a real one two seconds without it are the end."""
    assert patience({"speed": 1.0}) == patience({}) == 2.0
    assert patience({"speed": 10.0}) == 20.0


def test_the_time_left_is_the_clocks_and_not_the_robots():
    """At ten times the speed two minutes of the robot are twelve seconds."""
    out = io.StringIO()
    head = {"timestamp": 0.0, "t_ns": 0, "seq": 0, "valid": True, "source": "calibration"}
    message = CalibrationProgress(**head, state="moving", pose=1, poses=62, remaining_s=120.0)
    for speed in (1.0, 10.0):
        Display(Console(file=out, width=80), 62, speed).update(message)
    assert [line.split()[-2] for line in out.getvalue().splitlines()] == ["2:00", "0:12"]

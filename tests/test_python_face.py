"""The Python face: the same answers as the commands, as dataclasses, without a screen, a parser or a heavy import."""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parent))

import diagnosis_cases as cases
from calibration_sim import BIAS, body, sweep
from diagnosis_cases import COM, MASS, Bench
from test_calibration_command import table
from test_deflection_fit import ROBOT, write

import galen_hw
from galen_hw.cli import main

HEAVY = ("pandas", "pyarrow", "sklearn", "matplotlib", "scipy", "rich", "pinocchio", "zmq", "argparse")
WRENCH = {
    "schema": 1,
    "robot": "galen",
    "predict": "wrench",
    "tool": {"name": "retractor", "mass": MASS, "com": COM.tolist()},
    "model": {"bias": "free", "dynamics": "static"},
}


@pytest.fixture(autouse=True)
def _own_state(tmp_path, monkeypatch):
    monkeypatch.setenv("GALEN_HW_STATE", str(tmp_path / "state"))
    monkeypatch.setenv("GALEN_HW_RUNTIME", str(tmp_path / "run"))


@pytest.fixture
def poses(tmp_path):
    """A table of a sweep's static poses."""
    found = sweep(np.random.default_rng(0), bare=0)
    known = {"mass": BIAS.mass, "com": BIAS.com.tolist()}
    return table(tmp_path / "poses", found.R, found.wrench, zeroed_at=[0.0, 0.0, 0.0, 1.0], bias_body=known)


@pytest.fixture(scope="module")
def sets():
    """Deflection sets at four configurations, as recordings in memory."""
    return {s.name: dict(s.observations.columns) for s in [*ROBOT.sets(4, each=1), ROBOT.sets(1, each=1, day=1)[0]]}


def biased():
    """A recording whose sensor reads 8 % too much."""
    bench = Bench(rows=400)
    cases.gain(bench)
    info = galen_hw.RecordingInfo.model_validate(WRENCH)
    return galen_hw.Recording(dict(bench.observations().columns), info, Path("in memory"))


def without_time(answer):
    """An answer but for when it was made."""
    return {k: v for k, v in answer.items() if k not in ("date", "software")}


def test_importing_the_package_carries_nothing():
    """`import galen_hw` loads no library at all, so that the daemon pays for no notebook."""
    text = f"import galen_hw, sys; print([m for m in {HEAVY!r} if m in sys.modules])"
    assert subprocess.run([sys.executable, "-c", text], capture_output=True, text=True, check=True).stdout == "[]\n"


def test_every_name_of_the_face_is_there_and_documented():
    """Each name of `__all__` loads, has a docstring, and stands in docs/python.md."""
    page = (Path(__file__).parents[1] / "docs" / "python.md").read_text(encoding="utf-8")
    for name in galen_hw.__all__:
        assert name == "__version__" or getattr(galen_hw, name).__doc__
        assert f"`{name}`" in page or f"`{name}(" in page, name
    assert set(galen_hw.__all__) <= set(dir(galen_hw))
    with pytest.raises(AttributeError, match="no attribute 'calibrat'"):
        galen_hw.calibrat  # noqa: B018


def test_a_calibration_is_that_of_the_command(poses, tmp_path, capsys):
    """Mass and centre of mass as concealed; `to_json` is what the command prints; the saved file is taken up by the store."""
    found = galen_hw.calibrate(poses, tool="retractor")
    assert found.mass == pytest.approx(body().mass, abs=4 * found.mass_std)
    assert found.com == pytest.approx(body().com, abs=4 * found.com_std.max())
    assert main(["calibrate", "--from", str(poses), "--tool", "retractor", "--json"]) == 4
    said = json.loads(capsys.readouterr().out)
    ours = json.loads(json.dumps(found.to_json()))
    for answer in (ours, said):
        answer["tool"]["origin"].pop("date")
    assert without_time(ours) == without_time(said)
    assert said["software"] == f"galen-hw {galen_hw.__version__}"
    assert main(["tool", "import", str(found.save(tmp_path / "retractor.json"))]) == 0
    assert galen_hw.load_tool("retractor").mass == pytest.approx(found.mass)
    assert galen_hw.load_tool(tmp_path / "retractor.json") == found.tool
    assert len(found.plot().axes) >= 6
    assert "retractor" in str(found)


def test_a_diagnosis_is_that_of_the_command(tmp_path, capsys):
    """A scale that is off is named from memory as from a file, with the same numbers; seed and date stand in the answer."""
    recording = biased()
    found = galen_hw.diagnose(recording, seed=3)
    folder = galen_hw.write_table(recording, tmp_path / "run")
    assert main(["diagnose", str(folder), "--seed", "3", "--json"]) == 1
    said = json.loads(capsys.readouterr().out)
    ours = json.loads(json.dumps(found.to_json()))
    assert [f.effect for f in found.findings] == ["gain"]
    assert ours["findings"] == said["findings"]
    assert (said["schema"], said["seed"], said["software"]) == (1, 3, f"galen-hw {galen_hw.__version__}")
    assert "simulation and recording differ" in str(found)
    assert len(found.plot().axes) == len(ours["fit"]["rmse_before"])
    page = found.write_report(tmp_path / "page.html")
    assert "gain" in page.read_text(encoding="utf-8")
    assert "gain saved in" in found.save_model(tmp_path / "gain.json")[0]


def test_several_recordings_and_another_holdout(tmp_path):
    """Two recordings are fitted as one and judged on a third, as with --together and --holdout."""
    recording = biased()
    found = galen_hw.diagnose([recording, recording], holdout=galen_hw.write_table(recording, tmp_path / "other"))
    assert found.holdout == str(tmp_path / "other")
    assert "gain" in [f.effect for f in found.findings]


def test_a_deflection_fit_is_that_of_the_command(tmp_path, sets, capsys):
    """The same model with the same errors; saved, it is taken up by the store."""
    for name, columns in sets.items():
        write(tmp_path / "session", name, columns)
    found = galen_hw.fit_deflection(tmp_path / "session", models=["linear"])
    words = ["deflection", "fit", str(tmp_path / "session"), "--models", "linear", "--json", "--no-save"]
    assert main(words) == 0
    said = json.loads(capsys.readouterr().out)
    assert said["saved"] is None
    assert found.to_json()["models"][found.recommended]["rmse_m"] == said["models"][found.recommended]["rmse_m"]
    assert main(["deflection", "import", str(found.save(tmp_path / "arm.json"))]) == 0
    assert found.plot().axes


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: galen_hw.read_recording("nowhere"), "nowhere: there is no such recording"),
        (lambda: galen_hw.calibrate("nowhere"), "nowhere: there is no such recording"),
        (lambda: galen_hw.calibrate(biased(), tool="A b"), "cannot be a tool's name"),
        (lambda: galen_hw.diagnose([]), "no recording is given"),
        (lambda: galen_hw.diagnose(biased(), holdout=1.5), "holdout: 1.5 is no share"),
        (lambda: galen_hw.fit_deflection(biased()), "no tracked pose of the tip"),
        (lambda: galen_hw.load_tool("nothing"), "no tool 'nothing'"),
        (lambda: galen_hw.load_tool("nothing.json"), "nothing.json: cannot be read"),
        (lambda: galen_hw.Client("/nowhere"), "no daemon runs here"),
    ],
)
def test_bad_input_is_one_line(call, words):
    """Every error is the project's own: what, where, what to do."""
    with pytest.raises(galen_hw.GalenError) as caught:
        call()
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.live
def test_a_whole_virtual_robot_in_a_with_block():
    """The compensated wrench flows, and a push on the virtual world is seen in the raw one."""
    with galen_hw.virtual_robot() as robot, robot.client() as client:
        assert client.call("daemon", "info")["virtual"] is True
        with robot.subscriber(["wrench/raw"]) as bus:
            before = [bus.receive(5.0)[1].force.z for _ in range(200)]
            robot.control.push(force=[0.0, 0.0, -5.0], seconds=20.0)
            deepest = min(bus.receive(5.0)[1].force.z for _ in range(2000))
    assert deepest < np.mean(before) - 3.0
    assert not (robot.runtime / "command").exists()

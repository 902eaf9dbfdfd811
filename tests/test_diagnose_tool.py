"""What a diagnosis saves: a whole tool's file that the store takes up, and what cannot be served said and left out."""

import json
import sys
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parent))

import diagnosis_cases as cases
from diagnosis_cases import COM, JOINTS, MASS, Bench

from galen_hw.cli import main
from galen_hw.config.tool_store import ToolStore
from galen_hw.errors import UsageError
from galen_hw.identification.deflection.data import DeflectionSet
from galen_hw.identification.deflection.table import model_of
from galen_hw.kinematics import GalenRobot
from galen_hw.physics.effects.live import build_streams
from galen_hw.physics.effects.registry import scene_of
from galen_hw.physics.scenes.pose import APPLIED
from galen_hw.recording import Recording, RecordingInfo, write_table
from galen_hw.services.deflection.store import DeflectionStore
from tests.compensation_parts import tool_file

INFO = {
    "schema": 1,
    "robot": "galen",
    "predict": "wrench",
    "tool": {"name": "retractor", "mass": MASS, "com": COM.tolist()},
    "model": {"bias": "free", "dynamics": "static"},
}
EPOCH = 1_800_000_000.0


def written(bench: Bench, folder: Path) -> Path:
    """The bench's recording as a table."""
    return write_table(Recording(dict(bench.observations().columns), RecordingInfo.model_validate(INFO)), folder)


@pytest.fixture
def store(tmp_path, monkeypatch):
    """A store with the calibrated retractor, and the folder to work in."""
    monkeypatch.setenv("GALEN_HW_STATE", str(tmp_path / "state"))
    monkeypatch.setenv("GALEN_HW_RUNTIME", str(tmp_path / "run"))
    monkeypatch.chdir(tmp_path)
    found = ToolStore(tmp_path / "state")
    found.save(tool_file(mass=MASS, com=tuple(COM), inertia=None, bias=(0.0,) * 6, bias_body=None, zeroed_at=None))
    return found


def test_found_effects_become_a_generation_that_explains_the_next_recording(store, tmp_path, capsys):
    """A scale that is off and a push: the scale is saved with the offset, the push is left out and said; import and
    rollback are one command each; with the new tool a new recording agrees, with the old one it does not."""
    bench = Bench()
    cases.gain(bench)
    cases.contact(bench)
    bench.wrench[:, 3] += 0.004
    words = ["--tool", "retractor", "--save-model", "found.json"]
    assert main(["diagnose", str(written(bench, tmp_path / "run1")), *words]) == 1
    assert "contact is left out, an outside force is what the compensation is there to show" in capsys.readouterr().out
    assert main(["tool", "import", "found.json"]) == 0
    saved = store.load("retractor")
    assert [(t.effect, t.source) for t in saved.terms] == [("gain", "diagnosis of run1")]
    assert saved.terms[0].parameters["gain_error"] == pytest.approx(0.08, rel=0.05)
    assert saved.bias[3] == pytest.approx(0.004, abs=1e-4)
    assert saved.origin is not None
    assert "gain added and the offset fitted again" in saved.origin.remarks[-1]

    again = Bench(seed=2)
    cases.gain(again)
    second = written(again, tmp_path / "run2")
    assert main(["diagnose", str(second), "--tool", "retractor"]) == 0
    assert main(["tool", "rollback", "retractor"]) == 0
    assert main(["diagnose", str(second), "--tool", "retractor", "-o", "old.json"]) == 1
    assert [f["effect"] for f in json.loads(Path("old.json").read_text())["findings"]] == ["gain"]


def test_what_cannot_be_served_at_all_writes_no_file(store, tmp_path, capsys):
    """A push alone, and a drift of a table that nobody dated: one line each, nothing written."""
    for conceal, why in ((cases.contact, "an outside force"), (cases.drift, "does not say when it was made")):
        bench = Bench()
        conceal(bench)
        words = ["--tool", "retractor", "--save-model", "none.json"]
        assert main(["diagnose", str(written(bench, tmp_path / conceal.__name__)), *words]) == 1
        said = capsys.readouterr().out
        assert "none.json is not written" in said
        assert why in said
        assert not Path("none.json").exists()


def test_without_a_tool_the_terms_stand_alone_and_are_no_tool(store, tmp_path, capsys):
    """Terms of a table without --tool are saved; the store refuses them in one line."""
    bench = Bench()
    cases.gain(bench)
    assert main(["diagnose", str(written(bench, tmp_path / "run")), "--save-model", "terms.json"]) == 1
    values = json.loads(Path("terms.json").read_text())
    assert [t["effect"] for t in values["terms"]] == ["gain"]
    capsys.readouterr()
    assert main(["tool", "import", "terms.json"]) == 2
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 1
    assert "--tool NAME" in lines[0]


@dataclass(frozen=True)
class Sample:
    """One live sample."""

    t_ns: int
    timestamp: float
    q: tuple[float, ...] = (0.0,) * 5
    predicted: tuple[float, ...] = (0.0,) * 6


def drift_term(form: str, **more: float) -> dict:
    parameters = {"group": "wrench", "channel": "wrench.force.x", "form": form, "start": EPOCH, "length": 60.0, **more}
    return {"effect": "drift", "parameters": parameters}


@pytest.mark.parametrize(
    ("term", "formula"),
    [
        (drift_term("linear", change=0.3), lambda t: 0.3 * np.clip(t / 60.0, 0.0, 2.0)),
        (drift_term("warm_up", constant=12.0, amplitude=0.5), lambda t: 0.5 * (1.0 - np.exp(-max(t, 0.0) / 12.0))),
        ({"effect": "step", "parameters": {"channels": "wrench.force.x", "moment": EPOCH + 5.0, "jump_wrench.force.x": 0.2}},
         lambda t: 0.2 * (t >= 5.0)),
    ],
)  # fmt: skip
def test_dated_terms_go_by_the_wall_clock_live_and_in_a_recording(term, formula):
    """Whenever the daemon was started: the same value at the same time of day; a drift is held after twice its length; a
    recording of that time holds it in its simulation, one that nobody dated does not."""
    (stream,) = build_streams([term], joint_names=JOINTS, robot=GalenRobot())
    times = [-3.0, 0.0, 4.0, 30.0, 100.0, 500.0]
    live = [stream.step(Sample(round((77.0 + t) * 1e9), EPOCH + t))[0] for t in times]
    np.testing.assert_allclose(live, [formula(t) for t in times], atol=1e-6)

    seen = Bench(rows=200).observations()
    plain = scene_of(seen).simulated
    known = scene_of(replace(seen, belief=replace(seen.belief, terms=(term,), epoch=EPOCH + 3.0))).simulated
    np.testing.assert_allclose((known - plain)[:, 0], [formula(3.0 + t) for t in seen.columns["time"]], atol=1e-6)
    undated = scene_of(replace(seen, belief=replace(seen.belief, terms=(term,)))).simulated
    np.testing.assert_array_equal(undated, plain)


@pytest.mark.parametrize(
    "effect", ["contact", "glitches", "unknown", "temperature", "saturation", "vibration", "inertial"]
)
def test_live_services_refuse_what_they_cannot_predict(effect):
    """One line that says why; a tool is never compensated by half."""
    with pytest.raises(UsageError, match=f"terms: {effect}: cannot be predicted live: .{{10}}"):
        build_streams([{"effect": effect, "parameters": {}}], joint_names=JOINTS, robot=GalenRobot())


def test_a_joint_that_gives_is_served_by_the_deflection(store, tmp_path, capsys):
    """A soft tilt joint that also hardens, found from the tracked tip: the saved file is taken up by one command, and its
    model foretells the give of another recording to the tracker's noise."""
    info = RecordingInfo.model_validate(
        {
            "schema": 1,
            "robot": "galen",
            "predict": "pose",
            "tool": {"tip": [0.045, 0.0, -0.14]},
            "model": {"bias": "free"},
        }
    )
    seen = Recording(dict(cases.tracked(4e-3, 5e-4).columns), info)
    run = write_table(seen, tmp_path / "pose")
    assert main(["diagnose", str(run), "--save-model", "arm.json"]) == 1
    assert "galen-hw deflection import arm.json takes it up" in capsys.readouterr().out
    assert main(["deflection", "--state", str(tmp_path / "state"), "import", "arm.json"]) == 0
    file = DeflectionStore(tmp_path / "state").load("arm")
    another = cases.tracked(4e-3, 5e-4, seed=2)
    scene = scene_of(another)
    data = DeflectionSet("other", "", another, scene.time, scene.q, another.matrix(*APPLIED), scene.residual)
    left = data.give - model_of(file.model, file.values).predict(data)
    spread = np.std(left, axis=0)
    assert np.std(data.give, axis=0).max() > 3e-4
    np.testing.assert_array_less(spread, 1.15 * 7e-5)
    Path("arm.json").write_text('{"schema": 1, "terms": []}')
    assert main(["deflection", "--state", str(tmp_path / "state"), "import", "arm.json"]) == 2
    assert "is no deflection model" in capsys.readouterr().err

"""`galen-hw tool import`: what cannot be served, or belongs to other hardware, is refused in one line and changes nothing."""

import json
import threading
from pathlib import Path
from typing import Any

import pytest

from galen_hw.bus import Publisher
from galen_hw.cli import main
from galen_hw.config.tool_store import ToolStore
from galen_hw.tools.tool_import import hardware_here
from tests.compensation_parts import raw, tool_file


@pytest.fixture
def store(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> ToolStore:
    """A store with the retractor, calibrated on sensor FT1; no daemon runs."""
    monkeypatch.setenv("GALEN_HW_STATE", str(tmp_path / "state"))
    monkeypatch.setenv("GALEN_HW_RUNTIME", str(tmp_path / "run"))
    monkeypatch.delenv("GALEN_HW_CONFIG", raising=False)
    monkeypatch.chdir(tmp_path)
    found = ToolStore(tmp_path / "state")
    found.save(tool_file("FT1"))
    return found


def written(term: dict[str, Any] | None = None, **origin: Any) -> Path:
    """A tool's file with another origin or a term."""
    data = json.loads(tool_file("FT1").to_json())
    data["origin"] |= origin
    if term is not None:
        data["terms"] = [term]
    path = Path("in.json")
    path.write_text(json.dumps(data), encoding="utf-8")
    return path


GAIN = {"group": "wrench", "channel": "wrench.force.x", "gain_error": 0.08}


@pytest.mark.parametrize(
    ("term", "text"),
    [
        ({"effect": "unicorn", "parameters": {}}, "no effect 'unicorn'"),
        ({"effect": "contact", "parameters": {}}, "cannot be predicted live"),
        ({"effect": "gain", "parameters": {}}, "terms"),
        ({"effect": "gain", "parameters": GAIN | {"channel": "wrench.force.w"}}, "terms"),
        ({"effect": "gain", "parameters": GAIN | {"gain_error": 1e308}}, "beyond any sensor's range"),
        ({"effect": "joint_offset", "parameters": {"joint": "elbow", "offset": 0.01}}, "terms"),
    ],
)
def test_a_term_that_cannot_be_served_is_refused_whatever_is_forced(
    store: ToolStore, capsys: pytest.CaptureFixture[str], term: dict[str, Any], text: str
) -> None:
    """One line that names file and effect, status 2; the calibration in use stays."""
    for force in ([], ["--foreign"]):
        assert main(["tool", "import", str(written(term)), *force]) == 2
        error = capsys.readouterr().err
        assert text in error
        assert "in.json" in error
        assert error.count("\n") == 1
    assert store.active("retractor") == 1
    assert main(["tool", "import", str(written({"effect": "gain", "parameters": GAIN}))]) == 0
    assert store.active("retractor") == 2


@pytest.mark.parametrize(
    ("origin", "text"),
    [
        ({"robot": "kuka"}, "was calibrated on robot 'kuka', this is 'galen'"),
        ({"sensor_serial": "FT2"}, "was calibrated on sensor FT2, this is FT1"),
        ({"virtual": True, "sensor_serial": ""}, "was calibrated on a virtual robot, this is a real one"),
        ({"robot": "kuka", "sensor_serial": "FT2"}, "on sensor FT2, this is FT1 and was calibrated on robot 'kuka'"),
    ],
)
def test_a_foreign_calibration_is_refused_without_a_daemon_too(
    store: ToolStore, capsys: pytest.CaptureFixture[str], origin: dict[str, Any], text: str
) -> None:
    """Settings say the robot, the calibrations in use the sensor; --foreign takes it."""
    assert main(["tool", "import", str(written(**origin))]) == 2
    error = capsys.readouterr().err
    assert text in error
    assert "--foreign" in error
    assert error.count("\n") == 1
    assert len(store.history("retractor")) == 1
    assert main(["tool", "import", str(written(**origin)), "--foreign"]) == 0
    assert len(store.history("retractor")) == 2


def test_the_configured_robot_decides(
    store: ToolStore, capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of another name in the settings the galen's calibration is foreign; settings that cannot be read are one line."""
    monkeypatch.setenv("GALEN_HW_CONFIG", str(tmp_path / "galen.toml"))
    (tmp_path / "galen.toml").write_text('[robot]\nname = "galen_two"\n', encoding="utf-8")
    assert main(["tool", "import", str(written())]) == 2
    assert "robot 'galen', this is 'galen_two'" in capsys.readouterr().err
    assert main(["tool", "import", str(written(robot="galen_two"))]) == 0
    (tmp_path / "galen.toml").write_text("[robot]\nname = 3\n", encoding="utf-8")
    assert main(["tool", "import", str(written())]) == 2
    assert "galen.toml:2: robot.name" in capsys.readouterr().err


def test_the_running_sensor_says_its_serial_number(store: ToolStore, tmp_path: Path) -> None:
    """It is heard on the bus; a silent bus leaves the calibrations' word."""
    address, stop = f"ipc://{tmp_path / 'bus'}", threading.Event()

    def publish() -> None:
        with Publisher(address) as bus:
            while not stop.wait(0.01):
                bus.publish("wrench/raw", raw(1, [0.0] * 6, serial_number="FT7"))

    thread = threading.Thread(target=publish)
    thread.start()
    try:
        here = hardware_here({"virtual": False}, store, address)
    finally:
        stop.set()
        thread.join()
    assert (here.robot.name, here.serial, here.virtual, here.running) == ("galen", "FT7", False, True)
    assert hardware_here({}, store, "").serial == "FT1"


def test_an_export_overwrites_nothing_unless_told(store: ToolStore, capsys: pytest.CaptureFixture[str]) -> None:
    """A file that is there, a folder that is not: one line each, status 2; --overwrite writes both."""
    Path("mine.json").write_text("mine", encoding="utf-8")
    for file, text in (("mine.json", "is there already"), ("no/such/mine.json", "there is no such folder")):
        assert main(["tool", "export", "retractor", file]) == 2
        error = capsys.readouterr().err
        assert text in error
        assert error.count("\n") == 1
    assert Path("mine.json").read_text(encoding="utf-8") == "mine"
    assert not Path("no").exists()
    for file in ("mine.json", "no/such/mine.json"):
        assert main(["tool", "export", "retractor", file, "--overwrite"]) == 0
        assert json.loads(Path(file).read_text(encoding="utf-8"))["name"] == "retractor"


@pytest.mark.parametrize(
    "words",
    [["tool", part] for part in ("list", "show", "select", "history", "rollback", "export", "import")]
    + [["deflection", part] for part in ("fit", "list", "show", "select", "rollback", "import")],
)
def test_every_part_of_a_command_has_a_description_and_an_example(
    words: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    """`galen-hw tool show --help` and its like."""
    with pytest.raises(SystemExit):
        main([*words, "--help"])
    text = capsys.readouterr().out
    assert f"example: galen-hw {' '.join(words)}" in " ".join(text.split())
    assert len(text.split("\n\n")[1].split()) >= 3, "a sentence that says what it does"

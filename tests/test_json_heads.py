"""What `--json` prints: one object whose head says its schema, the version, the date and, where chance had a part, the seed."""

import argparse
import json
from collections.abc import Iterator
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest

from galen_hw.cli import COMMANDS, main, parser_of
from galen_hw.config.tool_store import ToolStore
from galen_hw.version import VERSION
from tests.compensation_parts import tool_file

HEAD = ["schema", "software", "date"]
ALONE = {
    # command: words without a daemon, the keys behind the head
    "check": (["POSES"], ["recordings"]),
    "find": ([], ["ports"]),
    "tool list": ([], ["tools"]),
    "tool show": (["retractor"], ["name"]),
    "tool history": (["retractor"], ["history"]),
    "tool select": (["retractor"], ["selected"]),
    "tool rollback": (["retractor"], ["name", "calibration"]),
    "tool export": (["retractor", "out.json"], ["file"]),
    "tool import": (["in.json"], ["name", "calibration"]),
    "deflection list": ([], ["models"]),
}
ELSEWHERE = {
    "monitor": "test_daemon_tools",
    "command": "test_daemon_tools",
    "status": "test_status",
    "virtual": "a line of addresses by which a program finds its wires, below the layer that answers",
    "calibrate": "test_calibration_command",
    "diagnose": "test_diagnosis_small",
    "deflection fit": "test_deflection_fit",
    "deflection select": "test_deflection_fit",
    "deflection rollback": "test_deflection_fit",
    "deflection import": "test_deflection_fit",
    "deflection show": "prints the model's file as it is, which has a head of its own",
}
POSES = "time,wrench.force.x,wrench.force.y,wrench.force.z,wrench.torque.x,wrench.torque.y,wrench.torque.z\n"


@pytest.fixture
def place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A store with a calibrated tool twice, its file, and a recording; no daemon runs."""
    for name in ("STATE", "RUNTIME"):
        monkeypatch.setenv(f"GALEN_HW_{name}", str(tmp_path / name.lower()))
    monkeypatch.chdir(tmp_path)
    store = ToolStore(tmp_path / "state")
    store.save(tool_file("FT1"))
    store.save(tool_file("FT1"))
    Path("in.json").write_text(tool_file("FT1").to_json(), encoding="utf-8")
    folder = tmp_path / "POSES"
    folder.mkdir()
    rows = "".join(f"{i / 10},{i % 3}.5,0.1{i},-2.{i},0.0{i},0.1,0.2{i}\n" for i in range(9))
    (folder / "recording.csv").write_text(POSES + rows)
    (folder / "recording.json").write_text('{"schema": 1, "predict": "wrench"}')
    return tmp_path


@pytest.mark.parametrize("command", ALONE)
def test_json_has_a_head(command: str, place: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The schema, who wrote it and when come first; then what was asked for."""
    words, keys = ALONE[command]
    assert main([*command.split(), *words, "--json"]) in (0, 1), capsys.readouterr().err
    said = json.loads(capsys.readouterr().out)
    assert list(said)[:3] == HEAD
    assert (said["schema"], said["software"]) == (1, f"galen-hw {VERSION}")
    assert abs(datetime.now(UTC) - datetime.fromisoformat(said["date"])) < timedelta(minutes=5)
    assert set(keys) <= said.keys()


def parts(name: str, parser: argparse.ArgumentParser) -> Iterator[tuple[str, argparse.ArgumentParser]]:
    """A command and the parts below it."""
    yield name, parser
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            for word, below in action.choices.items():
                yield from parts(f"{name} {word}", below)


def test_every_command_with_json_is_here() -> None:
    """A new command with `--json` stands in one of the two tables above."""
    every = [found for name in COMMANDS for found in parts(name, parser_of(name))]
    having = {name for name, parser in every if any("--json" in a.option_strings for a in parser._actions)}
    assert having == ALONE.keys() | ELSEWHERE.keys()

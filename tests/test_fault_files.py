"""Power that fails in the middle of a write: each file that decides something, cut off at every byte."""

import logging
import resource
import signal
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

sys.path.insert(0, str(Path(__file__).parent))

from ati_board import Board, ask, run_of
from calibration_plant import Plant
from compensation_parts import tool_file
from test_calibration_sweep import FEW
from test_deflection_service import service_at
from test_tool_store import tool

from galen_hw.clock import TimeBase
from galen_hw.config.load import read_document
from galen_hw.config.tool_store import ToolStore, write_atomic
from galen_hw.daemon.keep import DeviceKeeper, Keeper
from galen_hw.drivers.ati_netcanoem import AtiNetcanoem
from galen_hw.errors import GalenError, UsageError
from galen_hw.services.deflection.store import DeflectionStore

TIME = TimeBase()
CONFIG = Path(__file__).parent.parent / "config" / "galen.toml"


def written(monkeypatch: pytest.MonkeyPatch, act: Callable[[], object]) -> list[tuple[Path, bytes]]:
    """The files that an action replaces, in their order, with what they become."""
    found: list[tuple[Path, bytes]] = []

    def spy(path: Path, text: str) -> None:
        found.append((path, text.encode()))
        write_atomic(path, text)

    with monkeypatch.context() as patch:
        for module in ("galen_hw.config.tool_store", "galen_hw.services.deflection.store", "galen_hw.daemon.keep"):
            patch.setattr(f"{module}.write_atomic", spy)
        act()
    return found


def test_a_write_that_stops_at_any_byte_leaves_the_old_file(tmp_path: Path) -> None:
    """The real write, killed by a full disk after each number of bytes: all of the old text, or all of the new one."""
    path, old, new = tmp_path / "active.json", "old" * 5, "new text" * 8
    write_atomic(path, old)
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    ignored = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    try:
        for room in range(len(new)):
            resource.setrlimit(resource.RLIMIT_FSIZE, (room, hard))
            with pytest.raises(UsageError, match="cannot be written"):
                write_atomic(path, new)
            assert path.read_text() == old
            assert [p.name for p in tmp_path.iterdir()] == [path.name]
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
        signal.signal(signal.SIGXFSZ, ignored)
    write_atomic(path, new)
    assert path.read_text() == new


def test_a_calibration_is_never_half_saved(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Saved and selected over an older one. Cut in each of its files at every byte: the scratch file beside (what a power
    cut leaves), and the file itself (what a disk leaves that lies about fsync). The old tool, the new one, or one line."""
    store = ToolStore(tmp_path)
    store.save(tool(0.28))
    store.select("retractor")
    before = {p: p.read_bytes() for p in tmp_path.rglob("*.json")}
    files = written(monkeypatch, lambda: (store.save(tool(0.29)), store.select("retractor")))
    assert len(files) == 3
    lines = set()
    for n, (path, content) in enumerate(files):
        for done in (p for p in tmp_path.rglob("*") if p.is_file()):
            done.unlink()
        for old, text in [*before.items(), *files[:n]]:
            old.write_bytes(text)
        scratch = path.with_name(f".{path.name}.4711.new")
        for cut in range(len(content)):
            scratch.write_bytes(content[:cut])
            assert store.load("retractor").mass in (0.28, 0.29)
            assert store.selected() == "retractor"
        scratch.unlink()
        for cut in range(len(content)):
            path.write_bytes(content[:cut])
            try:
                assert store.load("retractor").mass in (0.28, 0.29)
                assert store.selected() in ("retractor", None)
            except UsageError as error:
                lines.add(str(error))
        assert store.generation("retractor", 1).mass == 0.28
    assert lines
    assert not any("\n" in line for line in lines)


def test_a_deflection_model_is_never_half_saved(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The same of its three files: the model that was saved, or one line; a service starts on whatever is there."""
    service_at(tmp_path)
    store = DeflectionStore(tmp_path)
    model = store.load("arm")
    files = written(monkeypatch, lambda: store.save(model))
    assert len(files) == 3
    lines: set[str] = set()
    for path, content in files:
        for cut in range(len(content)):
            path.write_bytes(content[:cut])
            try:
                assert store.load("arm").values == model.values
                assert store.selected() in ("arm", None)
            except UsageError as error:
                lines.add(str(error))
        path.write_bytes(content)


def test_what_is_kept_is_taken_whole_or_not_at_all(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    """A sensor's zero and a service's snapshot, cut at every byte and with every 5th bit turned: as kept, or afresh."""
    caplog.set_level(logging.CRITICAL)
    boot = tmp_path / "boot"
    boot.write_text("b-1\n")
    run = run_of(Board()).seconds(0.2)
    ask(run, "zero", samples=20)
    run.seconds(0.2)
    keeper = DeviceKeeper(tmp_path, virtual=False, boot_id=boot)
    keeper.keep_device("ft", run.device, "drill", run.now_ns)
    keeper.close()
    path = tmp_path / "ft.json"
    whole, kept = path.read_bytes(), Keeper(tmp_path).read("ft")
    assert kept
    damaged = [whole[:n] for n in range(len(whole) - 1)]
    damaged += [
        whole[: b // 8] + bytes([whole[b // 8] ^ 1 << b % 8]) + whole[b // 8 + 1 :] for b in range(0, 8 * len(whole), 5)
    ]
    refused = 0
    for content in damaged:
        path.write_bytes(content)
        found = Keeper(tmp_path).read("ft")
        refused += found is None
        assert found in (None, kept)
    assert refused > 0.95 * len(damaged)


@pytest.mark.parametrize(
    "text", ["[" * 100_000, '{"a":' * 200 + "1" + "}" * 200, '{"version": ' + "9" * 5000 + "}", '"x"', "\xff"]
)
def test_a_kept_file_that_is_no_snapshot_starts_afresh(tmp_path: Path, text: str) -> None:
    """Deep nesting and endless digits too: they had kept a process from starting."""
    (tmp_path / "compensation.json").write_bytes(text.encode("latin-1"))
    assert Keeper(tmp_path).read("compensation") is None
    DeviceKeeper(tmp_path, virtual=False).give_back("compensation", AtiNetcanoem("ft", AtiNetcanoem.Settings(), TIME))


def test_settings_that_end_anywhere_are_settings_or_one_line(tmp_path: Path) -> None:
    """The file that comes with the package, cut at every 7th byte."""
    whole = CONFIG.read_bytes()
    path = tmp_path / "galen.toml"
    outcomes = set()
    for cut in range(0, len(whole), 7):
        path.write_bytes(whole[:cut])
        try:
            read_document(path)
            outcomes.add("read")
        except GalenError as error:
            outcomes.add(type(error).__name__)
    assert "read" in outcomes
    assert len(outcomes) > 1


def test_no_stage_of_a_sweep_touches_a_tools_file(tmp_path: Path) -> None:
    """Whatever state a sweep is killed in, what serves is what served before: it writes below `sweeps` alone."""
    ToolStore(tmp_path).save(tool_file())
    before = {p: p.read_bytes() for p in tmp_path.rglob("*.json")}
    plant = Plant(tmp_path, FEW)
    seen: dict[str, Any] = {}

    def look(own: Plant) -> None:
        if own.progress and own.progress[-1].state not in seen:
            seen[own.progress[-1].state] = {
                p: p.read_bytes() for p in tmp_path.rglob("*.json") if "sweeps" not in p.parts
            }

    plant.hooks.append(look)
    assert plant.sweep().state == "done"
    plant.run_for(0.1)
    assert {"checking", "waiting", "moving", "settling", "averaging", "done"} <= seen.keys()
    assert all(found == before for found in seen.values())

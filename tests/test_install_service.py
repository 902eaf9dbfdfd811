"""The service on a machine: what is written, kept, given back; what systemd rates; ports by their lasting names."""

import json
import os
import re
import shutil
import subprocess
from pathlib import Path

import pytest

from galen_hw.cli import main
from galen_hw.config.found_ports import found_ports, lasting_name
from galen_hw.config.load import examine
from galen_hw.config.problems import Places
from galen_hw.daemon.tables import TABLES
from galen_hw.errors import UsageError
from galen_hw.tools import install_service
from galen_hw.tools.install_service import planned

PROGRAM = "/opt/galen-hw/bin/galen-hw"
MOST_EXPOSURE = 1.5


@pytest.fixture(autouse=True)
def installed(monkeypatch: pytest.MonkeyPatch) -> None:
    """As if from where a service may be: the tests' own environment may be anywhere."""
    monkeypatch.setattr(install_service, "_program", lambda: PROGRAM)


def contents(root: Path) -> dict[str, str]:
    return {str(p.relative_to(root)): p.read_text() for p in root.rglob("*") if p.is_file()}


def install(root: Path, *words: str) -> int:
    return main(["install-service", "--root", str(root), *words])


def test_a_dry_run_says_all_and_does_nothing(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Every file and every command, and an empty folder afterwards; no rights are needed."""
    assert main(["install-service", "--dry-run"]) == 0
    said = capsys.readouterr().out
    for words in (
        "/etc/systemd/system/galen-hw.service",
        "99-galen-hw.rules",
        "galen.toml",
        "would run: systemd-sysusers",
    ):
        assert words in said
    assert install(tmp_path, "--dry-run") == 0
    assert contents(tmp_path) == {}


def test_what_is_installed_is_what_the_options_say(tmp_path: Path) -> None:
    """User, rules with bit rate and restart-ms, settings, unit with this program; the same again changes nothing."""
    assert install(tmp_path, "--bitrate", "500000", "--restart-ms", "250") == 0
    found = contents(tmp_path)
    assert sorted(Path(name).name for name in found) == [
        "99-galen-hw.rules",
        "galen-hw.conf",
        "galen-hw.service",
        "galen.toml",
    ]
    rules = found["etc/udev/rules.d/99-galen-hw.rules"]
    assert "type can bitrate 500000 restart-ms 250" in rules
    assert f"ExecStart={PROGRAM} run" in found["etc/systemd/system/galen-hw.service"]
    assert re.search(r"^m galen-hw dialout$", found["etc/sysusers.d/galen-hw.conf"], re.MULTILINE)
    assert install(tmp_path, "--bitrate", "500000", "--restart-ms", "250") == 0
    assert contents(tmp_path) == found


def test_settings_are_the_users_and_what_was_there_comes_back(tmp_path: Path) -> None:
    """Settings are never replaced or taken away; a unit of somebody else is put aside, and is there again at the end."""
    unit, settings = tmp_path / install_service.UNIT, tmp_path / install_service.SETTINGS
    for path, text in ((unit, "[Service]\n# mine\n"), (settings, "# mine\n")):
        path.parent.mkdir(parents=True)
        path.write_text(text)
    assert install(tmp_path) == 0
    assert settings.read_text() == "# mine\n"
    assert PROGRAM in unit.read_text()
    assert install(tmp_path, "--uninstall", "--dry-run") == 0
    assert PROGRAM in unit.read_text()
    assert install(tmp_path, "--uninstall") == 0
    assert contents(tmp_path) == {install_service.UNIT: "[Service]\n# mine\n", install_service.SETTINGS: "# mine\n"}
    assert install(tmp_path, "--uninstall") == 0


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--bitrate", "2000000"], "--bitrate: must be from 10000 to 1000000"),
        (["--restart-ms", "0"], "--restart-ms: must be from 1 to 10000"),
        (["--config", "/nowhere.toml"], "/nowhere.toml: no such file"),
    ],
)
def test_wrong_use_is_one_line(tmp_path: Path, words: list[str], said: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert install(tmp_path, *words) == 2
    assert said in capsys.readouterr().err
    assert contents(tmp_path) == {}


@pytest.mark.parametrize("folder", ["/home/me/venv", "/root/venv", "/tmp/venv"])
def test_an_environment_that_the_unit_hides_is_refused(folder: str) -> None:
    """ProtectHome and PrivateTmp: systemd would only say "No such file or directory"."""
    with pytest.raises(UsageError, match="the service would not see it"):
        planned(f"{folder}/bin/galen-hw", 1_000_000, 100)


@pytest.mark.skipif(Path("/run/systemd/system").is_dir(), reason="systemd runs here: nothing is installed by a test")
def test_without_systemd_one_line_says_what_to_do(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["install-service"]) == 2
    assert "systemd does not run here; start the daemon by hand" in capsys.readouterr().err


@pytest.mark.skipif(shutil.which("systemd-analyze") is None, reason="systemd-analyze is not installed here")
def test_systemd_rates_the_unit_as_little_exposed(tmp_path: Path) -> None:
    """`systemd-analyze security --offline`: at most 1.5 of 10; what is left is CAN, loopback, serial ports, real time."""
    (unit,) = (file for file in planned("/bin/true", 1_000_000, 100) if file.path.endswith(".service"))
    path = tmp_path / "galen-hw.service"
    path.write_text(unit.text)
    command = ["systemd-analyze", "security", "--offline=true", "--no-pager", str(path)]
    done = subprocess.run(
        command,
        capture_output=True,
        text=True,
        check=False,
        timeout=60,
        env=os.environ | {"LC_ALL": "C", "SYSTEMD_COLORS": "0"},
    )
    found = re.search(r"Overall exposure level.*: (\d+\.\d+)", done.stdout)
    if found is None:
        pytest.skip(f"this systemd cannot do it offline: {done.stderr.strip()[:200]}")
    assert float(found[1]) <= MOST_EXPOSURE, done.stdout


def machine(folder: Path) -> tuple[Path, Path]:
    """A /dev and a /sys/class/net with two adapters, one without a serial number, and a CAN interface that is down."""
    dev, net = folder / "dev", folder / "net"
    for name in ("ttyUSB0", "ttyUSB1", "ttyACM0", "ttyS0"):
        dev.mkdir(exist_ok=True)
        (dev / name).touch()
    for link, target in (
        ("by-id/usb-FTDI_A1-port0", "ttyUSB0"),
        ("by-path/pci-0:1", "ttyUSB1"),
        ("by-path/pci-0:0", "ttyUSB0"),
    ):
        path = dev / "serial" / link
        path.parent.mkdir(parents=True, exist_ok=True)
        path.symlink_to(dev / target)
    for name, kind, state in (("can0", "280", "down"), ("can1", "280", "up"), ("eth0", "1", "up")):
        (net / name).mkdir(parents=True)
        (net / name / "type").write_text(f"{kind}\n")
        (net / name / "operstate").write_text(f"{state}\n")
    return dev, net


def test_ports_are_found_by_the_names_that_last(tmp_path: Path) -> None:
    """By identity, else by the socket, else said; CAN interfaces that are down with the line that brings them up."""
    dev, net = machine(tmp_path)
    found = {port.device.rpartition("/")[2]: port for port in found_ports(dev, net)}
    assert list(found) == ["ttyACM0", "ttyUSB0", "ttyUSB1", "can0", "can1"]
    assert found["ttyUSB0"].setting == f'transport = {{ url = "{dev}/serial/by-id/usb-FTDI_A1-port0" }}'
    assert found["ttyUSB1"].name == f"{dev}/serial/by-path/pci-0:1"
    assert "no serial number" in found["ttyUSB1"].note
    assert (found["ttyACM0"].lasting, found["ttyACM0"].note) == (False, "has no lasting name")
    assert "ip link set can0 up type can bitrate" in found["can0"].note
    assert (found["can1"].setting, found["can1"].note) == (
        'transport = { interface = "socketcan", channel = "can1" }',
        "",
    )
    assert found_ports(tmp_path / "none", tmp_path / "none") == []


def test_check_refuses_a_bare_name_and_gives_the_lasting_one(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The hint is the line to write where this machine has that port, and the command that finds it where not."""
    dev, _ = machine(tmp_path)
    assert lasting_name("/dev/ttyUSB0", dev).endswith("by-id/usb-FTDI_A1-port0")
    document = {"devices": {"motors": {"driver": "galil_dmc", "transport": {"url": "/dev/ttyUSB0"}}}}
    for name, todo in (
        ("", "use the name that galen-hw find shows for it"),
        ("/dev/serial/by-id/x", 'write "/dev/serial/by-id/x"'),
    ):
        monkeypatch.setattr("galen_hw.config.load.lasting_name", lambda _, name=name: name)
        _, problems = examine(document, Path("galen.toml"), Places("galen.toml", ""), TABLES)
        assert [p.todo for p in problems if "changes when cables are plugged" in p.what] == [todo]


def test_find_prints_what_can_be_pasted(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    dev, net = machine(tmp_path)
    ports = found_ports(dev, net)
    monkeypatch.setattr("galen_hw.config.found_ports.found_ports", lambda: ports)
    assert main(["find"]) == 0
    assert 'transport = { interface = "socketcan", channel = "can1" }' in capsys.readouterr().out
    assert main(["find", "--json"]) == 0
    assert [row["kind"] for row in json.loads(capsys.readouterr().out)["ports"]] == ["serial"] * 3 + ["can"] * 2
    monkeypatch.setattr("galen_hw.config.found_ports.found_ports", list)
    assert main(["find"]) == 1

"""A robot's computer without the extras: the daemon carries none of them, and what needs one says so in a line."""

import importlib.util
import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parent))

from calibration_sim import BIAS, sweep
from test_calibration_command import table

from galen_hw.cli import COMMANDS, main
from galen_hw.errors import UsageError
from galen_hw.extras import EXTRAS, MissingExtraError, need
from galen_hw.recording import read_recording

EXTRA = tuple(module for extra in ("diagnose", "reports", "import") for module in EXTRAS[extra])
DAEMON = (
    "galen_hw.cli, galen_hw.tools.run, galen_hw.daemon.supervisor, galen_hw.daemon.worker, galen_hw.daemon.tables, "
    "galen_hw.services.compensation.service, galen_hw.services.deflection.service, galen_hw.services.calibration.service, "
    "galen_hw.services.recorder, galen_hw.drivers.ati_netcanoem.device, galen_hw.drivers.galil_dmc.device, "
    "galen_hw.drivers.can_transport, galen_hw.drivers.virtual.process"
)
WITHOUT = f"import sys; sys.modules.update(dict.fromkeys({EXTRA!r})); from galen_hw.cli import main; "


@pytest.fixture
def without_extras(monkeypatch):
    """As on a machine where no extra is installed."""
    for module in EXTRA:
        for name in [n for n in sys.modules if n == module or n.startswith(f"{module}.")]:
            monkeypatch.delitem(sys.modules, name)
        monkeypatch.setitem(sys.modules, module, None)


@pytest.fixture
def poses(tmp_path, monkeypatch):
    """A table of a sweep's static poses, and a state of its own."""
    monkeypatch.setenv("GALEN_HW_STATE", str(tmp_path / "state"))
    monkeypatch.setenv("GALEN_HW_RUNTIME", str(tmp_path / "run"))
    found = sweep(np.random.default_rng(0), bare=0)
    known = {"mass": BIAS.mass, "com": BIAS.com.tolist()}
    return table(tmp_path / "poses", found.R, found.wrench, zeroed_at=[0.0, 0.0, 0.0, 1.0], bias_body=known)


def run_without(words, **options):
    """A command on a machine without extras."""
    code = f"{WITHOUT}sys.exit(main({[str(w) for w in words]!r}))"
    return subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False, **options)


def resident_mb(code):
    """Resident memory of a fresh interpreter after some imports, and which libraries of extras those loaded."""
    code += (
        f"\nimport sys; kb = next(l for l in open('/proc/self/status') if l.startswith('VmRSS')).split()[1]"
        f"\nprint(int(kb) / 1024, [m for m in {(*EXTRA, 'scipy')!r} if m in sys.modules])"
    )
    said = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    size, _, loaded = said.partition(" ")
    return float(size), loaded.strip()


def test_the_daemon_is_small():
    """All that its processes import: no library of an extra, no scipy, and less than 60 MB over bare Python and pinocchio."""
    bare, _ = resident_mb("import pinocchio")
    whole, loaded = resident_mb(f"import pinocchio, {DAEMON}")
    assert loaded == "[]"
    assert whole - bare < 60.0


@pytest.mark.parametrize("name", COMMANDS)
def test_help_needs_no_extra(name, without_extras, capsys):
    """Every command can be read about before anything more is installed."""
    with pytest.raises(SystemExit) as ended:
        main([name, "--help"])
    assert ended.value.code == 0
    assert "usage" in capsys.readouterr().out


def test_a_tool_is_calibrated_without_extras(poses):
    """From a table, as after a sweep on the robot: fitted and accepted; that there is no page is one line."""
    done = run_without(["calibrate", "--from", poses, "--tool", "retractor", "--yes"])
    assert done.returncode == 0, done.stderr
    assert "no page: matplotlib is not installed; pip install 'galen-hw[reports]'" in done.stdout
    assert "retractor/0001" in done.stdout


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["diagnose", "POSES"], "scikit-learn is not installed; pip install 'galen-hw[diagnose]'"),
        (["calibrate", "--from", "POSES", "--report", "x"], "--report: matplotlib is not installed"),
        (["deflection", "fit", "POSES", "--report", "x.html"], "--report: matplotlib is not installed"),
        (["export", "POSES", "OUT", "--format", "parquet"], "pyarrow is not installed; pip install 'galen-hw[import]'"),
        (
            ["export", "POSES", "OUT", "--format", "mat"],
            "a MATLAB file needs the package mat-io; pip install 'galen-hw[import]'",
        ),
        (["import", "FOREIGN", "-o", "OUT"], "pandas is not installed; pip install 'galen-hw[import]'"),
    ],
)
def test_a_missing_extra_is_one_line(poses, tmp_path, without_extras, capsys, words, said):
    """What is missing and what to type, status 2, nothing begun."""
    foreign = tmp_path / "other.csv"
    foreign.write_text("t;fx\n0,0;1,5\n0,1;1,6\n")
    places = {"POSES": str(poses), "OUT": str(tmp_path / "out"), "FOREIGN": str(foreign)}
    words = [places.get(word, word) for word in words]
    capsys.readouterr()
    assert main(words) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert said in line
    assert not (tmp_path / "out").exists()


def test_formats_of_the_plain_install_need_no_extra(tmp_path):
    """A CAN log is told and read by python-can; what an extra brings is not loaded to find that the file is not its."""
    log = tmp_path / "run.log"
    log.write_text("(1700000000.000000) can0 7FF#00\n(1700000000.010000) can0 7FF#00\n")
    done = run_without(["import", log, "-o", tmp_path / "out"])
    assert done.returncode == 2
    assert "no driver knows its frames (identifiers 7FF)" in done.stderr


def test_a_missing_extra_is_an_import_error_of_ours(without_extras):
    """So that Python code may catch either."""
    with pytest.raises(ImportError, match="scikit-learn is not installed") as caught:
        need("diagnose")
    assert isinstance(caught.value, MissingExtraError | UsageError)


def test_csv_reads_the_same_without_pyarrow(poses, without_extras, monkeypatch):
    """The same bits in every cell, and the same words for a cell that is no number."""
    text = (poses / "recording.csv").read_text().splitlines()
    head = text[0].split(",")
    cells = text[1].split(",")
    odd = ["", "NaN", "null", " 1.5 ", "-0.1e-3", "5e-324", "+3", "1"][: len(cells)]
    (poses / "recording.csv").write_text("\n".join([*text, ",".join([*odd, *cells[len(odd) :]]), ""]))
    plain = read_recording(poses).columns
    monkeypatch.undo()
    assert importlib.util.find_spec("pyarrow") is not None
    arrow = read_recording(poses).columns
    assert list(plain) == list(arrow) == head
    for name in head:
        np.testing.assert_array_equal(plain[name], arrow[name])


@pytest.mark.parametrize("cell", ["1_000", "abc", "0x10", "1,5"])
def test_a_bad_cell_is_named_without_pyarrow(poses, without_extras, cell):
    """File, column and row."""
    lines = (poses / "recording.csv").read_text().splitlines()
    lines[3] = f'"{cell}",' + lines[3].partition(",")[2]
    (poses / "recording.csv").write_text("\n".join(lines) + "\n")
    with pytest.raises(UsageError, match=r"is not a number") as caught:
        read_recording(poses)
    assert "row 3" in str(caught.value)


def test_the_extras_are_those_of_pyproject():
    """Each is in the table of the project, so that what is typed works."""
    import tomllib

    project = tomllib.loads((Path(__file__).parents[1] / "pyproject.toml").read_text())["project"]
    assert set(EXTRAS) <= set(project["optional-dependencies"])
    text = json.dumps(project["dependencies"])
    for name in ("pandas", "pyarrow", "scikit-learn", "matplotlib", "platformdirs"):
        assert name not in text

"""The command line's face: quick help, one line for wrong use, and documents that know every command."""

import contextlib
import importlib
import io
import math
import os
import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest

from galen_hw.cli import COMMANDS, _parser, main
from galen_hw.drivers.galil_dmc.settings import GalilSettings
from galen_hw.errors import EXIT_USAGE, UsageError
from galen_hw.tools.command import check_units, parse_arguments, units_given

ROOT = Path(__file__).parent.parent


def test_help_imports_nothing_heavy() -> None:
    """`galen-hw --help` answers at once because no command's module, and so no numpy, is imported for it."""
    code = (
        "import sys; from galen_hw.cli import main\n"
        "try: main(['--help'])\n"
        "except SystemExit: pass\n"
        "heavy = {'numpy', 'scipy', 'pydantic', 'zmq', 'can', 'pandas', 'rich'} & set(sys.modules)\n"
        "assert not heavy, heavy"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    for name in COMMANDS:
        assert re.search(rf"^\s+{name}\b", done.stdout, re.MULTILINE), name


@pytest.mark.parametrize("name", COMMANDS)
def test_every_command_has_help_of_its_own(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    """Each row of the table loads, and its help shows an example of use."""
    with pytest.raises(SystemExit) as exit_:
        main([name, "--help"])
    assert exit_.value.code == 0
    assert f"galen-hw {name}" in capsys.readouterr().out
    module = importlib.import_module(COMMANDS[name][0])
    assert callable(module.run)


@pytest.mark.parametrize("name", COMMANDS)
def test_every_command_is_in_the_readme(name: str) -> None:
    """A command that the README does not know is not found by anybody."""
    assert f"galen-hw {name}" in (ROOT / "README.md").read_text()


def test_wrong_use_exits_with_2(capsys: pytest.CaptureFixture[str]) -> None:
    """No command prints the help; an unknown one is named."""
    assert main([]) == EXIT_USAGE
    with pytest.raises(SystemExit) as exit_:
        main(["calibrat"])
    assert exit_.value.code == EXIT_USAGE
    assert "calibrat" in capsys.readouterr().err


@pytest.mark.parametrize(
    "words", [["record", "--duration", "5"], ["tool", "list", "--foo"], ["recrod"], ["tool", "selct"], ["--foo"]]
)
def test_wrong_use_is_one_line_and_says_where_to_look(words: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    """Of the command that was meant, not a page of usage of the whole program."""
    with pytest.raises(SystemExit) as exit_:
        main(words)
    assert exit_.value.code == EXIT_USAGE
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith(f"galen-hw {words[0]}: " if words[0] in COMMANDS else "galen-hw: ")
    assert line.endswith(" --help")
    assert any(word in line for word in words[-2:])


def test_an_error_is_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    """What, where, what to do; no traceback."""
    assert main(["diagnose", "no/such/recording"]) == EXIT_USAGE
    err = capsys.readouterr().err
    assert len(err.strip().splitlines()) == 1
    assert "no/such/recording" in err
    assert "Traceback" not in err


def test_output_that_nobody_reads_is_not_a_success(tmp_path: Path) -> None:
    """`galen-hw tool list | head`, the reader gone: the shell's status for SIGPIPE, and nothing on stderr."""
    reader, writer = os.pipe()
    os.close(reader)
    command = [sys.executable, "-m", "galen_hw.cli", "tool", "list"]
    environ = os.environ | {"GALEN_HW_STATE": str(tmp_path), "GALEN_HW_RUNTIME": str(tmp_path)}
    done = subprocess.run(command, stdout=writer, stderr=subprocess.PIPE, text=True, check=False, env=environ)
    os.close(writer)
    assert (done.returncode, done.stderr) == (141, "")


def _documented() -> list[tuple[str, str]]:
    """(page, command line) of every `galen-hw ...` in an indented block or in code, of README and docs."""
    found = []
    for page in (ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))):
        text = page.read_text(encoding="utf-8")
        lines = re.findall(r"^    (galen-hw .*)$", text, re.MULTILINE) + re.findall(r"`(galen-hw [^`]+)`", text)
        found += [(page.name, re.split(r"\s+#\s|\s{3,}", line)[0]) for line in lines]
    return found


def _alternatives(line: str) -> list[str]:
    """`galen-hw tool list | show` names several; a word in capitals or dots stands for one."""
    if re.search(r"\w \| \w", line):
        head, *others = re.split(r"\s*\|\s*", line)
        stem = head.rsplit(" ", 1)[0]
        return [head, *(f"{stem} {other}" for other in others)]
    return [line]


def _parses(line: str) -> str:
    """Empty if the program takes the line, else why not. Names alone (`galen-hw tool`) only have to be there."""
    words = shlex.split(line.replace("...", "x"))[1:]
    parser, command = _parser(words)
    try:
        if command is None or len(words) == 1 or (len(words) == 2 and not words[1].startswith("-")):
            parser.parse_args([*words, "--help"])
        parser.parse_args(words)
    except SystemExit as stopped:
        return "" if stopped.code == 0 else line
    return ""


def test_every_command_in_the_documents_is_one(capsys: pytest.CaptureFixture[str]) -> None:
    """README and docs, through the program's own parsers: an option that is gone, or never was, is found here."""
    lines = {alternative for _, line in _documented() for alternative in _alternatives(line)}
    assert len(lines) > 60
    wrong = [line for line in sorted(lines) if _parses(line)]
    assert not wrong, capsys.readouterr().err


def test_virtual_is_said_of_the_commands_that_have_it() -> None:
    """No more and no fewer, in the README and on the virtual robot's page."""
    having = set()
    for name in COMMANDS:
        parser, _ = _parser([name])
        with contextlib.redirect_stdout(io.StringIO()) as out, contextlib.suppress(SystemExit):
            parser.parse_args([name, *(["deflection"] if name == "collect" else []), "--help"])
        having |= {name} if re.search(r"--virtual\b", out.getvalue()) else set()
    (readme,) = re.findall(r"Without a robot add `--virtual` to (.*?);", (ROOT / "README.md").read_text())
    (page,) = re.findall(r"`--virtual` of (.*?) starts it", (ROOT / "docs" / "virtual.md").read_text(), re.DOTALL)
    assert set(re.findall(r"`(\w+)`", readme)) == set(re.findall(r"`(\w+)`", page)) == having


def test_commands_of_the_topics_page_can_be_pasted() -> None:
    """What stands there in code reads as a command, through a shell."""
    lines = re.findall(r"`(galen-hw command motors [^`]+)`", (ROOT / "docs" / "topics.md").read_text())
    found = {shlex.split(line)[3]: parse_arguments(shlex.split(line)[4:]) for line in lines}
    assert found == {"move_jp": {"position": {"roll": 0.3}}, "servo_jv": {"velocity": {"roll": 0.1}}}


@pytest.mark.parametrize(
    ("words", "meant"),
    [
        (["calibrat"], "calibrate"),
        (["tool", "lst"], "list"),
        (["record", "--secnds", "3"], "--seconds"),
        (["tool", "import", "x.json", "--froeign"], "--foreign"),
        (["deflection", "fit", "x", "--modles"], "--models"),
    ],
)
def test_the_nearest_word_is_named(words: list[str], meant: str, capsys: pytest.CaptureFixture[str]) -> None:
    """A command, a part or an option that is misspelt: one line with the one that was meant, status 2."""
    with pytest.raises(SystemExit) as exit_:
        main(words)
    assert exit_.value.code == EXIT_USAGE
    (line,) = capsys.readouterr().err.splitlines()
    assert f"did you mean {meant}?" in line


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("17deg", math.radians(17.0)),
        ("-5 mm", -5e-3),
        ("1.5e1kN", 15e3),
        ("2min", 120.0),
        ("20deg/s", math.radians(20.0)),
        ("7", 7),
        ("5furlong", "5furlong"),
        ('"5mm"', "5mm"),
        ("retractor", "retractor"),
    ],
)
def test_numbers_may_have_a_unit(text: str, value: float | str) -> None:
    """SI where the unit is known; what is no quantity stays a word, and quotes keep a word that looks like one."""
    found = parse_arguments([f"a.b={text}"])["a"]["b"]
    assert found == (pytest.approx(value) if isinstance(value, float) else value)


@pytest.mark.parametrize(
    ("word", "said"),
    [
        ("position.roll=5mm", "m is no unit of position.roll; give rad or mrad or deg"),
        ("position.roll=1kg", "kg is no unit of position.roll"),
        ("position.carriage1=5deg", "rad is no unit of position.carriage1; give m or cm or mm"),
        ("velocity.roll=5deg", "rad is no unit of velocity.roll; give rad/s or deg/s"),
        ("acceleration.roll=5deg/s", "rad/s is no unit of acceleration.roll; give rad/s^2"),
        ("position.roll=5deg", ""),
        ("position.roll=0.1", ""),
        ("settle=5s", ""),
    ],
)
def test_a_joint_takes_its_own_kind_of_unit(word: str, said: str) -> None:
    """No millimetres for an angle: the number alone would go to the controller, and the arm would move by it."""
    expected = GalilSettings().units
    if not said:
        check_units(units_given([word]), expected)
        return
    with pytest.raises(UsageError, match=re.escape(said)):
        check_units(units_given([word]), expected)


def test_a_command_without_arguments_asks_for_none(capsys: pytest.CaptureFixture[str]) -> None:
    """`KEY=VALUE` may be left out, and is not named as missing."""
    with pytest.raises(SystemExit):
        main(["command", "motors"])
    assert "required: NAME; " in capsys.readouterr().err


def test_an_option_takes_its_own_kind_of_unit(capsys: pytest.CaptureFixture[str]) -> None:
    """Seconds in minutes, and no newtons for seconds."""
    parser, _ = _parser(["record"])
    assert parser.parse_args(["record", "--seconds", "2min"]).seconds == 120.0
    for text in ("2N", "abc"):
        with pytest.raises(SystemExit):
            parser.parse_args(["record", "--seconds", text])
        said = capsys.readouterr().err
        assert f"--seconds: {text!r} is no number in s, nor one with its unit (s, ms, min)" in said


@pytest.mark.parametrize(
    ("words", "line"),
    [
        (["--completion", "ksh"], "galen-hw: no completion for 'ksh'; one of: bash, "),
        (["calibrat"], "galen-hw: argument COMMAND: there is no 'calibrat'; did you mean calibrate?; "),
        (["keys", "frob"], "galen-hw keys: argument {add,list,remove}: invalid choice: 'frob'"),
        (["virtual", "--settings", "{"], "galen-hw virtual: --settings: not JSON (Expecting property name"),
        (
            ["tool", "rollback", "pointer", "--generation", "1"],
            "tool 'pointer' has no generation 1; it was never calibrated",
        ),
        (["deflection", "show", "arm"], "no deflection model 'arm'; galen-hw deflection fit DATA... makes one"),
    ],
)
def test_what_is_wrong_is_said_once_and_in_words(
    words: list[str], line: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Named as the help names it; a clause is not repeated within itself."""
    monkeypatch.setenv("GALEN_HW_STATE", str(tmp_path))
    with contextlib.suppress(SystemExit):
        assert main(words) == 2
    (said,) = capsys.readouterr().err.splitlines()
    assert line in said
    assert said.count("not JSON") <= 1


def test_the_dashboard_without_its_libraries_is_named_once(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("galen_hw.tools.dashboard.command.NEEDED", ("no_such_module",))
    assert main(["dashboard"]) == 2
    assert capsys.readouterr().err.startswith("galen-hw dashboard: needs no_such_module; pip install")

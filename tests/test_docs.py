"""The documentation is true where a machine can tell: the reference, the links of the site, the release files."""

import argparse
import importlib.util
import os
import re
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

import galen_hw
from docs.fields import described
from docs.reference import reference
from docs.tables import PAGES
from galen_hw.cli import COMMANDS, main, parser_of
from galen_hw.drivers.table import DRIVERS
from galen_hw.messages import TOPICS
from galen_hw.physics.effects.registry import EFFECTS
from galen_hw.services.table import SERVICES
from galen_hw.version import VERSION

ROOT = Path(__file__).parents[1]


def test_the_reference_of_the_commands_is_current():
    """docs/commands.md is what the parsers say now; `make docs` writes it again."""
    text = reference()
    assert (ROOT / "docs" / "commands.md").read_text(encoding="utf-8") == text
    assert all(f"## galen-hw {name}\n" in text for name in COMMANDS)
    assert "--parent-pid" not in text


@pytest.mark.parametrize("name", PAGES)
def test_what_is_written_from_the_code_is_current(name):
    """Settings, messages and effects as the code has them; `make docs` writes them again."""
    assert (ROOT / "docs" / name).read_text(encoding="utf-8") == PAGES[name]()


def test_every_effect_setting_and_field_is_described():
    """What a class lacks words for fails here by its name; a new driver, service, message or effect is on its page."""
    settings, fields, effects = ((ROOT / "docs" / name).read_text(encoding="utf-8") for name in PAGES)
    assert [key for key in EFFECTS if f"## {key}\n" not in effects] == []
    assert [
        name for name in (*DRIVERS, *SERVICES) if f"{name}\n" not in settings and f"{name}]\n" not in settings
    ] == []
    assert [topic for topic in TOPICS if f"| `{topic}` |" not in fields] == []
    empty = [line for page in (settings, fields) for line in page.splitlines() if re.search(r"\|\s*\|$", line)]
    assert empty == []


def test_a_field_without_words_is_told_apart():
    """Fields one by one, several with the same words, and one after another in a line."""

    class Two:
        """Of two.

        Args:
            one: first, see `sampler.Sampler`: more; three, four: both.
            five_s: in s;
                on a second line. six: last.
        """

    Two.__module__ = "galen_hw.test"
    found = described(Two, ["one", "three", "four", "five_s", "six", "seven"])
    assert found == {
        "one": "first, see `sampler.Sampler`: more",
        "three": "both",
        "four": "both",
        "five_s": "in s; on a second line",
        "six": "last",
    }


def without_usage(page):
    """A manual page without its lines of usage, which argparse wraps in another way in each Python."""
    return re.sub(r"^usage: .*?\n\n", "", page, flags=re.MULTILINE | re.DOTALL)


def test_the_manual_page_is_current():
    """docs/galen-hw.1 is what the parsers say now; `make docs` writes it again."""
    pytest.importorskip("argparse_manpage", reason="argparse-manpage is not installed: make docs")
    from docs.man import page

    assert without_usage((ROOT / "docs" / "galen-hw.1").read_text(encoding="utf-8")) == without_usage(page())


@pytest.mark.parametrize("name", COMMANDS)
def test_every_command_and_option_is_in_the_manual_page(name):
    """Told from the file that is shipped; what is not meant for people is not in it."""
    page = (ROOT / "docs" / "galen-hw.1").read_text(encoding="utf-8").replace("\\-", "-")
    assert f".SS \\fBgalen-hw {name}\\fR" in page
    options = [o for a in parser_of(name)._actions if a.help != argparse.SUPPRESS for o in a.option_strings]
    assert [o for o in options if f"\\fB{o}\\fR" not in page and o not in ("-h", "--help")] == []
    assert "--parent-pid" not in page


@pytest.mark.skipif(shutil.which("groff") is None, reason="groff is not installed")
def test_the_manual_page_is_set_without_a_warning():
    """As `man galen-hw` shows it."""
    words = ["groff", "-man", "-Tutf8", "-ww", "-rLL=100n", str(ROOT / "docs" / "galen-hw.1")]
    done = subprocess.run(words, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")
    assert "galen-hw diagnose" in re.sub(r"\x1b\[[0-9;]*m", "", done.stdout)


def test_every_page_is_in_the_site():
    """A page that the navigation does not name is found by nobody; every notebook and decision counts."""
    listed = (ROOT / "mkdocs.yml").read_text(encoding="utf-8")
    pages = [p for kind in ("*.md", "adr/*.md", "notebooks/*.ipynb") for p in (ROOT / "docs").glob(kind)]
    missing = [str(p.relative_to(ROOT / "docs")) for p in pages if str(p.relative_to(ROOT / "docs")) not in listed]
    assert not missing
    assert len(list((ROOT / "docs" / "adr").glob("0*.md"))) >= 8


@pytest.mark.skipif(importlib.util.find_spec("mkdocs") is None, reason="mkdocs is not installed: make docs")
def test_the_site_builds_strictly(tmp_path):
    """No link leads nowhere, every name of the Python reference exists, and no page loads a font or style from elsewhere."""
    environ = os.environ | {"NO_MKDOCS_2_WARNING": "1", "PYTHONPATH": str(ROOT)}
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", str(tmp_path / "site")]
    done = subprocess.run(command, capture_output=True, text=True, check=False, cwd=ROOT, env=environ)
    assert done.returncode == 0, done.stderr
    page = (tmp_path / "site" / "python-reference.html").read_text(encoding="utf-8")
    assert "held_out_error" in page
    assert not re.search(r"<link[^>]+stylesheet[^>]+https?:", page)


def test_the_release_files_agree_with_the_project():
    """Licence and name in CITATION.cff; the classifier that says that the package is typed, and the file that makes it so."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    citation = (ROOT / "CITATION.cff").read_text(encoding="utf-8")
    own, *_ = project["license"].split(" AND ")  # others are of what is shipped with it
    assert f"license: {own}\n" in citation
    assert f"version: {VERSION}\n" in citation or ".dev" in VERSION
    assert "Typing :: Typed" in project["classifiers"]
    assert (Path(galen_hw.__file__).parent / "py.typed").exists()


def test_the_changelog_begins_with_the_version_that_the_package_has():
    """What is not released yet is a .dev of the section that stands first."""
    first = next(line for line in (ROOT / "CHANGELOG.md").read_text(encoding="utf-8").splitlines() if line[:3] == "## ")
    assert first.startswith(f"## [{VERSION.partition('.dev')[0]}]")
    assert ("unreleased" in first) == (".dev" in VERSION)


@pytest.mark.skipif(importlib.util.find_spec("shtab") is None, reason="shtab is not installed: galen-hw[completion]")
def test_the_completion_knows_every_command(capsys):
    """Commands, parts and options for bash; a shell that is not known is one line."""
    assert main(["--completion", "bash"]) == 0
    said = capsys.readouterr().out
    assert all(name in said for name in COMMANDS)
    assert "--save-model" in said
    assert main(["--completion", "csh99"]) == 2
    assert "no completion for 'csh99'; one of: bash" in capsys.readouterr().err

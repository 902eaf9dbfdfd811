"""The documentation is true where a machine can tell: the reference, the links of the site, the release files."""

import importlib.util
import os
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

import galen_hw
from docs.reference import reference
from galen_hw.cli import COMMANDS, main

ROOT = Path(__file__).parents[1]


def test_the_reference_of_the_commands_is_current():
    """docs/commands.md is what the parsers say now; `make docs` writes it again."""
    text = reference()
    assert (ROOT / "docs" / "commands.md").read_text(encoding="utf-8") == text
    assert all(f"## galen-hw {name}\n" in text for name in COMMANDS)
    assert "--parent-pid" not in text


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
    assert "Typing :: Typed" in project["classifiers"]
    assert (Path(galen_hw.__file__).parent / "py.typed").exists()


@pytest.mark.skipif(importlib.util.find_spec("shtab") is None, reason="shtab is not installed: galen-hw[completion]")
def test_the_completion_knows_every_command(capsys):
    """Commands, parts and options for bash; a shell that is not known is one line."""
    assert main(["--completion", "bash"]) == 0
    said = capsys.readouterr().out
    assert all(name in said for name in COMMANDS)
    assert "--save-model" in said
    assert main(["--completion", "csh99"]) == 2
    assert "no completion for 'csh99'; one of: bash" in capsys.readouterr().err

"""Where a command writes: `-o` and `--report` mean the same everywhere, and what cannot be written is said before the work."""

import shlex
from pathlib import Path

from galen_hw.config.paths import require_folder
from galen_hw.errors import UsageError

PAGE = "report.html"


def check_file(path: Path, option: str) -> None:
    """Refuse a file that could not be written.

    Raises:
        UsageError: a folder stands there, or the folder that it should be in is missing; `option` is named.
    """
    if path.is_dir():
        raise UsageError("is a folder", where=f"{option} {path}", todo="name a file in it")
    if not path.parent.is_dir():
        raise UsageError(
            "there is no such folder", where=f"{option} {path}", todo=f"mkdir {shlex.quote(str(path.parent))}"
        )


def report_page(given: Path) -> Path:
    """Return the page that `--report` names: a file that ends in .html, or `report.html` in a folder, which may be missing.

    Raises:
        UsageError: it cannot be written there.
    """
    if given.suffix.lower() in (".html", ".htm"):
        check_file(given, "--report")
        return given
    require_folder(given, "--report")
    return given / PAGE


def figures_beside(page: Path) -> Path:
    """Return the folder for a page's figures: its own for `report.html`, else `NAME-figures` beside it."""
    return page.parent if page.name == PAGE else page.with_name(f"{page.stem}-figures")

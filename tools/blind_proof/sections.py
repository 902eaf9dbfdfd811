"""Sections of docs/proof.md that commands of their own write: each keeps the others'."""

from pathlib import Path

MISTAKES = "mistakes"


def _marks(name: str) -> tuple[str, str]:
    return f"<!-- {name}: begin -->", f"<!-- {name}: end -->"


def kept(path: Path, name: str) -> str:
    """The section with its marks as it stands in a file; empty where there is none."""
    begin, end = _marks(name)
    text = path.read_text() if path.exists() else ""
    if begin not in text or end not in text:
        return ""
    return text[text.index(begin) : text.index(end) + len(end)] + "\n"


def replace(path: Path, name: str, section: str) -> None:
    """Write a section between its marks, or behind everything where it is new; all else stays."""
    begin, end = _marks(name)
    text, old = path.read_text() if path.exists() else "", kept(path, name)
    new = f"{begin}\n{section.strip()}\n\n{end}\n"
    path.write_text(
        text.replace(old.rstrip("\n"), new.rstrip("\n")) if old else (text.rstrip() + "\n\n" + new).lstrip()
    )

"""The seal: beside the data lies only a digest of the truth, until every verdict is on disk."""

import hashlib
import json
import subprocess
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Protocol


class Truth(Protocol):
    """A case, as plain values."""

    def as_dict(self) -> dict[str, Any]:
        """What is sealed of it."""


def truth_text(cases: Sequence[Truth]) -> str:
    """The truth in one canonical text."""
    return json.dumps([case.as_dict() for case in cases], sort_keys=True, default=float)


def digest(text: str) -> str:
    """SHA-256 of the truth, as it is written beside the data."""
    return hashlib.sha256(text.encode()).hexdigest()


def seal(cases: Sequence[Truth], folder: Path) -> str:
    """Write the digest; the truth itself stays in memory.

    Raises:
        RuntimeError: the folder has the digest of another truth.
    """
    text, path = truth_text(cases), folder / "truth.sha256"
    if path.exists() and path.read_text().strip() != digest(text):
        raise RuntimeError("the folder holds the digest of another truth: its verdicts are not of this set")
    path.write_text(digest(text) + "\n")
    return text


def unseal(text: str, folder: Path, verdicts: list[Path]) -> list[dict[str, Any]]:
    """Write and return the truth, once all verdicts exist and the digest still fits.

    Raises:
        RuntimeError: a verdict is missing, or the truth is not the one that was sealed.
    """
    missing = [p.name for p in verdicts if not p.exists()]
    if missing:
        raise RuntimeError(f"verdicts are missing, the truth stays sealed: {missing[:3]}")
    if (folder / "truth.sha256").read_text().strip() != digest(text):
        raise RuntimeError("the truth is not the one whose digest was written beside the data")
    (folder / "truth.json").write_text(text)
    values: list[dict[str, Any]] = json.loads(text)
    return values


def seed_of_commit() -> tuple[int, str]:
    """A seed from the commit's hash, so that nobody can tune to the judged set; and the hash."""
    commit = subprocess.run(["git", "rev-parse", "HEAD"], capture_output=True, text=True, check=True).stdout.strip()
    return seed_of(commit), commit


def seed_of(commit: str) -> int:
    """Return the seed that a commit's hash gives."""
    return int(commit[:8], 16)

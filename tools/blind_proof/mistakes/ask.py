"""Hand the recordings to the program, through its command line like anybody else, and keep what it says."""

import json
import os
import subprocess
import sys
import tempfile
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

from rich.progress import Progress

from galen_hw.tools.blind_proof.mistakes.build import ASKED, CONTROL

PATIENCE_S = 600.0
"""After which a recording of half a minute counts as one without an answer."""


NOT_ASKED: dict[str, Any] = {"exit": 0, "out": "", "err": "", "seconds": 0.0, "json": {}}


def answers(
    folder: Path,
    cases: list[tuple[str, str, str]],
    workers: int,
    patience_s: float = PATIENCE_S,
    *,
    control: bool = True,
) -> list[Path]:
    """One file a case, {"asked": answer, "control": answer}; those that are there stay.

    Args:
        folder: of the cases.
        cases: (name, command, command for the recording without the mistake).
        workers: asked at once.
        patience_s: for one answer.
        control: whether the recording without the mistake is asked too; if not, what would be said of it is unknown.
    """
    out = folder / "verdicts"
    out.mkdir(parents=True, exist_ok=True)
    paths = [out / f"{name}.json" for name, _, _ in cases]
    with Progress() as progress, ThreadPoolExecutor(workers) as pool:
        task = progress.add_task("asking", total=len(cases))

        def one(case: tuple[str, str, str], path: Path) -> None:
            name, command, beside = case
            if not path.exists():
                both = {CONTROL: NOT_ASKED}
                for what in (ASKED, CONTROL) if control else (ASKED,):
                    both[what] = ask(command if what == ASKED else beside, folder / name / what, patience_s)
                part = path.with_suffix(".part")
                part.write_text(json.dumps(both))
                part.replace(path)
            progress.advance(task)

        list(pool.map(one, cases, paths))
    return paths


def ask(command: str, recording: Path, patience_s: float = PATIENCE_S) -> dict[str, Any]:
    """What the program says of one recording: {"exit", "out", "err", "seconds", "json"}."""
    with tempfile.TemporaryDirectory() as scratch:
        written = Path(scratch) / "answer.json"
        words = {
            "diagnose": ["diagnose", str(recording), "-o", str(written)],
            "calibrate": ["calibrate", "--from", str(recording), "--yes", "--json"],
            "deflection": ["deflection", "fit", str(recording), "--no-save", "--json"],
            "check": ["check", str(recording), "--json"],
        }[command]
        # A tool store of its own: nothing that was calibrated before may speak in this answer.
        env = os.environ | {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "GALEN_HW_STATE": scratch}
        start = time.monotonic()
        try:
            done = subprocess.run(
                [sys.executable, "-m", "galen_hw.cli", *words],
                capture_output=True,
                text=True,
                check=False,
                timeout=patience_s,
                env=env,
            )
        except subprocess.TimeoutExpired:
            said = f"no answer after {patience_s:g} s"
            return {"exit": 124, "out": "", "err": said, "seconds": patience_s, "json": None}
        answer = written.read_text() if written.exists() else ""
    if command != "diagnose" and done.stdout.lstrip().startswith("{"):
        answer = done.stdout
    given = json.loads(answer) if answer else None
    if command == "check" and given is not None:
        given = next(iter(given["recordings"]), None)
    return {
        "exit": done.returncode,
        "out": done.stdout[-8000:],
        "err": done.stderr[-8000:],
        "seconds": time.monotonic() - start,
        "json": given,
    }

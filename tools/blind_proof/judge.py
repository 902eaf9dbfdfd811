"""Hand the recordings to the tool, through its command line like anybody else, and keep what it says."""

import hashlib
import json
import os
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

from rich.progress import Progress

from galen_hw.tools.blind_proof.generator.case import Case

ONE_RUN = {"step", "contact", "glitches", "drift", "temperature", "vibration"}
"""Effects of a moment or of the clock: a second run does not repeat them; the tool sets blocks of the first aside."""
PATIENCE_S = 600.0
"""After which a recording of two minutes counts as one without an answer."""


def verdicts(
    folder: Path, plans: list[dict[str, Any]], out: Path, workers: int, minutes: float = float("inf")
) -> list[Path]:
    """One verdict file a case: {"exit", "said", "seconds", "json"}; at most `workers` at a time. Those that are there stay.

    After so many minutes no other case is begun; they are taken in an order that mixes the kinds, so that what was judged by
    then is a sample of all. Returns the files that are there.
    """
    out.mkdir(parents=True, exist_ok=True)
    end = time.monotonic() + 60.0 * minutes
    paths = [out / f"{plan['name']}.json" for plan in plans]
    mixed = sorted(zip(plans, paths, strict=True), key=lambda one: hashlib.sha256(one[0]["name"].encode()).digest())
    with Progress() as progress, ThreadPoolExecutor(workers) as pool:
        task = progress.add_task("diagnosing", total=len(plans))

        def one(plan: dict[str, Any], path: Path) -> None:
            if not path.exists() and time.monotonic() < end:
                part = path.with_suffix(".part")
                part.write_text(json.dumps(_ask(folder / plan["name"], second_run=plan["second_run"])))
                part.replace(path)
            progress.advance(task)

        list(pool.map(lambda each: one(*each), mixed))
    return [path for path in paths if path.exists()]


def _ask(case: Path, *, second_run: bool) -> dict[str, Any]:
    """What `galen-hw diagnose` says about one case."""
    answer = case / "answer.json"
    command = ["galen_hw.cli", "diagnose", str(case / "train"), "-o", str(answer)]
    return asked([*command, "--holdout", str(case / "test")] if second_run else command, answer)


def asked(command: list[str], answer: Path) -> dict[str, Any]:
    """Return what a module with its arguments says, and writes to `answer`: {"exit", "said", "seconds", "json"}."""
    # Of a run before that was cut off.
    answer.unlink(missing_ok=True)
    start = time.monotonic()
    env = os.environ | {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    whole = [sys.executable, "-m", *command]
    try:
        done = subprocess.run(whole, capture_output=True, text=True, check=False, timeout=PATIENCE_S, env=env)
    except subprocess.TimeoutExpired:
        said = f"no answer after {PATIENCE_S:g} s"
        return {"exit": 124, "said": said, "seconds": PATIENCE_S, "json": None}
    verdict = json.loads(answer.read_text()) if answer.exists() else None
    said = (done.stdout + "\n" + done.stderr)[-6000:]
    return {"exit": done.returncode, "said": said, "seconds": time.monotonic() - start, "json": verdict}


def second_run(case: Case) -> bool:
    """Return whether a second run judges: effects of a moment or of the clock are judged on blocks of the first."""
    return case.share != "premise" and not ({e.key for e in case.effects} & ONE_RUN)

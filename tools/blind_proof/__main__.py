"""`make proof`: plan, generate, seal, diagnose, unseal, score, compare with rivals, write docs/proof.md.

    python -m galen_hw.tools.blind_proof [--cases 480] [--seed N] [--keep DIR] [--minutes N] [--write docs/proof.md] [--no-rivals]

Without `--seed` the seed comes from the commit's hash. With `--keep` a run that was cut off goes on when it is called again on
the same commit: the same set is generated, its truth must have the digest that was written, and what was judged stays.
"""

import argparse
import json
import os
import sys
import tempfile
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
from rich.progress import track

from galen_hw.tools.blind_proof import judge, real, report, score, seal
from galen_hw.tools.blind_proof.generator.build import CHANNELS, build
from galen_hw.tools.blind_proof.generator.case import Case
from galen_hw.tools.blind_proof.generator.plan import plan


def main() -> int:
    """Run the proof; exit status 1 if a promised figure was missed."""
    args = _arguments()
    own, commit = seal.seed_of_commit()
    seed = own if args.seed is None else args.seed
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(args.keep or scratch)
        folder.mkdir(parents=True, exist_ok=True)
        if (folder / "truth.json").exists():
            cases, scored = _unsealed(folder)
            seed, commit = json.loads((folder / "set.json").read_text())
        else:
            if (begun := folder / "set.json").exists() and json.loads(begun.read_text()) != [seed, commit]:
                was = json.loads(begun.read_text())
                print(
                    f"{folder} holds a set of seed {was[0]}, commit {was[1]}: go on there, or keep elsewhere",
                    file=sys.stderr,
                )
                return 2
            begun.write_text(json.dumps([seed, commit]))
            cases, scored = _judged(seed, args.cases, folder, args.workers, args.minutes)
        rivals = [] if args.no_rivals else _rivals(cases, scored, folder, args.workers, args.rivals)
        recordings = real.LEFT_OUT if args.no_real else _real(folder / "real", args.workers, commit)
        missed = report.write(
            Path(args.write), scored, rivals, recordings, seed=seed, commit=commit, planned=len(cases)
        )
    for line in missed:
        print(f"missed: {line}", file=sys.stderr)
    return 1 if missed else 0


def _real(folder: Path, workers: int, commit: str) -> list[str]:
    """The real recordings, asked of this commit's engine where no answer was kept, whatever commit the set is of."""
    return real.recordings(folder, workers, commit, seal.seed_of_commit()[1])


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="blind_proof", description=__doc__)
    parser.add_argument("--cases", type=int, default=480, help="how many recordings (default 480)")
    parser.add_argument("--seed", type=int, help="of the set; from the commit's hash if left out")
    parser.add_argument(
        "--keep", help="folder for data, verdicts and truth (a temporary one); a judged one is not judged again"
    )
    parser.add_argument(
        "--minutes",
        type=float,
        default=float("inf"),
        help="after so many no other case is judged, and the report is of those that were (default: all are)",
    )
    parser.add_argument("--write", default="docs/proof.md", help="where the report goes, figures beside it")
    parser.add_argument("--workers", type=int, default=os.cpu_count() or 1)
    parser.add_argument(
        "--rivals", type=int, metavar="N", help="cases that the rivals get, evenly chosen (default all)"
    )
    parser.add_argument("--no-rivals", action="store_true", help="leave the rivals out")
    parser.add_argument("--no-real", action="store_true", help="leave the real recordings out")
    return parser.parse_args()


def _judged(seed: int, count: int, folder: Path, workers: int, minutes: float) -> tuple[list[Case], list[score.Scored]]:
    """Generate and seal, ask the tool, unseal, score: all cases, and those that were judged in time."""
    planned = plan(seed, count)
    with ProcessPoolExecutor(workers) as pool:
        made = pool.map(build, planned, [folder / c.name for c in planned])
        cases = list(track(made, total=len(planned), description="generating"))
    sealed = seal.seal(cases, folder)
    plans = [{"name": c.name, "second_run": judge.second_run(c)} for c in cases]
    verdicts = judge.verdicts(folder, plans, folder / "verdicts", workers, minutes)
    return cases, _scored(seal.unseal(sealed, folder, verdicts), folder)


def _unsealed(folder: Path) -> tuple[list[Case], list[score.Scored]]:
    """A set that was judged and unsealed before, all or a part, scored again from its files.

    Raises:
        RuntimeError: the truth is not the one that was sealed.
    """
    text = (folder / "truth.json").read_text()
    truth = seal.unseal(text, folder, [])
    return [Case.from_dict(case) for case in truth], _scored(truth, folder)


def _scored(truth: list[dict[str, Any]], folder: Path) -> list[score.Scored]:
    out = []
    for case in truth:
        path = folder / "verdicts" / f"{case['name']}.json"
        if not path.exists():
            continue
        verdict = json.loads(path.read_text())
        out.append(score.score(case | {"second_run": judge.second_run(Case.from_dict(case))}, verdict))
    return out


def _rivals(
    cases: list[Case], scored: list[score.Scored], folder: Path, workers: int, most: int | None
) -> list[dict[str, Any]]:
    """Held-out errors of the tool and its rivals on cases with a second run and something to find: all, or every n-th."""
    by = {s.truth["name"]: s for s in scored}
    chosen = [(c, by[c.name]) for c in cases if c.name in by and by[c.name].rmse_ratio() is not None and c.effects]
    if most is not None and most < len(chosen):
        chosen = [chosen[i] for i in np.linspace(0, len(chosen) - 1, most).astype(int)]
    with ProcessPoolExecutor(workers) as pool:
        rows = pool.map(_rival_row, [c for c, _ in chosen], [folder / c.name for c, _ in chosen])
        found = list(track(rows, total=len(chosen), description="rivals"))
    own = [{"tool": s.rmse_ratio(), "named": s.rmse_ratio(named=True), "name": c.name} for c, s in chosen]
    return [row | mine for row, mine in zip(found, own, strict=True)]


def _rival_row(case: Case, folder: Path) -> dict[str, Any]:
    """Each rival's held-out error over the noise, rms over the touched channels; kept with the case."""
    from galen_hw.tools.blind_proof import rivals

    if (kept := folder / "rivals.json").exists():
        return dict(json.loads(kept.read_text()))
    names = list(CHANNELS[case.group])
    errors = rivals.errors(folder, names)
    touched = {c for e in case.effects for c in e.channels}
    noise = case.holdout_noise_rms
    at = [k for k, n in enumerate(names) if n in touched]
    row = {r: float(np.sqrt(np.mean([(e[k] / noise[names[k]]) ** 2 for k in at]))) for r, e in errors.items()}
    kept.write_text(json.dumps(row))
    return row


if __name__ == "__main__":
    sys.exit(main())

"""`make mistakes`: generate, seal, ask, unseal, score, write the section of docs/proof.md.

    python -m galen_hw.tools.blind_proof.mistakes [--cases 300] [--seed N] [--only KIND] [--keep DIR] [--write docs/proof.md]
    python -m galen_hw.tools.blind_proof.mistakes --given DIR

Without `--write` the section goes to the screen. Without `--seed` the seed comes from the commit's hash. With `--keep` a run
that was cut off goes on, and a finished one is scored again from its files.
"""

import argparse
import json
import os
import sys
import tempfile
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

from rich.progress import track

from galen_hw.tools.blind_proof import seal, sections
from galen_hw.tools.blind_proof.mistakes import ask, given, report
from galen_hw.tools.blind_proof.mistakes.build import build, plan
from galen_hw.tools.blind_proof.mistakes.case import Mistake
from galen_hw.tools.blind_proof.mistakes.kinds import KINDS
from galen_hw.tools.blind_proof.mistakes.origins import REAL
from galen_hw.tools.blind_proof.mistakes.score import Scored, score


def main() -> int:
    """Run it; exit status 1 if a promised figure was missed, 2 for wrong use."""
    args = _arguments()
    if args.list:
        print("\n".join(f"{k.key:26} {k.about:18} {k.command:10} {', '.join(k.families)}" for k in KINDS.values()))
        return 0
    handed = given.judged(Path(args.given), args.workers) if args.given else []
    for name, good, said in handed:
        print(f"{'right' if good else 'WRONG'}  {name}: {said}")
    if args.given and not args.write:
        return 0 if all(good for _, good, _ in handed) else 1
    seed, commit = (args.seed, "given by hand") if args.seed is not None else seal.seed_of_commit()
    with tempfile.TemporaryDirectory() as scratch:
        try:
            cases = _judged(seed, args, Path(args.keep or scratch))
        except (ValueError, RuntimeError) as why:
            print(f"mistakes: {why}", file=sys.stderr)
            return 2
    text = report.section(cases, seed, commit, handed)
    if args.write:
        sections.replace(Path(args.write), sections.MISTAKES, text)
    else:
        print(text)
    missed = [
        f"{what}: promised {promised}, reached {reached}"
        for what, promised, reached, good in report.figures(cases)
        if not good
    ]
    for line in missed:
        print(f"missed: {line}", file=sys.stderr)
    return 1 if missed else 0


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="mistakes", description=__doc__)
    parser.add_argument("--cases", type=int, default=300, help="how many recordings (default 300)")
    parser.add_argument("--seed", type=int, help="of the set; from the commit's hash if left out")
    parser.add_argument("--only", metavar="KIND", help="kinds by key or by how their keys begin, separated by commas")
    parser.add_argument("--keep", metavar="DIR", help="folder for data, answers and truth (a temporary one)")
    parser.add_argument("--write", metavar="FILE", help="the report whose section is written (default: the screen)")
    parser.add_argument(
        "--given", metavar="DIR", help="recordings with mistakes that were handed over; alone, if nothing is written"
    )
    parser.add_argument("--workers", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--patience", type=float, default=ask.PATIENCE_S, help="seconds that an answer may take")
    parser.add_argument(
        "--no-control", action="store_true", help="leave out the recordings without a mistake (to develop)"
    )
    parser.add_argument("--list", action="store_true", help="list the kinds")
    return parser.parse_args()


def _judged(seed: int, args: argparse.Namespace, folder: Path) -> list[Scored]:
    """Generate and seal, ask, unseal, score."""
    folder.mkdir(parents=True, exist_ok=True)
    planned = plan(seed, args.cases, args.only)
    with ProcessPoolExecutor(args.workers) as pool:
        made = pool.map(build, planned, [folder / c.name for c in planned])
        cases = list(track(made, total=len(planned), description="generating"))
    sealed = seal.seal(cases, folder)
    asked = [(c.name, c.command, _control(c)) for c in cases]
    verdicts = ask.answers(folder, asked, args.workers, args.patience, control=not args.no_control)
    truth = seal.unseal(sealed, folder, verdicts)
    return [score(t, json.loads(v.read_text())) for t, v in zip(truth, verdicts, strict=True)]


def _control(case: Mistake) -> str:
    """The command for the recording without the mistake: the whole answer where it is needed to judge, else the premises alone.

    Of a real recording nobody knows all effects, and a mistake that is repaired in silence must leave the answer as sharp.
    """
    needed = case.family in REAL or KINDS[case.kind].silent or case.command != "diagnose"
    return case.command if needed else "check"


if __name__ == "__main__":
    sys.exit(main())

"""Which cases make up a set, and how each becomes two folders: the recording with its mistake, and without."""

from dataclasses import asdict
from pathlib import Path

import numpy as np

from galen_hw.tools.blind_proof.mistakes import origins
from galen_hw.tools.blind_proof.mistakes.case import Mistake
from galen_hw.tools.blind_proof.mistakes.kinds import KINDS

ASKED, CONTROL = "asked", "control"
"""Folders of a case: with the mistake and without."""


def chosen(only: str | None) -> list[str]:
    """Keys of all kinds, or of those whose key begins with one of some words, separated by commas.

    Raises:
        ValueError: no kind is called so.
    """
    if only is None:
        return list(KINDS)
    heads = tuple(only.split(","))
    exact = [k for k in KINDS if k in heads]
    found = exact or [k for k in KINDS if k.startswith(heads)]
    if not found:
        raise ValueError(f"no kind is called {only}; there are {', '.join(KINDS)}")
    return found


def plan(seed: int, count: int, only: str | None = None) -> list[Mistake]:
    """`count` cases: every kind comes round before any repeats, each time in another of its families that are present."""
    keys = chosen(only)
    rng = np.random.default_rng([seed, len(keys)])
    cases: list[Mistake] = []
    left: dict[str, list[str]] = {}
    while len(cases) < count:
        for key in rng.permutation(keys):
            if len(cases) == count:
                break
            kind = KINDS[str(key)]
            if not left.get(kind.key):
                families = [f for f in kind.families if origins.present(f)]
                left[kind.key] = [str(f) for f in rng.permutation(families)]
            family = left[kind.key].pop()
            number = len(cases)
            cases.append(Mistake(f"mistake-{number:04d}", [seed, number], kind.key, family, kind.command))
    return cases


class UnfitError(Exception):
    """No recording of a family has what a mistake is made in."""


def build(case: Mistake, folder: Path) -> Mistake:
    """Write `folder/asked` and `folder/control`; returns the case with its truth.

    Raises:
        UnfitError: the family has no recording that fits.
    """
    kind = KINDS[case.kind]
    rng = np.random.default_rng(case.seed)
    for _ in range(20):
        rec = origins.make(case.family, rng, kind.needs)
        if kind.fits(rec):
            break
    else:
        raise UnfitError(f"{case.kind} fits no recording of {case.family}")
    case.effects = list(rec.effects)
    case.load = asdict(rec.load) if rec.load else None
    case.coulomb = rec.coulomb
    rec.write(folder / CONTROL)
    made = kind.apply(rec, rng)
    case.says = made.says
    case.numbers, case.loads = made.numbers, [asdict(load) for load in made.loads]
    rec.write(folder / ASKED)
    return case

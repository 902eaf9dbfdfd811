"""The section `## Ordinary mistakes` of docs/proof.md: failures first, the figures, and a table of the kinds."""

from collections.abc import Sequence

from galen_hw.tools.blind_proof.mistakes.kinds import KINDS
from galen_hw.tools.blind_proof.mistakes.score import Scored

NAMED, WRONG, SPOKEN = 0.95, 0.01, 0.005
"""Promised shares: cause named at least, confident wrong name or number at most, a premise speaks of nothing at most."""


def figures(cases: Sequence[Scored]) -> list[tuple[str, str, str, bool]]:
    """What, promised, reached, whether it is met."""
    n = max(len(cases), 1)
    named, wrong = sum(c.named for c in cases), sum(bool(c.wrong) for c in cases)
    spoken = sum(bool(c.spoken) for c in cases)
    return [
        ("cause named", f">= {NAMED:.0%}", f"{named / n:.1%} ({named} of {len(cases)})", named >= NAMED * n),
        (
            "confident wrong name or number",
            f"<= {WRONG:.0%}",
            f"{wrong / n:.1%} ({wrong} of {len(cases)})",
            wrong <= WRONG * n,
        ),
        (
            "without a mistake: a premise speaks",
            f"<= {SPOKEN:.1%}",
            f"{spoken / n:.1%} ({spoken} of {len(cases)})",
            spoken <= SPOKEN * n,
        ),
    ]


def section(cases: Sequence[Scored], seed: int, commit: str, given: Sequence[tuple[str, bool, str]] = ()) -> str:
    """The section's text; `given`: (name, right, answer) of the recordings that were handed over."""
    lines = [
        "## Ordinary mistakes\n",
        "Written by `make mistakes`. One ordinary mistake in each of these recordings, which are right without it; the truth",
        "stayed sealed until every answer was on disk. The judge shares no code with the tool.\n",
        f"{len(cases)} recordings with a mistake and the same without, seed {seed} (commit {commit}).\n",
        "| what | promised | reached | |",
        "| --- | --- | --- | --- |",
        *(f"| {w} | {p} | {r} | {'yes' if good else '**no**'} |" for w, p, r, good in figures(cases)),
    ]
    if given:
        right = sum(good for _, good, _ in given)
        met = "yes" if right == len(given) else "**no**"
        lines.append(f"| recordings that were handed over: right | {len(given)} of {len(given)} | {right} | {met} |")
    warned = sum(c.warned for c in cases)
    lines += ["", f"A warning of numpy reached the screen in {warned} answers.\n"] if warned else [""]
    lines += [*failures(cases), *_kinds(cases)]
    if given:
        lines += ["### Handed over\n", "| recording | right | answer |", "| --- | --- | --- |"]
        lines += [f"| {name} | {'yes' if good else '**no**'} | {_cell(said)} |" for name, good, said in given]
        lines.append("")
    return "\n".join(lines)


def failures(cases: Sequence[Scored]) -> list[str]:
    """Every case that was not answered rightly, and every premise that spoke of nothing."""
    out = ["### Failures first\n"]
    bad = [c for c in cases if not c.right]
    for case in sorted(bad, key=lambda c: (not c.wrong, c.truth["kind"])):
        t = case.truth
        fault = f"**wrong: {'; '.join(case.wrong)}**" if case.wrong else "not named"
        also = f" (without the mistake too: {'; '.join(case.beside)})" if case.beside else ""
        out.append(f"- {t['name']}, {t['kind']} in {t['family']} ({t['says']}): {fault}{also}. {_cell(case.short)}")
    out += [
        f"- {c.truth['name']}, {c.truth['family']} without a mistake: {_cell('; '.join(c.spoken))}"
        for c in cases
        if c.spoken
    ]
    return [*out, ""] if len(out) > 1 else [*out, "None.", ""]


def _kinds(cases: Sequence[Scored]) -> list[str]:
    """A row a kind, those with failures first."""
    rows = []
    for key, kind in KINDS.items():
        mine = [c for c in cases if c.truth["kind"] == key]
        if mine:
            named, wrong = sum(c.named for c in mine), sum(bool(c.wrong) for c in mine)
            seconds = sorted(c.asked["seconds"] for c in mine)[len(mine) // 2]
            row = f"| {key} | {kind.about} | {kind.command} | {len(mine)} | {named} | {wrong} | {seconds:.0f} |"
            rows.append((named - len(mine) - wrong, row))
    head = "| kind | about | asked with | cases | cause named | confidently wrong | median s |"
    return ["### Kinds\n", head, "| --- " * 7 + "|", *(row for _, row in sorted(rows, key=lambda r: r[0])), ""]


def _cell(text: str) -> str:
    return " ".join(text.replace("|", "/").split())

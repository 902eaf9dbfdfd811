"""A diagnosis on the terminal: the five lines of each recording, one table for many."""

from collections.abc import Sequence
from pathlib import Path

from rich import box
from rich.console import Console
from rich.table import Table
from rich.text import Text

from galen_hw.diagnosis.report.summary import VERDICTS, lines, summary
from galen_hw.diagnosis.result import Diagnosis

COLOURS = {"agrees": "green", "explained": "cyan", "partly_explained": "yellow", "unexplained": "red"}
FEW = 3
"""Up to so many recordings are told one by one; of more there is the table, and JSON and pages for the rest."""


def show(console: Console, answers: Sequence[Diagnosis]) -> None:
    """All answers: one by one where they are few, and the table where they are several."""
    if len(answers) <= FEW:
        for answer in answers:
            show_one(console, answer)
    if len(answers) > 1:
        console.print(table(answers))


def show_one(console: Console, answer: Diagnosis) -> None:
    """Verdict in its colour, then the lines under their labels; unbroken lines where a program reads."""
    if not console.is_terminal:
        console.print(summary(answer), soft_wrap=True, markup=False, highlight=False)
        return
    colour = COLOURS[answer.verdict]
    console.print(Text.assemble((answer.recording, "bold"), ": ", (VERDICTS[answer.verdict], f"bold {colour}")))
    grid = Table.grid(padding=(0, 2, 0, 0))
    grid.add_column(style="dim", min_width=7, no_wrap=True)
    grid.add_column(overflow="fold")
    for label, text in lines(answer):
        style = "bold" if label == "next" else "yellow" if label == "note" else ""
        grid.add_row(f"  {label}", Text(text, style=style))
    console.print(grid)
    console.print()


def table(answers: Sequence[Diagnosis]) -> Table:
    """One row a recording: verdict, what was found, and the held-out error before and after over the noise."""
    out = Table(box=box.SIMPLE_HEAD, padding=(0, 1, 0, 0), pad_edge=False)
    out.add_column("recording", overflow="fold")
    out.add_column("verdict", no_wrap=True)
    out.add_column("found", overflow="fold")
    out.add_column("error / noise", justify="right", no_wrap=True)
    common = _common([answer.recording for answer in answers])
    for answer in answers:
        before, after = (_worst(answer, key) for key in ("rmse_before", "rmse_after"))
        colour = COLOURS[answer.verdict]
        found = ", ".join(f.effect + (f" ({', '.join(f.joints)})" if f.joints else "") for f in answer.findings)
        name = answer.recording.removeprefix(common)
        out.add_row(name, Text(answer.verdict, style=colour), found or "-", f"{before:.2f} to {after:.2f}")
    agree = sum(answer.verdict == "agrees" for answer in answers)
    out.caption = f"{agree} of {len(answers)} agree; error of the worst channel on held-out data over its noise"
    out.caption_justify = "left"
    return out


def _worst(answer: Diagnosis, key: str) -> float:
    floor, values = answer.fit["noise_floor"], answer.fit[key]
    return max((values[c] / floor[c] for c in values if floor[c] > 0.0), default=float("nan"))


def _common(names: Sequence[str]) -> str:
    """The folder that all recordings are in."""
    folders = {str(Path(name).parent) for name in names}
    return f"{folders.pop()}/" if len(folders) == 1 else ""

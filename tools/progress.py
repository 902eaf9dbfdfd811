"""How far the work on recordings is, on stderr: a bar on a terminal, some lines elsewhere."""

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

LINES = 10
"""At most so many lines tell of many recordings where there is no bar."""


@contextmanager
def working(what: str) -> Iterator[Callable[[str, float], None]]:
    """A bar on stderr for one recording, or a line a stage where stderr is no terminal.

    What it yields is told the stage and its share of the whole.
    """
    with _bar() as progress:
        task = progress.add_task(what, total=1.0)
        said = [what]

        def told(stage: str, share: float) -> None:
            progress.update(task, description=stage, completed=min(max(share, 0.0), 1.0))
            # Reading and the first look are not said: what they refuse stays one line, its error.
            if stage != said[-1] and share > 0.0:
                said.append(stage)
                _say(progress, stage)

        yield told


@contextmanager
def counting(what: str, total: int) -> Iterator[Callable[[], None]]:
    """A bar on stderr for many recordings, or some lines where stderr is no terminal; what it yields is called after each."""
    with _bar(MofNCompleteColumn()) as progress:
        task = progress.add_task(what, total=total)
        _say(progress, f"{what} {total} recordings")

        def done() -> None:
            progress.advance(task)
            count = int(progress.tasks[0].completed)
            if LINES * count // total > LINES * (count - 1) // total:
                _say(progress, f"{count} of {total}")

        yield done


def _say(progress: Progress, text: str) -> None:
    """A line where there is no bar."""
    if progress.disable:
        print(text, file=sys.stderr, flush=True)


def _bar(*more: MofNCompleteColumn) -> Progress:
    console = Console(stderr=True)
    columns = (SpinnerColumn(), TextColumn("{task.description:<28}"), BarColumn(40), *more, TimeElapsedColumn())
    return Progress(*columns, console=console, transient=True, disable=not console.is_terminal)

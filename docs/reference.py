"""Writes the reference of the command line from the program's own parsers: `python docs/reference.py FILE`."""

import argparse
import sys
from collections.abc import Iterator
from pathlib import Path

from galen_hw.cli import COMMANDS, parser_of

STATUS = """0 fine, 1 something was found, 2 wrong use or input, 3 hardware, 4 refused (nothing was done), 70 internal error,
130 interrupted, 141 output cut off.
"""
HEAD = f"""# Commands

Written from the program's own parsers (`python docs/reference.py docs/commands.md`). Numbers may have a unit where
the option is a length of time or a force (`--seconds 2min`, `--max-force 12N`), and in `galen-hw command` (`17deg`, `5mm`).

Exit status: {STATUS}
Completion: `galen-hw --completion bash` (zsh, fish, tcsh, powershell) prints it; it needs `pip install 'galen-hw[completion]'`.
The same as a manual page: `man galen-hw`, where pip has put it (`share/man/man1` of the environment).
"""


def main() -> int:
    """Write the page of the commands."""
    return write(reference())


def write(text: str) -> int:
    """Write a page to the path that the command line gives, or to the standard output; 0, the status."""
    if len(sys.argv) > 1:
        Path(sys.argv[1]).write_text(text, encoding="utf-8")
    else:
        print(text, end="")
    return 0


def reference() -> str:
    """Return the page: every command, its parts and their options."""
    parts = [HEAD]
    for name in COMMANDS:
        parts += _section(f"galen-hw {name}", parser_of(name), level=2)
    return "\n".join(parts)


def _section(name: str, parser: argparse.ArgumentParser, level: int) -> Iterator[str]:
    """A heading, what it is for, its words in a table, its example; then the parts below it."""
    yield f"{'#' * level} {name}\n"
    yield f"{parser.description}\n"
    rows = [f"| `{_words(a)}` | {_help(a)} |" for a in parser._actions if _shown(a)]  # noqa: SLF001 - no other way
    if rows:
        yield "\n".join(["| word | meaning |", "| --- | --- |", *rows]) + "\n"
    for line in (parser.epilog or "").split("; "):
        if "galen-hw" in line:
            yield f"    {line[line.index('galen-hw') :]}"
    yield ""
    for action in parser._actions:  # noqa: SLF001
        if isinstance(action, argparse._SubParsersAction):  # noqa: SLF001
            for part, below in action.choices.items():
                yield from _section(f"{name} {part}", below, level + 1)


def _shown(action: argparse.Action) -> bool:
    """Whether it is a word of the command's own, and meant for people."""
    hidden = (argparse._HelpAction, argparse._SubParsersAction)  # noqa: SLF001
    return action.help != argparse.SUPPRESS and not isinstance(action, hidden)


def _words(action: argparse.Action) -> str:
    """An option with its value, or the name of a word."""
    value = str(action.metavar or (action.dest.upper() if action.nargs != 0 else ""))
    if not action.option_strings:
        return str(action.metavar or "|".join(action.choices or [action.dest.upper()]))
    return ", ".join(action.option_strings) + (f" {value}" if value and action.nargs != 0 else "")


def _help(action: argparse.Action) -> str:
    choices = f" ({', '.join(map(str, action.choices))})" if action.choices else ""
    return (str(action.help or "") + choices).replace("|", "\\|").replace("<", "&lt;")


if __name__ == "__main__":
    sys.exit(main())

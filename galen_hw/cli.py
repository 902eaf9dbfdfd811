"""The command `galen-hw`: one table of commands, each in a file of its own under `tools/`, loaded when it is named."""

import argparse
import importlib
import os
import sys
import traceback
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path
from typing import Any, Final, NoReturn

from galen_hw.errors import EXIT_INTERNAL, EXIT_OK, EXIT_USAGE, GalenError, UsageError
from galen_hw.extras import explained
from galen_hw.version import VERSION

EXIT_PIPE: Final = 128 + 13
COMMANDS: Final[dict[str, tuple[str, str]]] = {
    # name: (module with `add_arguments(parser)` and `run(args) -> int`, help)
    "run": ("galen_hw.tools.run", "run the daemon beside the robot"),
    "check": ("galen_hw.tools.check", "check the set-up and name every problem at once"),
    "find": ("galen_hw.tools.find", "list the ports of this machine by their lasting names"),
    "monitor": ("galen_hw.tools.monitor.command", "show live topics: rates, ages, losses, wrench"),
    "status": ("galen_hw.tools.status", "say whether all is well: alarms, rates, latency, noise, drift"),
    "dashboard": ("galen_hw.tools.dashboard.command", "show the robot live in a browser, with buttons"),
    "virtual": ("galen_hw.tools.virtual", "run the virtual robot: the other ends of the wires"),
    "calibrate": (
        "galen_hw.tools.calibration.command",
        "sweep, fit and verify a tool's weight, centre of mass and sensor bias",
    ),
    "tool": ("galen_hw.tools.tool", "list, show, select, roll back and export tools and their calibrations"),
    "command": ("galen_hw.tools.command", "send one request to a device or service of the running daemon"),
    "record": ("galen_hw.tools.record", "record the bus to an MCAP file"),
    "replay": ("galen_hw.tools.replay", "play a recording through the services again"),
    "export": ("galen_hw.tools.export", "write a recording as a table, or for MATLAB, ROS 2 or Foxglove"),
    "import": ("galen_hw.tools.import_table", "take a recording of another program: bags, CAN logs, MATLAB, CSV, ..."),
    "bridge": ("galen_hw.tools.bridge.command", "pass the live bus on to Foxglove or ROS 2"),
    "diagnose": ("galen_hw.tools.diagnose", "find what a model left out: locate, name, model, prove"),
    "collect": ("galen_hw.tools.collect.command", "guided collection of deflection data with the tracker"),
    "install-service": ("galen_hw.tools.install_service", "install the daemon as a systemd service, or take it away"),
    "keys": ("galen_hw.tools.keys", "make and list keys for viewers on other machines"),
    "deflection": ("galen_hw.tools.deflection.command", "fit and compare deflection models"),
}


def main(argv: list[str] | None = None) -> int:
    """Run one command.

    Returns:
        The exit status: 0 fine, 1 found something, 2 wrong use or input, 3 hardware, 4 refused, 70 internal error, 141 output
        cut off.
    """
    argv = sys.argv[1:] if argv is None else argv
    command = _named(argv)
    said = f"galen-hw {command}" if command in COMMANDS else "galen-hw"
    try:
        return _run(argv)
    except GalenError as error:
        if os.environ.get("GALEN_HW_TRACEBACK"):
            raise
        print(f"{said}: {error}", file=sys.stderr)
        return error.exit_code
    except KeyboardInterrupt:
        with suppress(KeyboardInterrupt):  # Who presses twice needs no traceback either.
            print(f"{said}: interrupted", file=sys.stderr)
        return 130
    except (BrokenPipeError, SystemExit) as error:
        if isinstance(error, SystemExit) and not isinstance(error.__context__, BrokenPipeError):
            raise
        # The reader of our output has gone (head, less; rich turns it into an exit with 1). Nobody has seen all of it, so
        # that 0 or 1 would claim too much: the status is the shell's for SIGPIPE. Stop Python's flush from saying it again.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return EXIT_PIPE
    except Exception as error:
        if os.environ.get("GALEN_HW_TRACEBACK"):
            raise
        print(f"{said}: {_internal(error)}", file=sys.stderr)
        return EXIT_INTERNAL


def _run(argv: list[str]) -> int:
    """Parse and carry out.

    Raises:
        MissingExtraError: a library that the command needs is not installed.
    """
    try:
        parser, command = _parser(argv)
        args, unknown = parser.parse_known_args(argv)
        if unknown:
            meant = _meant(unknown[0].partition("=")[0], _options(parser))
            _Parser(prog=f"galen-hw {command or ''}".strip()).error(f"{' '.join(unknown)}: not known{meant}")
        if args.completion is not None:
            return _complete(args.completion)
        if args.command is None:
            parser.print_help()
            return EXIT_USAGE
        assert command is not None
        status = int(importlib.import_module(COMMANDS[command][0]).run(args))
        sys.stdout.flush()  # Here, where a reader that has gone can still be told in the status.
    except ModuleNotFoundError as error:
        if (missing := explained(error)) is not None:
            raise missing from error
        raise
    return status


def _complete(shell: str) -> int:
    """Print what a shell needs to complete commands and options.

    Raises:
        MissingExtraError: shtab is not installed.
        UsageError: not a shell that it knows.
    """
    import shtab

    if shell not in shtab.SUPPORTED_SHELLS:
        raise UsageError(f"no completion for {shell!r}", todo=f"one of: {', '.join(shtab.SUPPORTED_SHELLS)}")
    print(shtab.complete(whole_parser(), shell=shell))
    return EXIT_OK


def _named(argv: list[str]) -> str | None:
    """The word that should be a command."""
    return next((word for word in argv if not word.startswith("-")), None)


def _meant(word: str, known: Iterable[str]) -> str:
    """`; did you mean ...?` where a known word is near; only then is difflib loaded."""
    from difflib import get_close_matches

    near = get_close_matches(word, list(known), n=1, cutoff=0.6)
    return f"; did you mean {near[0]}?" if near else ""


def _options(parser: argparse.ArgumentParser) -> list[str]:
    """All options of a parser and of the commands below it that are loaded."""
    found: list[str] = []
    for action in parser._actions:  # noqa: SLF001 - argparse gives no other way to a parser's options
        found += [word for word in action.option_strings if word.startswith("--")]
        if isinstance(action, argparse._SubParsersAction):  # noqa: SLF001
            for below in action.choices.values():
                found += _options(below)
    return found


def _internal(error: Exception) -> str:
    """Say in one line what this program did wrong, where, and how to report it."""
    last = traceback.extract_tb(error.__traceback__)[-1]
    what = " ".join(f"{type(error).__name__} {error}".split())
    todo = "please report it with the traceback that GALEN_HW_TRACEBACK=1 shows"
    return f"internal error: {what} ({Path(last.filename).name}:{last.lineno}); {todo}"


def _parser(argv: list[str]) -> tuple[argparse.ArgumentParser, str | None]:
    """The parser; only the named command's module is imported, so that --help is quick."""
    parser = _Parser(
        prog="galen-hw", description="Hardware interface of the Galen surgical robot.", formatter_class=_OneColumn
    )
    parser.add_argument("--version", action="version", version=f"galen-hw {VERSION}")
    parser.add_argument(
        "--completion", metavar="SHELL", help="print the completion of bash, zsh, fish, tcsh or powershell"
    )
    subparsers = parser.add_subparsers(dest="command", metavar="COMMAND")
    named = _named(argv)
    for name, (module, text) in COMMANDS.items():
        sub = subparsers.add_parser(name, help=text, description=text[0].upper() + text[1:] + ".")
        if name == named or argv == [*COMMANDS]:  # all of them, for the completion
            importlib.import_module(module).add_arguments(sub)
    return parser, named if named in COMMANDS else None


def whole_parser() -> argparse.ArgumentParser:
    """Return the parser with every command's own, for what is written from it: completion, the manual page."""
    return _parser(list(COMMANDS))[0]


def parser_of(command: str) -> argparse.ArgumentParser:
    """Return a command's own parser, for what is written from it: the reference, completion."""
    parser, _ = _parser([command])
    for action in parser._actions:  # noqa: SLF001 - argparse gives no other way to the parsers below
        if isinstance(action, argparse._SubParsersAction):  # noqa: SLF001
            found: argparse.ArgumentParser = action.choices[command]
            return found
    raise AssertionError(command)


class _Parser(argparse.ArgumentParser):
    """Says what is wrong and where to look in one line, as every other problem is said; commands are such parsers too."""

    def error(self, message: str) -> NoReturn:
        """End with the status of wrong use."""
        self.exit(EXIT_USAGE, f"{self.prog}: {message}; {self.prog} --help\n")

    def _check_value(self, action: argparse.Action, value: Any) -> None:
        """Refuse what is no choice; the nearest one is named instead of all of them."""
        if action.choices is not None and value not in action.choices and (near := _meant(str(value), action.choices)):
            raise argparse.ArgumentError(action, f"there is no {value!r}{near}")
        super()._check_value(action, value)


class _OneColumn(argparse.HelpFormatter):
    """Every command on one line with its help: argparse itself forgets that commands are indented once more."""

    def __init__(self, prog: str, **options: Any) -> None:
        super().__init__(prog, **options)
        self._action_max_length = max(map(len, COMMANDS)) + 2 * self._indent_increment


if __name__ == "__main__":
    sys.exit(main())

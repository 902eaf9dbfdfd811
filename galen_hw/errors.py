"""The errors that a user meets: one line each, saying what is wrong, where, and what to do."""

from typing import Any

EXIT_OK = 0
EXIT_FOUND = 1
"""The work was done and something was found: a mismatch, a problem of the set-up, a check that did not pass."""
EXIT_USAGE = 2
EXIT_HARDWARE = 3
EXIT_REFUSED = 4
"""Well asked, and not done: the robot is not in a state for it, the data cannot be fitted, nobody accepted the result."""
EXIT_INTERNAL = 70
"""A fault of this program, as EX_SOFTWARE of sysexits.h: never 1, which says that something was found."""


class GalenError(Exception):
    """A problem the user can act on.

    Args:
        what: what is wrong, a clause without a full stop.
        where: file and key, device and address, row and column; empty where there is no place.
        todo: what to do about it; empty where nothing helps.
    """

    exit_code = EXIT_REFUSED

    def __init__(self, what: str, *, where: str = "", todo: str = "") -> None:
        super().__init__(what, where, todo)
        self.what, self.where, self.todo = what, where, todo

    @property
    def problem(self) -> str:
        """Return where and what, without what to do, for a message that has a field of its own for that."""
        return f"{self.where}: {self.what}" if self.where else self.what

    def __str__(self) -> str:
        return f"{self.problem}; {self.todo}" if self.todo else self.problem

    def __reduce__(self) -> tuple[Any, ...]:
        # What the constructor takes by name, pickle would hand over by place: a process would answer with a crash.
        return _again, (type(self), self.what, self.where, self.todo), self.__dict__


def _again(kind: type[GalenError], what: str, where: str, todo: str) -> GalenError:
    """An error as it was in the process that raised it."""
    error = kind.__new__(kind, what, where, todo)
    GalenError.__init__(error, what, where=where, todo=todo)
    return error


class UsageError(GalenError):
    """Wrong use, unreadable input or bad configuration (exit status 2)."""

    exit_code = EXIT_USAGE


class HardwareError(GalenError):
    """A device cannot be reached or refuses (exit status 3)."""

    exit_code = EXIT_HARDWARE


class CommandRejectedError(GalenError):
    """A command that is well formed but must not be carried out now; nothing was sent (exit status 4)."""


class WrongCommandError(CommandRejectedError):
    """A command that its target does not have, or with arguments that it does not take; nothing was sent (exit status 2)."""

    exit_code = EXIT_USAGE

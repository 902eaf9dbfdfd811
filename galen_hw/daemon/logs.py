"""What the daemon's processes write to stderr: a line a second at most for each cause, in the form that journald takes.

Under systemd (stderr is the journal's, as JOURNAL_STREAM says) each line bears its priority, and every `fault` of the bus
is a line too; on a terminal neither is, for there `galen-hw monitor` shows them.
"""

import logging
import os
import sys
import time
from collections.abc import Callable, Mapping
from typing import Final

FAULTS: Final = "galen-hw.faults"
EVERY_S: Final = 1.0
MOST_CAUSES: Final = 256
"""Remembered at a time; the oldest are forgotten."""
_PRIORITY: Final = {logging.DEBUG: 7, logging.INFO: 6, logging.WARNING: 4, logging.ERROR: 3, logging.CRITICAL: 2}


class OncePerSecond(logging.Filter):
    """Passes one line a second of each cause; the next one that passes says how many were left out.

    A cause is the line's text without its numbers: the same words about the same device.

    Args:
        clock: monotonic seconds.
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        super().__init__()
        self._clock = clock
        self._said: dict[tuple[object, ...], tuple[float, int]] = {}

    def filter(self, record: logging.LogRecord) -> bool:
        """Return whether this line may be written; see the class."""
        words = record.args if isinstance(record.args, tuple) else (record.args,)
        cause = (record.name, record.msg, *(word for word in words if isinstance(word, str)))
        now = self._clock()
        said, left_out = self._said.get(cause, (-EVERY_S, 0))
        if now - said < EVERY_S:
            self._said[cause] = said, left_out + 1
            return False
        self._said.pop(cause, None)
        self._said[cause] = now, 0
        if len(self._said) > MOST_CAUSES:
            del self._said[next(iter(self._said))]
        if left_out:
            record.msg, record.args = f"{record.getMessage()} (and {left_out} more like this)", ()
        return True


class JournalFormatter(logging.Formatter):
    """One line a record, with its priority as systemd reads it from a stream."""

    def format(self, record: logging.LogRecord) -> str:
        """The text, each of its lines (a traceback has several) with the priority."""
        level = max((known for known in _PRIORITY if known <= record.levelno), default=logging.DEBUG)
        return "\n".join(f"<{_PRIORITY[level]}>{line}" for line in super().format(record).splitlines())


def is_journal(fd: int, environ: Mapping[str, str] = os.environ) -> bool:
    """Return whether a descriptor is the one that systemd has connected to the journal."""
    found = os.fstat(fd)
    return environ.get("JOURNAL_STREAM") == f"{found.st_dev}:{found.st_ino}"


def set_up() -> None:
    """Have this process log to stderr in the daemon's way."""
    journal = is_journal(sys.stderr.fileno())
    handler = logging.StreamHandler(sys.stderr)
    handler.setFormatter(JournalFormatter() if journal else logging.Formatter("%(message)s"))
    handler.addFilter(OncePerSecond())
    logging.basicConfig(level=logging.WARNING, handlers=[handler])
    logging.getLogger("galen-hw").setLevel(logging.INFO)
    logging.getLogger(FAULTS).setLevel(logging.WARNING if journal else logging.CRITICAL)

"""A small runner for downloaded programs: enough for messages, waits and motion from a program's threads."""

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from galen_hw.drivers.virtual.galil_dmc.format import Rejected

if TYPE_CHECKING:
    from collections.abc import Callable

    from galen_hw.drivers.virtual.galil_dmc.controller import Controller

MAX_LINES = 2000
_THREADS = 8


@dataclass(slots=True)
class Thread:
    """One running thread: the next line, and until when it waits."""

    line: int
    part: int = 0
    wait_until: float = 0.0


@dataclass(slots=True)
class Program:
    """The program memory and its threads.

    Args:
        append: the download under way is added to the end (DL #), not put in the program's place.
        execute: runs one command and returns its data; set by the interpreter.
    """

    lines: list[str] = field(default_factory=list)
    threads: dict[int, Thread] = field(default_factory=dict)
    incoming: list[str] | None = None
    append: bool = False
    execute: "Callable[[str], str | bytes | None] | None" = None

    @property
    def running(self) -> bool:
        """A thread runs."""
        return bool(self.threads)

    def receive(self, text: str) -> bool:
        """A line of a download; True when it was the last (a lone backslash)."""
        assert self.incoming is not None
        head, backslash, _ = text.partition("\\")
        if head:
            self.incoming.append(head)
        if not backslash:
            return False
        before = self.lines if self.append else []
        self.lines, self.incoming = [*before, *self.incoming][:MAX_LINES], None
        return True

    def start(self, label: str, thread: int) -> None:
        """XQ.

        Raises:
            Rejected: no such label (10), or the thread is in use (19), or no such thread (6).
        """
        if not 0 <= thread < _THREADS:
            raise Rejected(6)
        if thread in self.threads:
            raise Rejected(19)
        self.threads[thread] = Thread(self.find(label))

    def find(self, label: str) -> int:
        """Index of the line after `#label`; the first line for an empty label."""
        if not label and self.lines:
            return 0
        for index, line in enumerate(self.lines):
            if line.split(";")[0].strip() == label:
                return index
        raise Rejected(10)

    def halt(self, thread: int | None = None) -> None:
        """HX: one thread, or all."""
        if thread is None:
            self.threads.clear()
        else:
            self.threads.pop(thread, None)

    def step(self, controller: "Controller") -> None:
        """Each thread does one command a tick, as far as it does not wait."""
        for number, thread in list(self.threads.items()):
            if controller.t >= thread.wait_until:
                self._one(controller, number, thread)

    def _one(self, controller: "Controller", number: int, thread: Thread) -> None:
        if thread.line >= len(self.lines):
            self.threads.pop(number, None)
            return
        parts = self.lines[thread.line].split(";")
        text = parts[thread.part].strip()
        line = thread.line
        if text[:2] == "AM" and any(axis.moving for axis in controller.axes):
            return
        thread.part += 1
        if thread.part >= len(parts):
            thread.line, thread.part = thread.line + 1, 0
        try:
            self._command(controller, number, thread, text)
        except Rejected as rejected:
            controller.error_code = rejected.code
            controller.say(f"?{line} {text}")
            self.threads.pop(number, None)

    def _command(self, controller: "Controller", number: int, thread: Thread, text: str) -> None:
        name, rest = text[:2], text[2:].strip()
        if not text or text.startswith(("#", "'")) or name in {"NO", "AM"}:
            return
        if name == "EN":
            self.threads.pop(number, None)
        elif name == "WT":
            thread.wait_until = controller.t + float(rest) / 1000.0
        elif name == "JP":
            label, _, condition = rest.partition(",")
            if not condition or controller.value(condition):
                thread.line, thread.part = self.find(label.strip()), 0
        elif self.execute is not None and isinstance(data := self.execute(text), str):
            controller.say(data)

"""What systemd is told: ready when samples flow, alive while they are compensated, and how it goes."""

import os
import time
from collections.abc import Mapping
from typing import Final

import sdnotify

STATUS_EVERY_S: Final = 1.0


class Notifier:
    """Speaks systemd's notification protocol; silent where nobody listens (no NOTIFY_SOCKET).

    It waits for nobody: what a busy systemd does not take is said again with the next turn.
    """

    def __init__(self) -> None:
        self._systemd = sdnotify.SystemdNotifier()
        if self._systemd.socket is not None:
            self._systemd.socket.setblocking(False)
            self._systemd.debug = True  # without, it swallows what says that a word was not taken
        self._owed: list[str] = []
        self._progress: dict[str, int] = {}
        self._status = ("", 0.0)
        microseconds = int(os.environ.get("WATCHDOG_USEC", "0"))
        self.watchdog_s = microseconds / 1e6

    def ready(self) -> None:
        """Samples flow."""
        self._owed.append("READY=1")
        self._settle()

    def stopping(self) -> None:
        """The end has begun."""
        self._owed.append("STOPPING=1")
        self._settle()

    def progress(self, signs: Mapping[str, int]) -> None:
        """Feed the watchdog, if every sign of progress has changed since it was fed last."""
        if all(value != self._progress.get(name, -1) for name, value in signs.items()):
            self._settle()
            if self._send("WATCHDOG=1"):
                self._progress = dict(signs)

    def status(self, text: str) -> None:
        """One line for `systemctl status`, at most once a second."""
        now = time.monotonic()
        if text != self._status[0] and now - self._status[1] >= STATUS_EVERY_S and self._send(f"STATUS={text}"):
            self._status = (text, now)

    def _settle(self) -> None:
        """Say what must not be lost."""
        while self._owed and self._send(self._owed[0]):
            self._owed.pop(0)

    def _send(self, text: str) -> bool:
        try:
            self._systemd.notify(text.encode().decode("latin-1"))  # which it encodes again
        except OSError:
            return False
        return True

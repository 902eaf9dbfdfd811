"""What systemd is told: ready when samples flow, alive while they are compensated, and how it goes."""

import os
import time
from typing import Final

import sdnotify

STATUS_EVERY_S: Final = 1.0


class Notifier:
    """Speaks systemd's notification protocol; silent where nobody listens (no NOTIFY_SOCKET)."""

    def __init__(self) -> None:
        self._systemd = sdnotify.SystemdNotifier()
        self._progress = -1
        self._status = ("", 0.0)
        microseconds = int(os.environ.get("WATCHDOG_USEC", "0"))
        self.watchdog_s = microseconds / 1e6

    def ready(self) -> None:
        """Samples flow."""
        self._systemd.notify("READY=1")

    def stopping(self) -> None:
        """The end has begun."""
        self._systemd.notify("STOPPING=1")

    def progress(self, samples: int) -> None:
        """Feed the watchdog, if more samples than the last time have been compensated."""
        if samples != self._progress:
            self._progress = samples
            self._systemd.notify("WATCHDOG=1")

    def status(self, text: str) -> None:
        """One line for `systemctl status`, at most once a second."""
        now = time.monotonic()
        if text != self._status[0] and now - self._status[1] >= STATUS_EVERY_S:
            self._status = (text, now)
            self._systemd.notify(f"STATUS={text}")

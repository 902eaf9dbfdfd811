"""What services have learnt, kept over restarts: one JSON file a service, replaced whole or not at all."""

import contextlib
import logging
import os
import queue
import threading
from pathlib import Path
from typing import Any

import msgspec

log = logging.getLogger("galen-hw")


def write_atomically(path: Path, content: bytes) -> None:
    """Replace a file by another content; after a crash either the old or the new one is there, whole.

    Raises:
        OSError: the folder cannot be written.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    new = path.with_name(f".{path.name}.{os.getpid()}")
    try:
        with new.open("wb") as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        new.replace(path)
    except OSError:
        new.unlink(missing_ok=True)
        raise


class Keeper:
    """Reads snapshots at the start and writes them in a thread, so that a slow disk never holds up the loop.

    Args:
        folder: where the files are.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._queue: queue.SimpleQueue[tuple[str, bytes] | None] = queue.SimpleQueue()
        self._thread: threading.Thread | None = None
        self._last: dict[str, bytes] = {}

    def read(self, service: str) -> dict[str, Any] | None:
        """The last snapshot; None when there is none or it cannot be read."""
        path = self._folder / f"{service}.json"
        try:
            found = msgspec.json.decode(path.read_bytes())
        except FileNotFoundError:
            return None
        except (OSError, msgspec.DecodeError) as error:
            log.warning("%s: what was kept cannot be read (%s); starting afresh", path, error)
            return None
        return found if isinstance(found, dict) else None

    def keep(self, service: str, snapshot: dict[str, Any]) -> None:
        """Write a snapshot soon, unless it is what was written last."""
        content = msgspec.json.format(msgspec.json.encode(snapshot))
        if self._last.get(service) == content:
            return
        self._last[service] = content
        if self._thread is None:
            self._thread = threading.Thread(target=self._write, name="keeper", daemon=True)
            self._thread.start()
        self._queue.put((service, content))

    def close(self) -> None:
        """Wait until all is written."""
        if self._thread is not None:
            self._queue.put(None)
            self._thread.join(timeout=5.0)
            self._thread = None

    def _write(self) -> None:
        while (item := self._queue.get()) is not None:
            with contextlib.suppress(ValueError):
                try:
                    write_atomically(self._folder / f"{item[0]}.json", item[1])
                except OSError as error:
                    log.warning("%s: state cannot be kept (%s)", self._folder / item[0], error.strerror)

"""What services and devices have learnt, kept over restarts: one JSON file each, replaced whole or not at all."""

import logging
import queue
import threading
from pathlib import Path
from typing import Any, Final

import msgspec

from galen_hw.config.tool_store import write_atomic
from galen_hw.documents import DocumentError, intact, load_json, sealed
from galen_hw.drivers.device import Device
from galen_hw.errors import UsageError

VERSION: Final = 1
BOOT_ID: Final = Path("/proc/sys/kernel/random/boot_id")
log = logging.getLogger("galen-hw")


class Keeper:
    """Reads snapshots at the start and writes them in a thread, so that a slow disk never holds up the loop.

    Args:
        folder: where the files are.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._queue: queue.SimpleQueue[tuple[str, str] | None] = queue.SimpleQueue()
        self._thread: threading.Thread | None = None
        self._last: dict[str, str] = {}

    def read(self, service: str) -> dict[str, Any] | None:
        """The last snapshot; None when there is none or it cannot be read."""
        path = self._folder / f"{service}.json"
        try:
            found = load_json(path.read_bytes())
        except FileNotFoundError:
            return None
        except (OSError, DocumentError) as error:
            log.warning("%s: what was kept cannot be read (%s); starting afresh", path, error)
            return None
        if not isinstance(found, dict):
            return None
        if not intact(found):
            log.warning("%s: has not the digest of what was written; starting afresh", path)
            return None
        return {key: value for key, value in found.items() if key != "digest"}

    def keep(self, service: str, snapshot: dict[str, Any]) -> None:
        """Write a snapshot soon, unless it is what was written last."""
        plain = msgspec.json.decode(msgspec.json.encode(snapshot))
        content = msgspec.json.format(msgspec.json.encode(sealed(plain))).decode()
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
            try:
                write_atomic(self._folder / f"{item[0]}.json", item[1])
            except UsageError as error:
                self._last.pop(item[0], None)  # The same again is tried again.
                log.warning("what %s has learnt is not kept: %s", item[0], error)


class DeviceKeeper(Keeper):
    """Keeps what devices know (a zero), for the next process of the same kind since the same boot.

    Args:
        folder: where the files are; virtual: of virtual devices, apart from those of real ones.
    """

    def __init__(self, folder: Path, *, virtual: bool, boot_id: Path = BOOT_ID) -> None:
        super().__init__(folder)
        self._suffix = "-virtual" if virtual else ""
        self._known: set[str] = set()
        try:
            self._boot = boot_id.read_text(encoding="ascii").strip()
        except (OSError, ValueError):
            self._boot = ""  # Nothing can be known to be of this boot then.

    def give_back(self, name: str, device: Device[Any]) -> None:
        """Hand a device what was kept of it, with what speaks against using it."""
        found = self.read(name + self._suffix) or {}
        state = found.get("state")
        if not isinstance(state, dict) or not state:
            return
        obstacle = ""
        if found.get("version") != VERSION:
            obstacle = "another version has kept it"
        elif not self._boot or found.get("boot") != self._boot:
            obstacle = "the computer was started again since"
        self._known.add(name)
        device.restore(state, obstacle)

    def keep_device(self, name: str, device: Device[Any], tool: str, now_ns: int) -> None:
        """Write down what a device knows now; `tool`: in hand."""
        state = device.snapshot(now_ns)
        if state:
            self._known.add(name)
            state = state | {"tool": state.get("tool") or tool}
        if name in self._known:
            self.keep(name + self._suffix, {"version": VERSION, "boot": self._boot, "state": state})

"""Where things live: sockets in the runtime directory, tools in the state directory, settings in a file."""

import os
import socket
import stat
import tempfile
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from galen_hw.errors import HardwareError, UsageError
from galen_hw.permission import require_permission

SERVICE_RUNTIME: Final = Path("/run/galen-hw")
SITE_CONFIG: Final = Path("/etc/galen-hw/galen.toml")
DEFAULT_CONFIG: Final = Path(__file__).with_name("galen.toml")
VIEWERS_ADDRESS: Final = "tcp://127.0.0.1:9872"
ANSWER_S: Final = 1.0
"""Longest wait for a socket of this machine to take a connection."""
LONGEST_SOCKET_PATH: Final = 107
"""Bytes of a Unix socket's path that the kernel takes (sun_path less its final zero)."""


@dataclass(frozen=True, slots=True)
class Addresses:
    """ZeroMQ addresses of one daemon, all in its runtime directory.

    Args:
        runtime: the directory.
    """

    runtime: Path

    @property
    def bus(self) -> str:
        """Everything published (connect a SUB)."""
        return f"ipc://{self.runtime / 'bus.pub'}"

    @property
    def batches(self) -> str:
        """The same in batches, for who only looks (see `galen_hw.bus.Batcher`)."""
        return f"ipc://{self.runtime / 'batches'}"

    @property
    def command(self) -> str:
        """Requests (connect a REQ or DEALER)."""
        return f"ipc://{self.runtime / 'command'}"

    @property
    def inward(self) -> str:
        """Between the daemon's own processes: publications on their way to the bus."""
        return f"ipc://{self.runtime / 'inward'}"

    @property
    def control(self) -> str:
        """Between the daemon's own processes: requests, replies and heartbeats."""
        return f"ipc://{self.runtime / 'control'}"

    @property
    def virtual(self) -> Path:
        """Directory of the virtual robot's wires."""
        return self.runtime / "virtual"

    @property
    def lock(self) -> Path:
        """File that one daemon locks."""
        return self.runtime / "lock"

    def remove_sockets(self) -> None:
        """Take away what is left of a daemon that has ended; only for whom holds the lock."""
        for address in (self.bus, self.batches, self.command, self.inward, self.control):
            Path(address.removeprefix("ipc://")).unlink(missing_ok=True)

    def require_daemon(self) -> None:
        """Return if somebody listens at the daemon's command socket: a daemon that was killed leaves the file alone.

        Raises:
            HardwareError: nobody does: no daemon runs, or it uses another directory.
            UsageError: this user may not connect to it.
        """
        require_permission(self.runtime / "command")
        with socket.socket(socket.AF_UNIX) as probe, suppress(OSError):  # what else is wrong, the client will meet
            probe.settimeout(ANSWER_S)
            try:
                probe.connect(str(self.runtime / "command"))
            except (FileNotFoundError, ConnectionRefusedError):
                todo = "start one with galen-hw run (or galen-hw run --virtual), or give its directory"
                raise HardwareError("no daemon runs here", where=str(self.runtime), todo=todo) from None


def runtime_dir(environ: Mapping[str, str] = os.environ) -> Path:
    """Directory of the sockets of a daemon started here; not created.

    In order: `GALEN_HW_RUNTIME`, `RUNTIME_DIRECTORY` (systemd), `$XDG_RUNTIME_DIR/galen-hw`, a directory of the user's
    below the temporary one.
    """
    if own := environ.get("GALEN_HW_RUNTIME") or environ.get("RUNTIME_DIRECTORY", "").split(":")[0]:
        return Path(own)
    if xdg := environ.get("XDG_RUNTIME_DIR"):
        return Path(xdg) / "galen-hw"
    return Path(tempfile.gettempdir()) / f"galen-hw-{os.getuid()}"


def client_runtime_dir(environ: Mapping[str, str] = os.environ) -> Path:
    """Directory where a client looks for a daemon: the user's own if one has been started there, else the service's."""
    own = runtime_dir(environ)
    if (
        environ.get("GALEN_HW_RUNTIME")
        or _may_be_there(own / "command")
        or not _may_be_there(SERVICE_RUNTIME / "command")
    ):
        return own
    return SERVICE_RUNTIME


def _may_be_there(path: Path) -> bool:
    """Return whether a file is there, or may be where this user may not look."""
    try:
        return path.exists()
    except PermissionError:
        return True


def state_dir(environ: Mapping[str, str] = os.environ) -> Path:
    """Directory of tools, calibrations and what services keep; not created.

    In order: `GALEN_HW_STATE`, `STATE_DIRECTORY` (systemd), `$XDG_STATE_HOME/galen-hw`, `~/.local/state/galen-hw`.
    """
    if own := environ.get("GALEN_HW_STATE") or environ.get("STATE_DIRECTORY", "").split(":")[0]:
        return Path(own)
    xdg = environ.get("XDG_STATE_HOME")
    return (Path(xdg) if xdg else Path.home() / ".local" / "state") / "galen-hw"


def config_path(given: str | None, environ: Mapping[str, str] = os.environ) -> Path:
    """The file of settings: the one given, `GALEN_HW_CONFIG`, the site's in /etc, or the default one."""
    if named := given or environ.get("GALEN_HW_CONFIG"):
        return Path(named)
    return SITE_CONFIG if SITE_CONFIG.exists() else DEFAULT_CONFIG


def make_runtime(path: Path) -> Addresses:
    """Create the runtime directory, for its owner only; one that is there already stays open to its group.

    Raises:
        UsageError: it cannot be made, belongs to someone else, is open to others, or is too deep for a socket.
    """
    try:
        path.mkdir(mode=0o700, parents=True, exist_ok=True)
        found = path.stat()
    except OSError as error:
        raise UsageError(
            error.strerror or "cannot be made", where=str(path), todo="give another one with --dir"
        ) from None
    if found.st_uid != os.getuid():
        raise UsageError(
            "runtime directory belongs to another user", where=str(path), todo="give another one with --dir"
        )
    if found.st_mode & (stat.S_IWGRP | stat.S_IWOTH):
        raise UsageError("runtime directory is writable by others", where=str(path), todo=f"chmod 750 {path}")
    if len(os.fsencode(path / "bus.pub")) > LONGEST_SOCKET_PATH:
        raise UsageError(
            "runtime directory's path is too long for a socket", where=str(path), todo="give a shorter one"
        )
    return Addresses(path)


def require_folder(path: Path, option: str) -> None:
    """Refuse a path where no folder can be made because a file stands there, or above; `option` names it in the error.

    Raises:
        UsageError: the file by its name.
    """
    there = next((p for p in (path, *path.parents) if p.exists()), None)
    if there is not None and not there.is_dir():
        raise UsageError("is a file, not a folder", where=f"{option} {there}", todo="give another folder")

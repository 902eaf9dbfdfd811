"""One daemon a runtime directory."""

import fcntl
import os

from galen_hw.config.paths import Addresses
from galen_hw.errors import UsageError


def lock(addresses: Addresses) -> int:
    """The descriptor that holds the runtime directory's lock; the kernel frees it however the daemon ends.

    Raises:
        UsageError: another daemon holds it.
    """
    fd = os.open(addresses.lock, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o640)
    try:
        fcntl.flock(fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        pid = os.read(fd, 32).decode(errors="replace").strip()
        os.close(fd)
        todo = "stop it first, or give another runtime directory with --dir"
        raise UsageError(
            f"a daemon runs here already (process {pid})", where=str(addresses.runtime), todo=todo
        ) from None
    os.truncate(fd, 0)
    os.write(fd, f"{os.getpid()}\n".encode())
    return fd

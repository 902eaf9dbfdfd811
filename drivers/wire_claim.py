"""Who uses a wire of this machine: one claim each, so that nobody takes a wire that another process works with.

A claim is a name in the kernel's abstract socket space: no file, no folder, no rights to set up; it is seen by every
user of the machine (of its network name space) and ends with the process that holds it, however that ends. Serial
ports belong to one process at a time. A CAN interface may have several; whoever wants it alone (`galen-hw check`)
leaves it to those who are there.
"""

import contextlib
import fcntl
import hashlib
import itertools
import os
import socket
import stat
import termios
from pathlib import Path
from typing import Final, Self

from galen_hw.errors import HardwareError

_PREFIX: Final = "galen-hw/wire/"
_LONGEST: Final = 60
_LONGEST_WORDS: Final = 80
_numbers = itertools.count()


class Claim:
    """A wire claimed by this process until `close`.

    Args:
        key: of the wire, see `port_key`; processes that mean the same wire have the same one.
        shared: others may have it too.
        alone: refuse it when anybody has it, though it may be shared.
        where: the wire, for error messages.

    Raises:
        HardwareError: it is in use; by which process.
    """

    def __init__(self, key: str, where: str, *, shared: bool = False, alone: bool = False) -> None:
        self._sockets: list[socket.socket] = []
        if (alone or not shared) and (busy := users(key)):
            raise _in_use(where, busy)
        try:
            if not shared:
                self._bind(_name(key))
            self._bind(f"{_name(key)}#{os.getpid()}.{next(_numbers)}")
        except OSError as error:
            self.close()
            raise _in_use(where, users(key)) from error

    def _bind(self, name: str) -> None:
        one = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self._sockets.append(one)
        one.bind("\0" + name)

    def close(self) -> None:
        """Give the wire back; twice is fine."""
        while self._sockets:
            self._sockets.pop().close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def users(key: str) -> list[int]:
    """The processes that have a wire."""
    start = f"@{_name(key)}#"
    try:
        lines = Path("/proc/net/unix").read_text(errors="replace").splitlines()
    except OSError:
        return []
    names = [line.rsplit(" ", 1)[-1] for line in lines if start in line]
    found = {name.removeprefix(start).partition(".")[0] for name in names if name.startswith(start)}
    return sorted(int(pid) for pid in found if pid.isdecimal())


def port_key(path: str) -> str:
    """The key of a serial port, the same for every name of the device."""
    found = os.stat(path)  # noqa: PTH116 - the device behind all links
    if stat.S_ISCHR(found.st_mode):
        return f"tty:{os.major(found.st_rdev)}:{os.minor(found.st_rdev)}"
    return f"path:{os.path.realpath(path)}"


def is_pseudo_terminal(path: str) -> bool:
    """Return whether a port leads to a program of this machine and not to a device."""
    return os.path.realpath(path).startswith("/dev/pts/")


def keep_others_out(fd: int, path: str) -> None:
    """Let the kernel refuse the port to others while it is open (TIOCEXCL), those that know no claims and no locks.

    Not on a pseudo terminal: its mark would outlive us, for its far end keeps it open.
    """
    if not is_pseudo_terminal(path):
        with contextlib.suppress(OSError):
            fcntl.ioctl(fd, termios.TIOCEXCL)


def _name(key: str) -> str:
    digest = hashlib.sha256(key.encode()).hexdigest()[:16] if len(key) > _LONGEST or not key.isprintable() else ""
    return _PREFIX + (key[: _LONGEST - 17].replace(" ", "_") + ":" + digest if digest else key.replace(" ", "_"))


def _in_use(where: str, pids: list[int]) -> HardwareError:
    who = ", ".join(f"process {pid}{_words(pid)}" for pid in pids) or "another process"
    return HardwareError(f"in use by {who}", where=where, todo="it is left alone; end that process first")


def _words(pid: int) -> str:
    try:
        text = Path(f"/proc/{pid}/cmdline").read_bytes().decode("utf-8", "replace")
    except OSError:
        return ""
    words = "".join(char if char.isprintable() else " " for char in text).strip()
    return f" ({words[:_LONGEST_WORDS]})" if words else ""

"""Serial lines without hardware: a pseudo-terminal whose far end hangs in a folder under a fixed name."""

import errno
import os
import termios
import tty
from pathlib import Path

_SPEEDS = {getattr(termios, f"B{rate}"): rate for rate in (9600, 19200, 38400, 57600, 115200, 230400, 921600)}


class Pty:
    """The master side, non-blocking. The slave is kept open too, so that clients may come and go (no EIO).

    Args:
        link: where a symbolic link to the slave is put; one that is there already is replaced.
    """

    def __init__(self, link: Path) -> None:
        self.link = link
        self._master, self._slave = os.openpty()
        tty.setraw(self._slave)
        os.set_blocking(self._master, False)
        self.device = os.ttyname(self._slave)
        link.unlink(missing_ok=True)
        link.symlink_to(self.device)
        self._backlog = b""
        self.counters = {"bytes_in": 0, "bytes_out": 0, "overrun_bytes": 0}

    def fileno(self) -> int:
        """The master's descriptor, for select."""
        return self._master

    @property
    def baud_rate(self) -> int:
        """What the client has set, 0 for an unusual one; a pty itself knows no speed."""
        return _SPEEDS.get(termios.tcgetattr(self._master)[5], 0)

    def read(self) -> bytes:
        """What has arrived, empty if nothing."""
        try:
            data = os.read(self._master, 65536)
        except OSError as error:
            if error.errno in {errno.EAGAIN, errno.EIO}:  # EIO: nobody holds the far end.
                return b""
            raise
        self.counters["bytes_in"] += len(data)
        return data

    def write(self, data: bytes) -> None:
        """Write; when nobody reads, what does not fit is lost in whole pieces, as on a real line."""
        if self._backlog:
            self._backlog = self._backlog[self._put(self._backlog) :]
            if self._backlog:
                self.counters["overrun_bytes"] += len(data)
                return
        self._backlog = data[self._put(data) :]

    def close(self) -> None:
        """Close both ends and take the link away, if it is still ours."""
        if self.link.is_symlink() and self.link.readlink() == Path(self.device):
            self.link.unlink()
        os.close(self._master)
        os.close(self._slave)

    def _put(self, data: bytes) -> int:
        try:
            count = os.write(self._master, data)
        except OSError as error:
            if error.errno in {errno.EAGAIN, errno.EIO}:
                return 0
            raise
        self.counters["bytes_out"] += count
        return count

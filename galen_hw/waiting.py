"""Waits until one of several descriptors can be read, however many descriptors the process has."""

import select
from collections.abc import Sequence


def readable(fds: Sequence[int], timeout_s: float) -> list[int]:
    """Those of `fds` that can be read (or have failed, which a read will tell), after at most `timeout_s`.

    `select` and not `poll` where it can be: its time-outs are not whole milliseconds, and a polled sensor is asked every
    333 us. But it takes no descriptor above 1023, and a process in which clients have opened that many must go on.
    """
    try:
        return select.select(fds, (), (), timeout_s)[0]
    except ValueError:
        poll = select.poll()
        for fd in fds:
            poll.register(fd, select.POLLIN)
        return [fd for fd, _ in poll.poll(1e3 * timeout_s)]

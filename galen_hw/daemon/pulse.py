"""Signs of life of the processes in memory that all of them share: seen at once, by whoever cares, without a socket.

One 8-byte word a sign, written by one process only, in monotonic nanoseconds. A process that is stopped, stuck or dead
leaves its words as they are, which is what the others look at.
"""

import mmap
import os
from typing import Final

WORDS: Final = 64
LOOP: Final = 0
"""Sign of a process: its loop has turned."""
WRENCH: Final = 1
"""Sign of a process: a raw wrench has been published."""
_SIGNS: Final = 2


class PulseBoard:
    """The signs of all processes, in the order of `names`.

    Args:
        fd: of the memory, from `make`; it is closed here, the mapping stays.
        names: of the processes, the same everywhere.
    """

    def __init__(self, fd: int, names: tuple[str, ...]) -> None:
        self._memory = mmap.mmap(fd, 8 * WORDS)
        self._words = memoryview(self._memory).cast("q")
        self._index = {name: _SIGNS * i for i, name in enumerate(names)}

    @staticmethod
    def make() -> int:
        """Memory that child processes inherit; its descriptor."""
        fd = os.memfd_create("galen-hw-pulse", 0)
        os.ftruncate(fd, 8 * WORDS)
        return fd

    def beat(self, name: str, sign: int, now_ns: int) -> None:
        """Write a sign of one's own process."""
        self._words[self._index[name] + sign] = now_ns

    def seen_ns(self, name: str, sign: int) -> int:
        """When a process gave a sign last; 0 for never, or since it was started again."""
        return self._words[self._index[name] + sign]

    def forget(self, name: str) -> None:
        """A process is started again: what it did before counts no more."""
        for sign in range(_SIGNS):
            self._words[self._index[name] + sign] = 0

    def close(self) -> None:
        """Give the memory back."""
        self._words.release()
        self._memory.close()

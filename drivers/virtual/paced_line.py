"""A serial line that takes its time: each byte is there when its last bit is."""

from collections import deque
from typing import Final

from galen_hw.clock import NS_PER_S

_BITS_PER_BYTE: Final = 10  # 8N1: start, eight, stop
_CHUNK_NS: Final = 2_000_000


class PacedLine:
    """One direction of a serial line.

    Args:
        baud_rate: bits/s; 0 lets everything through at once, as a socket does.
    """

    def __init__(self, baud_rate: int) -> None:
        self._queue: deque[tuple[int, int]] = deque()
        self._free_ns = 0
        self.set_baud_rate(baud_rate)

    def set_baud_rate(self, baud_rate: int) -> None:
        """Change the speed of what is put from now on."""
        self._byte_ns = _BITS_PER_BYTE * NS_PER_S // baud_rate if baud_rate else 0

    def put(self, data: bytes, t_ns: int) -> None:
        """Send `data` from `t_ns` on, after what is still under way."""
        at = max(t_ns, self._free_ns)
        for byte in data:
            at += self._byte_ns
            self._queue.append((at, byte))
        self._free_ns = at

    def pop(self, now_ns: int) -> tuple[int, int] | None:
        """The next byte that has arrived by `now_ns`, with its time; None when there is none."""
        if self._queue and self._queue[0][0] <= now_ns:
            return self._queue.popleft()
        return None

    def take(self, now_ns: int) -> bytes:
        """All bytes that have arrived by `now_ns`."""
        out = bytearray()
        while (item := self.pop(now_ns)) is not None:
            out.append(item[1])
        return bytes(out)

    def clear(self) -> None:
        """Lose what is under way."""
        self._queue.clear()
        self._free_ns = 0

    def next_ns(self, now_ns: int) -> int | None:
        """When it pays to look again: when the queue is through, at most 2 ms from now; None while it is empty."""
        if not self._queue:
            return None
        return max(self._queue[0][0], min(self._queue[-1][0], now_ns + _CHUNK_NS))

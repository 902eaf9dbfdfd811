"""Pair the frames of a stream whose samples come as two CAN frames each, where the protocol numbers nothing.

A sample is believed only if everything about it fits: the second frame follows the first at once (no other frame of the
stream between, within `window_ns`), both have one length, and the reader has kept up. After a silence of `stall_ns` frames
may have been dropped on the way and the rest has lost its times: pairs are counted as late until one comes at its own pace
again. What remains is a loss of exactly a second frame and the next first one within the window, which is at most half a
period: not possible as long as the frames' times are told apart.
"""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class PairLayout:
    """Describe the two frames of a sample.

    Args:
        first_id, second_id: their CAN identifiers, 11 bits.
        lengths: that they may have, bytes; both of a sample have the same one.
        head: how the data of a first frame begin.
    """

    first_id: int
    second_id: int
    lengths: tuple[int, ...]
    head: bytes = b""


@dataclass(slots=True)
class Pairer:
    """Pair the frames of one stream.

    Args:
        layout: of its samples.
        period_ns: from sample to sample, ns.
        window_ns: from first to second frame at most, ns.
        stall_ns: after a silence this long what had piled up is late, ns; see above.
        counters: of the device; counts lost, late, doubled, short, in frames (lost: in samples).
    """

    layout: PairLayout
    period_ns: int
    window_ns: int
    stall_ns: int
    counters: dict[str, int]
    _first: bytes = b""
    _first_ns: int = 0
    _last: bytes = b""
    _last_second: bytes = b""
    _last_ns: int = 0
    _began: bool = False
    _behind: bool = False

    def first(self, data: bytes, t_ns: int) -> None:
        """Take a first frame that was read at `t_ns`, ns."""
        self._pace(t_ns)
        if len(data) not in self.layout.lengths:
            self.counters["short"] += 1
            self._drop()
        elif not data.startswith(self.layout.head):
            self.counters["late"] += 1  # a response nobody waits for; its second half must not be ours
            self._drop()
        elif self._first == data and t_ns - self._first_ns <= self.window_ns:
            self.counters["doubled"] += 1
        else:
            self._drop()
            self._first, self._first_ns = data, t_ns

    def second(self, data: bytes, t_ns: int) -> bytes | None:
        """Take a second frame that was read at `t_ns`, ns; return the bytes of both if they are certain to be one sample."""
        self._pace(t_ns)
        first, self._first = self._first, b""
        if len(data) not in self.layout.lengths:
            self.counters["short"] += 1
            self.counters["lost"] += bool(first)
            return None
        if not first:
            self._alone(data, t_ns)
            return None
        if len(first) != len(data) or not 0 <= t_ns - self._first_ns <= self.window_ns:
            self.counters["lost"] += 1
            return None
        return self._whole(first, data, t_ns)

    def _whole(self, first: bytes, second: bytes, t_ns: int) -> bytes | None:
        """Return the bytes of both unless they came before, or had piled up."""
        response = first + second
        pace_ns = t_ns - self._last_ns
        if self._began and response == self._last and pace_ns < self.period_ns * 3 // 4:
            self.counters["doubled"] += 2
            return None
        if self._behind and pace_ns < self.period_ns // 2:
            self.counters["late"] += 2
            self._last, self._last_second, self._last_ns = response, second, t_ns
            return None
        self._last, self._last_second, self._last_ns = response, second, t_ns
        self._began, self._behind = True, False
        return response

    def _alone(self, data: bytes, t_ns: int) -> None:
        """Count a second frame without its first."""
        if self._began and data == self._last_second and t_ns - self._last_ns <= self.window_ns:
            self.counters["doubled"] += 1
        else:
            self.counters["lost"] += 1

    def _drop(self) -> None:
        """Count a first frame without its second."""
        if self._first:
            self.counters["lost"] += 1
            self._first = b""

    def _pace(self, t_ns: int) -> None:
        """Notice that nothing was read for long: what comes next had piled up."""
        newest_ns = max(self._last_ns, self._first_ns)
        if self._began and not self._behind and t_ns - newest_ns > self.stall_ns + self.period_ns:
            self._behind = True
            self._last_ns = t_ns
            self._drop()

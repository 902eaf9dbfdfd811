"""A thousand wrenches a second made fifty: means over 20 ms, the newest `KEPT` of them."""

from collections import deque
from itertools import islice
from typing import Final

from galen_hw.messages import WrenchCompensated, WrenchRaw

BIN_NS: Final = 20_000_000
KEPT: Final = 1500
"""Half a minute: what a page that is opened now sees of the time before."""
SIX: Final = range(6)


class Bins:
    """Means of raw and compensated wrenches. A row: time (monotonic s), raw (6), compensated (6), share that was valid."""

    def __init__(self) -> None:
        self.count = 0
        """Rows so far, those that are forgotten included."""
        self._rows: deque[list[float]] = deque(maxlen=KEPT)
        self._bin = 0
        self._clear()

    def add(self, message: WrenchRaw | WrenchCompensated) -> None:
        """Take a wrench."""
        index = message.t_ns // BIN_NS
        if index != self._bin:
            self._close()
            self._bin = index
        f, t = message.force, message.torque
        kind = int(type(message) is WrenchCompensated)
        sums = self._sums[kind]
        for i, value in enumerate((f.x, f.y, f.z, t.x, t.y, t.z)):
            sums[i] += value
        self._counts[kind] += 1
        if kind:
            self._valid += message.valid

    def since(self, count: int) -> list[list[float]]:
        """The rows after the first `count`, as far as they are kept."""
        first = max(0, len(self._rows) - (self.count - count))
        return list(islice(self._rows, first, None))

    def _clear(self) -> None:
        self._sums = ([0.0] * 6, [0.0] * 6)
        self._counts, self._valid = [0, 0], 0

    def _close(self) -> None:
        if any(self._counts):
            means = [
                self._sums[kind][i] / self._counts[kind] if self._counts[kind] else float("nan")
                for kind in (0, 1)
                for i in SIX
            ]
            valid = self._valid / self._counts[1] if self._counts[1] else 0.0
            self._rows.append([self._bin * BIN_NS / 1e9, *(round(x, 5) for x in means), round(valid, 3)])
            self.count += 1
        self._clear()

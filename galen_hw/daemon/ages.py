"""How old messages are when they are published: a histogram that costs a fraction of a microsecond a message."""

from typing import Final

from galen_hw.clock import NS_PER_S

_FINE_BITS: Final = 3
_FINE: Final = 1 << _FINE_BITS
"""Steps an octave: a percentile is at most an eighth too high."""
_CELLS: Final = 64 * _FINE
_MOST: Final = (1 << 63) - 1


class Ages:
    """Counts ages since the last `take`."""

    __slots__ = ("_cells", "_worst")

    def __init__(self) -> None:
        self._cells = [0] * _CELLS
        self._worst = 0

    def add(self, age_ns: int) -> None:
        """Count one; what is negative or beyond 2^63 ns counts as the nearest that is not."""
        age = age_ns if _FINE <= age_ns <= _MOST else _FINE if age_ns < _FINE else _MOST
        octave = age.bit_length() - 1 - _FINE_BITS
        self._cells[(octave << _FINE_BITS) + (age >> octave) - _FINE] += 1
        self._worst = max(self._worst, age)

    def take(self) -> tuple[float, float, float] | None:
        """Median, 99th percentile and worst since the last call, s; None where nothing was counted."""
        total = sum(self._cells)
        if not total:
            return None
        found = (self._share(0.5, total), self._share(0.99, total), self._worst / NS_PER_S)
        self.__init__()  # type: ignore[misc]
        return found

    def _share(self, share: float, total: int) -> float:
        """The upper edge of the cell below which this share lies, s."""
        left = share * total
        for index, count in enumerate(self._cells):
            left -= count
            if left <= 0:
                octave, step = divmod(index, _FINE)
                return min(self._worst, (step + _FINE + 1) << octave) / NS_PER_S
        return self._worst / NS_PER_S

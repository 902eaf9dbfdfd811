"""A tare: the average of what is left over, taken off from then on."""

from dataclasses import dataclass, field

from galen_hw.services.compensation.model import Six


@dataclass(slots=True)
class Tare:
    """An average that is being taken.

    Args:
        request_id: to answer when it is done.
        samples: how many to average.
        until_ns: time-out on the shell's clock; set at the first tick.
    """

    request_id: str
    samples: int
    until_ns: int
    count: int = 0
    _sums: list[float] = field(default_factory=lambda: [0.0] * 6)
    _squares: list[float] = field(default_factory=lambda: [0.0] * 6)

    def feed(self, left: Six) -> bool:
        """Add one sample of raw minus predicted; True when there are enough."""
        for i, value in enumerate(left):
            self._sums[i] += value
            self._squares[i] += value * value
        self.count += 1
        return self.count >= self.samples

    @property
    def mean(self) -> Six:
        """(6,) N and N m."""
        return tuple([total / self.count for total in self._sums])  # type: ignore[return-value]

    @property
    def std(self) -> Six:
        """Scatter (6,) of one sample, N and N m: large when the tool was moved or touched."""
        pairs = zip(self._squares, self.mean, strict=True)
        return tuple([max(0.0, s / self.count - m * m) ** 0.5 for s, m in pairs])

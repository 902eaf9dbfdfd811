"""A hand-made STRAIN board and a wire that can misbehave but keeps the order, for the driver's tests."""

import random
from collections import deque
from dataclasses import dataclass, field

from conformance.peer import Run

from galen_hw.clock import TimeBase
from galen_hw.drivers.device import CanFrame
from galen_hw.drivers.iit_strain import IitStrain
from galen_hw.drivers.iit_strain.codec import encode_vector

MS = 1_000_000
FULL_SCALES = (1500, 1500, 2000, 35, 35, 25)


@dataclass
class Board:
    """Streams the number of the sample on every axis, or `counts`; obeys while it streams, as the board does."""

    address: int = 1
    board: int = 12
    serial_number: bytes = b"SN042"
    full_scales: tuple[int, ...] = FULL_SCALES
    counts: tuple[int, ...] | None = None
    limits: tuple[int, int] = (0, 0)
    deaf: bool = False
    rates: dict[str, float] = field(default_factory=dict)
    rng: random.Random = field(default_factory=lambda: random.Random(1))
    number: int = 0
    period_ms: int = 10
    streaming: bool = False
    seen: list[CanFrame] = field(default_factory=list)
    latency_ns: int = 200_000
    _wire: deque = field(default_factory=deque)
    _next_ns: int = 0
    _last_ns: int = 0

    def take(self, wires, now_ns):
        for wire in wires:
            self.seen.append(wire)
            if not self.deaf and wire.arbitration_id == 0x200 | self.address:
                self._obey(wire.data, now_ns)

    def _happens(self, what):
        return self.rng.random() < self.rates.get(what, 0.0)

    def _obey(self, data, now_ns):
        if data[0] == 0x07:
            self.streaming, self._next_ns = data[1] == 0, now_ns + 3 * MS
        elif data[0] == 0x08:
            self.period_ms = data[1]
        answers = {0x1A: self.serial_number.ljust(7, b"\0"), 0x1C: bytes([self.board, 2, 0, 7, 2, 0, 0])}
        if data[0] == 0x18:
            answers[0x18] = data[1:2] + self.full_scales[data[1]].to_bytes(2, "big")
        if data[0] in answers:
            self._put(CanFrame(0x200 | self.address << 4, data[:1] + answers[data[0]]), now_ns)

    def _sample(self, now_ns):
        counts = self.counts or (self.number % 30000,) * 6
        base = 0x300 | self.address << 4
        frames = [CanFrame(base | 0xA, encode_vector(counts[:3], self.limits[0]))]
        frames.append(CanFrame(base | 0xB, encode_vector(counts[3:], self.limits[1])))
        for frame in frames * 2 if self._happens("double_pair") else frames:
            if self._happens("foreign"):
                self._put(CanFrame(0x123, self.rng.randbytes(8)), now_ns, 0)
            for _ in range(0 if self._happens("drop") else 2 if self._happens("double") else 1):
                short = self._happens("short")
                self._put(CanFrame(frame.arbitration_id, frame.data[:-1] if short else frame.data), now_ns)

    def _put(self, frame, now_ns, gap_ns=110_000):
        self._last_ns = max(self._last_ns + gap_ns, now_ns + self.latency_ns)
        self._wire.append((self._last_ns, frame))

    def give(self, now_ns):
        while self.streaming and self._next_ns <= now_ns:
            self.number += 1
            self._sample(self._next_ns)
            self._next_ns += self.period_ms * MS
        due = []
        while self._wire and self._wire[0][0] <= now_ns:
            due.append(self._wire.popleft()[1])
        return due

    @property
    def due_ns(self):
        due_ns = self._wire[0][0] if self._wire else 1 << 62
        return min(due_ns, self._next_ns) if self.streaming else due_ns


def run_of(board=None, **settings):
    """A started device against a board."""
    return Run(IitStrain("ft", IitStrain.Settings(**settings), TimeBase()), board or Board()).start()

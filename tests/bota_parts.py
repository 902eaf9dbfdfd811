"""A hand-made peer of a Bota sensor's device: what its process would say, and what may befall it on the way."""

import random
from dataclasses import dataclass, field

import numpy as np
from conformance.peer import Run

from galen_hw.clock import NS_PER_S, TimeBase
from galen_hw.drivers.bota.codec import Frame, Sensor, encode
from galen_hw.drivers.bota.device import Bota

SENSOR = Sensor("BFT-ROKS-SER-M8", "SN000853", "1.2.3", 1000)


def rounded(stamp_us: int) -> int:
    """A stamp as the package hands it over: 32 bits of microseconds, through a float32."""
    return int(np.float32(stamp_us % (1 << 32)))


@dataclass
class Process:
    """Answers and streams; a sample's number is its force along x, its time of measurement is in `measured_ns`.

    Args:
        sensor: who answers; status: of every frame from now on.
        begin_us: of the stamp's clock; silent: nothing is said at all.
        lose, double: shares of the frames; stall: share of the frames at which the reader stands still for 5 to 60 ms.
    """

    sensor: Sensor = SENSOR
    status: int = 0
    begin_us: int = 5_000_000
    silent: bool = False
    lose: float = 0.0
    double: float = 0.0
    stall: float = 0.0
    seed: int = 0
    measured_ns: dict[int, int] = field(default_factory=dict)
    lost: int = 0
    heard: list[bytes] = field(default_factory=list)
    _line: list[tuple[int, bytes]] = field(default_factory=list)
    _next_ns: int = 0
    _blocked_ns: int = 0
    _number: int = 0

    def __post_init__(self) -> None:
        self._rng = random.Random(self.seed)

    @property
    def period_ns(self) -> int:
        return self.sensor.period_us * 1000

    def take(self, wires: list[bytes], now_ns: int) -> None:
        for wire in wires:
            self.heard.append(wire)
            if wire == b"identify\n" and not self.silent:
                self._line.append((now_ns, encode(self.sensor)))
            elif wire == b"start\n":
                self._next_ns = now_ns + self.period_ns
            elif wire == b"stop\n":
                self._next_ns, self._line = 0, []

    def frame(self, number: int, t_ns: int) -> bytes:
        stamp = rounded(self.begin_us + t_ns // 1000)
        return encode(Frame(stamp, self.status, (float(number), 2.0, 3.0), (0.1, 0.2, 0.3), 25.0))

    def give(self, now_ns: int) -> list[bytes]:
        while self._next_ns and self._next_ns <= now_ns and not self.silent:
            self._measure(self._next_ns)
            self._next_ns += self.period_ns
        due = [wire for t_ns, wire in self._line if t_ns <= now_ns]
        self._line = [(t_ns, wire) for t_ns, wire in self._line if t_ns > now_ns]
        return due

    def _measure(self, t_ns: int) -> None:
        self._number += 1
        number, rng = self._number, self._rng
        self.measured_ns[number] = t_ns
        if rng.random() < self.lose:
            self.lost += 1
            return
        if rng.random() < self.stall:
            self._blocked_ns = max(self._blocked_ns, t_ns + round(rng.uniform(0.005, 0.06) * NS_PER_S))
        read_ns = max(t_ns + rng.randrange(self.period_ns // 10), self._blocked_ns)
        self._line += [(read_ns, self.frame(number, t_ns))] * (2 if rng.random() < self.double else 1)

    @property
    def due_ns(self) -> int:
        waiting = [t_ns for t_ns, _ in self._line]
        return min([*waiting, *([self._next_ns] if self._next_ns and not self.silent else [])], default=1 << 62)


def run_of(process: Process, **settings) -> Run:
    device = Bota("ft", Bota.Settings(**{"rate_hz": 1e6 / process.sensor.period_us} | settings), TimeBase())
    return Run(device, process).start()


def wrenches(run: Run) -> list:
    return run.messages("wrench/raw")

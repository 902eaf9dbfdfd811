"""A wire that can misbehave but keeps the order, and what hand-made sensors of two frames a sample share, for drivers' tests."""

import random
from collections import deque
from dataclasses import dataclass, field

from galen_hw.drivers.device import CanFrame
from galen_hw.messages import Request

MS = 1_000_000


@dataclass
class PairedPeer:
    """Streams the number of the sample on every axis; a subclass has `_obey`, `_sample`, `command_id` and `period_ns`.

    Args:
        deaf: obeys nothing.
        rates: probability of "drop", "double" (a frame), "double_pair", "short", "foreign" for each frame, "deaf" a command.
    """

    deaf: bool = False
    rates: dict[str, float] = field(default_factory=dict)
    rng: random.Random = field(default_factory=lambda: random.Random(1))
    number: int = 0
    streaming: bool = False
    seen: list[CanFrame] = field(default_factory=list)
    latency_ns: int = 200_000
    _wire: deque = field(default_factory=deque)
    _next_ns: int = 0
    _last_ns: int = 0

    def take(self, wires, now_ns):
        for wire in wires:
            self.seen.append(wire)
            if not self.deaf and wire.arbitration_id == self.command_id and not self._happens("deaf"):
                self._obey(wire.data, now_ns)

    def give(self, now_ns):
        while self.streaming and self._next_ns <= now_ns:
            self.number += 1
            self._put_pair(self._sample(), self._next_ns)
            self._next_ns += self.period_ns
        due = []
        while self._wire and self._wire[0][0] <= now_ns:
            due.append(self._wire.popleft()[1])
        return due

    @property
    def due_ns(self):
        due_ns = self._wire[0][0] if self._wire else 1 << 62
        return min(due_ns, self._next_ns) if self.streaming else due_ns

    def _happens(self, what):
        return self.rng.random() < self.rates.get(what, 0.0)

    def _begin(self, now_ns):
        self.streaming, self._next_ns = True, now_ns + 3 * MS

    def _put_pair(self, frames, now_ns):
        for frame in frames * 2 if self._happens("double_pair") else frames:
            if self._happens("foreign"):
                self._put(CanFrame(0x123, self.rng.randbytes(8)), now_ns, 0)
            for _ in range(0 if self._happens("drop") else 2 if self._happens("double") else 1):
                short = self._happens("short")
                self._put(CanFrame(frame.arbitration_id, frame.data[:-1] if short else frame.data), now_ns)

    def _put(self, frame, now_ns, gap_ns=110_000):
        self._last_ns = max(self._last_ns + gap_ns, now_ns + self.latency_ns)
        self._wire.append((self._last_ns, frame))


def ask(run, name, **args):
    """Make a request now; its immediate outputs are added to the run's."""
    outputs = run.device.request(Request(id=name, target="ft", name=name, args=args), run.now_ns)
    run.outputs += outputs
    return outputs


def wrenches(run):
    return run.messages("wrench/raw")


def force(wrench):
    return (wrench.force.x, wrench.force.y, wrench.force.z, wrench.torque.x, wrench.torque.y, wrench.torque.z)

"""A hand-made NETCANOEM board and a wire that can misbehave but keeps the order, for the driver's tests."""

import random
import struct
from collections import deque
from dataclasses import dataclass, field

import numpy as np
from conformance.peer import Run

from galen_hw.clock import TimeBase
from galen_hw.drivers.ati_netcanoem import AtiNetcanoem
from galen_hw.drivers.device import CanFrame
from galen_hw.messages import Request

MS = 1_000_000


@dataclass
class Board:
    """Answers in order. Its gauges show the number of the request, or what `gauges` says.

    Args:
        rates: probability of "drop", "double" (a frame), "double_pair", "short", "foreign", "delay" for each answer's
        frames.
    """

    base_id: int = 0x20
    firmware: bytes = b"\x03\x08\x00\x0c"
    serial_number: bytes = b"FT01234\0"
    matrix: np.ndarray = field(default_factory=lambda: np.eye(6))
    counts: tuple[int, int] = (1, 1)
    units: bytes = b"\x02\x03"
    status: int = 0
    gauges: tuple[int, ...] | None = None
    slot: int = 0
    deaf: bool = False
    loops_back: bool = False
    latency_ns: int = 200_000
    rates: dict[str, float] = field(default_factory=dict)
    delay_ns: int = 300 * MS
    rng: random.Random = field(default_factory=lambda: random.Random(1))
    asked: int = 0
    seen: list[CanFrame] = field(default_factory=list)
    script: tuple = ()
    _wire: deque = field(default_factory=deque)
    _last_ns: int = 0

    def take(self, wires, now_ns):
        for wire in wires:
            self.seen.append(wire)
            if self.loops_back:
                self._put(wire, now_ns)
            if wire.arbitration_id == self.base_id << 4 and not wire.data:
                self.asked += 1
            if not self.deaf and not self._happens("drop"):
                self._answer(wire, now_ns)

    def _happens(self, what):
        return self.rng.random() < self.rates.get(what, 0.0)

    def _put(self, frame, now_ns, extra_ns=0):
        self._last_ns = max(self._last_ns, now_ns + self.latency_ns + extra_ns)  # the wire keeps the order
        self._wire.append((self._last_ns, frame))

    def _answer(self, wire, now_ns):
        delay_ns = self.rng.randrange(self.delay_ns) if self._happens("delay") else 0
        if self._happens("foreign"):
            self._put(CanFrame(self.rng.choice([0x001, 0x1FF, 0x210, 0x7FF]), self.rng.randbytes(8)), now_ns)
        frames = self.frames(wire)
        for frame in frames * 2 if self._happens("double_pair") else frames:
            for _ in range(0 if self._happens("drop") else 2 if self._happens("double") else 1):
                short = self._happens("short")
                self._put(CanFrame(frame.arbitration_id, frame.data[:-1] if short else frame.data), now_ns, delay_ns)

    def frames(self, wire):
        """What an undisturbed board answers."""
        opcode = wire.arbitration_id - (self.base_id << 4)
        texts = {
            0x5: self.serial_number,
            0x7: struct.pack(">II", *self.counts),
            0x8: self.units,
            0xF: self.firmware,
        }
        if opcode == 0 and not wire.data:
            k = self.asked % 30000
            sg = self.gauges or (k, k, k, k, k, k)
            data = [struct.pack(">H3h", self.status, sg[0], sg[2], sg[4]), struct.pack(">3h", sg[1], sg[3], sg[5])]
        elif opcode == 2 and len(wire.data) == 1:
            row = struct.pack(">6f", *self.matrix[wire.data[0]])
            data = [row[:8], row[8:16], row[16:]]
        elif opcode == 6 and len(wire.data) == 1:
            self.slot = wire.data[0]
            data = [wire.data]
        elif opcode in (7, 8) and self.firmware[:2] < b"\x03\x07":
            data = []
        else:
            data = [texts[opcode]] if opcode in texts and not wire.data else []
        return [CanFrame(wire.arbitration_id + place, chunk) for place, chunk in enumerate(data)]

    def give(self, now_ns):
        due = []
        while self._wire and self._wire[0][0] <= now_ns:
            due.append(self._wire.popleft()[1])
        return due

    @property
    def due_ns(self):
        return self._wire[0][0] if self._wire else 1 << 62


def run_of(board=None, **settings):
    """A started device against a board."""
    device = AtiNetcanoem("ft", AtiNetcanoem.Settings(**settings), TimeBase())
    return Run(device, board or Board()).start()


def ask(run, name, **args):
    """Make a request now; its immediate outputs are added to the run's."""
    outputs = run.device.request(Request(id=name, target="ft", name=name, args=args), run.now_ns)
    run.outputs += outputs
    return outputs


def wrenches(run):
    return run.messages("wrench/raw")


def force(wrench):
    return (wrench.force.x, wrench.force.y, wrench.force.z, wrench.torque.x, wrench.torque.y, wrench.torque.z)

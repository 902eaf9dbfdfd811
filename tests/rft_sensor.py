"""A hand-made Robotous RFT sensor and a wire that can misbehave but keeps the order, for the driver's tests."""

import random
from collections import deque
from dataclasses import dataclass, field

from conformance.peer import Run

from galen_hw.clock import TimeBase
from galen_hw.drivers.device import CanFrame
from galen_hw.drivers.robotous_rft import RobotousRft
from galen_hw.drivers.robotous_rft.codec import OUTPUT_RATES_HZ, encode_data
from galen_hw.messages import Request

MS = 1_000_000


@dataclass
class Sensor:
    """Streams the number of the sample on every axis, or `axes`, less its bias; obeys only 0x0C and 0x11 meanwhile."""

    model: bytes = b"RFT60-HA01"
    serial_number: bytes = b"S-0001"
    rate_code: int = 1
    filter: tuple[int, int] = (0, 0)
    overload: int = 0
    axes: tuple[int, ...] | None = None
    obeys_bias: bool = True
    deaf: bool = False
    refuses: dict[int, int] = field(default_factory=dict)
    ids: tuple[int, int, int] = (0x64, 1, 2)
    rates: dict[str, float] = field(default_factory=dict)
    rng: random.Random = field(default_factory=lambda: random.Random(1))
    number: int = 0
    streaming: bool = False
    bias: tuple[int, ...] = (0,) * 6
    seen: list[CanFrame] = field(default_factory=list)
    latency_ns: int = 200_000
    _wire: deque = field(default_factory=deque)
    _next_ns: int = 0
    _last_ns: int = 0

    def take(self, wires, now_ns):
        for wire in wires:
            self.seen.append(wire)
            if not self.deaf and wire.arbitration_id == self.ids[0] and not self._happens("deaf"):
                self._obey(wire.data, now_ns)

    def _happens(self, what):
        return self.rng.random() < self.rates.get(what, 0.0)

    def _obey(self, data, now_ns):
        number = data[0]
        if number == 0x0C:
            self.streaming = False
        elif number == 0x11:
            if self.obeys_bias:
                self.bias = self.raw() if data[1] else (0,) * 6
        elif self.streaming:
            return
        elif number == 0x0B:
            self.streaming, self._next_ns = True, now_ns + 3 * MS
        else:
            self._put_response(bytes([number]) + self._answer(number, data), now_ns)

    def _answer(self, number, data):
        if number in self.refuses:
            return bytes([0, self.refuses[number]])
        if number == 0x0F:
            self.rate_code = data[1]
        if number == 0x08:
            self.filter = (data[1], data[2])
        texts = {1: self.model, 2: self.serial_number, 3: b"1.7", 0x10: bytes([self.rate_code])}
        return {**texts, 9: bytes(self.filter), 0x12: b"\0\0\3\0\0\0"}.get(number, b"\1\0")

    def raw(self):
        return self.axes or (self.number % 20000,) * 6

    def _put_response(self, response, now_ns):
        response = response.ljust(16, b"\0")
        self._put_frames([response[:8], response[8:]], now_ns)

    def _put_frames(self, datas, now_ns):
        frames = [CanFrame(self.ids[1], datas[0]), CanFrame(self.ids[2], datas[1])]
        for frame in frames * 2 if self._happens("double_pair") else frames:
            if self._happens("foreign"):
                self._put(CanFrame(0x123, self.rng.randbytes(8)), now_ns, 0)
            for _ in range(0 if self._happens("drop") else 2 if self._happens("double") else 1):
                short = self._happens("short")
                self._put(CanFrame(frame.arbitration_id, frame.data[:-1] if short else frame.data), now_ns)

    def _put(self, frame, now_ns, gap_ns=110_000):
        self._last_ns = max(self._last_ns + gap_ns, now_ns + self.latency_ns)
        self._wire.append((self._last_ns, frame))

    def _stream(self, now_ns):
        period_ns = 1_000_000_000 // OUTPUT_RATES_HZ[self.rate_code]
        while self.streaming and self._next_ns <= now_ns:
            self.number += 1
            axes = tuple(raw - bias for raw, bias in zip(self.raw(), self.bias, strict=True))
            self._put_frames(encode_data(axes, self.overload), self._next_ns)
            self._next_ns += period_ns

    def give(self, now_ns):
        self._stream(now_ns)
        due = []
        while self._wire and self._wire[0][0] <= now_ns:
            due.append(self._wire.popleft()[1])
        return due

    @property
    def due_ns(self):
        due_ns = self._wire[0][0] if self._wire else 1 << 62
        return min(due_ns, self._next_ns) if self.streaming else due_ns


def run_of(sensor=None, **settings):
    """A started device against a sensor."""
    return Run(RobotousRft("rft", RobotousRft.Settings(**settings), TimeBase()), sensor or Sensor()).start()


def ask(run, name, **args):
    """Make a request now; its immediate outputs are added to the run's."""
    outputs = run.device.request(Request(id=name, target="rft", name=name, args=args), run.now_ns)
    run.outputs += outputs
    return outputs


def wrenches(run):
    return run.messages("wrench/raw")


def force(wrench):
    return (wrench.force.x, wrench.force.y, wrench.force.z, wrench.torque.x, wrench.torque.y, wrench.torque.z)

"""A scripted Galil for tests: plain bytes by the manual's words, with switches for everything that goes wrong."""

import struct
from dataclasses import dataclass, field
from typing import Any

from galen_hw.clock import TimeBase
from galen_hw.drivers.galil_dmc import GalilDmc
from galen_hw.messages import Reply, Request

MS = 1_000_000
LETTERS = "ABCDE"


def record(axes: dict[str, dict[str, int]], *, general: bool = False, amplifier: int = 0) -> bytes:
    """A QR answer without its ':' for axis blocks given by field, offsets as in the manual's table."""
    out = bytearray([0x84 if general else 0x80, sum(1 << (ord(a) - 65) for a in axes), 0, 0])
    if general:
        block = bytearray(52)
        struct.pack_into("<I", block, 48, amplifier)
        out += block
    for _, values in sorted(axes.items()):
        block = bytearray(36)
        struct.pack_into("<H", block, 0, values.get("status", 0))
        block[2], block[3] = values.get("switches", 0x0C), values.get("stop_code", 1)
        for offset, name in ((4, "reference"), (8, "position"), (20, "velocity_64"), (24, "torque")):
            struct.pack_into("<i", block, offset, values.get(name, 0))
        out += block
    struct.pack_into("<H", out, 2, len(out))
    return bytes(out)


@dataclass
class GalilPeer:
    """Answers lines; moves never end by themselves."""

    axes: dict[str, dict[str, int]] = field(default_factory=lambda: {a: {"position": 0, "status": 1} for a in LETTERS})
    lines: list[str] = field(default_factory=list)
    refuse: dict[str, int] = field(default_factory=dict)
    silent: set[str] = field(default_factory=set)
    model: str = "DMC4153 Rev 1.2a"
    sizes: str = "5, 52, 26, 36"
    abort: int = 1
    amplifier: int = 0
    echo: bool = False
    dead: bool = False
    code: int = 0
    cut: int = 0

    def answer(self, wire: bytes) -> bytes:
        line = wire.decode("latin-1").rstrip("\r")
        if self.dead:
            return b""
        if line:
            self.lines.append(line)
        out = wire if self.echo else b""
        for command in line.split(";"):
            if command[:2] in self.silent:
                return b""
            out += self._one(command)
        return out

    def _one(self, command: str) -> bytes:
        name, _, rest = command.partition(" ")
        if name in self.refuse:
            self.code = self.refuse[name]
            return b"?"
        if name == "EO":
            self.echo = rest == "1"
        if name == "QR":
            out = record({a: self.axes[a] for a in LETTERS}, general="I" in rest, amplifier=self.amplifier) + b":"
            return out[: len(out) - self.cut]
        text = {"\x12\x16": self.model, "QZ": self.sizes, "TC": f"{self.code} Reason"}.get(name, "")
        if name == "MG":
            values = [self.abort if item == "_AB" else 0 for item in rest.split(",")]
            text = "".join(f" {value:.4f}" for value in values)
        self._act(name, rest)
        return (text + "\r\n" if text else "").encode() + b":"

    def _act(self, name: str, rest: str) -> None:
        for letter in rest if name in {"BG", "ST", "SH", "MO"} else "":
            axis = self.axes[letter]
            status = axis.get("status", 0)
            axis["status"] = {"BG": status | 0x8000, "ST": status & 0x7FFF, "SH": status & ~1, "MO": status | 1}[name]
            if name in {"BG", "ST"}:
                axis["stop_code"] = {"BG": 0, "ST": 4}[name]


@dataclass
class Bench:
    """A device and a peer on a simulated clock; the peer answers 1 ms after it is asked."""

    peer: GalilPeer = field(default_factory=GalilPeer)
    settings: dict[str, Any] = field(default_factory=dict)
    now_ns: int = 10**9
    outputs: list[Any] = field(default_factory=list)
    sent: list[bytes] = field(default_factory=list)
    chunk: int = 0
    latency_ns: int = MS
    byte_ns: int = 0

    def __post_init__(self) -> None:
        self.device = GalilDmc("motors", GalilDmc.Settings(**self.settings), TimeBase(10**18))
        self.line: list[tuple[int, bytes]] = []

    def start(self, seconds: float = 1.0) -> "Bench":
        self.device.start(self.now_ns)
        return self.run(seconds)

    def run(self, seconds: float) -> "Bench":
        end = self.now_ns + round(seconds * 1e9)
        while True:
            due = min([t for t, _ in self.line], default=1 << 62)
            at = max(self.now_ns, min(due, self.device.wakeup_ns))
            if at > end:
                self.now_ns = end
                return self
            self.now_ns = at
            arrived = [data for t, data in self.line if t <= at]
            self.line = [(t, data) for t, data in self.line if t > at]
            for data in arrived:
                self.feed(data)
            wires, outputs = self.device.poll(self.now_ns)
            self.outputs += outputs
            for wire in wires:
                self.take(wire)

    def take(self, wire: bytes) -> None:
        self.sent.append(wire)
        if answer := self.peer.answer(wire):
            self.line.append((self.now_ns + self.latency_ns + self.byte_ns * len(wire + answer), answer))

    def feed(self, data: bytes) -> None:
        size = self.chunk or max(len(data), 1)
        for start in range(0, len(data), size):
            self.outputs += self.device.feed(data[start : start + size], self.now_ns)

    def ask(self, name: str, seconds: float = 0.2, **args: Any) -> Reply | None:
        """Make a request and run; its reply if one came."""
        self.outputs += self.device.request(Request(id=name, target="motors", name=name, args=args), self.now_ns)
        self.run(seconds)
        replies = [output for output in self.outputs if isinstance(output, Reply) and output.id == name]
        return replies[-1] if replies else None

    def messages(self, topic: str) -> list[Any]:
        return [output[1] for output in self.outputs if isinstance(output, tuple) and output[0] == topic]

    @property
    def joints(self) -> Any:
        return self.messages("joints/state")[-1]

    @property
    def status(self) -> Any:
        return self.messages("status")[-1]

    @property
    def faults(self) -> list[str]:
        return [fault.what for fault in self.messages("fault")]


def ready(**settings: Any) -> Bench:
    """A connected and enabled robot."""
    bench = Bench(settings=settings).start()
    assert bench.device.ready
    reply = bench.ask("enable")
    assert reply is not None
    assert reply.error is None
    bench.peer.lines.clear()
    return bench

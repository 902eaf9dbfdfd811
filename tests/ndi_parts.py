"""A scripted tracker for tests: plain text and bytes by the Combined API's words, with switches for what goes wrong."""

import struct
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from galen_hw.clock import TimeBase
from galen_hw.drivers.ndi_tracker import NdiTracker
from galen_hw.drivers.serial_line import LineControl

MS = 1_000_000
FRAME_NS = 16_666_667
DELAY_NS = 3 * MS
VECTORS = Path(__file__).parent / "vectors"
MARKERS = {role: {"rom_file": VECTORS / f"ndi_{role}.rom"} for role in ("tool", "reference")}


def crc(data: bytes) -> int:
    """CRC-16 bit by bit, apart from the driver's table."""
    value = 0
    for byte in data:
        value ^= byte
        for _ in range(8):
            value = value >> 1 ^ (0xA001 if value & 1 else 0)
    return value


def line(text: str) -> bytes:
    return f"{text}{crc(text.encode()):04X}\r".encode()


def binary(body: bytes) -> bytes:
    head = b"\xc4\xa5" + struct.pack("<H", len(body))
    return head + struct.pack("<H", crc(head)) + body + struct.pack("<H", crc(body))


@dataclass
class NdiPeer:
    """Two wireless bodies; `baud` is what it listens at, other rates give it garbage."""

    baud: int = 9600
    tracking: bool = False
    dead: bool = False
    refuse: dict[str, int] = field(default_factory=dict)
    lines: list[str] = field(default_factory=list)
    ports: dict[str, int] = field(default_factory=dict)
    stale: set[str] = field(default_factory=set)
    states: dict[str, str] = field(default_factory=dict)
    roms: dict[str, bytes] = field(default_factory=dict)
    frame_shift: int = 0
    frozen: int | None = None
    status: int = 0
    port_status: int = 0x31
    next_handle: int = 1
    quiet: bool = False

    def answer(self, wire: bytes, now_ns: int, baud: int) -> bytes:
        if self.dead:
            return b""
        if baud != self.baud:
            return b"\xf8\x80\x1e"
        text = wire.decode("ascii")[:-5]
        assert wire == line(text)
        self.lines.append(text)
        name = text.partition(":")[0]
        if name in self.refuse:
            return line(f"ERROR{self.refuse[name]:02X}")
        return self._one(name, text.partition(":")[2], now_ns)

    def _one(self, name: str, rest: str, now_ns: int) -> bytes:
        if name in {"BX", "TX"}:
            if not self.tracking:
                return line("ERROR0C")
            frame = self.frozen if self.frozen is not None else (now_ns - DELAY_NS) // FRAME_NS + self.frame_shift
            return binary(self._bx(frame)) if name == "BX" else line(self._tx(frame))
        if name == "INIT" and self.tracking:
            return line("ERROR0C")
        text = getattr(self, f"_{name.lower()}", lambda _: "OKAY")(rest)
        return line(text)

    def _comm(self, rest: str) -> str:
        self.baud = {"0": 9600, "5": 115200, "6": 921600}[rest[0]]
        return "OKAY"

    def _tstart(self, _: str) -> str:
        self.tracking = True
        return "OKAY"

    def _tstop(self, _: str) -> str:
        self.tracking = False
        return "OKAY"

    def _phsr(self, rest: str) -> str:
        chosen = {
            "00": self.ports,
            "01": {h: s for h, s in self.ports.items() if h in self.stale},
            "02": {h: s for h, s in self.ports.items() if not s & 0x10 and h in self.roms},
            "03": {h: s for h, s in self.ports.items() if s & 0x10 and not s & 0x20},
        }[rest]
        return f"{len(chosen):02X}" + "".join(f"{h}{s:03X}" for h, s in chosen.items())

    def _phf(self, rest: str) -> str:
        self.ports.pop(rest, None)
        return "OKAY"

    def _phrq(self, _: str) -> str:
        handle = f"{self.next_handle:02X}"
        self.next_handle += 1
        self.ports[handle] = 0x01
        return handle

    def _pvwr(self, rest: str) -> str:
        handle, address, data = rest[:2], int(rest[2:6], 16), bytes.fromhex(rest[6:])
        assert len(data) == 64
        assert address == len(self.roms.get(handle, b""))
        self.roms[handle] = self.roms.get(handle, b"") + data
        return "OKAY"

    def _pinit(self, rest: str) -> str:
        self.ports[rest] |= 0x10
        return "OKAY"

    def _pena(self, rest: str) -> str:
        self.ports[rest[:2]] |= 0x20
        return "OKAY"

    def _phinf(self, rest: str) -> str:
        return "02100008NDI         001" + f"SERIAL{rest[:2]}" + "31" + "0" * 14

    def _bx(self, frame: int) -> bytes:
        out = bytes([len(self.ports)])
        for handle in self.ports:
            state = self.states.get(handle, "ok")
            out += bytes([int(handle, 16), {"ok": 1, "missing": 2, "disabled": 4}[state]])
            if state == "ok":
                out += struct.pack("<8f", 1, 0, 0, 0, 100.0 * int(handle, 16), 0, -1500, 0.1)
            if state != "disabled":
                out += struct.pack("<II", self.port_status, frame)
        return out + struct.pack("<H", self.status)

    def _tx(self, frame: int) -> str:
        out = f"{len(self.ports):02X}"
        for handle in self.ports:
            state = self.states.get(handle, "ok")
            x = 10000 * int(handle, 16)
            seen = f"+10000+00000+00000+00000+{x:06d}+000000-150000+01000"
            out += handle + (seen if state == "ok" else state.upper())
            out += "\n" if state in {"disabled", "unoccupied"} else f"{self.port_status:08X}{frame:08X}\n"
        return f"{out}{self.status:04X}"


@dataclass
class NdiBench:
    """A tracker's driver and a peer on a simulated clock; the line carries the baud rate of its changes."""

    peer: NdiPeer = field(default_factory=NdiPeer)
    settings: dict[str, Any] = field(default_factory=dict)
    now_ns: int = 10**9
    outputs: list[Any] = field(default_factory=list)
    baud: int = 115200
    chunk: int = 0
    latency_ns: int = MS
    breaks: list[int] = field(default_factory=list)

    def __post_init__(self) -> None:
        settings = {"markers": MARKERS} | self.settings
        self.device = NdiTracker("tracker", NdiTracker.Settings(**settings), TimeBase(10**18))
        self.line: list[tuple[int, bytes]] = []

    def start(self, seconds: float = 2.0) -> "NdiBench":
        self.device.start(self.now_ns)
        return self.run(seconds)

    def run(self, seconds: float) -> "NdiBench":
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
                size = self.chunk or max(len(data), 1)
                for place in range(0, len(data), size):
                    self.outputs += self.device.feed(data[place : place + size], self.now_ns)
            wires, outputs = self.device.poll(self.now_ns)
            self.outputs += outputs
            for wire in wires:
                self.take(wire)

    def take(self, wire: bytes) -> None:
        if isinstance(wire, LineControl):
            self.baud = wire.change.baud_rate or self.baud
            if wire.change.break_on is False and not self.peer.dead:
                self.peer.baud, self.peer.tracking = 9600, False
                self.line.append((self.now_ns + 1000 * MS, line("RESET")))
            if wire.change.break_on:
                self.breaks.append(self.now_ns)
        elif answer := self.peer.answer(wire, self.now_ns, self.baud):
            self.line.append((self.now_ns + self.latency_ns, answer))

    def messages(self, topic: str) -> list[Any]:
        return [output[1] for output in self.outputs if isinstance(output, tuple) and output[0] == topic]

    @property
    def faults(self) -> list[str]:
        return [fault.what for fault in self.messages("fault")]

"""A peer that plays the `script` of `tests/vectors/NAME.json`, and a loop that runs a device against it.

A script entry is {"when": wire, "reply": [wires], "repeat_s"?, "until"?}; a wire is {"id", "data"} in hex on CAN, and
{"text"} (Latin-1) or {"hex"} on a serial line.
"""

import json
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from galen_hw.clock import TimeBase
from galen_hw.drivers.device import CanFrame, Device, Output

VECTORS = Path(__file__).parents[1] / "vectors"
LATENCY_NS = 200_000


def wire_of(entry: dict[str, str]) -> Any:
    """A CAN frame or bytes from its JSON form."""
    if "id" in entry:
        return CanFrame(int(entry["id"], 16), bytes.fromhex(entry["data"]))
    return bytes.fromhex(entry["hex"]) if "hex" in entry else entry["text"].encode("latin-1")


def script_of(driver: str) -> list[dict[str, Any]]:
    """The script of a driver's table of vectors; empty when it has none."""
    path = VECTORS / f"{driver}.json"
    return json.loads(path.read_text()).get("script", []) if path.exists() else []


@dataclass
class Peer:
    """Answers `LATENCY_NS` after each request, or not at all when its script is empty.

    Args:
        changed: what is said instead, by place in the script and in its reply.
    """

    script: list[dict[str, Any]]
    changed: dict[tuple[int, int], Any] = field(default_factory=dict)
    _line: list[tuple[int, Any]] = field(default_factory=list)
    _streams: dict[int, int] = field(default_factory=dict)

    def take(self, wires: list[Any], now_ns: int) -> None:
        for wire in wires:
            for place, entry in enumerate(self.script):
                if wire == wire_of(entry["when"]):
                    self._line += [(now_ns + LATENCY_NS, wire) for wire in self._reply(place)]
                    if "repeat_s" in entry:
                        self._streams[place] = now_ns + round(entry["repeat_s"] * 1e9)
                if "until" in entry and wire == wire_of(entry["until"]):
                    self._streams.pop(place, None)

    def _reply(self, place: int) -> list[Any]:
        replies = enumerate(self.script[place]["reply"])
        return [self.changed.get((place, number), wire_of(reply)) for number, reply in replies]

    def give(self, now_ns: int) -> list[Any]:
        for place, due_ns in self._streams.items():
            if due_ns <= now_ns:
                entry = self.script[place]
                self._line += [(due_ns, wire) for wire in self._reply(place)]
                self._streams[place] = due_ns + round(entry["repeat_s"] * 1e9)
        due = [wire for t_ns, wire in self._line if t_ns <= now_ns]
        self._line = [(t_ns, wire) for t_ns, wire in self._line if t_ns > now_ns]
        return due

    @property
    def due_ns(self) -> int:
        return min([t_ns for t_ns, _ in self._line] + list(self._streams.values()), default=1 << 62)


@dataclass
class Virtual:
    """A virtual device, in its world, as a peer."""

    device: Any
    world: Any

    def take(self, wires: list[Any], now_ns: int) -> None:
        self.world.advance(now_ns)
        for wire in wires:
            self.device.feed(wire, now_ns)

    def give(self, now_ns: int) -> list[Any]:
        self.world.advance(now_ns)
        return list(self.device.poll(now_ns))

    @property
    def due_ns(self) -> int:
        return int(self.device.wakeup_ns)


@dataclass
class Run:
    """A device, its peer, and all that came of it.

    Args:
        device: not yet started.
        peer: see there.
        now_ns: when it begins.
        spoil: what to make of each answer: none, one or more wires.
    """

    device: Device[Any]
    peer: Any
    now_ns: int = 1_000_000_000
    spoil: Callable[[Any], list[Any]] = lambda wire: [wire]
    outputs: list[Output] = field(default_factory=list)
    sent: list[tuple[int, Any]] = field(default_factory=list)
    fed: list[tuple[int, Any]] = field(default_factory=list)
    times_ns: set[int] = field(default_factory=set)
    polls: int = 0

    def start(self) -> "Run":
        self.times_ns.add(self.now_ns)
        self.device.start(self.now_ns)
        return self

    def until(self, end_ns: int) -> "Run":
        """Run the loop of a daemon: poll when the device wants it, feed what arrives when it arrives."""
        while True:
            next_ns = max(self.now_ns, min(self.device.wakeup_ns, self.peer.due_ns))
            if next_ns > end_ns:
                self.now_ns = end_ns
                return self
            self.now_ns = next_ns
            self.times_ns.add(next_ns)
            for wire in self.peer.give(next_ns):
                for spoilt in self.spoil(wire):
                    self.feed(spoilt)
            if self.device.wakeup_ns <= next_ns:
                self.poll()

    def seconds(self, seconds: float) -> "Run":
        return self.until(self.now_ns + round(seconds * 1e9))

    def poll(self) -> list[Any]:
        self.polls += 1
        wires, outputs = self.device.poll(self.now_ns)
        self.outputs += outputs
        self.sent += [(self.now_ns, wire) for wire in wires]
        self.peer.take(wires, self.now_ns)
        return wires

    def feed(self, wire: Any) -> list[Output]:
        self.times_ns.add(self.now_ns)
        self.fed.append((self.now_ns, wire))
        outputs = self.device.feed(wire, self.now_ns)
        self.outputs += outputs
        return outputs

    def messages(self, topic: str) -> list[Any]:
        return [output[1] for output in self.outputs if isinstance(output, tuple) and output[0] == topic]

    @property
    def replies(self) -> list[Any]:
        return [output for output in self.outputs if not isinstance(output, tuple)]


def virtual_run(driver: Any, device: Any, world: Any, **settings: Any) -> Run:
    """A started driver against a virtual device."""
    return Run(driver("ft", driver.Settings(**settings), TimeBase()), Virtual(device, world)).start()

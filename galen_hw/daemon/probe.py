"""Looks at devices without a daemon (opens each wire for some seconds), or at a running daemon through its bus."""

import time
from dataclasses import dataclass, field
from typing import Any, Final

from galen_hw.bus import Subscriber
from galen_hw.clock import TimeBase
from galen_hw.config.load import DeviceSetup, Setup
from galen_hw.config.paths import Addresses
from galen_hw.daemon.orders import build_port
from galen_hw.daemon.port import Port, Waker
from galen_hw.daemon.realtime import sharpen_timers
from galen_hw.messages import Fault, Message, Status, WrenchRaw
from galen_hw.waiting import readable

READY_WITHIN_S: Final = 12.0
"""As a tracker needs that was left at another rate: INIT at two rates (2 s each), a break and RESET (5 s), INIT again (2 s)."""
MEASURE_S: Final = 2.0
QUIET_TOPICS: Final = ("status", "fault")


@dataclass
class Seen:
    """What was seen of one device.

    Args:
        wire: "open", or why not; ready: it answered as the right device; opening_error: what, where, todo.
        rates: messages a second by topic; saturated, invalid: messages of the wrench that were.
        faults: last of each text; detail: of its own status; counters: of device and wire.
    """

    wire: str = "closed"
    ready: bool = False
    error: tuple[str, str, str] | None = None
    measured_s: float = 0.0
    counts: dict[str, int] = field(default_factory=dict)
    saturated: int = 0
    invalid: int = 0
    serial_number: str = ""
    faults: dict[str, Fault] = field(default_factory=dict)
    detail: str = ""
    counters: dict[str, int] = field(default_factory=dict)

    def take(self, topic: str, message: Message) -> None:
        """Count one message of the device."""
        if isinstance(message, Fault):
            self.faults[message.what] = message
        elif isinstance(message, Status):
            self.detail, self.counters = message.detail, message.counters
        else:
            self.counts[topic] = self.counts.get(topic, 0) + 1
            self.invalid += not message.valid
        if isinstance(message, WrenchRaw):
            self.saturated += message.saturated
            self.serial_number = message.serial_number

    def forget_counts(self) -> None:
        """Begin to measure."""
        self.counts, self.saturated, self.invalid = {}, 0, 0

    def rates_hz(self) -> dict[str, float]:
        """Messages a second by topic."""
        return {topic: n / max(1e-3, self.measured_s) for topic, n in self.counts.items()}


def probe_devices(setup: Setup) -> dict[str, Seen]:
    """Open every device's wire at once, wait until all answer, then measure; each is brought to rest and closed.

    A wire that another process uses (a daemon of another runtime directory) is left alone.
    """
    sharpen_timers()
    waker = Waker()
    time_base = TimeBase.now()
    ports = {name: build_port(device, time_base, waker, alone=True) for name, device in setup.devices.items()}
    seen = {name: Seen() for name in ports}
    try:
        _drive(ports, seen, waker, READY_WITHIN_S, until_ready=True)
        for one in seen.values():
            one.forget_counts()
        begun = time.monotonic()
        if any(port.device.ready for port in ports.values()):
            _drive(ports, seen, waker, MEASURE_S, until_ready=False)
        for name, port in ports.items():
            _conclude(seen[name], port, time.monotonic() - begun)
    finally:
        for port in ports.values():
            port.rest()
            port.close()
        waker.close()
    return seen


def listen_to_daemon(addresses: Addresses, info: dict[str, Any], setup: Setup) -> dict[str, Seen]:
    """The same from a running daemon: its own word on the wires, rates and faults from the bus."""
    seen = {name: Seen() for name in setup.devices}
    for name, state in info.get("devices", {}).items():
        if name in seen:
            seen[name].wire, seen[name].ready = state["wire"], state["ready"]
            seen[name].error = tuple(state["problem"]) if state["problem"] else None
    begun = time.monotonic()
    with Subscriber(addresses.bus) as subscriber:
        while (left := MEASURE_S - (time.monotonic() - begun)) > 0:
            received = subscriber.receive(left)
            if received is not None and received[1].source in seen:
                seen[received[1].source].take(*received)
    for one in seen.values():
        one.measured_s = time.monotonic() - begun
    return seen


def _drive(ports: dict[str, Port], seen: dict[str, Seen], waker: Waker, seconds: float, *, until_ready: bool) -> None:
    until = time.monotonic() + seconds
    while (now := time.monotonic()) < until:
        if until_ready and all(p.device.ready or p.error is not None for p in ports.values()):
            return
        fds = [waker.fd, *(p.fd for p in ports.values() if p.fd is not None)]
        wake = min((p.wakeup_ns for p in ports.values()), default=0) / 1e9 - now
        ready = readable(fds, min(max(0.0, wake), until - now))
        if waker.fd in ready:
            waker.clear()
        for name, port in ports.items():
            if port.error is not None:
                continue  # looked at once; a second attempt would only say the same
            for output in port.step(readable=port.fd in ready):
                if isinstance(output, tuple):
                    seen[name].take(*output)


def _conclude(seen: Seen, port: Port, seconds: float) -> None:
    seen.wire, seen.ready, seen.measured_s = port.state, port.device.ready, seconds
    if port.error is not None:
        seen.error = (port.error.what, port.error.where, port.error.todo)
    seen.counters = dict(port.device.counters)
    if port.transport is not None:
        seen.counters |= {f"wire {key}": n for key, n in port.transport.counters.items()}


def nominal_hz(device: DeviceSetup, topic: str, default: float) -> float:
    """The rate that a device was asked for, where its settings name one."""
    rate = getattr(device.settings, "rate_hz", None)
    return float(rate) if topic == "wrench/raw" and isinstance(rate, int | float) else default

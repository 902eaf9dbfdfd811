"""What the machine itself takes: the way of a sample with nothing done on it, between three bare processes.

    python -m galen_hw.tools.benchmarks.floor [--rate 1000] [--seconds 10] [--json]

One process stamps and writes datagrams at a fixed rate, the second publishes each on a bus, the third takes its age: the
same wake-ups as from a wire over the daemon to a subscriber, with no driver, no compensation and no message decoded. What
`bench_latency` shows above this is the work of the daemon; the rest is the scheduler's and ZeroMQ's. The same of the share
of a core that the second process takes: it wakes once a sample and sends once, and the daemon's core does so too.
"""

import argparse
import gc
import json
import multiprocessing
import socket
import struct
import sys
import tempfile
import time
from dataclasses import dataclass
from multiprocessing.synchronize import Event
from pathlib import Path
from typing import Final

import numpy as np

from galen_hw.bus import Publisher, Subscriber
from galen_hw.spatial import Array

TOPIC: Final = b"floor"
PADDING: Final = bytes(200)
"""As long as a compensated wrench on the bus."""
SETTLE_S: Final = 1.0


@dataclass(frozen=True)
class Floor:
    """What was measured on the bare processes.

    Args:
        ages_us: (N,) of the datagrams as they arrive behind the bus, us.
        relay_share: of one core, that the process took which passes them on; all its threads.
    """

    ages_us: Array
    relay_share: float

    @property
    def percentiles_us(self) -> tuple[float, float]:
        """Return the 50th and the 99th percentile of the ages, us."""
        p50, p99 = np.percentile(self.ages_us, [50.0, 99.0])
        return float(p50), float(p99)


def main(argv: list[str] | None = None) -> int:
    """Measure and print a line or JSON."""
    parser = argparse.ArgumentParser(prog="bench_floor", description=__doc__)
    parser.add_argument("--rate", type=float, default=1000.0, help="samples a second")
    parser.add_argument("--seconds", type=float, default=10.0)
    parser.add_argument("--json", action="store_true")
    args = parser.parse_args(argv)
    floor = measure(args.rate, args.seconds)
    (p50, p99), percent = floor.percentiles_us, 100.0 * floor.relay_share
    if args.json:
        found = {"rate_hz": args.rate, "p50_us": p50, "p99_us": p99, "relay_core_percent": percent}
        print(json.dumps(found))
    else:
        print(
            f"{args.rate:.0f} Hz with nothing done: p50 {p50:.0f} us, p99 {p99:.0f} us, relay {percent:.1f} % of a core"
        )
    return 0


def cpu_s(pid: int) -> float:
    """Seconds that all threads of a process have run (the scheduler's own count, not the clock tick's samples)."""
    tasks = Path(f"/proc/{pid}/task").iterdir()
    return sum(int((task / "schedstat").read_text(encoding="ascii").split()[0]) for task in tasks) / 1e9


def measure(rate_hz: float, seconds: float) -> Floor:
    """Measure for so long, after a settling time, with processes of its own."""
    with tempfile.TemporaryDirectory(prefix="galen-floor-") as folder:
        wire, bus = f"{folder}/wire", f"ipc://{folder}/bus"
        spawn = multiprocessing.get_context("spawn")
        ready = spawn.Event()
        relay = spawn.Process(target=_relay, args=(wire, bus, ready), daemon=True)
        relay.start()
        ready.wait(30.0)
        source = spawn.Process(target=_source, args=(wire, rate_hz), daemon=True)
        source.start()
        try:
            assert relay.pid is not None, "it was started"
            return _listen(bus, relay.pid, int(SETTLE_S * rate_hz), int(seconds * rate_hz))
        finally:
            source.terminate()
            relay.terminate()
            source.join()
            relay.join()


def _source(wire: str, rate_hz: float) -> None:
    """Stamped datagrams, evenly."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as out:
        out.connect(wire)
        due = time.monotonic()
        while True:
            due += 1.0 / rate_hz
            time.sleep(max(0.0, due - time.monotonic()))
            out.send(struct.pack("<q", time.monotonic_ns()) + PADDING)


def _relay(wire: str, bus: str, ready: Event) -> None:
    """From the wire to the bus."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as inlet, Publisher(bus) as publisher:
        inlet.bind(wire)
        ready.set()
        while True:
            publisher.publish_bytes(TOPIC, inlet.recv(512))


def _listen(bus: str, relay: int, skipped: int, count: int) -> Floor:
    out = np.zeros(count)
    with Subscriber(bus, as_published=True) as subscriber:
        gc.disable()
        for _ in range(skipped):
            _receive(subscriber)
        before, begun = cpu_s(relay), time.monotonic()
        for k in range(count):
            payload = _receive(subscriber)
            out[k] = time.monotonic_ns() - struct.unpack_from("<q", payload)[0]
        share = (cpu_s(relay) - before) / (time.monotonic() - begun)
        gc.enable()
    return Floor(out / 1e3, share)


def _receive(subscriber: Subscriber) -> bytes:
    """Receive the next datagram.

    Raises:
        TimeoutError: none comes.
    """
    frames = subscriber.receive_bytes(10.0)
    if frames is None:
        raise TimeoutError("the bus fell silent")
    return frames[1]


if __name__ == "__main__":
    sys.exit(main())

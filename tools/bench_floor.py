"""What the machine itself takes: the way of a sample with nothing done on it, between three bare processes.

    python -m galen_hw.tools.bench_floor [--rate 1000] [--seconds 10] [--json]

One process stamps and writes datagrams at a fixed rate, the second publishes each on a bus, the third takes its age: the
same wake-ups as from a wire over the daemon to a subscriber, with no driver, no compensation and no message decoded. What
`bench_latency` shows above this is the work of the daemon; the rest is the scheduler's and ZeroMQ's.
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
from multiprocessing.synchronize import Event
from typing import Final

import numpy as np

from galen_hw.bus import Publisher, Subscriber
from galen_hw.spatial import Array

TOPIC: Final = b"floor"
PADDING: Final = bytes(200)
"""As long as a compensated wrench on the bus."""
SETTLE_S: Final = 1.0


def main(argv: list[str] | None = None) -> int:
    """Measure and print a line or JSON."""
    parser = argparse.ArgumentParser(prog="bench_floor", description=__doc__)
    parser.add_argument("--rate", type=float, default=1000.0, help="samples a second")
    parser.add_argument("--seconds", type=float, default=10.0)
    parser.add_argument("--json", action="store_true")
    args = parser.parse_args(argv)
    p50, p99 = np.percentile(ages_us(args.rate, args.seconds), [50.0, 99.0])
    if args.json:
        print(json.dumps({"rate_hz": args.rate, "p50_us": float(p50), "p99_us": float(p99)}))
    else:
        print(f"{args.rate:.0f} Hz with nothing done: p50 {p50:.0f} us, p99 {p99:.0f} us")
    return 0


def ages_us(rate_hz: float, seconds: float) -> Array:
    """(N,) ages of the datagrams as they arrive behind the bus, us."""
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
            return _ages(bus, int(SETTLE_S * rate_hz), int(seconds * rate_hz))
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


def _ages(bus: str, skipped: int, count: int) -> Array:
    out = np.zeros(skipped + count)
    with Subscriber(bus, as_published=True) as subscriber:
        gc.disable()
        for k in range(len(out)):
            frames = subscriber.receive_bytes(10.0)
            if frames is None:
                raise TimeoutError("the bus fell silent")
            out[k] = time.monotonic_ns() - struct.unpack_from("<q", frames[1])[0]
        gc.enable()
    return out[skipped:] / 1e3


if __name__ == "__main__":
    sys.exit(main())

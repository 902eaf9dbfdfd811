"""Measures the way of a sample: stamp at the wire to the compensated wrench in another process, over a range of rates.

Run with `python -m galen_hw.tools.benchmarks.latency --seconds 60`. Starts `galen-hw run --virtual` for each rate: the
numbers hold with the virtual robot, the daemon and this subscriber sharing the cores of the machine.
"""

import argparse
import gc
import json
import os
import sys
import tempfile
import time
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from galen_hw.bus import CommandClient, Subscriber
from galen_hw.config.paths import Addresses
from galen_hw.daemon.session import own_daemon
from galen_hw.messages import Status
from galen_hw.tools.benchmarks.floor import cpu_s

RATES_HZ: Final = (1000.0, 1500.0, 2000.0, 2500.0, 3000.0)
SETTLE_S: Final = 3.0
TOPIC: Final = "wrench/compensated"
TEMPLATE: Final = """
[devices.ft]
driver = "{driver}"
transport = {{ interface = "socketcan" }}
settings = {{ rate_hz = {rate} }}
{motors}
[services.compensation]
{more}
[bus]
viewers = "{viewers}"
[daemon]
realtime_priority = {priority}
"""
MOTORS: Final = """
[devices.motors]
driver = "galil_dmc"
transport = { url = "/dev/serial/by-id/none" }
"""


@dataclass(frozen=True)
class Result:
    """One rate: samples and losses on the bus, latency in us, and the core process' share of one core.

    Args:
        wire: what the sensor's driver has counted in the time: missed slots, time-outs, losses.
    """

    nominal_hz: float
    rate_hz: float
    received: int
    lost: int
    p50_us: float
    p90_us: float
    p99_us: float
    p999_us: float
    max_us: float
    core_share: float
    wire: dict[str, int]


def main(argv: list[str] | None = None) -> int:
    """Run the sweep and print a table or JSON."""
    parser = argparse.ArgumentParser(prog="bench_latency", description=__doc__)
    parser.add_argument("--seconds", type=float, default=10.0, help="measured at each rate, after a settling time")
    parser.add_argument("--rates", type=float, nargs="+", default=list(RATES_HZ), help="samples a second")
    parser.add_argument("--driver", default="ati_netcanoem")
    parser.add_argument("--motors", action="store_true", help="with the motors' process and its joint states")
    parser.add_argument("--priority", type=int, default=20, help="real-time priority of the core process, 0 for none")
    parser.add_argument("--json", action="store_true")
    args = parser.parse_args(argv)
    results = [measure(rate, args) for rate in args.rates]
    if args.json:
        machine = {"cores": os.cpu_count(), "python": sys.version.split()[0], "seconds": args.seconds}
        print(json.dumps({**machine, "results": [asdict(r) for r in results]}))
    else:
        _print(results)
    return 0 if not any(r.lost for r in results) else 1


def measure(rate_hz: float, args: argparse.Namespace) -> Result:
    """One rate, with a daemon of its own."""
    with tempfile.TemporaryDirectory(prefix="galen-bench-") as folder:
        config = Path(folder) / "galen.toml"
        words = {"driver": args.driver, "rate": rate_hz, "priority": args.priority, "viewers": ""}
        motors = MOTORS if args.motors else ""
        config.write_text(TEMPLATE.format(**words, motors=motors, more="[services.calibration]" if motors else ""))
        with own_daemon(config=str(config), runtime=Path(folder) / "run", state=Path(folder) / "state") as addresses:
            return listen(rate_hz, args.seconds, addresses)


def listen(rate_hz: float, seconds: float, addresses: Addresses) -> Result:
    """What a subscriber of a daemon at this rate sees in so many seconds."""
    with CommandClient(addresses.command) as client:
        core = int(client.call("daemon", "info")["processes"]["core"])
    ages_ns = np.zeros(int(1.2 * rate_hz * seconds) + 1000, dtype=np.int64)
    count, last_seq, lost = 0, -1, 0
    with Subscriber(addresses.bus, [TOPIC]) as subscriber, Subscriber(addresses.bus, ["status"]) as statuses:
        _skip(subscriber, SETTLE_S)
        before, wire_before = cpu_s(core), _wire(statuses)
        gc.collect()
        gc.disable()
        begun = time.monotonic()
        until = begun + seconds
        while time.monotonic() < until and count < len(ages_ns):
            received = subscriber.receive(1.0)
            if received is None:
                continue
            message = received[1]
            ages_ns[count] = time.monotonic_ns() - message.t_ns
            if last_seq >= 0:
                lost += message.seq - last_seq - 1
            last_seq = message.seq
            count += 1
        elapsed = time.monotonic() - begun
        gc.enable()
        share = (cpu_s(core) - before) / elapsed
        wire_after = _wire(statuses, wait_s=1.5)
    p50, p90, p99, p999, most = np.percentile(ages_ns[:count], [50, 90, 99, 99.9, 100]) / 1e3
    wire = {
        k: v - wire_before.get(k, 0) for k, v in wire_after.items() if k != "samples" and v != wire_before.get(k, 0)
    }
    figures = (float(p50), float(p90), float(p99), float(p999), float(most))
    return Result(rate_hz, count / elapsed, count, lost, *figures, share, wire)


def _skip(subscriber: Subscriber, seconds: float) -> None:
    until = time.monotonic() + seconds
    while time.monotonic() < until:
        subscriber.receive(0.1)


def _wire(statuses: Subscriber, wait_s: float = 0.0) -> dict[str, int]:
    """The sensor's counters in its latest status."""
    counters: dict[str, int] = {}
    until = time.monotonic() + wait_s
    while (received := statuses.receive(max(0.05, until - time.monotonic()))) is not None:
        message: Any = received[1]
        if isinstance(message, Status) and message.source == "ft":
            counters = message.counters
        if counters and time.monotonic() >= until:
            break
    return counters


def _print(results: list[Result]) -> None:
    print("  asked Hz    got Hz  received  lost   p50 us   p90 us   p99 us  p99.9 us    max us   core %  wire")
    for r in results:
        print(
            f"{r.nominal_hz:10.0f}{r.rate_hz:10.1f}{r.received:10d}{r.lost:6d}{r.p50_us:9.0f}{r.p90_us:9.0f}{r.p99_us:9.0f}"
            f"{r.p999_us:10.0f}{r.max_us:10.0f}{100 * r.core_share:9.1f}  {r.wire or ''}"
        )


if __name__ == "__main__":
    sys.exit(main())

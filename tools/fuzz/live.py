"""Fuzzed frames on every socket of a running daemon: none may end a process, and samples must flow afterwards.

python -m galen_hw.tools.fuzz.live --frames 1000000
"""

import argparse
import os
import random
import subprocess
import sys
import tempfile
import time
from contextlib import suppress
from pathlib import Path
from typing import Any, Final

import zmq

from galen_hw.bus import CommandClient, Subscriber
from galen_hw.config.paths import Addresses
from galen_hw.errors import EXIT_FOUND, EXIT_OK, HardwareError
from galen_hw.messages import STREAMS, TOPICS
from galen_hw.tools.fuzz.mutate import mutated
from galen_hw.tools.fuzz.targets import TARGETS

READY_S: Final = 120.0
AT_ONCE: Final = 500
"""Frames between two looks at what comes back."""


HEAD: Final = """
## A running daemon

Mutated frames of each kind, and crowds of frames, on every socket of `galen-hw run --virtual`. After each socket the same
processes must run and new samples be compensated.

| socket | frames | frames/s | processes that ended |
| --- | --- | --- | --- |
"""


def noise(rng: random.Random, socket: str) -> list[bytes]:
    """The frames of one message to a socket."""
    target = {"command": "socket: command", "control": "socket: control"}.get(socket, "socket: bus and inward")
    payload = mutated(rng, TARGETS[target].seeds)
    if rng.random() < 0.05:
        return [rng.randbytes(rng.randint(0, 9)) for _ in range(rng.randint(1, 12))]
    if socket == "command":
        return [b"", payload]
    if socket == "control":
        return [rng.choice((b"beat", b"reply", b"request")), payload[1:]]
    return [rng.choice([name.encode() for name in sorted(TOPICS)]), payload[1:]]


def shower(address: str, kind: int, socket: str, frames: int, seed: int) -> None:
    """Send so many messages, and read what comes back."""
    rng = random.Random(seed)
    context: zmq.Context[Any] = zmq.Context.instance()
    with context.socket(kind) as one:
        one.setsockopt(zmq.LINGER, 2000)
        one.connect(address)
        for number in range(frames):
            one.send_multipart(noise(rng, socket))
            if number % AT_ONCE == 0 and kind == zmq.DEALER:
                while one.poll(0):
                    one.recv_multipart()


def alive(addresses: Addresses) -> dict[str, int]:
    """The daemon's processes, once compensated samples flow that are new."""
    with CommandClient(addresses.command) as client, Subscriber(addresses.bus, sorted(STREAMS)) as bus:
        pids = dict(client.call("daemon", "info", timeout_s=READY_S)["processes"])
        begun = time.monotonic_ns()
        until = time.monotonic() + READY_S
        while time.monotonic() < until:
            received = bus.receive(1.0)
            if received and received[0] == "wrench/compensated" and received[1].t_ns > begun:
                return pids
    raise HardwareError("no samples flow any more", where=addresses.bus)


def main(argv: list[str] | None = None) -> int:
    """Shower every socket; exit status 1 when a process has ended."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--frames", type=int, default=1_000_000, help="on each socket (default: a million)")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--append", type=Path, metavar="FILE", help="write the table at the end of this page")
    args = parser.parse_args(argv)
    with tempfile.TemporaryDirectory(prefix="galen-hw-") as folder:
        addresses = Addresses(Path(folder) / "run")
        environ = os.environ | {"GALEN_HW_STATE": str(Path(folder) / "state")}
        command = [sys.executable, "-m", "galen_hw.cli", "run", "--virtual", "--dir", str(addresses.runtime)]
        with subprocess.Popen(command, env=environ, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL) as daemon:
            assert daemon.stdout is not None
            try:
                daemon.stdout.readline()
                return _showers(addresses, args)
            finally:
                daemon.terminate()
                with suppress(subprocess.TimeoutExpired):
                    daemon.wait(20.0)


def _showers(addresses: Addresses, args: argparse.Namespace) -> int:
    sockets: dict[str, tuple[str, Any]] = {
        "command": (addresses.command, zmq.DEALER),
        "control": (addresses.control, zmq.DEALER),
        "inward": (addresses.inward, zmq.PUSH),
        "bus.pub": (addresses.bus, zmq.XSUB),
        "batches": (addresses.batches, zmq.XSUB),
    }
    before, ended = alive(addresses), 0
    rows: list[str] = []
    for name, (address, kind) in sockets.items():
        begun = time.monotonic()
        shower(address, kind, name, args.frames, args.seed)
        after = alive(addresses)
        gone = [process for process, pid in before.items() if after.get(process) != pid]
        ended += len(gone)
        rate = args.frames / (time.monotonic() - begun)
        rows.append(f"| {name} | {args.frames} | {rate:.0f} | {', '.join(gone) or 'none'} |")
        print(rows[-1], flush=True)
        before = after
    if args.append:
        text = args.append.read_text(encoding="utf-8").partition(HEAD)[0]
        args.append.write_text(f"{text}{HEAD}{chr(10).join(rows)}\n", encoding="utf-8")
    return EXIT_FOUND if ended else EXIT_OK


if __name__ == "__main__":
    sys.exit(main())

"""Benchmark: the polled ATI sensor over the CAN interfaces that need no kernel support, in two processes.

python -m galen_hw.tools.benchmarks.can [--seconds 10] [--rates 1000 3000] [--interfaces slcan socketcand udp_multicast]

The board is a bare answering machine, so that the figures are those of transport and device: at a fixed rate what was
lost or missed, the time from request to stamp, and the host's processor time a sample.
"""

import argparse
import multiprocessing
import os
import select
import socket
import struct
import time
import tty
from collections.abc import Callable
from multiprocessing.synchronize import Event
from typing import Any, Final

import can
import numpy as np

from galen_hw.clock import NS_PER_S, TimeBase
from galen_hw.drivers.ati_netcanoem import AtiNetcanoem
from galen_hw.drivers.can_transport import CanTransport
from galen_hw.drivers.device import CanFrame

GROUP: Final = "239.74.163.77"


def answers(frame: CanFrame, count: int) -> list[CanFrame]:
    """What a board at base id 0x20 answers; `count` makes each sample another one."""
    opcode = frame.arbitration_id - 0x200
    if opcode == 0 and not frame.data:
        wobble = count % 1000
        first, second = struct.pack(">H3h", 0, 18 + wobble, -454, -6488), struct.pack(">3h", 1274, -1389, 323)
        return [CanFrame(0x200, first), CanFrame(0x201, second)]
    if opcode == 2 and len(frame.data) == 1:
        row = struct.pack(">6f", *np.roll([900.0, 0.5, 0.0, 0.0, 0.0, 0.0], frame.data[0]))
        return [CanFrame(0x202, row[:8]), CanFrame(0x203, row[8:16]), CanFrame(0x204, row[16:])]
    if opcode == 6 and len(frame.data) == 1:
        return [frame]
    fixed = {5: b"BENCH001", 7: struct.pack(">II", 1_000_000, 50_000), 8: b"\x02\x03", 0xF: b"\x03\x08\x00\x00"}
    return [CanFrame(frame.arbitration_id, fixed[opcode])] if opcode in fixed and not frame.data else []


def _slcan_text(frames: list[CanFrame]) -> bytes:
    return b"".join(b"t%03X%d%s\r" % (f.arbitration_id, len(f.data), f.data.hex().upper().encode()) for f in frames)


def _tcp_text(frames: list[CanFrame]) -> bytes:
    return b"".join(b"< frame %03X 0.0 %s >" % (f.arbitration_id, f.data.hex().upper().encode()) for f in frames)


def _slcan_frames(lines: list[bytes]) -> list[CanFrame]:
    return [CanFrame(int(x[1:4], 16), bytes.fromhex(x[5:].decode())) for x in lines if x[:1] == b"t"]


def _tcp_frames(lines: list[bytes]) -> list[CanFrame]:
    words = [line.split() for line in lines if b"send" in line]
    return [CanFrame(int(w[2], 16), bytes(int(x, 16) for x in w[4:])) for w in words]


def serve_stream(fd: int, end: bytes, parse: Callable[..., Any], form: Callable[..., bytes], stop: Event) -> None:
    """Answer on a descriptor: the far end of an slcan pty or of a socketcand connection."""
    rest, count = b"", 0
    while not stop.is_set():
        if not select.select([fd], [], [], 0.2)[0]:
            continue
        try:
            *lines, rest = (rest + os.read(fd, 65536)).split(end)
        except OSError:
            return
        for frame in parse(lines):
            count += 1
            os.write(fd, form(answers(frame, count)))


def serve_slcan(ready: Any, stop: Event) -> None:
    """An slcan adapter with the board behind it, on a pty."""
    master, slave = os.openpty()
    tty.setraw(slave)
    ready.send({"interface": "slcan", "channel": os.ttyname(slave)})
    serve_stream(master, b"\r", _slcan_frames, _slcan_text, stop)


def serve_socketcand(ready: Any, stop: Event) -> None:
    """A socketcand server with the board behind it."""
    server = socket.create_server(("127.0.0.1", 0))
    options = {"host": "127.0.0.1", "port": server.getsockname()[1]}
    ready.send({"interface": "socketcand", "channel": "can0", "options": options})
    connection, _ = server.accept()
    connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    connection.sendall(b"< hi >")
    connection.recv(100)
    connection.sendall(b"< ok >")
    connection.recv(100)
    connection.sendall(b"< ok >")
    serve_stream(connection.fileno(), b">", _tcp_frames, _tcp_text, stop)


def serve_udp(ready: Any, stop: Event) -> None:
    """The board on a multicast group."""
    with can.Bus(GROUP, "udp_multicast", ignore_config=True) as bus:
        ready.send({"interface": "udp_multicast", "channel": GROUP})
        count = 0
        while not stop.is_set():
            message = bus.recv(0.2)
            if message is None or len(message.data) > 1:
                continue
            count += 1
            for frame in answers(CanFrame(message.arbitration_id, bytes(message.data)), count):
                bus.send(can.Message(arbitration_id=frame.arbitration_id, data=frame.data, is_extended_id=False))


SERVERS: Final = {"slcan": serve_slcan, "socketcand": serve_socketcand, "udp_multicast": serve_udp}


def host(transport: CanTransport, rate_hz: float, seconds: float) -> dict[str, float]:
    """Run the device on the open transport; figures of the last `seconds`."""
    device = AtiNetcanoem("ft", AtiNetcanoem.Settings(rate_hz=rate_hz), TimeBase.now())
    device.start(time.monotonic_ns())
    asked_ns, begun_ns, cpu = 0, 0, 0.0
    before: dict[str, int] = {}
    delays: list[int] = []
    while not begun_ns or time.monotonic_ns() - begun_ns < seconds * NS_PER_S:
        now_ns = time.monotonic_ns()
        if device.ready and not begun_ns:
            begun_ns, before, cpu = now_ns, device.counters, time.process_time()
        wires, _ = device.poll(now_ns)
        if wires:
            asked_ns = time.monotonic_ns()
            transport.send(wires)
        wait_s = max(0.0, (device.wakeup_ns - time.monotonic_ns()) / NS_PER_S)
        for frame, t_ns in transport.receive(wait_s):
            outputs = device.feed(frame, t_ns)
            if begun_ns and any(isinstance(output, tuple) and output[0] == "wrench/raw" for output in outputs):
                delays.append(t_ns - asked_ns)
    cpu = time.process_time() - cpu
    after = device.counters
    grown = {name: float(after[name] - before[name]) for name in ("samples", "lost", "missed", "late", "repeated")}
    p50, p99 = np.percentile(delays, [50, 99]) / 1e3
    per_sample = cpu / grown["samples"] * 1e6
    return grown | {"rate": grown["samples"] / seconds, "p50_us": p50, "p99_us": p99, "cpu_us": per_sample}


def main() -> int:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=10.0)
    parser.add_argument("--rates", type=float, nargs="+", default=[1000.0, 3000.0])
    parser.add_argument("--interfaces", nargs="+", default=list(SERVERS), choices=list(SERVERS))
    args = parser.parse_args()
    print(
        f"{'interface':14}{'asked Hz':>9}{'rate Hz':>9}{'lost':>6}{'missed':>8}{'p50 us':>8}{'p99 us':>8}{'CPU us':>8}"
    )
    for interface in args.interfaces:
        for rate_hz in args.rates:
            near, far = multiprocessing.Pipe()
            stop = multiprocessing.Event()
            process = multiprocessing.Process(target=SERVERS[interface], args=(far, stop), daemon=True)
            process.start()
            transport = CanTransport(CanTransport.Settings(**near.recv()))
            transport.open()
            figures = host(transport, rate_hz, args.seconds)
            transport.close()
            stop.set()
            process.join(2.0)
            print(
                f"{interface:14}{rate_hz:9.0f}{figures['rate']:9.1f}{figures['lost']:6.0f}{figures['missed']:8.0f}"
                f"{figures['p50_us']:8.0f}{figures['p99_us']:8.0f}{figures['cpu_us']:8.0f}"
            )
    return 0


if __name__ == "__main__":
    raise SystemExit(main())

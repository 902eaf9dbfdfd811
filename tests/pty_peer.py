"""A virtual serial device on a pty for as long as a client process runs: the shell that tests need, and no more."""

import os
import select
import subprocess
import sys
import termios
import time
import tty
from pathlib import Path

_SPEEDS = {getattr(termios, f"B{rate}"): rate for rate in (9600, 19200, 38400, 57600, 115200, 230400, 921600)}


def run_client(device, script: str, *args: str, at_most_s: float = 60.0) -> str:
    """Run Python source in another process with the pty's name as its first argument; its standard output.

    NDI's client holds the interpreter's lock while it waits, so that the device must live in another process.
    """
    master, slave = os.openpty()
    tty.setraw(slave)
    os.set_blocking(master, False)
    command = [sys.executable, "-c", script, os.ttyname(slave), *args]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as client:
        try:
            _pump(device, master, client, time.monotonic() + at_most_s)
            out, err = client.communicate(timeout=5)
        finally:
            client.kill()
            os.close(master)
            os.close(slave)
    assert client.returncode == 0, err
    return out


def _pump(device, master: int, client: "subprocess.Popen[str]", end: float) -> None:
    while client.poll() is None and time.monotonic() < end:
        wait = min(max(0.0, (device.wakeup_ns - time.monotonic_ns()) * 1e-9), 0.05)
        ready = select.select([master], [], [], wait)[0]
        now = time.monotonic_ns()
        if hasattr(device, "host_baud_rate"):
            device.host_baud_rate = _SPEEDS.get(termios.tcgetattr(master)[5])
        if ready:
            device.feed(os.read(master, 4096), now)
        for data in device.poll(now):
            os.write(master, data)


VECTORS = Path(__file__).parent / "vectors"


def rom(name: str = "tool") -> Path:
    """A tool definition of the vectors."""
    return VECTORS / f"ndi_{name}.rom"

"""A daemon's process tree for tests: ptys as wires, its own directories, ended whatever happens."""

import os
import pty
import select
import signal
import socket
import subprocess
import sys
import threading
import time
import tty
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO, Any

import msgspec

from galen_hw.bus import CommandClient, Subscriber
from galen_hw.config.paths import Addresses

TESTS = Path(__file__).parent
TABLES = {
    "drivers": {"sensor": "daemon_parts:LineSensor", "motors": "daemon_parts:LineMotors"},
    "transports": {"serial": "daemon_parts:PtyTransport"},
    "services": {
        "compensation": "daemon_parts:Compensation",
        "calibration": "daemon_parts:Calibration",
        "health": "galen_hw.services.health.service:HealthService",
    },
}
RUN = """
import json, logging, sys
from pathlib import Path
from galen_hw.cli import main
from galen_hw.config.load import Tables
import galen_hw.daemon.tables as tables
tables.TABLES = Tables(**json.loads(sys.argv[1]))
tables.read_setup.__defaults__ = (None, tables.TABLES)
sys.exit(main(sys.argv[2:]))
"""


class Wire:
    """The far end of a pty: writes a line at a time, keeps what it read."""

    def __init__(self) -> None:
        self.master, self._slave = pty.openpty()
        tty.setraw(self._slave)
        os.set_blocking(self.master, False)  # a line that nobody reads must not hold up the test's end
        self.path = os.ttyname(self._slave)
        self.heard = b""
        self._chatter: threading.Thread | None = None
        self._stop = threading.Event()

    def say(self, line: str) -> None:
        with suppress(BlockingIOError):
            os.write(self.master, f"{line}\n".encode())

    def hear(self, word: bytes, timeout_s: float = 10.0) -> bool:
        until = time.monotonic() + timeout_s
        while word not in self.heard:
            left = until - time.monotonic()
            if left <= 0 or not select.select([self.master], [], [], left)[0]:
                return False
            self.heard += os.read(self.master, 4096)
        return True

    def chatter(self, line: Callable[[int], str] | str, every_s: float = 0.01) -> None:
        """Say a line again and again in a thread, until `hush`."""
        make = line if callable(line) else lambda _: line

        def talk() -> None:
            n = 0
            while not self._stop.wait(every_s):
                self.say(make(n))
                n += 1

        self._stop.clear()
        self._chatter = threading.Thread(target=talk, daemon=True)
        self._chatter.start()

    def hush(self) -> None:
        self._stop.set()
        if self._chatter is not None:
            self._chatter.join()
            self._chatter = None

    def close(self) -> None:
        self.hush()
        if self.master >= 0:
            os.close(self.master)
            os.close(self._slave)
            self.master = -1


@dataclass
class Tree:
    """A daemon under test."""

    folder: Path
    sensor: Wire = field(default_factory=Wire)
    motors: Wire = field(default_factory=Wire)
    process: "subprocess.Popen[str] | None" = None
    viewers: str = ""
    said: str = ""

    @property
    def addresses(self) -> Addresses:
        return Addresses(self.folder / "run")

    @property
    def environ(self) -> dict[str, str]:
        own = {"PYTHONPATH": str(TESTS), "GALEN_HW_RUNTIME": str(self.folder / "run")}
        return os.environ | own | {"GALEN_HW_STATE": str(self.folder / "state")}

    def write_config(self, text: str = "", **devices: str) -> Path:
        wires = {"ft": self.sensor.path, "motors": self.motors.path} | devices
        path = self.folder / "galen.toml"
        path.write_text(
            f"""
[devices.ft]
driver = "sensor"
transport = {{ url = "{wires["ft"]}" }}
[devices.motors]
driver = "motors"
transport = {{ url = "{wires["motors"]}", with_fd = false }}
[services.compensation]
[services.calibration]
[bus]
viewers = ""
[daemon]
realtime_priority = 0
{text}
"""
        )
        return path

    def command(self, *words: str) -> list[str]:
        return [sys.executable, "-c", RUN, msgspec.json.encode(TABLES).decode(), *words]

    def __post_init__(self) -> None:
        self._streams: list[IO[str]] = []

    def start(self, *words: str, environ: dict[str, str] | None = None) -> "subprocess.Popen[str]":
        command = self.command("run", "--config", str(self.folder / "galen.toml"), *words)
        self.process = subprocess.Popen(
            command, env=self.environ | (environ or {}), text=True, stdout=subprocess.PIPE, stderr=subprocess.PIPE
        )
        assert self.process.stdout is not None
        assert self.process.stderr is not None
        self._streams += [self.process.stdout, self.process.stderr]
        return self.process

    def close(self) -> None:
        """End the process and the wires, whatever state they are in."""
        if self.process is not None and self.process.poll() is None:
            self.process.terminate()
            try:
                self.process.wait(timeout=15)
            except subprocess.TimeoutExpired:
                self.process.kill()
                self.process.wait()
        for stream in self._streams:
            stream.close()
        self.sensor.close()
        self.motors.close()

    def start_ready(self, *words: str) -> "subprocess.Popen[str]":
        """Start with both devices talking; back when the daemon says that it is ready."""
        self.sensor.chatter(lambda n: str(float(n)))
        self.motors.chatter("0.5", every_s=0.02)
        process = self.start(*words)
        assert process.stdout is not None
        line = process.stdout.readline()
        if not line.startswith("ready"):
            assert process.stderr is not None
            raise AssertionError(f"not ready: {line!r} {process.stderr.read()}")
        self.said = line
        return process

    def call(self, target: str, name: str, timeout_s: float = 10.0, **args: Any) -> dict[str, Any]:
        with CommandClient(self.addresses.command) as client:
            return client.call(target, name, args, timeout_s)

    def subscriber(self, *topics: str) -> Subscriber:
        return Subscriber(self.addresses.bus, topics)

    def end(self) -> tuple[int, str]:
        """SIGTERM; the exit status and what was said on stderr."""
        assert self.process is not None
        self.process.send_signal(signal.SIGTERM)
        _, stderr = self.process.communicate(timeout=30)
        return self.process.returncode, stderr


@contextmanager
def daemon_tree(folder: Path) -> Iterator[Tree]:
    """A tree whose processes and wires are gone afterwards."""
    tree = Tree(folder)
    try:
        yield tree
    finally:
        tree.close()


def alive(pid: int) -> bool:
    """A process that exists and is not a zombie."""
    try:
        return "\nState:\tZ" not in Path(f"/proc/{pid}/status").read_text()
    except FileNotFoundError:
        return False


def within(seconds: float, condition: Callable[[], bool], wait: threading.Event | None = None) -> bool:
    """Whether a condition of other processes comes true in time."""
    until = time.monotonic() + seconds
    pause = wait or threading.Event()
    while time.monotonic() < until:
        if condition():
            return True
        pause.wait(0.02)
    return condition()


class Systemd:
    """The socket on which systemd hears a service."""

    def __init__(self, folder: Path) -> None:
        self.path = str(folder / "notify")
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self._socket.bind(self.path)
        self._socket.settimeout(0.1)
        self.heard: list[str] = []

    def listen(self) -> None:
        """Take one word, or wait a moment for none."""
        try:
            self.heard.append(self._socket.recv(4096).decode())
        except TimeoutError:
            return

    def drain(self) -> None:
        """Take what waits, so that there is room for what comes."""
        while select.select([self._socket], [], [], 0.0)[0]:
            self.heard.append(self._socket.recv(4096).decode())

    def hears(self, word: str, seconds: float = 10.0) -> bool:
        """Whether a word comes in time."""

        def check() -> bool:
            self.listen()
            return word in self.heard

        return within(seconds, check)

    def hears_in(self, *words: str, seconds: float = 10.0) -> bool:
        """Whether one message with all these words comes in time."""

        def check() -> bool:
            self.listen()
            return any(all(word in line for word in words) for line in self.heard)

        return within(seconds, check)

    def close(self) -> None:
        self._socket.close()

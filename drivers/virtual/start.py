"""Start the virtual robot from another program: `--virtual` and the end-to-end tests."""

import json
import os
import select
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any, Protocol, TypeAlias

from galen_hw.drivers.virtual.control import VirtualControl
from galen_hw.errors import HardwareError


class Process(Protocol):
    """What is asked of a process, as `subprocess.Popen` has it."""

    @property
    def pid(self) -> int:
        """Of the process."""
        ...

    def poll(self) -> int | None:
        """Its status once it has ended."""
        ...

    def wait(self, timeout: float | None = None) -> int:
        """Its status when it has ended; `subprocess.TimeoutExpired` when it has not in time."""
        ...

    def terminate(self) -> None:
        """SIGTERM."""
        ...

    def kill(self) -> None:
        """SIGKILL."""
        ...


Starter: TypeAlias = Callable[[Sequence[str], Mapping[int, int]], Process]
"""Starts `galen-hw` with these words, its descriptors 0, 1 and 2 being the given ones of ours, in a session of its own."""


@dataclass(slots=True)
class VirtualRobot:
    """A virtual robot that runs.

    Args:
        folder: of its wires.
        addresses: by wire (`can0`, `motors`, `tracker`, `control`): settings of the transport that reaches it.
        files: that come with its devices, by name: `tool.rom` and `reference.rom`, the marker bodies' definitions.
        sensor: driver of the sensor on `can0`.
        control: to change its world.
    """

    folder: Path
    addresses: dict[str, dict[str, Any]]
    files: dict[str, str]
    sensor: str
    control: VirtualControl
    _process: Process
    _said: IO[bytes]

    @property
    def pid(self) -> int:
        """Of its process."""
        return self._process.pid

    @property
    def alive(self) -> bool:
        """Its process has not ended."""
        return self._process.poll() is None

    @property
    def said(self) -> str:
        """What it has written to its standard error; nothing as long as all is well."""
        self._said.seek(0)
        return self._said.read().decode("utf-8", "replace").strip()

    def close(self) -> None:
        """End it and wait until it has cleaned up."""
        self.control.close()
        if self.alive:
            self._process.terminate()
            try:
                self._process.wait(5.0)
            except subprocess.TimeoutExpired:
                self._process.kill()
                self._process.wait()
        self._said.close()


def start_virtual(
    folder: Path | str,
    *,
    sensor: str = "ati_netcanoem",
    can: str = "slcan",
    channel: str = "",
    seed: int = 0,
    tool: str | None = None,
    settings: Mapping[str, Mapping[str, Any]] | None = None,
    timeout_s: float = 60.0,
    starter: Starter | None = None,
) -> VirtualRobot:
    """Start the process and wait until it is ready; it ends with this process at the latest. Options: `Options`.

    `starter`: how; as an interpreter of its own if None.

    Raises:
        HardwareError: it does not start; its own line says why.
    """
    words = ["--dir", str(folder), "--sensor", sensor, "--can", can, "--channel", channel, "--seed", str(seed)]
    words += ["--settings", json.dumps(dict(settings or {})), "--parent-pid", str(os.getpid()), "--json"]
    words += ["--tool", tool] if tool else []
    said = tempfile.TemporaryFile(prefix="galen-virtual-")  # noqa: SIM115 - closed by `VirtualRobot.close`
    reading, writing = os.pipe()
    # Its errors go not to a pipe: nobody reads it while the robot runs, and a full one would stop the robot.
    with open(os.devnull, "rb") as nothing:  # noqa: PTH123
        process = (starter or _execute)(["virtual", *words], {0: nothing.fileno(), 1: writing, 2: said.fileno()})
    os.close(writing)
    line = _first_line(reading, time.monotonic() + timeout_s)
    os.close(reading)
    if not line.startswith(b'{"ready"'):
        process.kill()
        process.wait()
        said.seek(0)
        lines = said.read().decode("utf-8", "replace").strip().splitlines() or ["no answer"]
        said.close()
        raise HardwareError(lines[-1].removeprefix("galen-hw virtual: "), where="virtual robot")
    ready = json.loads(line)
    return VirtualRobot(Path(folder), ready["addresses"], ready["files"], sensor, VirtualControl(folder), process, said)


def _execute(words: Sequence[str], fds: Mapping[int, int]) -> Process:
    """The `Starter` that needs nobody. Ctrl-C is for the command: it ends the virtual robot itself, and last."""
    command = [sys.executable, "-m", "galen_hw.cli", *words]
    return subprocess.Popen(command, stdin=fds[0], stdout=fds[1], stderr=fds[2], start_new_session=True)


@contextmanager
def virtual_robot(folder: Path | str | None = None, **options: Any) -> Iterator[VirtualRobot]:
    """`start_virtual` for a `with` statement; in a temporary folder if none is given."""
    with tempfile.TemporaryDirectory(prefix="galen-virtual-") as temporary:
        robot = start_virtual(folder or temporary, **options)
        try:
            yield robot
        finally:
            robot.close()


def _first_line(stream: int, deadline: float) -> bytes:
    """The first line of the process's output; what has come of it when it ends or time is up."""
    line = b""
    while not line.endswith(b"\n"):
        wait = deadline - time.monotonic()
        if wait <= 0.0 or not select.select([stream], (), (), wait)[0]:
            return line
        chunk = os.read(stream, 4096)
        if not chunk:
            return line
        line += chunk
    return line

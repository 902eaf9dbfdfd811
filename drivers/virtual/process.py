"""The virtual robot as a process: one event loop for all virtual devices, behind ptys in one folder."""

import fcntl
import importlib
import json
import os
import select
import signal
import socket
import sys
import time
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final, Self

import msgspec
import zmq

from galen_hw.drivers.table import VIRTUAL_DEVICES
from galen_hw.drivers.virtual.bridges import open_can_port
from galen_hw.drivers.virtual.commands import Commands
from galen_hw.drivers.virtual.control import CONTROL_NAME
from galen_hw.drivers.virtual.ports import Port, SerialPort
from galen_hw.drivers.virtual.ptys import Pty
from galen_hw.drivers.virtual.world import World
from galen_hw.errors import HardwareError, UsageError

SENSORS: Final = ("ati_netcanoem", "robotous_rft", "iit_strain")
_SERIAL: Final = {"motors": "galil_dmc", "tracker": "ndi_tracker"}
_LONGEST_SOCKET_PATH: Final = 107
_IDLE_S: Final = 0.1
_STALL_NS: Final = 20_000_000
"""This process was kept from running so long beyond the time it had asked for."""


@dataclass(frozen=True, slots=True)
class Options:
    """How the virtual robot is set up.

    Args:
        folder: of the links, the control socket and the lock.
        sensor: row of `VIRTUAL_DEVICES` on the CAN bus.
        can: "slcan" (a pty), "socketcan", "udp_multicast" or "socketcand"; channel: of the latter ones.
        seed: of noise; tool: in the holder at first.
        settings: by device (row of the table): overrides of its `Settings`.
        parent_pid: end with that process.
    """

    folder: Path
    sensor: str = "ati_netcanoem"
    can: str = "slcan"
    channel: str = ""
    seed: int = 0
    tool: str | None = None
    settings: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    parent_pid: int | None = None


def make_device(row: str, world: World, settings: Mapping[str, Any]) -> Any:
    """The virtual device of a row of `VIRTUAL_DEVICES`.

    Raises:
        UsageError: no such row, or settings that it does not have.
    """
    if row not in VIRTUAL_DEVICES:
        raise UsageError(f"no virtual device {row!r}", where="virtual", todo=f"one of: {', '.join(VIRTUAL_DEVICES)}")
    module, _, name = VIRTUAL_DEVICES[row].partition(":")
    kind = getattr(importlib.import_module(module), name)
    try:
        return kind(kind.Settings(**settings), world)
    except ValueError as error:
        raise UsageError(str(error).replace("\n", " "), where=f"settings of {row}", todo="correct them") from error


class VirtualProcess:
    """World, devices, ports and control socket; closes all of them as a context manager.

    Args:
        options: see `Options`.
        clock: ns.

    Raises:
        HardwareError: another virtual robot runs in the folder, or a CAN channel cannot be opened.
        UsageError: bad options.
    """

    def __init__(self, options: Options, clock: Callable[[], int] = time.monotonic_ns) -> None:
        if options.sensor not in SENSORS:
            todo = f"one of: {', '.join(SENSORS)}"
            raise UsageError(f"no virtual sensor {options.sensor!r}", where="--sensor", todo=todo)
        self._options, self.clock = options, clock
        self.world = World(seed=options.seed)
        self.world.attach(options.tool)
        rows = {"can0": options.sensor, **_SERIAL}
        self.devices = {name: make_device(row, self.world, options.settings.get(row, {})) for name, row in rows.items()}
        self.ports: dict[str, Port] = {}
        self._stack = ExitStack()

    def __enter__(self) -> Self:
        with ExitStack() as stack:
            self._lock(stack)
            self._open_ports(stack)
            self._control = self._bind(stack)
            self.commands = Commands(self.world, self.devices, self.ports, self.clock)
            self._stack = stack.pop_all()
        return self

    def __exit__(self, *_: object) -> None:
        self._stack.close()

    def _open_ports(self, stack: ExitStack) -> None:
        """The wires and the files; first those of the motors: the sensor then reads where the joints are now."""
        options = self._options
        for name in _SERIAL.keys() & self.devices.keys():
            self._add(stack, name, SerialPort(Pty(options.folder / name), self.devices[name]))
        port = open_can_port(options.can, options.channel, options.folder / "can0", self.devices["can0"])
        self._add(stack, "can0", port)
        for device in self.devices.values():
            for name, content in getattr(device, "files", {}).items():
                self._put(stack, options.folder / name, content)

    @property
    def files(self) -> dict[str, str]:
        """Where the files that come with the devices are, by name: the tool definitions of the marker bodies."""
        names = (name for device in self.devices.values() for name in getattr(device, "files", {}))
        return {name: str(self._options.folder / name) for name in names}

    @property
    def addresses(self) -> dict[str, dict[str, str | int]]:
        """Settings of the transports that reach each device, and the control socket."""
        control: dict[str, str | int] = {"url": f"ipc://{self._options.folder / CONTROL_NAME}"}
        return {**{name: port.address for name, port in self.ports.items()}, "control": control}

    def serve(self) -> None:
        """Run until told to stop: SIGTERM, SIGINT, the control socket, or the end of the parent process."""
        with ExitStack() as stack:
            endings = _endings(stack, self._options.parent_pid)
            by_descriptor = {port.fileno(): port for port in self.ports.values()}
            ports = list(self.ports.values())
            control = int(self._control.fileno())
            watched = [*by_descriptor, control, *endings]
            while not self.commands.stopped:
                wake = min([port.wakeup_ns for port in ports])
                wait = min(max(0.0, (wake - time.monotonic_ns()) * 1e-9), _IDLE_S)
                ready = select.select(watched, (), (), wait)[0]
                now = time.monotonic_ns()
                self._excuse(now - wake)
                self.world.advance(now)
                for descriptor in ready:
                    if descriptor in by_descriptor:
                        by_descriptor[descriptor].read(now)
                    elif descriptor in endings:
                        return
                for port in ports:
                    if port.wakeup_ns <= now:
                        port.write(now)
                if control in ready or not ready:
                    self._answer_control()

    def _excuse(self, late_ns: int) -> None:
        """A busy machine is no silence of the host: a controller's own clock stands while this process cannot run."""
        if late_ns > _STALL_NS:
            self.commands.stalls += 1
            for device in self.devices.values():
                if hasattr(device, "stand"):
                    device.stand(late_ns)

    def _answer_control(self) -> None:
        """ZeroMQ's descriptor tells of changes only: take all there is."""
        while int(self._control.get(zmq.EVENTS)) & zmq.POLLIN:
            try:
                request = msgspec.msgpack.decode(self._control.recv_multipart()[-1])
            except (msgspec.DecodeError, ValueError, RecursionError):  # ValueError: text that is not UTF-8
                request = None
            self._control.send(msgspec.msgpack.encode(self.commands.carry_out(request)))

    def _add(self, stack: ExitStack, name: str, port: Port) -> None:
        stack.callback(port.close)
        self.ports[name] = port

    def _put(self, stack: ExitStack, path: Path, content: bytes) -> None:
        path.write_bytes(content)
        stack.callback(path.unlink, missing_ok=True)

    def _lock(self, stack: ExitStack) -> None:
        folder = self._options.folder
        try:
            folder.mkdir(parents=True, exist_ok=True)
            lock = stack.enter_context((folder / "lock").open("a+", encoding="ascii"))
        except OSError as error:
            raise UsageError(f"cannot be used ({error.strerror})", where=str(folder), todo="choose --dir") from error
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            lock.seek(0)
            raise HardwareError(
                f"a virtual robot runs here already (process {lock.read().strip() or '?'})",
                where=str(folder),
                todo="stop it or choose another --dir",
            ) from error
        lock.truncate(0)
        lock.write(str(os.getpid()))
        lock.flush()

    def _bind(self, stack: ExitStack) -> "zmq.Socket[bytes]":
        path = self._options.folder / CONTROL_NAME
        if len(os.fsencode(path)) > _LONGEST_SOCKET_PATH:
            raise UsageError("path too long for a socket", where=str(path), todo="choose a shorter --dir")
        context = stack.enter_context(zmq.Context())
        control = stack.enter_context(context.socket(zmq.REP))
        control.setsockopt(zmq.LINGER, 200)
        control.bind(f"ipc://{path}")
        stack.callback(path.unlink, missing_ok=True)
        return control


def _endings(stack: ExitStack, parent_pid: int | None) -> list[int]:
    """Descriptors that become readable when it is time to stop."""
    ours, theirs = socket.socketpair()
    stack.callback(ours.close)
    stack.callback(theirs.close)
    theirs.setblocking(False)
    stack.callback(signal.set_wakeup_fd, signal.set_wakeup_fd(theirs.fileno()))
    for number in (signal.SIGTERM, signal.SIGINT):
        stack.callback(signal.signal, number, signal.signal(number, lambda *_: None))
    if parent_pid is None:
        return [ours.fileno()]
    try:
        parent = os.pidfd_open(parent_pid)
    except ProcessLookupError:
        os.kill(os.getpid(), signal.SIGTERM)
        return [ours.fileno()]
    stack.callback(os.close, parent)
    return [ours.fileno(), parent]


def run(options: Options, *, as_json: bool) -> int:
    """Serve until stopped; prints the addresses and READY, or one line of JSON."""
    with VirtualProcess(options) as process:
        if as_json:
            ready = {"ready": True, "dir": str(options.folder), "sensor": options.sensor}
            print(json.dumps({**ready, "addresses": process.addresses, "files": process.files}), flush=True)
        else:
            for name, address in process.addresses.items():
                print(f"{name:8}" + " ".join(f"{key}={value}" for key, value in address.items()))
            for name, path in process.files.items():
                print(f"{name:15}{path}")
            print("READY", flush=True)
        process.serve()
    sys.stdout.flush()
    return 0

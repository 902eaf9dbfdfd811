"""CAN through python-can: SocketCAN, slcan adapters, udp multicast, socketcand, and `virtual` inside one process."""

import logging
import os
import socket
import time
from pathlib import Path
from typing import Any, Final, Literal, Self, TypeAlias

import can
from can.interfaces.slcan import slcanBus
from pydantic import BaseModel, ConfigDict, Field, model_validator

from galen_hw.drivers.can_errors import ERROR_COUNTERS, count_error_frame, explain, is_full
from galen_hw.drivers.device import CanFrame
from galen_hw.drivers.slcan_bus import ChunkedSlcanBus
from galen_hw.drivers.transport import Transport
from galen_hw.errors import HardwareError

Interface: TypeAlias = Literal["socketcan", "slcan", "virtual", "udp_multicast", "socketcand"]
MOST_FRAMES: Final = 4096
"""Frames that one `receive` returns at most."""
CONNECT_S: Final = 2.0


class CanSettings(BaseModel):
    """Keys of a CAN wire.

    Args:
        interface: of python-can.
        channel: `can0`; a serial port (slcan); a multicast address; the name on the server (socketcand); any name
        (virtual). bitrate: bit/s. SocketCAN's is set by the system (`ip link set can0 up type can bitrate 1000000`).
        options: passed on to python-can's bus, e.g. slcan: sleep_after_open (s; 0 by itself on a pty), tty_baudrate;
            udp_multicast: port; socketcand: host, port, tcp_tune.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    interface: Interface = "socketcan"
    channel: str = Field(default="can0", min_length=1)
    bitrate: int = Field(default=1_000_000, gt=0, le=2_000_000)
    options: dict[str, bool | int | float | str] = {}

    @model_validator(mode="after")
    def _check(self) -> Self:
        if self.interface == "slcan" and self.bitrate not in slcanBus._BITRATES:  # noqa: SLF001 - its table
            raise ValueError(f"an slcan adapter's bitrate must be one of {sorted(slcanBus._BITRATES)}")  # noqa: SLF001
        if self.interface == "socketcand" and not {"host", "port"} <= set(self.options):
            raise ValueError("socketcand needs options host and port")
        return self


class CanTransport(Transport[CanFrame]):
    """An open CAN wire; standard data frames only, all else is counted.

    Each frame is stamped with CLOCK_MONOTONIC right after it was read; python-can's own stamps are of different clocks
    from interface to interface and are not used.
    """

    Settings = CanSettings

    def __init__(self, settings: CanSettings) -> None:
        self.address = f"{settings.interface}:{settings.channel}"
        self._settings = settings
        self._bus: can.BusABC | None = None
        self._slcan: ChunkedSlcanBus | None = None
        self._tcp: socket.socket | None = None
        self._counters = dict.fromkeys(("received", "sent", "unsent", "not_data", "malformed", *ERROR_COUNTERS), 0)

    def open(self) -> None:
        """See `Transport.open`."""
        self.close()
        logging.getLogger("can").setLevel(logging.CRITICAL)  # it logs what we say better, once, as HardwareError
        try:
            self._bus = self._make_bus()
        except (OSError, ValueError, TypeError, ArithmeticError, can.CanError, NotImplementedError) as error:
            raise explain(self._settings.interface, self._settings.channel, error) from error
        self._slcan = self._bus if isinstance(self._bus, ChunkedSlcanBus) else None
        # python-can's socketcand bus offers no descriptor and does not notice a closed connection
        tcp = getattr(self._bus, "_SocketCanDaemonBus__socket", None)
        self._tcp = tcp if isinstance(tcp, socket.socket) else None

    def _make_bus(self) -> can.BusABC:
        options: dict[str, Any] = dict(self._settings.options)
        channel, interface = self._settings.channel, self._settings.interface
        if interface == "slcan":
            if os.path.realpath(channel).startswith("/dev/pts/"):
                options.setdefault("sleep_after_open", 0.0)  # the pause is for adapters that boot when they are opened
            return ChunkedSlcanBus(channel, bitrate=self._settings.bitrate, **options)
        if interface == "socketcan":
            _check_socketcan(channel)
        if interface == "socketcand":
            _greet(str(options["host"]), int(options["port"]))
        return can.Bus(channel, interface, ignore_config=True, **options)

    def send(self, wires: list[CanFrame]) -> None:
        """See `Transport.send`; what a full queue does not take is counted as `unsent`, not waited for."""
        bus = self._need_bus()
        if not wires:
            return
        try:
            if self._slcan is not None:
                self._slcan.send_frames(wires)
                self._counters["sent"] += len(wires)
                return
            for frame in wires:
                self._send_one(bus, frame)
        except (OSError, can.CanError, ValueError) as error:
            raise self._gone(error) from error

    def _send_one(self, bus: can.BusABC, frame: CanFrame) -> None:
        message = can.Message(arbitration_id=frame.arbitration_id, data=frame.data, is_extended_id=False)
        try:
            bus.send(message, timeout=0.0 if self._settings.interface == "socketcan" else 0.1)
            self._counters["sent"] += 1
        except can.CanError as error:
            if not is_full(error):
                raise
            self._counters["unsent"] += 1

    def receive(self, timeout_s: float) -> list[tuple[CanFrame, int]]:
        """See `Transport.receive`."""
        bus = self._need_bus()
        try:
            if self._slcan is not None:
                frames, t_ns = self._slcan.read_frames(timeout_s)
                self._counters["received"] += len(frames)
                return [(frame, t_ns) for frame in frames]
            return self._receive_messages(bus, timeout_s)
        except (OSError, can.CanError, ValueError) as error:
            raise self._gone(error) from error

    def _receive_messages(self, bus: can.BusABC, timeout_s: float) -> list[tuple[CanFrame, int]]:
        received: list[tuple[CanFrame, int]] = []
        while len(received) < MOST_FRAMES:
            message = self._receive_one(bus, 0.0 if received else timeout_s)
            t_ns = time.monotonic_ns()
            if message is None:
                break
            frame = self._sort(message)
            if frame is not None:
                received.append((frame, t_ns))
        self._counters["received"] += len(received)
        return received

    def _receive_one(self, bus: can.BusABC, timeout_s: float) -> can.Message | None:
        try:
            message = bus.recv(timeout_s)
        except can.CanOperationError as error:
            if self._settings.interface != "udp_multicast" or isinstance(error.__cause__, OSError):
                raise
            self._counters["malformed"] += 1  # a datagram of somebody else on the group
            return None
        if message is None and self._tcp is not None and _is_closed(self._tcp):
            raise can.CanOperationError("the server closed the connection")
        return message

    def _sort(self, message: can.Message) -> CanFrame | None:
        if message.is_error_frame:
            count_error_frame(message, self._counters)
            return None
        if message.is_extended_id or message.is_remote_frame or message.is_fd:
            self._counters["not_data"] += 1
            return None
        return CanFrame(message.arbitration_id, bytes(message.data))

    def close(self) -> None:
        """See `Transport.close`."""
        bus, self._bus, self._slcan, self._tcp = self._bus, None, None, None
        if bus is None:
            return
        try:
            bus.shutdown()
        except (OSError, can.CanError):
            logging.getLogger(__name__).debug("%s was gone when it was closed", self.address)

    def fileno(self) -> int | None:
        """See `Transport.fileno`; none for `virtual`."""
        if self._tcp is not None:
            return self._tcp.fileno()
        try:
            return None if self._bus is None else self._bus.fileno()
        except NotImplementedError:
            return None

    @property
    def counters(self) -> dict[str, int]:
        """Frames in and out, and what went wrong: see `can_errors.ERROR_COUNTERS`."""
        counters = dict(self._counters)
        if self._slcan is not None:
            for name in ("rejected", "malformed", "not_data"):
                counters[name] = counters.get(name, 0) + getattr(self._slcan, name)
        return counters

    def _need_bus(self) -> can.BusABC:
        if self._bus is None:
            raise HardwareError("the wire is not open", where=self.address)
        return self._bus

    def _gone(self, error: Exception) -> HardwareError:
        return HardwareError(
            f"the wire is gone: {error}", where=self.address, todo="check the adapter and its cable; it is opened again"
        )


def _check_socketcan(channel: str) -> None:
    """Fail early and plainly where python-can would log first."""
    socket.socket(socket.PF_CAN, socket.SOCK_RAW, socket.CAN_RAW).close()
    if not Path("/sys/class/net", channel).exists():
        raise OSError(19, "no such interface")


def _greet(host: str, port: int) -> None:
    """Fail early where python-can would try for ten seconds without a pause; leave as a polite client does."""
    with socket.create_connection((host, port), CONNECT_S) as tcp:
        tcp.recv(64)


def _is_closed(tcp: socket.socket) -> bool:
    try:
        return tcp.recv(1, socket.MSG_PEEK | socket.MSG_DONTWAIT) == b""
    except BlockingIOError:
        return False

"""CAN: slcan adapters and socketcand servers on our own; SocketCAN, udp multicast and `virtual` through python-can."""

import logging
import socket
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Literal, Self, TypeAlias

from pydantic import BaseModel, ConfigDict, Field, model_validator

from galen_hw.drivers.can_errors import ERROR_COUNTERS, explain
from galen_hw.drivers.device import CanFrame
from galen_hw.drivers.slcan_wire import BITRATES, SlcanWire
from galen_hw.drivers.socketcand_wire import SocketcandWire
from galen_hw.drivers.transport import Transport
from galen_hw.drivers.wire_claim import Claim, port_key
from galen_hw.errors import HardwareError

if TYPE_CHECKING:
    from galen_hw.drivers.can_wire import CanWire
    from galen_hw.drivers.library_bus import LibraryBus

Interface: TypeAlias = Literal["socketcan", "slcan", "virtual", "udp_multicast", "socketcand"]
COUNTERS: Final = (
    "received",  # data frames
    "sent",
    "unsent",  # the interface had no room for them
    "not_data",  # extended and remote frames, CAN FD
    "malformed",  # text of an adapter or server that is none
    "reopened",  # an adapter's channel, after nothing had been heard for long
    *ERROR_COUNTERS,
)
MOST_NEWS: Final = 8
_OWN_OPTIONS: Final[dict[str, dict[str, type]]] = {
    "slcan": {"tty_baudrate": int, "sleep_after_open": float, "rtscts": bool, "listen_only": bool},
    "socketcand": {"host": str, "port": int, "tcp_tune": bool},
}
"""Options of the wires that are our own, and their types; `tcp_tune` is always done."""


_TYPES: Final = {int: "a whole number", float: "a number", bool: "true or false", str: "a text"}


class CanSettings(BaseModel):
    """Keys of a CAN wire.

    Args:
        interface: as python-can names them.
        channel: `can0`; a serial port (slcan); a multicast address; the name on the server (socketcand); any name
        (virtual). bitrate: bit/s. SocketCAN's is set by the system (`ip link set can0 up type can bitrate 1000000`).
        options: slcan: sleep_after_open (s; 0 by itself on a pty), tty_baudrate, rtscts, listen_only; socketcand: host,
            port; the others are passed on to python-can's bus, e.g. udp_multicast: port.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    interface: Interface = "socketcan"
    channel: str = Field(default="can0", min_length=1)
    bitrate: int = Field(default=1_000_000, gt=0, le=2_000_000)
    options: dict[str, bool | int | float | str] = {}

    @model_validator(mode="after")
    def _check(self) -> Self:
        if self.interface == "slcan" and self.bitrate not in BITRATES:
            raise ValueError(f"an slcan adapter's bitrate must be one of {sorted(BITRATES)}")
        if self.interface == "socketcand" and not {"host", "port"} <= set(self.options):
            raise ValueError("socketcand needs options host and port")
        if self.interface in _OWN_OPTIONS:
            self._check_options(_OWN_OPTIONS[self.interface])
        return self

    def _check_options(self, known: dict[str, type]) -> None:
        for key, value in self.options.items():
            if key not in known:
                raise ValueError(f"{self.interface} has no option {key}; it knows {', '.join(known)}")
            if type(value) is not known[key] and not (known[key] is float and type(value) is int):
                raise ValueError(f"option {key} of {self.interface} must be {_TYPES[known[key]]}, not {value!r}")


class CanTransport(Transport[CanFrame]):
    """An open CAN wire; standard data frames only, all else is counted."""

    Settings = CanSettings

    def __init__(self, settings: CanSettings) -> None:
        self.address = f"{settings.interface}:{settings.channel}"
        self._settings = settings
        self.bus_bit_rate = settings.bitrate
        self._bus: LibraryBus | None = None
        self._text: CanWire | None = None
        self._claim: Claim | None = None
        self._counters = dict.fromkeys(COUNTERS, 0)

    def open(self) -> None:
        """See `Transport.open`."""
        self.close()
        try:
            self._take()
        except (OSError, ValueError, TypeError, ArithmeticError, NotImplementedError) as error:
            self.close()
            raise explain(self._settings.interface, self._settings.channel, error) from error
        except HardwareError:
            self.close()
            raise

    def _take(self) -> None:
        options: dict[str, Any] = dict(self._settings.options)
        channel, interface = self._settings.channel, self._settings.interface
        if interface == "slcan":
            self._claim = Claim(channel if "://" in channel else port_key(channel), self.address)
            self._text = SlcanWire(channel, self._settings.bitrate, self._counters, **options)
        elif interface == "socketcand":
            host, port = str(options["host"]), int(options["port"])
            self._claim = Claim(f"socketcand:{host}:{port}/{channel}", self.address, shared=True, alone=self.alone)
            self._text = SocketcandWire(channel, host, port, self._counters)
        else:
            if interface == "socketcan":
                self._claim = Claim(f"socketcan:{channel}", self.address, shared=True, alone=self.alone)
                _check_socketcan(channel)
            from galen_hw.drivers.library_bus import LibraryBus

            self._bus = LibraryBus(interface, channel, self._counters, **options)

    def send(self, wires: list[CanFrame]) -> None:
        """See `Transport.send`; what a full queue does not take is counted as `unsent`, not waited for."""
        if not wires:
            return
        try:
            if self._text is not None:
                self._text.send_frames(wires)
                self._counters["sent"] += len(wires)
                return
            self._need_bus().send(wires)
        except (OSError, ValueError) as error:
            raise self._gone(error) from error

    def receive(self, timeout_s: float) -> list[tuple[CanFrame, int]]:
        """See `Transport.receive`."""
        try:
            if self._text is not None:
                frames, t_ns = self._text.read_frames(timeout_s)
                self._counters["received"] += len(frames)
                return [(frame, t_ns) for frame in frames]
            bus = self._need_bus()
            try:
                return bus.receive(timeout_s)
            finally:
                if bus.news:
                    self.news, bus.news = [*self.news, *bus.news][-MOST_NEWS:], []
        except (OSError, ValueError) as error:
            raise self._gone(error) from error

    def tend(self, now_ns: int) -> None:
        """See `Transport.tend`: an slcan adapter's channel that was closed is opened again."""
        if self._text is None or now_ns < self._text.wakeup_ns:
            return
        try:
            self._text.tend(now_ns)
        except OSError as error:
            raise self._gone(error) from error

    @property
    def wakeup_ns(self) -> int:
        """See `Transport.wakeup_ns`."""
        return super().wakeup_ns if self._text is None else self._text.wakeup_ns

    def close(self) -> None:
        """See `Transport.close`."""
        bus, text, claim = self._bus, self._text, self._claim
        self._bus = self._text = self._claim = None
        try:
            if text is not None:
                text.close()
            if bus is not None:
                bus.close()
        except OSError:
            logging.getLogger(__name__).debug("%s was gone when it was closed", self.address)
        if claim is not None:
            claim.close()

    def fileno(self) -> int | None:
        """See `Transport.fileno`; none for `virtual`."""
        if self._text is not None:
            return self._text.fd
        return None if self._bus is None else self._bus.fileno()

    @property
    def counters(self) -> dict[str, int]:
        """See `COUNTERS`."""
        return dict(self._counters)

    def _need_bus(self) -> "LibraryBus":
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

"""Serial lines through pyserial: a port of this machine, `socket://host:port`, `rfc2217://`, `loop://`."""

import contextlib
import errno
import io
import select
import time
from typing import Final, NoReturn

import serial
from pydantic import BaseModel, ConfigDict, Field

from galen_hw.drivers.serial_line import LineChange, LineControl
from galen_hw.drivers.transport import Transport
from galen_hw.drivers.wire_claim import Claim, keep_others_out, port_key
from galen_hw.errors import HardwareError

CHUNK: Final = 65536
_CLOSED: Final = "the wire is not open"
_REASONS: Final[dict[int, tuple[str, str]]] = {
    errno.ENOENT: ("no such port", "plug it in and look at galen-hw find"),
    errno.ENODEV: ("no such port", "plug it in and look at galen-hw find"),
    errno.ENXIO: ("no such port", "plug it in and look at galen-hw find"),
    errno.EACCES: ("no permission to open the port", "add the user to the group dialout and log in again"),
    errno.EPERM: ("no permission to open the port", "add the user to the group dialout and log in again"),
    errno.EBUSY: ("the port is in use by another program", "end the other program; lsof PORT names it"),
    errno.EAGAIN: ("the port is in use by another program", "end the other program; lsof PORT names it"),
    errno.ENOTTY: ("not a serial port", "check the url in the configuration"),
    errno.EISDIR: ("a folder, not a serial port", "check the url in the configuration"),
    errno.EINVAL: ("the port does not take these settings", "check baud_rate"),
    errno.ECONNREFUSED: ("nothing listens at that address", "check host and port, and that the device is on"),
    errno.EHOSTUNREACH: ("no route to that host", "check cable and address"),
    errno.ETIMEDOUT: ("no answer from that host", "check cable and address"),
}


class SerialSettings(BaseModel):
    """Keys of a serial wire, 8N1.

    Args:
        url: a port (/dev/serial/by-id/...), or a URL of pyserial: socket://host:port, rfc2217://host:port, loop://.
        baud_rate: bit/s; a device may change it (a tracker's COMM).
        rtscts, xonxoff: flow control by lines or by characters.
        low_latency: ask the adapter's driver not to wait for more bytes (FTDI: 16 ms by itself).
        write_timeout_s: longest wait for a peer that takes no bytes.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    url: str = Field(default="/dev/ttyUSB0", min_length=1)
    baud_rate: int = Field(default=115200, gt=0)
    rtscts: bool = False
    xonxoff: bool = False
    low_latency: bool = True
    write_timeout_s: float = Field(default=1.0, gt=0)


class SerialTransport(Transport[bytes]):
    """An open serial wire, for this program alone (flock); each read is stamped right after it.

    Args:
        settings: see `SerialSettings`.
    """

    Settings = SerialSettings

    def __init__(self, settings: SerialSettings) -> None:
        self.address = settings.url
        self._settings = settings
        self._port: serial.Serial | None = None
        self._fd: int | None = None
        self._claim: Claim | None = None
        self._counters = dict.fromkeys(("bytes_in", "bytes_out", "reads", "line_changes"), 0)

    def open(self) -> None:
        """See `Transport.open`."""
        settings = self._settings
        self.close()
        try:
            # Before the port is touched: opening it alone changes its speed and drops what another program waits for.
            self._claim = _claim(settings.url)
            self._port = serial.serial_for_url(
                settings.url,
                baudrate=settings.baud_rate,
                rtscts=settings.rtscts,
                xonxoff=settings.xonxoff,
                timeout=0,
                write_timeout=settings.write_timeout_s,
                exclusive=True,
            )
        except (serial.SerialException, OSError, ValueError) as error:
            self.close()
            self._explain(error)
        with contextlib.suppress(io.UnsupportedOperation, AttributeError):
            self._fd = self._port.fileno()
            keep_others_out(self._fd, settings.url)
        if settings.low_latency:
            # pseudo terminals and most adapters but FTDI's know no such mode
            with contextlib.suppress(ValueError, NotImplementedError, AttributeError, OSError):
                self._port.set_low_latency_mode(True)

    def send(self, wires: list[bytes]) -> None:
        """See `Transport.send`; a `LineControl` among them is carried out in its turn."""
        port = self._open_port()
        try:
            for wire in wires:
                if isinstance(wire, LineControl):
                    self._change(port, wire.change)
                else:
                    port.write(wire)
                    self._counters["bytes_out"] += len(wire)
        except (serial.SerialException, OSError) as error:
            self._gone(error)

    def receive(self, timeout_s: float) -> list[tuple[bytes, int]]:
        """See `Transport.receive`; at most one chunk."""
        port = self._open_port()
        try:
            data = self._read(port, timeout_s)
        except (serial.SerialException, OSError, TypeError, ValueError) as error:  # the last two: closed meanwhile
            self._gone(error)
        t_ns = time.monotonic_ns()
        if not data:
            return []
        self._counters["reads"] += 1
        self._counters["bytes_in"] += len(data)
        return [(data, t_ns)]

    def close(self) -> None:
        """See `Transport.close`."""
        port, self._port, self._fd = self._port, None, None
        if port is not None:
            with contextlib.suppress(serial.SerialException, OSError):
                port.close()
        if self._claim is not None:
            self._claim.close()
            self._claim = None

    def fileno(self) -> int | None:
        """See `Transport.fileno`."""
        return self._fd

    @property
    def counters(self) -> dict[str, int]:
        """Bytes in and out, reads, changes of the line."""
        return dict(self._counters)

    def _read(self, port: serial.Serial, timeout_s: float) -> bytes:
        if self._fd is not None:
            readable, _, _ = select.select([self._fd], [], [], timeout_s)
            return bytes(port.read(CHUNK)) if readable else b""
        if port.timeout != timeout_s:
            port.timeout = timeout_s
        first = bytes(port.read(1))
        return first + bytes(port.read(port.in_waiting)) if first else b""

    def _change(self, port: serial.Serial, change: LineChange) -> None:
        """Let what was written leave, then change the line."""
        self._counters["line_changes"] += 1
        if self._fd is not None and hasattr(port, "flush"):
            port.flush()
        if change.baud_rate is not None and port.baudrate != change.baud_rate:
            port.baudrate = change.baud_rate
        if change.break_on is not None:
            with contextlib.suppress(OSError):  # a pseudo terminal has no break
                port.break_condition = change.break_on

    def _open_port(self) -> serial.Serial:
        if self._port is None:
            raise HardwareError(_CLOSED, where=self.address)
        return self._port

    def _explain(self, error: Exception) -> NoReturn:
        """One line for an opening that failed."""
        text = str(error)
        code = getattr(error, "errno", None) or getattr(error.__context__, "errno", None)
        if "exclusively lock" in text:
            code = errno.EBUSY
        elif "onfigure port" in text and code is None:
            code = errno.ENOTTY
        if isinstance(error, ValueError) and "protocol" in text:
            raise HardwareError(
                "not a port and not a URL that is known",
                where=self.address,
                todo="write /dev/... or socket://host:port",
            ) from None
        named = [known for known in _REASONS if f"rrno {known}]" in text or f"({known}," in text]
        what, todo = _REASONS.get(code if code in _REASONS else (named[0] if named else 0), (text, "check the url"))
        raise HardwareError(what, where=self.address, todo=todo) from None

    def _gone(self, error: Exception) -> NoReturn:
        if isinstance(error, serial.SerialTimeoutException):
            what, todo = "the device takes no bytes", "check flow control, cable and power"
        else:
            what, todo = "the device is gone", "check cable and power; it is tried again"
        raise HardwareError(what, where=self.address, todo=todo) from None


def _claim(url: str) -> Claim | None:
    """The claim of a port of this machine or of a server's port; nobody else can have a loop."""
    scheme, mark, _ = url.partition("://")
    if not mark:
        return Claim(port_key(url), url)
    return Claim(url, url) if scheme in ("socket", "rfc2217") else None

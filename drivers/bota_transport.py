"""The wire of a Bota sensor: the lines of a process of its own that has the vendor's driver (`bota.process` says why)."""

import contextlib
import select
import socket
import subprocess
import sys
import threading
from typing import Final, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, model_validator

from galen_hw.drivers.bota.codec import LONGEST
from galen_hw.drivers.bota.process import STAMP
from galen_hw.drivers.transport import Transport
from galen_hw.drivers.wire_claim import Claim, port_key
from galen_hw.errors import HardwareError
from galen_hw.extras import MissingExtraError, need

MOST_AT_ONCE: Final = 256
_TODO_REACH: Final = "check power, cable, interface and address"
_TODO_GONE: Final = "check its power and cable; it is opened again"


class BotaWireSettings(BaseModel):
    """Keys of a Bota sensor's wire; names and modes are those of the vendor's package.

    Args:
        interface: as the package calls it; Bota_Dummy is a sensor of the package's own, at 10 Hz, that needs no hardware.
        address: serial port (Bota_Binary...), CAN interface that is up (Bota_CAN...), network interface
            (CANopen_over_EtherCAT...; Python then needs the rights cap_net_raw and cap_net_admin) or IP address (Bota_Socket).
        baud_rate: of a serial port, bit/s.
        device_id: on CAN.
        app_mode, app_submode: what the sensor measures and how often, see its manual.
        sinc_length: of the filter of a sensor of the first generation (..._gen0), which gives its rate too.
        open_timeout_s: longest that the package may take to open, start or stop the sensor.
        silent_s: a sensor that gives no frame for so long is opened anew.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    interface: Literal[
        "Bota_Binary",
        "Bota_Binary_gen0",
        "Bota_Socket",
        "Bota_CAN",
        "Bota_CAN_FD",
        "Bota_CAN_Robot",
        "CANopen_over_EtherCAT",
        "CANopen_over_EtherCAT_gen0",
        "Bota_Dummy",
    ] = "Bota_Binary"
    address: str = Field(default="", examples=["/dev/serial/by-id/usb-Bota_Systems-if00"])
    baud_rate: int = Field(default=460_800, gt=0)
    device_id: int = Field(default=1, ge=0, le=255)
    app_mode: int = Field(default=0, ge=0, le=255)
    app_submode: int = Field(default=0, ge=0, le=255)
    sinc_length: int = Field(default=512, ge=1, le=65535)
    open_timeout_s: float = Field(default=20.0, gt=0.0, le=120.0)
    silent_s: float = Field(default=2.0, ge=0.05, le=60.0)

    @model_validator(mode="after")
    def _check(self) -> Self:
        if not self.address and self.interface != "Bota_Dummy":
            raise ValueError(f"{self.interface} needs an address")
        if self.interface == "Bota_CAN_Robot" and not 1 <= self.device_id <= 20:
            raise ValueError("device_id of Bota_CAN_Robot must be 1 to 20")
        return self


class BotaTransport(Transport[bytes]):
    """An open Bota sensor; each line bears the time at which the package handed its frame over.

    Args:
        settings: see `BotaWireSettings`.
    """

    Settings = BotaWireSettings

    def __init__(self, settings: BotaWireSettings) -> None:
        self.address = f"{settings.interface}:{settings.address}" if settings.address else settings.interface
        self._settings = settings
        self._link: socket.socket | None = None
        self._process: subprocess.Popen[bytes] | None = None
        self._claim: Claim | None = None
        self._last_word: str | None = None
        self._counters = dict.fromkeys(("lines_in", "lines_out", "reads"), 0)

    def open(self) -> None:
        """See `Transport.open`; returns when the sensor is configured, after seconds with some."""
        self.close()
        try:
            need("bota", self.address)
        except MissingExtraError as error:
            raise HardwareError(error.what, where=self.address, todo=error.todo) from None
        try:
            self._claim = self._take_claim()
            self._begin()
            self._await_opened()
        except OSError as error:
            self.close()
            what = error.strerror or str(error)
            raise HardwareError(what, where=self.address, todo=_TODO_REACH) from None
        except HardwareError:
            self.close()
            raise

    def send(self, wires: list[bytes]) -> None:
        """See `Transport.send`."""
        link = self._open_link()
        try:
            for wire in wires:
                link.send(wire)
                self._counters["lines_out"] += 1
        except OSError:
            raise self._gone() from None

    def receive(self, timeout_s: float) -> list[tuple[bytes, int]]:
        """See `Transport.receive`."""
        link = self._open_link()
        if timeout_s:
            select.select([link], [], [], timeout_s)
        received: list[tuple[bytes, int]] = []
        self._counters["reads"] += 1
        while len(received) < MOST_AT_ONCE and (got := self._next(link)) is not None:
            received.append(got)
        self._counters["lines_in"] += len(received)
        if not received and self._last_word is not None:
            raise self._gone()
        return received

    def close(self) -> None:
        """See `Transport.close`: the process brings the sensor to rest and ends; it is not waited for here."""
        link, process, claim = self._link, self._process, self._claim
        self._link = self._process = self._claim = self._last_word = None
        if link is not None:
            link.close()
        if process is not None:
            words = (process, claim, self._settings.open_timeout_s)
            threading.Thread(target=_see_out, args=words, name="bota end", daemon=True).start()
        elif claim is not None:
            claim.close()

    def fileno(self) -> int | None:
        """See `Transport.fileno`."""
        return None if self._link is None else self._link.fileno()

    @property
    def counters(self) -> dict[str, int]:
        """Lines in and out, reads."""
        return dict(self._counters)

    def _take_claim(self) -> Claim | None:
        """The claim of what the package opens, so that no other program of ours does; anybody may have the dummy."""
        interface, address = self._settings.interface, self._settings.address
        if interface == "Bota_Dummy":
            return None
        if interface.startswith("Bota_CAN"):
            return Claim(f"socketcan:{address}", self.address, shared=True, alone=self.alone)
        return Claim(port_key(address) if interface.startswith("Bota_Binary") else f"bota:{address}", self.address)

    def _begin(self) -> None:
        ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self._link = ours
        with theirs:
            words = ["-m", "galen_hw.drivers.bota.process", str(theirs.fileno()), self._settings.model_dump_json()]
            self._process = subprocess.Popen(
                [sys.executable, *words], pass_fds=(theirs.fileno(),), stdin=subprocess.DEVNULL
            )
        ours.setblocking(False)

    def _await_opened(self) -> None:
        link = self._open_link()
        if not select.select([link], [], [], self._settings.open_timeout_s + 5.0)[0]:
            raise HardwareError("the vendor's driver does not come up", where=self.address, todo=_TODO_REACH)
        if (word := self._next(link)) is not None or self._last_word != "":
            what = self._last_word if word is None and self._last_word else "the vendor's driver has ended at its start"
            raise HardwareError(what, where=self.address, todo=_TODO_REACH)
        self._last_word = None

    def _next(self, link: socket.socket) -> tuple[bytes, int] | None:
        """The next line with its time; None when there is none, or after the last (`_last_word` is then set)."""
        if self._last_word is not None:
            return None
        try:
            got = link.recv(STAMP.size + LONGEST)
        except BlockingIOError:
            return None
        except OSError:
            got = b""
        if len(got) < STAMP.size:
            self._last_word = "the vendor's driver has ended: the sensor was silent for too long, or the driver failed"
            return None
        (t_ns,), line = STAMP.unpack_from(got), got[STAMP.size :]
        if t_ns == 0:
            self._last_word = line.decode("utf-8", "replace")
            return None
        return line, t_ns

    def _open_link(self) -> socket.socket:
        if self._link is None:
            raise HardwareError("the wire is not open", where=self.address)
        return self._link

    def _gone(self) -> HardwareError:
        what = self._last_word or "the vendor's driver takes no words"
        return HardwareError(what, where=self.address, todo=_TODO_GONE)


def _see_out(process: "subprocess.Popen[bytes]", claim: Claim | None, patience_s: float) -> None:
    """Wait for the end of a process whose socket is closed; only then may the sensor be opened again."""
    try:
        process.wait(patience_s + 5.0)
    except subprocess.TimeoutExpired:
        process.kill()
        with contextlib.suppress(OSError):
            process.wait()
    if claim is not None:
        claim.close()

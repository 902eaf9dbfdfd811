"""The process that has the vendor's driver: `python -m galen_hw.drivers.bota.process SOCKET SETTINGS`.

`bota_driver.BotaDriver.read_frame_blocking` keeps the interpreter's lock while it waits (1.1.16: for the whole 100 ms between
two frames of the dummy sensor), so that a thread would stop the daemon's loop as well; its C++ library writes to stdout; and it
may hang. Here it can do all this. Each frame is stamped with CLOCK_MONOTONIC, which all processes share, as soon as the package
hands it over, and sent on as one datagram: eight bytes of that time, then the line (see `codec`).

A datagram of time 0 is for `bota_transport`: empty once the sensor is configured, else why this process ends. It also ends when
its socket does, the sensor brought to rest, and by SIGALRM when a call of the package does not come back. Its priority is that
of the daemon's process which started it.
"""

import contextlib
import ctypes
import json
import os
import re
import signal
import socket
import struct
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, Final

from galen_hw.drivers.bota import codec
from galen_hw.drivers.bota.codec import IDENTIFY, START, STOP, Frame, Sensor

STAMP: Final = struct.Struct("<q")
_COLOUR: Final = re.compile(r"\x1b\[[0-9;]*m")
_METADATA: Final = re.compile(r"Metadata read from the sensor: model (.+) \((.+)\) with firmware version (.+)")
_ERROR: Final = "[bota_ERROR] "
_NOT_READ: Final = "DEFAULT_"
"""Begins what the package says where the sensor's interface does not tell."""
_LOOK_EACH: Final = 1000
"""Frames between two times that what the package has written is thrown away."""


class VendorError(Exception):
    """The package refuses or fails; in its own words."""


class Said:
    """What the package writes to stdout and stderr; the only place where it tells model, serial number and reasons."""

    def __init__(self) -> None:
        self._fd = os.memfd_create("bota")
        self._c = ctypes.CDLL(None)
        for standard in (1, 2):
            os.dup2(self._fd, standard)

    def take(self) -> list[str]:
        """Return the lines since the last time."""
        self._c.fflush(None)
        text = os.pread(self._fd, os.lseek(self._fd, 0, os.SEEK_END), 0).decode("utf-8", "replace")
        os.ftruncate(self._fd, 0)
        os.lseek(self._fd, 0, os.SEEK_SET)
        return _COLOUR.sub("", text).splitlines()


@contextmanager
def at_most(seconds: float) -> Iterator[None]:
    """End this process by SIGALRM if the block takes longer: no other way leads out of a call that keeps the lock."""
    signal.setitimer(signal.ITIMER_REAL, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)


def config_of(bota_driver: Any, settings: dict[str, Any]) -> Any:
    """Return the package's own configuration; offsets and coefficients that the sensor has stored stay as they are."""
    interface, address = settings["interface"], settings["address"]
    config = bota_driver.BotaDriverConfig()
    config.communication_interface_name = interface
    config.product_name = config.serial_number = (
        "any"  # must not be empty; another one is only a warning of the package
    )
    if interface.startswith("Bota_Binary"):
        serial = bota_driver.BotaBinaryCommunicationInterfaceConfig()
        serial.com_port, serial.baudrate = address, settings["baud_rate"]
        config.binary_communication_interface_params = serial
    elif interface.startswith("Bota_CAN"):
        can = bota_driver.BotaCanCommunicationInterfaceConfig()
        can.can_interface, can.device_id = address, settings["device_id"]
        config.can_communication_interface_params = can
    elif interface.startswith("CANopen"):
        coe = bota_driver.CoeCommunicationInterfaceConfig()
        coe.network_interface = address
        config.coe_communication_interface_params = coe
    elif interface == "Bota_Socket":
        udp = bota_driver.BotaSocketCommunicationInterfaceConfig()
        udp.sensor_ip_address = address
        config.socket_communication_interface_params = udp
    else:
        config.dummy_communication_interface_params = bota_driver.BotaDummyCommunicationInterfaceConfig()
    if interface.endswith("_gen0"):
        gen0 = bota_driver.Gen0SensorOperationConfig()
        gen0.sinc_length = settings["sinc_length"]
        config.gen0_sensor_operation_params = gen0
    else:
        gen_a = bota_driver.GenASensorOperationConfig()
        gen_a.app_mode, gen_a.app_submode = settings["app_mode"], settings["app_submode"]
        config.genA_sensor_operation_params = gen_a
    operation = bota_driver.DriverOperationConfig()
    operation.runtime_verbosity = False
    config.driver_operation_params = operation
    return config


class Vendor:
    """One sensor, configured and at rest.

    Args:
        settings: of the transport, as plain data; said: what the package writes.

    Raises:
        VendorError: it cannot be reached or configured.
    """

    def __init__(self, settings: dict[str, Any], said: Said) -> None:
        self._said, self._silent_s, self._call_s = said, settings["silent_s"], settings["open_timeout_s"]
        self._frames = 0
        self.is_streaming = False
        import bota_driver

        with self._explained():
            self._driver = bota_driver.BotaDriver(config_of(bota_driver, settings))
            self._must(self._driver.configure(), "configure")
            period_us = int(self._driver.get_expected_timestep_us())
        found = next((match for line in said.take() if (match := _METADATA.search(line))), None)
        words = ("", "", "") if found is None else found.groups()
        model, serial_number, firmware = ("" if word.startswith(_NOT_READ) else word for word in words)
        self.sensor = Sensor(model, serial_number, firmware, max(0, period_us))

    def start(self) -> None:
        """Let frames flow.

        Raises:
            VendorError: the package refuses.
        """
        if not self.is_streaming:
            with self._explained():
                self._must(self._driver.activate(), "activate")
            self.is_streaming = True

    def stop(self) -> None:
        """Let none flow.

        Raises:
            VendorError: the package refuses.
        """
        if self.is_streaming:
            self.is_streaming = False
            with self._explained():
                self._must(self._driver.deactivate(), "deactivate")

    def read(self) -> tuple[Frame, int]:
        """Wait for a frame; with our stamp, ns of CLOCK_MONOTONIC.

        Raises:
            VendorError: the package has given the sensor up.
        """
        self._frames += 1
        if self._frames % _LOOK_EACH == 0:
            self._said.take()
        try:
            with at_most(self._silent_s):
                got = self._driver.read_frame_blocking()
                t_ns = time.monotonic_ns()
        except RuntimeError as error:
            raise self._error(str(error)) from error
        return Frame(got.timestamp, got.status.val, (*got.force,), (*got.torque,), got.temperature), t_ns

    def close(self) -> None:
        """Bring the sensor to rest and give it back; what fails is nobody's concern any more."""
        with contextlib.suppress(RuntimeError), at_most(self._call_s):
            self._driver.shutdown()

    @contextmanager
    def _explained(self) -> Iterator[None]:
        try:
            with at_most(self._call_s):
                yield
        except (RuntimeError, ValueError, TypeError) as error:
            raise self._error(str(error)) from error

    def _must(self, done: bool, what: str) -> None:
        if not done:
            raise RuntimeError(f"the sensor does not {what}")

    def _error(self, text: str) -> VendorError:
        """The package's own reasons, where it has written any."""
        reasons = [line.partition(_ERROR)[2] for line in self._said.take() if _ERROR in line]
        return VendorError("; ".join(reasons) or text)


def serve(link: socket.socket, vendor: Vendor) -> None:
    """Carry words to the sensor and frames to the device, until the other end is closed.

    Raises:
        VendorError: the package gives up.
    """
    while True:
        try:
            word = link.recv(codec.LONGEST, socket.MSG_DONTWAIT if vendor.is_streaming else 0)
        except BlockingIOError:
            frame, t_ns = vendor.read()
            link.send(STAMP.pack(t_ns) + codec.encode(frame))
            continue
        if not word:
            return
        if word == START:
            vendor.start()
        elif word == STOP:
            vendor.stop()
        elif word == IDENTIFY:
            link.send(STAMP.pack(time.monotonic_ns()) + codec.encode(vendor.sensor))


def main() -> int:
    """Open the sensor, say that it is open, serve; the last word is why it ended."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the daemon, which then closes the socket
    signal.signal(signal.SIGALRM, signal.SIG_DFL)
    link, settings = socket.socket(fileno=int(sys.argv[1])), json.loads(sys.argv[2])
    with contextlib.suppress(BrokenPipeError, ConnectionResetError):
        try:
            vendor = Vendor(settings, Said())
            try:
                link.send(STAMP.pack(0))
                serve(link, vendor)
            finally:
                vendor.close()
        except (VendorError, ImportError) as error:
            link.send(STAMP.pack(0) + str(error).encode()[: codec.LONGEST])
            return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())

"""Where the virtual devices' wires end: each port joins one device to a pty or to a python-can bus."""

from abc import ABC, abstractmethod
from typing import Protocol, TypeVar

from galen_hw.drivers.device import CanFrame
from galen_hw.drivers.virtual.ptys import Pty
from galen_hw.drivers.virtual.slcan import SlcanAdapter

W = TypeVar("W", CanFrame, bytes)


class VirtualDevice(Protocol[W]):
    """The other end of a wire."""

    def feed(self, wire: W, t_ns: int) -> None:
        """Take what the host sent."""
        ...

    def poll(self, now_ns: int) -> list[W]:
        """What to send to the host now."""
        ...

    @property
    def wakeup_ns(self) -> int:
        """When `poll` wants to be called next."""
        ...


class VirtualCanDevice(VirtualDevice[CanFrame], Protocol):
    """A node on a CAN bus."""

    @property
    def bit_rate(self) -> int:
        """Of the node, bit/s; at another one it hears nothing."""
        ...


class Port(ABC):
    """One entry of the event loop."""

    address: dict[str, str | int]

    @abstractmethod
    def fileno(self) -> int:
        """Descriptor to wait for."""

    @abstractmethod
    def read(self, now_ns: int) -> None:
        """Take what has arrived, and answer."""

    @abstractmethod
    def write(self, now_ns: int) -> None:
        """Send what is due."""

    @property
    @abstractmethod
    def wakeup_ns(self) -> int:
        """When `write` is due next."""

    @abstractmethod
    def close(self) -> None:
        """Close the wire."""

    @property
    @abstractmethod
    def counters(self) -> dict[str, int]:
        """Whole numbers that only grow."""


class SerialPort(Port):
    """A serial device on a pty."""

    def __init__(self, pty: Pty, device: VirtualDevice[bytes]) -> None:
        self._pty, self._device = pty, device
        self._hears_baud_rate = hasattr(device, "host_baud_rate")
        self.address = {"url": str(pty.link)}

    def fileno(self) -> int:
        """The pty's master."""
        return self._pty.fileno()

    @property
    def wakeup_ns(self) -> int:
        """The device's."""
        return self._device.wakeup_ns

    def read(self, now_ns: int) -> None:
        """Host to device, then what it answers at once."""
        data = self._pty.read()
        if data:
            self._note_baud_rate()
            self._device.feed(data, now_ns)
        self.write(now_ns)

    def _note_baud_rate(self) -> None:
        """A device that changes its rate on command garbles what a host at another rate sends."""
        if self._hears_baud_rate:
            self._device.host_baud_rate = self._pty.baud_rate  # type: ignore[attr-defined]

    def write(self, now_ns: int) -> None:
        """Device to host."""
        self._note_baud_rate()
        for chunk in self._device.poll(now_ns):
            self._pty.write(chunk)

    def close(self) -> None:
        """Close the pty."""
        self._pty.close()

    @property
    def counters(self) -> dict[str, int]:
        """The pty's."""
        return self._pty.counters


class SlcanPort(Port):
    """A CAN node behind a virtual LAWICEL adapter on a pty."""

    def __init__(self, pty: Pty, device: VirtualCanDevice) -> None:
        self._pty, self._device = pty, device
        self._adapter = SlcanAdapter(lambda: device.bit_rate)
        self.address = {"interface": "slcan", "channel": str(pty.link), "bitrate": device.bit_rate}

    def fileno(self) -> int:
        """The pty's master."""
        return self._pty.fileno()

    @property
    def wakeup_ns(self) -> int:
        """The device's."""
        return self._device.wakeup_ns

    def read(self, now_ns: int) -> None:
        """Host to bus, and what the bus answers at once: one read, one write."""
        answer, frames = self._adapter.feed(self._pty.read())
        for frame in frames:
            self._device.feed(frame, now_ns)
        out = answer + self._adapter.encode(self._device.poll(now_ns), now_ns)
        if out:
            self._pty.write(out)

    def write(self, now_ns: int) -> None:
        """Bus to host."""
        out = self._adapter.encode(self._device.poll(now_ns), now_ns)
        if out:
            self._pty.write(out)

    def close(self) -> None:
        """Close the pty."""
        self._pty.close()

    @property
    def counters(self) -> dict[str, int]:
        """The pty's and the adapter's."""
        return {**self._pty.counters, **self._adapter.counters}

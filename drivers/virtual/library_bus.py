"""The virtual robot on a bus of python-can; loaded only where it is asked for (see galen_hw/drivers/library_bus.py)."""

import threading
import time
from collections import Counter
from typing import Final, Self

import can

from galen_hw.drivers.device import CanFrame
from galen_hw.drivers.virtual.ports import Port, VirtualCanDevice
from galen_hw.errors import HardwareError

CHANNELS: Final = {"socketcan": "vcan0", "udp_multicast": "239.74.163.2"}
_TODO: Final = {
    "socketcan": "sudo ip link add dev vcan0 type vcan && sudo ip link set vcan0 up, or use --can slcan",
    "udp_multicast": "this machine may lack multicast; use --can slcan",
}


def open_bus_port(kind: str, channel: str, device: VirtualCanDevice) -> "BusPort":
    """A port on the bus of a row of `CHANNELS`; an empty `channel` is the usual one.

    Raises:
        HardwareError: it cannot be opened.
    """
    channel = channel or CHANNELS[kind]
    try:
        bus = can.Bus(interface=kind, channel=channel)
    except (can.CanError, OSError, ValueError) as error:
        raise HardwareError(f"cannot be opened ({error})", where=f"{kind} {channel}", todo=_TODO[kind]) from error
    address: dict[str, str | int] = {"interface": kind, "channel": channel, "bitrate": device.bit_rate}
    return BusPort(bus, device, address)


class BusPort(Port):
    """A CAN node on a bus of python-can. There is no bit rate on these buses.

    Args:
        bus: open; closed with the port.
        device: the node.
        address: how a client reaches it.
    """

    def __init__(self, bus: can.BusABC, device: VirtualCanDevice, address: dict[str, str | int]) -> None:
        self._bus, self._device, self.address = bus, device, address
        self._echoes: Counter[tuple[int, bytes]] = Counter()
        self._echoing = address["interface"] == "udp_multicast"
        self._counters = {"frames_in": 0, "frames_out": 0, "send_failed": 0}

    def fileno(self) -> int:
        """The bus's socket."""
        return self._bus.fileno()

    @property
    def wakeup_ns(self) -> int:
        """The device's."""
        return self._device.wakeup_ns

    @property
    def counters(self) -> dict[str, int]:
        """Frames each way."""
        return self._counters

    def read(self, now_ns: int) -> None:
        """Everything that has arrived, and the answers."""
        while (message := self._bus.recv(0.0)) is not None:
            self.take(message, now_ns)
        self.write(now_ns)

    def take(self, message: can.Message, now_ns: int) -> None:
        """One frame for the node; a multicast sender hears itself, and must not take that for a request."""
        if message.is_extended_id or message.is_remote_frame or message.is_error_frame or message.is_fd:
            return
        key = (message.arbitration_id, bytes(message.data))
        if self._echoes[key] > 0:
            self._echoes[key] -= 1
            return
        self._counters["frames_in"] += 1
        self._device.feed(CanFrame(*key), now_ns)

    def write(self, now_ns: int) -> None:
        """What the node sends."""
        for frame in self._device.poll(now_ns):
            if self._echoing:
                self._echoes[frame.arbitration_id, frame.data] += 1
            try:
                self._bus.send(can.Message(arbitration_id=frame.arbitration_id, data=frame.data, is_extended_id=False))
                self._counters["frames_out"] += 1
            except can.CanError:
                self._counters["send_failed"] += 1  # As on a real bus: the frame is lost, the node goes on.

    def close(self) -> None:
        """Close the bus."""
        self._bus.shutdown()


class InProcessCan:
    """A virtual node on python-can's `virtual` interface, served by a thread of this process.

    Args:
        device: the node.
        channel: of the `virtual` interface; the client opens the same.
    """

    def __init__(self, device: VirtualCanDevice, channel: str) -> None:
        bus = can.Bus(interface="virtual", channel=channel)
        self._bus, self._device = bus, device
        self._port = BusPort(bus, device, {"interface": "virtual", "channel": channel})
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._serve, name=f"virtual CAN {channel}", daemon=True)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._stopping.set()
        self._thread.join()
        self._port.close()

    def _serve(self) -> None:
        while not self._stopping.is_set():
            wait = (self._port.wakeup_ns - time.monotonic_ns()) * 1e-9
            message = self._bus.recv(min(max(0.0, wait), 0.05))
            now = time.monotonic_ns()
            if message is not None:
                self._port.take(message, now)
            self._port.write(now)

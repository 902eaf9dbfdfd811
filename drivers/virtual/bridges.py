"""The CAN side of the virtual robot: a pty with a virtual adapter, a bus of python-can, or a socketcand server."""

from pathlib import Path
from typing import Final

from galen_hw.drivers.virtual.ports import Port, SlcanPort, VirtualCanDevice
from galen_hw.drivers.virtual.ptys import Pty
from galen_hw.drivers.virtual.socketcand import SocketcandPort
from galen_hw.errors import UsageError

CAN_KINDS: Final = ("slcan", "socketcan", "udp_multicast", "socketcand")


def open_can_port(kind: str, channel: str, link: Path, device: VirtualCanDevice) -> Port:
    """The port that carries `device`; see `Options`.

    Raises:
        UsageError: no such kind. HardwareError: its channel cannot be opened.
    """
    if kind == "slcan":
        return SlcanPort(Pty(link), device)
    if kind == "socketcand":
        return SocketcandPort(channel, device)
    if kind not in CAN_KINDS:
        raise UsageError(f"no CAN kind {kind!r}", where="--can", todo=f"one of: {', '.join(CAN_KINDS)}")
    from galen_hw.drivers.virtual.library_bus import open_bus_port

    return open_bus_port(kind, channel, device)

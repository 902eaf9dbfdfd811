"""The CAN side of the virtual robot: a pty with a virtual adapter, or a bus of python-can."""

from pathlib import Path

from galen_hw.drivers.virtual.ports import Port, SlcanPort, VirtualCanDevice
from galen_hw.drivers.virtual.ptys import Pty
from galen_hw.errors import UsageError


def open_can_port(kind: str, channel: str, link: Path, device: VirtualCanDevice) -> Port:
    """The port that carries `device`."""
    del channel
    if kind == "slcan":
        return SlcanPort(Pty(link), device)
    raise UsageError(f"no CAN kind {kind!r}")

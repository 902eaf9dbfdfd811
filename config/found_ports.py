"""The ports of this machine by their lasting names: serial ports by identity, CAN interfaces by their kind."""

from dataclasses import dataclass
from pathlib import Path
from typing import Final

DEV: Final = Path("/dev")
NET: Final = Path("/sys/class/net")
_CAN: Final = "280"
"""ARPHRD_CAN."""


@dataclass(frozen=True, slots=True)
class FoundPort:
    """A port.

    Args:
        kind: "serial" or "can"; name: the lasting one, for the settings; device: what it is now.
        lasting: the name stays with the device, or (by-path) with the socket that it is plugged into.
        note: what is worth knowing.
    """

    kind: str
    name: str
    device: str
    lasting: bool = True
    note: str = ""

    @property
    def setting(self) -> str:
        """The line of galen.toml."""
        if self.kind == "can":
            return f'transport = {{ interface = "socketcan", channel = "{self.name}" }}'
        return f'transport = {{ url = "{self.name}" }}'


def lasting_name(device: str, dev: Path = DEV) -> str:
    """The name by identity of a serial port, or by the socket that it is plugged into; empty where there is none."""
    try:
        target = (dev / Path(device).name).resolve()
    except (OSError, RuntimeError):
        return ""
    for folder in ("by-id", "by-path"):
        for link in _links(dev / "serial" / folder):
            if link.resolve() == target:
                return str(link)
    return ""


def found_ports(dev: Path = DEV, net: Path = NET) -> list[FoundPort]:
    """Every serial port of an adapter and every CAN interface, in the order of their names."""
    return [*_serial(dev), *_can(net)]


def _serial(dev: Path) -> list[FoundPort]:
    devices = sorted(p for stem in ("ttyUSB", "ttyACM") for p in dev.glob(f"{stem}*"))
    found = []
    for device in devices:
        name = lasting_name(str(device), dev)
        note = (
            "" if "/by-id/" in name else "has no serial number; its name is that of the socket that it is plugged into"
        )
        found.append(
            FoundPort("serial", name or str(device), str(device), bool(name), note if name else "has no lasting name")
        )
    return found


def _can(net: Path) -> list[FoundPort]:
    found = []
    for one in sorted(net.iterdir()) if net.is_dir() else ():
        if _word(one / "type") == _CAN:
            state = _word(one / "operstate") or "unknown"
            note = (
                ""
                if state == "up"
                else f"is {state}; ip link set {one.name} up type can bitrate 1000000 restart-ms 100"
            )
            found.append(FoundPort("can", one.name, one.name, note=note))
    return found


def _links(folder: Path) -> list[Path]:
    return sorted(folder.iterdir()) if folder.is_dir() else []


def _word(path: Path) -> str:
    try:
        return path.read_text(encoding="ascii").strip()
    except (OSError, UnicodeDecodeError):
        return ""

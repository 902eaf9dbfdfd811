"""Port handles of the virtual tracker: asked for, given a tool definition, initialised, enabled."""

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Final

from galen_hw.drivers.virtual.ndi_tracker.definition import is_definition
from galen_hw.drivers.virtual.ndi_tracker.wire import (
    INVALID_HANDLE,
    INVALID_PRIORITY,
    NO_HANDLE_LEFT,
    NO_TOOL,
    NOT_INITIALISABLE,
    OUT_OF_RANGE,
    TOO_LONG,
    TOO_SHORT,
    TOOL_NOT_ENABLED,
    TOOL_NOT_INITIALISED,
    WRONG_PARAMETERS,
    NdiError,
)

if TYPE_CHECKING:
    from collections.abc import Callable

_HANDLES: Final = 24
_ROM_BYTES: Final = 1024
_CHUNK: Final = 64

IN_PORT: Final = 0x01
INITIALISED: Final = 0x10
ENABLED: Final = 0x20
OUT_OF_VOLUME: Final = 0x40
PARTLY_OUT: Final = 0x80


@dataclass(slots=True)
class Port:
    """One handle.

    Args:
        handle: its number; marker: index of the marker in the scene that it will see.
    """

    handle: int
    marker: int
    rom: bytearray = field(default_factory=lambda: bytearray(_ROM_BYTES))
    loaded: bool = False
    initialised: bool = False
    enabled: bool = False

    @property
    def status(self) -> int:
        """Port status bits, as far as they do not depend on what is seen."""
        return IN_PORT | self.initialised * INITIALISED | self.enabled * ENABLED


class Ports:
    """All handles. A passive tool is told by its geometry; here the order of asking says which marker it is."""

    def __init__(self) -> None:
        self.by_handle: dict[int, Port] = {}

    def clear(self) -> None:
        """As after INIT: no handles."""
        self.by_handle.clear()

    def request(self, parameters: str) -> str:
        """PHRQ, hardware(8) system(1) tool(1) port(2) reserved(2); a new handle."""
        if len(parameters) != 14:
            raise NdiError(WRONG_PARAMETERS)
        free = [h for h in range(1, _HANDLES) if h not in self.by_handle]
        if not free:
            raise NdiError(NO_HANDLE_LEFT)
        taken = {port.marker for port in self.by_handle.values()}
        marker = next(m for m in range(_HANDLES) if m not in taken)
        self.by_handle[free[0]] = Port(free[0], marker)
        return f"{free[0]:02X}"

    def free(self, parameters: str) -> str:
        """PHF."""
        del self.by_handle[self.find(parameters).handle]
        return "OKAY"

    def find(self, text: str) -> Port:
        """The handle that a parameter begins with.

        Raises:
            NdiError: not a number, or not in use.
        """
        try:
            return self.by_handle[int(text[:2], 16)]
        except (ValueError, KeyError):
            raise NdiError(INVALID_HANDLE) from None

    def search(self, parameters: str) -> str:
        """PHSR: 00 all, 01 to be freed, 02 not initialised, 03 not enabled, 04 enabled."""
        choices: dict[str, Callable[[Port], bool]] = {
            "": lambda _: True,
            "00": lambda _: True,
            "01": lambda _: False,
            "02": lambda port: port.loaded and not port.initialised,
            "03": lambda port: port.initialised and not port.enabled,
            "04": lambda port: port.enabled,
        }
        if parameters not in choices:
            raise NdiError(OUT_OF_RANGE)
        chosen = choices[parameters]
        ports = [port for port in self.by_handle.values() if chosen(port)]
        return f"{len(ports):02X}" + "".join(f"{port.handle:02X}{port.status:03X}" for port in ports)

    def write(self, parameters: str) -> str:
        """PVWR: handle, address, 64 bytes in hexadecimal."""
        port, digits = self.find(parameters), parameters[6:]
        if len(digits) != 2 * _CHUNK:
            raise NdiError(TOO_SHORT if len(digits) < 2 * _CHUNK else TOO_LONG)
        try:
            address, data = int(parameters[2:6], 16), bytes.fromhex(digits)
        except ValueError:
            raise NdiError(OUT_OF_RANGE) from None
        if address > _ROM_BYTES - _CHUNK:
            raise NdiError(OUT_OF_RANGE)
        port.rom[address : address + _CHUNK] = data
        port.loaded = True
        return "OKAY"

    def initialise(self, parameters: str) -> str:
        """PINIT: only a handle with a tool definition that is one; a passive body has no memory of its own to ask."""
        port = self.find(parameters)
        if not port.loaded:
            raise NdiError(NO_TOOL)
        if not is_definition(port.rom):
            raise NdiError(NOT_INITIALISABLE)
        port.initialised = True
        return "OKAY"

    def enable(self, parameters: str) -> str:
        """PENA: handle and priority S, D or B."""
        port = self.find(parameters)
        if parameters[2:] not in {"S", "D", "B"}:
            raise NdiError(INVALID_PRIORITY)
        if not port.initialised:
            raise NdiError(TOOL_NOT_INITIALISED)
        port.enabled = True
        return "OKAY"

    def disable(self, parameters: str) -> str:
        """PDIS."""
        port = self.find(parameters)
        if not port.enabled:
            raise NdiError(TOOL_NOT_ENABLED)
        port.enabled = False
        return "OKAY"

    def information(self, parameters: str) -> str:
        """PHINF: the groups that the option's bits ask for, in their order."""
        port = self.find(parameters)
        try:
            option = int(parameters[2:] or "0001", 16)
        except ValueError:
            raise NdiError(OUT_OF_RANGE) from None
        groups = {
            0x01: f"02000000{'NDI':<12}001{0x34801400 + port.marker:08X}{port.status:02X}",
            0x02: "00000000",
            0x04: f"{'8700339' if port.marker == 0 else '8700449':<20}",
            0x08: "00",
            0x10: "29",
            0x20: f"{'P6-00123'}01{0:02d}00",
            0x40: "00",
        }
        return "".join(text for bit, text in groups.items() if option & bit)

"""Settings of an NDI tracker and of the marker bodies it follows."""

from pathlib import Path
from typing import Literal, TypeAlias

from pydantic import BaseModel, ConfigDict, Field, PrivateAttr, field_validator, model_validator

from galen_hw.drivers.ndi_tracker.codec import BAUD_CODES, ROM_LIMIT, ROM_SIGNATURE

Role: TypeAlias = Literal["tool", "reference"]


class MarkerSettings(BaseModel):
    """A marker body and how to find it.

    Args:
        rom_file: its tool definition, without which a wireless (passive) body cannot be tracked.
        handle: of a body that the tracker knows by itself (a wired one), two hex digits.
        serial_number: of such a body, as PHINF tells it.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    rom_file: Path | None = None
    handle: str | None = Field(default=None, pattern="^[0-9A-F]{2}$")
    serial_number: str | None = None
    _rom: bytes = PrivateAttr(default=b"")

    @model_validator(mode="after")
    def _read(self) -> "MarkerSettings":
        if self.rom_file is None:
            return self
        try:
            self._rom = self.rom_file.read_bytes()
        except OSError as error:
            raise ValueError(f"rom_file {self.rom_file} cannot be read ({error.strerror})") from None
        if not 0 < len(self._rom) <= ROM_LIMIT:
            size = len(self._rom)
            raise ValueError(f"rom_file {self.rom_file} has {size} bytes, a tool definition has 1 to {ROM_LIMIT}")
        if not self._rom.startswith(ROM_SIGNATURE):
            raise ValueError(f"rom_file {self.rom_file} is no tool definition: it does not begin with NDI")
        return self

    @property
    def rom(self) -> bytes:
        """The tool definition, read when the settings were."""
        return self._rom


def _both() -> dict[Role, MarkerSettings]:
    return {"tool": MarkerSettings(), "reference": MarkerSettings()}


class NdiSettings(BaseModel):
    """Settings of an NDI tracker.

    Args:
        markers: what to track, by the topic's last word ("tool", "reference").
        reply: BX (binary, finer) or TX (text, for old firmware).
        baud_rate: final rate of the serial line (COMM); 0 on a socket.
        frame_rate_hz: at which the tracker counts frames.
        poll_rate_hz: most requests a second; no multiple of the frame rate, so that some come just after a new frame.
        latency_s: constant part of the delay from exposure to the first byte, taken off every time.
        reply_timeout_s, init_timeout_s, reset_timeout_s: longest waits for a reply, for INIT, for RESET.
        quiet_s: the line counts as drained after so long a silence; reconnect_s: pause between attempts.
        missing_s: a marker body not seen for so long is a fault.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    markers: dict[Role, MarkerSettings] = Field(default_factory=_both, min_length=1)
    reply: Literal["BX", "TX"] = "BX"
    baud_rate: int = 115200
    frame_rate_hz: float = Field(default=60.0, gt=0)
    poll_rate_hz: float = Field(default=137.0, gt=0, le=1000)
    latency_s: float = Field(default=0.0, ge=0, lt=1)
    reply_timeout_s: float = Field(default=0.5, gt=0)
    init_timeout_s: float = Field(default=2.0, gt=0)
    reset_timeout_s: float = Field(default=5.0, gt=0)
    quiet_s: float = Field(default=0.05, gt=0)
    reconnect_s: float = Field(default=1.0, gt=0)
    missing_s: float = Field(default=2.0, gt=0)

    @field_validator("baud_rate")
    @classmethod
    def _known(cls, baud_rate: int) -> int:
        if baud_rate and baud_rate not in BAUD_CODES:
            raise ValueError(f"baud_rate must be 0 (socket) or one of {', '.join(map(str, sorted(BAUD_CODES)))}")
        return baud_rate

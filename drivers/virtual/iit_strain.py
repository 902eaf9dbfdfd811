"""Play IIT's F/T sensor with a STRAIN2 board: the other end of its CAN wire.

Written from the maker's firmware (robotology/icub-firmware, `embot_prot_can*.cpp` and `theSTRAIN`) and host program
(robotology/icub-main, `CanBusFtSensor.cpp`). Identifiers: class, sender, receiver or kind, of 3, 4 and 4 bits. Commands and
answers are of class 2, samples of class 3.
"""

import struct
from typing import ClassVar, Final

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from galen_hw.clock import NS_PER_S
from galen_hw.drivers.device import CanFrame
from galen_hw.drivers.virtual.paired_sensor import FAULTS, NEVER_NS, VirtualPairedSensor
from galen_hw.drivers.virtual.world import World
from galen_hw.spatial import Array

_SECOND_MS: Final = 1000
_FORCE, _TORQUE = 0xA, 0xB
_FAULTS: Final = FAULTS | {
    "ft.saturated": "the converter's channel of that number (0) is at its upper limit: the sample repeats the last good one",
}


class StrainSettings(BaseModel):
    """Hold how the sensor is made and set up.

    Args:
        address: on the bus; board: its type (12: STRAIN2).
        full_scales: whole N and N m, of 0x8000 counts.
        offset: reading of the unloaded sensor, N and N m.
        late_s: of a late frame, s.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    address: int = Field(1, ge=1, le=14)
    board: int = Field(12, ge=0, le=255)
    serial_number: str = Field("SN042", max_length=7)
    firmware: tuple[int, int, int] = (2, 0, 7)
    protocol: tuple[int, int] = (2, 0)
    full_scales: tuple[int, int, int, int, int, int] = (1500, 1500, 2000, 35, 35, 25)
    offset: tuple[float, float, float, float, float, float] = (11.0, -7.5, 23.0, 0.21, -0.34, 0.08)
    late_s: float = Field(0.03, ge=0.0)


class VirtualIitStrain(VirtualPairedSensor):
    """Play the sensor; idle after power-up.

    Args:
        settings: see `StrainSettings`.
        world: whose wrench it feels.
    """

    Settings: ClassVar = StrainSettings
    FAULTS: ClassVar = _FAULTS
    SEED: ClassVar = 11
    SHORT: ClassVar = 5

    def __init__(self, settings: StrainSettings, world: World) -> None:
        super().__init__(world, settings.late_s)
        self._settings = settings
        self._scale = 0x8000 / np.asarray(settings.full_scales, dtype=float)
        self.power_cycle(0)

    def power_cycle(self, t_ns: int) -> None:
        """Switch off and on: the stream has ended, its period is the firmware's, the tare is gone."""
        self._idle()
        self._period_ms = 10
        self._tare: Array = np.zeros(6)

    def feed(self, wire: CanFrame, t_ns: int) -> None:
        """Take a frame from the bus: a command of any host, to this board or to all."""
        identifier, data = wire.arbitration_id, wire.data
        receiver = identifier & 0xF
        if (
            identifier >> 8 != 2
            or receiver not in (self._settings.address, 0xF)
            or identifier >> 4 & 0xF == self._settings.address
        ):
            return
        if not data or (self._faults.any and self._broken(t_ns)):
            self.counters["ignored"] += 1
            return
        self.counters["commands"] += 1
        answer = self._obey(data[0] & 0x7F, data[1:].ljust(7, b"\0"), t_ns)
        if answer is None:
            return
        sender = identifier >> 4 & 0xF
        self._send(t_ns, CanFrame(0x200 | self._settings.address << 4 | sender, bytes([data[0] & 0x7F]) + answer))

    @property
    def _period_ns(self) -> int:
        return max(1, self._period_ms) * NS_PER_S // _SECOND_MS

    def _obey(self, command: int, parameters: bytes, t_ns: int) -> bytes | None:
        """Carry a command out; the answer behind its number, None where it has none."""
        settings = self._settings
        if command == 0x07:
            self._next_sample_ns = t_ns if parameters[0] == 0 else NEVER_NS
        elif command == 0x08:
            self._period_ms = parameters[0]
        elif command == 0x15:
            self._tare = -self._measured(t_ns) if parameters[0] == 1 else np.zeros(6)
        elif command == 0x18 and parameters[0] < 6:
            return struct.pack(">BH", parameters[0], settings.full_scales[parameters[0]])
        elif command == 0x1A:
            return settings.serial_number.encode("ascii").ljust(7, b"\0")
        elif command == 0x1C:
            major, minor = settings.protocol
            compatible = major == parameters[0] and minor >= parameters[1]
            return bytes([settings.board, *settings.firmware, major, minor, compatible])
        else:
            self.counters["ignored"] += 1
        return None

    def _measured(self, t_ns: int) -> Array:
        """Return what it feels, (6,) counts: offset included and tare not."""
        return np.asarray((self._world.wrench(t_ns) + self._settings.offset) * self._scale)

    def _sample(self, t_ns: int) -> None:
        """Send force and torque."""
        self.counters["samples"] += 1
        saturated = self._saturated()
        counts = self._held(self._noisy(self._measured(t_ns) + self._tare), repeat=bool(saturated))
        frames = []
        for kind, first in ((_FORCE, 0), (_TORQUE, 3)):
            data = struct.pack("<3H", *(count + 0x8000 for count in counts[first : first + 3]))
            if saturated:
                data += bytes([1 | sum(2 << 2 + 2 * (k - first) for k in saturated if first <= k < first + 3)])
            frames.append(CanFrame(0x300 | self._settings.address << 4 | kind, data))
        self._send_sample(t_ns, *frames)

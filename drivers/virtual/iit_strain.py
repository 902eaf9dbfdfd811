"""Play IIT's F/T sensor with a STRAIN2 board: the other end of its CAN wire.

Written from the maker's firmware (robotology/icub-firmware, `embot_prot_can*.cpp` and `theSTRAIN`) and host program
(robotology/icub-main, `CanBusFtSensor.cpp`). Identifiers: class, sender, receiver or kind, of 3, 4 and 4 bits. Commands and
answers are of class 2, samples of class 3.
"""

import struct
from heapq import heappop, heappush
from typing import ClassVar, Final, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from galen_hw.clock import NS_PER_S
from galen_hw.drivers.device import CanFrame
from galen_hw.drivers.virtual.faults import FaultPicker
from galen_hw.drivers.virtual.world import World
from galen_hw.spatial import Array

NEVER_NS: Final = 2**63 - 1
_SECOND_MS: Final = 1000
_FORCE, _TORQUE = 0xA, 0xB
_FAULTS: Final = {
    "ft.saturated": "the converter's channel of that number (0) is at its upper limit: the sample repeats the last good one",
    "ft.noise": "that many counts (20) of extra noise on every axis",
    "ft.stuck": "all axes keep their values",
    "ft.stuck_axis": "the axis of that number (0) keeps its value",
    "ft.lost_first": "the force of a sample is lost",
    "ft.lost_second": "the torque of a sample is lost",
    "ft.late": "the torque of a sample comes late by `late_s`",
    "ft.doubled": "a sample comes twice",
    "ft.short": "the torque of a sample has five bytes",
    "ft.foreign": "frames of other nodes around each sample",
    "ft.silent": "no answer and no sample at all",
    "ft.reset": "the board restarts once, and is idle",
}


class StrainSettings(BaseModel):
    """How the sensor is made and set up.

    Args:
        address: on the bus; board: its type (12: STRAIN2).
        full_scales: whole N and N m, of 0x8000 counts.
        offset: reading of the unloaded sensor, N and N m.
        late_s: of a late frame.
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


class VirtualIitStrain:
    """The sensor; idle after power-up.

    Args:
        settings: see `StrainSettings`.
        world: whose wrench it feels.
    """

    Settings: ClassVar = StrainSettings
    wire: ClassVar[Literal["can"]] = "can"
    FAULTS: ClassVar = _FAULTS
    bit_rate: Final = 1_000_000

    def __init__(self, settings: StrainSettings, world: World) -> None:
        self._settings, self._world = settings, world
        self._faults = FaultPicker(world, frozenset(_FAULTS))
        self._rng = np.random.default_rng(world.seed + 11)
        self._scale = 0x8000 / np.asarray(settings.full_scales, dtype=float)
        self.counters = {"commands": 0, "samples": 0, "ignored": 0}
        self.power_cycle(0)

    @property
    def wakeup_ns(self) -> int:
        """When `poll` has something to send."""
        return min(self._queue[0][0] if self._queue else NEVER_NS, self._next_sample_ns)

    def power_cycle(self, t_ns: int) -> None:
        """Switch off and on: the stream has ended, its period is the firmware's, the tare is gone."""
        del t_ns
        self._queue: list[tuple[int, int, CanFrame]] = []
        self._sent, self._next_sample_ns, self._period_ms = 0, NEVER_NS, 10
        self._tare: Array = np.zeros(6)
        self._last: Array = np.zeros(6)

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

    def poll(self, now_ns: int) -> list[CanFrame]:
        """Give the frames whose time has come; a stream that was not asked for long gives at most its last ten samples."""
        if self._next_sample_ns <= now_ns:
            if not (self._faults.any and self._broken(now_ns)):
                self._stream(now_ns)
            elif self._next_sample_ns != NEVER_NS:  # Silent, not restarted: it goes on measuring.
                self._next_sample_ns = now_ns + self._period
        out: list[CanFrame] = []
        while self._queue and self._queue[0][0] <= now_ns:
            out.append(heappop(self._queue)[2])
        return out

    @property
    def _period(self) -> int:
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

    def _stream(self, now_ns: int) -> None:
        backlog = (now_ns - self._next_sample_ns) // self._period
        self._next_sample_ns += max(0, backlog - 9) * self._period
        while self._next_sample_ns <= now_ns:
            self._sample(self._next_sample_ns)
            self._next_sample_ns += self._period

    def _broken(self, t_ns: int) -> bool:
        if self._faults.begins("ft.reset"):
            self.power_cycle(t_ns)
            return True
        return self._faults.strikes("ft.silent")

    def _measured(self, t_ns: int) -> Array:
        """Return what it feels, (6,) counts, offset included and tare not."""
        return np.asarray((self._world.wrench(t_ns) + self._settings.offset) * self._scale)

    def _sample(self, t_ns: int) -> None:
        """Queue force and torque; they pass through the faults."""
        self.counters["samples"] += 1
        saturated = {number or 0 for number in self._faults.hits("ft.saturated")}
        exact = self._measured(t_ns) + self._tare
        for sigma in self._faults.hits("ft.noise"):
            exact = exact + self._rng.standard_normal(6) * (20 if sigma is None else sigma)
        stuck = sorted({number or 0 for number in self._faults.hits("ft.stuck_axis")})
        exact[stuck] = self._last[stuck]
        if not saturated and not self._faults.strikes("ft.stuck"):
            self._last = exact
        counts = np.clip(np.rint(self._last), -0x8000, 0x7FFF).astype(int) + 0x8000
        frames = []
        for kind, first in ((_FORCE, 0), (_TORQUE, 3)):
            data = struct.pack("<3H", *counts[first : first + 3].tolist())
            if saturated:
                data += bytes([1 | sum(2 << 2 + 2 * (k - first) for k in saturated if first <= k < first + 3)])
            frames.append(CanFrame(0x300 | self._settings.address << 4 | kind, data))
        self._through_faults(frames[0], frames[1], t_ns)

    def _through_faults(self, first: CanFrame, second: CanFrame, t_ns: int) -> None:
        if not self._faults.any:
            self._send(t_ns, first, second)
            return
        strikes = self._faults.strikes
        before = [CanFrame(0x080)] if strikes("ft.foreign") else []
        if not strikes("ft.lost_first"):
            before.append(first)
        after = [] if strikes("ft.lost_second") else [second]
        if strikes("ft.short"):
            after = [CanFrame(second.arbitration_id, second.data[:5])]
        if strikes("ft.doubled"):
            after += [*before, *after]
        late = round(self._settings.late_s * NS_PER_S) if strikes("ft.late") else 0
        self._send(t_ns, *before)
        self._send(t_ns + late, *after)

    def _send(self, t_ns: int, *frames: CanFrame) -> None:
        for frame in frames:
            self._sent += 1
            heappush(self._queue, (t_ns, self._sent, frame))

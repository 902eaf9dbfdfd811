"""The virtual ATI NETCANOEM board: the other end of its CAN wire, written from ATI manual 9610-05-1030-04.

Big-endian throughout; identifiers are `base << 4 | opcode`. What the manual does not say (a wrong length, an undefined
opcode, an index out of range) is met with silence unless the settings say otherwise.
"""

import struct
from heapq import heappop, heappush
from typing import ClassVar, Final, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from galen_hw.clock import NS_PER_S
from galen_hw.drivers.device import CanFrame
from galen_hw.drivers.virtual.ati_calibration import Calibration, calibration, gauge_matrix, gauge_offsets
from galen_hw.drivers.virtual.faults import FaultPicker
from galen_hw.drivers.virtual.world import World
from galen_hw.spatial import Array

NEVER_NS: Final = 2**63 - 1
_SLOTS: Final = 16
_FAULTS: Final = {
    "ft.status": "status bit of the number after the dot, with the summary bit 15",
    "ft.sticky_can_error": "status 0x4000 in every sample, as a published log of a good sensor shows",
    "ft.stuck_gauge": "the gauge of that number (0) keeps its value",
    "ft.saturated": "the gauge of that number (0) reads +32767",
    "ft.saturated_low": "the gauge of that number (0) reads -32768",
    "ft.noise": "that many counts (100) of extra noise on every gauge",
    "ft.lost_first": "the opcode-0 frame of a sample is lost",
    "ft.lost_second": "the opcode-1 frame of a sample is lost",
    "ft.late": "a sample comes late by `late_s`",
    "ft.doubled": "a sample comes twice",
    "ft.short": "the opcode-1 frame of a sample is two bytes short",
    "ft.foreign": "frames of other nodes around each sample",
    "ft.silent": "no answer at all",
    "ft.reset": "the watchdog resets the board once: slot 0 again, status bit 0",
}


class AtiSettings(BaseModel):
    """How the board is made and set up.

    Args:
        base_id, bit_rate: stored configuration (factory: 0x20, 250000).
        firmware: major, minor, build.
        gauge_seed: which transducer it is: sensitivities and offsets.
        counts: per force and per torque unit.
        turnaround_s, reset_s, late_s: time to an answer, to wake after a reset, and of a late answer.
        malformed: "silent", or "answer" (surplus bytes ignored, undefined opcodes echoed without data).
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    base_id: int = Field(0x20, ge=0, le=0x7F)
    bit_rate: int = 1_000_000
    serial_number: str = Field("FT28417", max_length=8)
    firmware: tuple[int, int, int] = (3, 8, 12)
    gauge_seed: int = 28417
    counts: tuple[int, int] = (1_000_000, 1_000_000)
    turnaround_s: float = Field(0.0, ge=0.0)
    reset_s: float = Field(0.005, ge=0.0)
    late_s: float = Field(0.03, ge=0.0)
    malformed: Literal["silent", "answer"] = "silent"


class VirtualAtiNetcanoem:
    """The board and its transducer.

    Args:
        settings: see `AtiSettings`.
        world: whose wrench it feels.
    """

    Settings: ClassVar = AtiSettings
    wire: ClassVar[Literal["can"]] = "can"
    FAULTS: ClassVar = _FAULTS

    def __init__(self, settings: AtiSettings, world: World) -> None:
        self._settings, self._world = settings, world
        self._faults = FaultPicker(world, frozenset(_FAULTS))
        self._gauges = gauge_matrix(settings.gauge_seed)
        self._offsets = gauge_offsets(settings.gauge_seed)
        self._rng = np.random.default_rng(settings.gauge_seed + 2)
        # Slot 0 in N and N m, slot 1 in lbf and lbf in, slot 2 in N and N mm; the others are empty.
        units = ((2, 3), (1, 1), (2, 4))
        self._slots: dict[int, Calibration] = {
            slot: calibration(self._gauges, force, torque, settings.counts)
            for slot, (force, torque) in enumerate(units)
        }
        self._empty = Calibration(np.zeros((6, 6)), 0, 0, 0, 0)
        self._stored = (settings.base_id, settings.bit_rate)
        self._queue: list[tuple[int, int, CanFrame]] = []  # heap of due time, order of sending, frame
        self._sent = 0
        self._stuck: dict[int, int] = {}
        self.counters = {"requests": 0, "samples": 0, "ignored": 0}
        self.power_cycle(0)
        self._awake_ns = 0

    @property
    def wakeup_ns(self) -> int:
        """When `poll` has something to send."""
        return self._queue[0][0] if self._queue else NEVER_NS

    @property
    def gauges(self) -> Array:
        """(6, 6) true sensitivities, counts per N and N m."""
        return self._gauges

    def power_cycle(self, t_ns: int) -> None:
        """Switch off and on: the stored base identifier and bit rate come into force."""
        self._base, self.bit_rate = self._stored
        ids = [self._base << 4 | op for op in range(16)]
        self._ids = ids
        self._handlers = {
            ids[0x0]: (0, self._read_gauges),
            ids[0x2]: (1, self._read_matrix_row),
            ids[0x5]: (0, self._read_serial_number),
            ids[0x6]: (1, self._set_slot),
            ids[0x7]: (0, self._read_counts),
            ids[0x8]: (0, self._read_units),
            ids[0x9]: (1, self._read_diagnostic),
            ids[0xC]: (0, self._reset),
            ids[0xD]: (1, self._set_base_id),
            ids[0xE]: (1, self._set_bit_rate),
            ids[0xF]: (0, self._read_firmware),
        }
        self._restart(t_ns, watchdog=False)

    def feed(self, wire: CanFrame, t_ns: int) -> None:
        """Take a frame from the bus."""
        if wire.arbitration_id >> 4 != self._base:
            return
        if t_ns < self._awake_ns or (self._faults.any and self._broken(t_ns)):
            self.counters["ignored"] += 1
            return
        length, handler = self._handlers.get(wire.arbitration_id, (-1, self._read_gauges))
        if len(wire.data) == length or (len(wire.data) > length >= 0 and self._settings.malformed == "answer"):
            self.counters["requests"] += 1
            handler(wire.data, t_ns)
        else:
            self.counters["ignored"] += 1
            if length < 0 and self._settings.malformed == "answer":
                self._send(t_ns, CanFrame(wire.arbitration_id))

    def poll(self, now_ns: int) -> list[CanFrame]:
        """Frames whose time has come."""
        out: list[CanFrame] = []
        while self._queue and self._queue[0][0] <= now_ns:
            out.append(heappop(self._queue)[2])
        return out

    def _send(self, t_ns: int, *frames: CanFrame) -> None:
        due = t_ns + round(self._settings.turnaround_s * NS_PER_S)
        for frame in frames:
            self._sent += 1
            heappush(self._queue, (due, self._sent, frame))

    def _answer(self, t_ns: int, op: int, data: bytes = b"") -> None:
        self._send(t_ns, CanFrame(self._ids[op], data))

    def _restart(self, t_ns: int, *, watchdog: bool) -> None:
        self._slot, self._status = 0, 1 if watchdog else 0
        self._queue.clear()
        self._awake_ns = t_ns + round(self._settings.reset_s * NS_PER_S)

    def _broken(self, t_ns: int) -> bool:
        if self._faults.begins("ft.reset"):
            self._restart(t_ns, watchdog=True)
            return True
        return self._faults.strikes("ft.silent")

    def _read_gauges(self, _data: bytes, t_ns: int) -> None:
        """Opcode 0: gauges as counts, in two frames."""
        exact = self._gauges @ self._world.wrench(t_ns) + self._offsets
        self.counters["samples"] += 1
        if self._faults.any:
            self._send_faulty(exact, t_ns)
        else:
            self._send(t_ns, *self._sample(_counts(exact), self._status_word()))

    def _sample(self, g: list[int], status: int) -> tuple[CanFrame, CanFrame]:
        first = struct.pack(">Hhhh", status, g[0], g[2], g[4])
        return CanFrame(self._ids[0], first), CanFrame(self._ids[1], struct.pack(">hhh", g[1], g[3], g[5]))

    def _status_word(self) -> int:
        empty = 0 if self._slot in self._slots else 1 << 6
        status = self._status | empty
        return status | 0x8000 if status else 0

    def _send_faulty(self, exact: Array, t_ns: int) -> None:
        hits, strikes = self._faults.hits, self._faults.strikes
        for sigma in hits("ft.noise"):
            exact = exact + self._rng.standard_normal(6) * (100 if sigma is None else sigma)
        g = _counts(exact)
        stuck = {number or 0 for number in hits("ft.stuck_gauge")}
        self._stuck = {k: self._stuck.get(k, g[k]) for k in stuck if k < 6}
        forced = dict(self._stuck)
        forced |= {n or 0: 32767 for n in hits("ft.saturated")} | {n or 0: -32768 for n in hits("ft.saturated_low")}
        for k, value in forced.items():
            g[k % 6] = value
        status = self._status_word()
        for bit in hits("ft.status"):
            status |= 0x8000 | 1 << ((bit or 0) & 15)
        if strikes("ft.sticky_can_error"):
            status |= 0x4000
        first, second = self._sample(g, status)
        frames = [] if strikes("ft.lost_first") else [first]
        if not strikes("ft.lost_second"):
            frames.append(CanFrame(second.arbitration_id, second.data[:4]) if strikes("ft.short") else second)
        if strikes("ft.foreign"):
            frames = [CanFrame(0x080), *frames, CanFrame(0x701, b"\x05")]
        if strikes("ft.doubled"):
            frames += frames
        late = round(self._settings.late_s * NS_PER_S) if strikes("ft.late") else 0
        self._send(t_ns + late, *frames)

    def _read_matrix_row(self, data: bytes, t_ns: int) -> None:
        if data[0] < 6:
            row = self._slots.get(self._slot, self._empty).row(data[0])
            for k in range(3):
                self._answer(t_ns, 2 + k, row[8 * k : 8 * k + 8])

    def _read_serial_number(self, _data: bytes, t_ns: int) -> None:
        self._answer(t_ns, 0x5, self._settings.serial_number.encode("ascii").ljust(8, b"\x00"))

    def _set_slot(self, data: bytes, t_ns: int) -> None:
        if data[0] < _SLOTS:
            self._slot = data[0]
            self._answer(t_ns, 0x6, data[:1])

    def _read_counts(self, _data: bytes, t_ns: int) -> None:
        slot = self._slots.get(self._slot, self._empty)
        if self._settings.firmware >= (3, 7, 0):
            self._answer(t_ns, 0x7, struct.pack(">II", slot.counts_per_force, slot.counts_per_torque))

    def _read_units(self, _data: bytes, t_ns: int) -> None:
        slot = self._slots.get(self._slot, self._empty)
        if self._settings.firmware >= (3, 7, 0):
            self._answer(t_ns, 0x8, bytes((slot.force_unit, slot.torque_unit)))

    def _read_diagnostic(self, data: bytes, t_ns: int) -> None:
        """Opcode 9; the manual gives no scale, so the numbers only are where a healthy board's might be."""
        if data[0] < 6 and self._settings.firmware >= (3, 8, 0):
            thermistor = round(32768 - 400 * (self._world.temperature - 22.0))
            value = (32768, 0, thermistor, 43000, 32768, 12)[data[0]]
            self._answer(t_ns, 0x9, struct.pack(">H", max(0, min(0xFFFF, value))))

    def _reset(self, _data: bytes, t_ns: int) -> None:
        self._restart(t_ns, watchdog=False)

    def _set_base_id(self, data: bytes, t_ns: int) -> None:
        if data[0] <= 0x7F:
            self._stored = (data[0], self._stored[1])
            self._answer(t_ns, 0xD)

    def _set_bit_rate(self, data: bytes, t_ns: int) -> None:
        self._stored = (self._stored[0], 2_000_000 // (data[0] + 1))
        self._answer(t_ns, 0xE)

    def _read_firmware(self, _data: bytes, t_ns: int) -> None:
        major, minor, build = self._settings.firmware
        self._answer(t_ns, 0xF, struct.pack(">BBH", major, minor, build))


def _counts(exact: Array) -> list[int]:
    """Whole counts of a 16-bit converter."""
    return [int(x) for x in np.clip(np.rint(exact), -32768, 32767)]

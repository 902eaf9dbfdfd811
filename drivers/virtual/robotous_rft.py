"""The virtual Robotous RFT sensor: the other end of its CAN wire, written from the RFT manual, revision 1.7, chapter 3.

Commands are eight bytes to the receiver's identifier; a response is sixteen bytes in two frames, on two identifiers.
"""

import struct
from collections.abc import Callable
from typing import ClassVar, Final, TypeAlias

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from galen_hw.clock import NS_PER_S
from galen_hw.drivers.device import CanFrame
from galen_hw.drivers.virtual.paired_sensor import FAULTS, NEVER_NS, VirtualPairedSensor
from galen_hw.drivers.virtual.world import World
from galen_hw.spatial import Array

_READ_ONCE, _START, _STOP, _BIAS = 0x0A, 0x0B, 0x0C, 0x11
_RATES_HZ: Final = (200, 10, 20, 50, 100, 200, 333, 500, 1000)
_CUTOFFS_HZ: Final = (0, 500, 300, 200, 150, 100, 50, 40, 30, 20, 10, 5, 3, 2, 1)
_UNSUPPORTED, _OUT_OF_RANGE, _FAILED = 1, 2, 3
_OVERLOAD: Final = 1.2
_Command: TypeAlias = Callable[[bytes, int], bytes]
_FAULTS: Final = FAULTS | {
    "ft.saturated": "the axis of that number (0) reads full scale and is flagged",
    "ft.set_fails": "settings cannot be stored (error 3)",
}


class RftSettings(BaseModel):
    """How the sensor is made and set up.

    Args:
        ids: receiver, transmitter 1, transmitter 2.
        df, dt: counts per N and per N m; max_rate_hz: what the model can do (RFT40, RFT44: 200).
        rating: N, N m; above 1.2 of it an axis is flagged.
        offset: reading of the unloaded sensor before its bias command, N and N m.
        rate_code: stored output rate; late_s: of a late frame.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    ids: tuple[int, int, int] = (0x64, 0x01, 0x02)
    model: str = Field("RFT60-HA01", max_length=15)
    serial_number: str = Field("HA01-2041", max_length=15)
    firmware: str = Field("1.04.02", max_length=15)
    df: float = 50.0
    dt: float = 2000.0
    max_rate_hz: int = 1000
    rating: tuple[float, float, float, float, float, float] = (150.0, 150.0, 200.0, 4.0, 4.0, 4.0)
    offset: tuple[float, float, float, float, float, float] = (3.12, -2.46, 8.7, 0.031, -0.052, 0.018)
    rate_code: int = Field(0, ge=0, le=8)
    late_s: float = Field(0.03, ge=0.0)


class VirtualRobotousRft(VirtualPairedSensor):
    """The sensor; idle after power-up.

    Args:
        settings: see `RftSettings`.
        world: whose wrench it feels.
    """

    Settings: ClassVar = RftSettings
    FAULTS: ClassVar = _FAULTS
    SEED: ClassVar = 7
    SHORT: ClassVar = 6

    def __init__(self, settings: RftSettings, world: World) -> None:
        super().__init__(world, settings.late_s)
        self._settings = settings
        self._scale = np.repeat([settings.df, settings.dt], 3)
        self._rating = np.asarray(settings.rating)
        self._stored_ids = settings.ids
        self._rate_code, self._filter = settings.rate_code, (0, 0)
        self._baud = (0, 0)  # In force and stored; of the UART variant, kept here all the same.
        self._commands: dict[int, _Command] = {
            0x01: lambda _d, _t: settings.model.encode("ascii"),
            0x02: lambda _d, _t: settings.serial_number.encode("ascii"),
            0x03: lambda _d, _t: settings.firmware.encode("ascii"),
            0x04: self._set_ids,
            0x05: lambda _d, _t: bytes((*self._ids, *self._stored_ids)),
            0x06: self._set_baud,
            0x07: lambda _d, _t: bytes(self._baud),
            0x08: self._set_filter,
            0x09: lambda _d, _t: bytes(self._filter),
            _READ_ONCE: lambda _d, t_ns: self._reading(t_ns),
            0x0F: self._set_rate,
            0x10: lambda _d, _t: bytes((self._rate_code,)),
            0x12: lambda _d, _t: bytes(self._overloads),
        }
        self.power_cycle(0)

    def power_cycle(self, t_ns: int) -> None:
        """Switch off and on: identifiers and baud rate come into force, the bias is gone, the output is stopped."""
        self._idle()
        self._ids, self._baud = self._stored_ids, (self._baud[1], self._baud[1])
        self._bias: Array = np.zeros(6)
        self._filtered: tuple[int, Array] | None = None
        self._overloads, self._over = [0] * 6, [False] * 6

    def feed(self, wire: CanFrame, t_ns: int) -> None:
        """Take a frame from the bus."""
        if wire.arbitration_id != self._ids[0]:
            return
        command = wire.data[0] if len(wire.data) == 8 else -1
        streaming = self._next_sample_ns != NEVER_NS
        deaf = self._faults.any and self._broken(t_ns)
        if command < 0 or deaf or (streaming and command not in {_STOP, _BIAS}):
            self.counters["ignored"] += 1
            return
        self.counters["commands"] += 1
        if command == _START:
            self._next_sample_ns = t_ns
        elif command == _STOP:
            self._next_sample_ns = NEVER_NS
        elif command == _BIAS:
            self._bias = self._measured(t_ns) if wire.data[1] == 1 else np.zeros(6)
        else:
            self._respond(command, self._commands.get(command, self._unsupported)(wire.data[1:], t_ns), t_ns)

    @property
    def _period_ns(self) -> int:
        return NS_PER_S // _RATES_HZ[self._rate_code]

    def _sample(self, t_ns: int) -> None:
        self._respond(_START, self._reading(t_ns), t_ns)

    def _measured(self, t_ns: int) -> Array:
        """(6,) N, N m, offset and filter included, bias not."""
        w = self._world.wrench(t_ns) + self._settings.offset
        cutoff = _CUTOFFS_HZ[self._filter[1]] if self._filter[0] else 0
        if cutoff and self._filtered is not None:
            dt = max(0, t_ns - self._filtered[0]) / NS_PER_S
            w = self._filtered[1] + (1.0 - np.exp(-2.0 * np.pi * cutoff * dt)) * (w - self._filtered[1])
        self._filtered = (t_ns, w)
        return np.asarray(w)

    def _reading(self, t_ns: int) -> bytes:
        """R1..R13: six big-endian int16 and the overload flags, bit 5 for Fx to bit 0 for Tz."""
        self.counters["samples"] += 1
        load = self._measured(t_ns)
        saturated = self._saturated()
        over = [k in saturated or abs(load[k]) > _OVERLOAD * self._rating[k] for k in range(6)]
        for k in range(6):
            self._overloads[k] = min(255, self._overloads[k] + (over[k] and not self._over[k]))
        self._over = over
        exact = self._noisy((load - self._bias) * self._scale)
        exact[sorted(saturated)] = 0x7FFF
        counts = self._held(exact)
        return struct.pack(">6hB", *counts, sum(flag << (5 - k) for k, flag in enumerate(over)))

    def _respond(self, command: int, parameters: bytes, t_ns: int) -> None:
        """Two frames; samples pass through the faults."""
        data = bytes((command,)) + parameters.ljust(15, b"\x00")
        first, second = CanFrame(self._ids[1], data[:8]), CanFrame(self._ids[2], data[8:])
        send = self._send_sample if command in {_READ_ONCE, _START} else self._send
        send(t_ns, first, second)

    def _unsupported(self, _data: bytes, _t_ns: int) -> bytes:
        return bytes((0, _UNSUPPORTED))

    def _result(self, *, within: bool) -> bytes | None:
        """The refusal of a setting, None when it may be stored."""
        if not within:
            return bytes((0, _OUT_OF_RANGE))
        return bytes((0, _FAILED)) if self._faults.strikes("ft.set_fails") else None

    def _set_ids(self, data: bytes, _t_ns: int) -> bytes:
        ids = (data[0], data[1], data[2])
        refusal = self._result(within=min(ids) >= 1 and len(set(ids)) == 3)
        if refusal is None:
            self._stored_ids = ids
        return refusal or bytes((1, 0))

    def _set_baud(self, data: bytes, _t_ns: int) -> bytes:
        refusal = self._result(within=data[0] <= 4)
        if refusal is None:
            self._baud = (self._baud[0], data[0])
        return refusal or bytes((1, 0))

    def _set_filter(self, data: bytes, _t_ns: int) -> bytes:
        refusal = self._result(within=data[0] <= 1 and data[1] < len(_CUTOFFS_HZ))
        if refusal is None:
            self._filter, self._filtered = (data[0], data[1]), None
        return refusal or bytes((1, 0))

    def _set_rate(self, data: bytes, _t_ns: int) -> bytes:
        within = data[0] < len(_RATES_HZ) and _RATES_HZ[data[0]] <= self._settings.max_rate_hz
        refusal = self._result(within=within)
        if refusal is None:
            self._rate_code = data[0]
        return refusal or bytes((1, 0))

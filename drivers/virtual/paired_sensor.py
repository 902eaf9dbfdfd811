"""Play CAN force/torque sensors that stream by themselves, each sample in two frames: when they send, and how samples break."""

from abc import ABC, abstractmethod
from heapq import heappop, heappush
from typing import ClassVar, Final, Literal

import numpy as np

from galen_hw.clock import NS_PER_S
from galen_hw.drivers.device import CanFrame
from galen_hw.drivers.virtual.faults import FaultPicker
from galen_hw.drivers.virtual.world import World
from galen_hw.spatial import Array

NEVER_NS: Final = 2**63 - 1
BACKLOG: Final = 10
"""Samples that a stream gives at most when it was not asked for long."""
FAULTS: Final = {
    "ft.noise": "that many counts (20) of extra noise on every axis",
    "ft.stuck": "all axes keep their values",
    "ft.stuck_axis": "the axis of that number (0) keeps its value",
    "ft.lost_first": "the first frame of a sample is lost",
    "ft.lost_second": "the second frame of a sample is lost",
    "ft.late": "the second frame of a sample comes late by `late_s`",
    "ft.doubled": "a sample comes twice",
    "ft.short": "the second frame of a sample is cut short",
    "ft.foreign": "frames of other nodes around each sample",
    "ft.silent": "no answer and no sample at all",
    "ft.reset": "the sensor restarts once, and is idle",
}
"""What all of them know; each adds its own."""


class VirtualPairedSensor(ABC):
    """Send what is due: answers, and samples of two frames.

    Args:
        world: whose wrench it feels.
        late_s: of a late frame, s.
    """

    wire: ClassVar[Literal["can"]] = "can"
    FAULTS: ClassVar[dict[str, str]]
    SEED: ClassVar[int]
    """Of its noise, added to the world's."""
    SHORT: ClassVar[int]
    """Bytes of a frame that is cut short."""
    bit_rate: Final = 1_000_000
    _queue: list[tuple[int, int, CanFrame]]
    """Heap of due time (ns), order of sending, frame."""
    _next_sample_ns: int

    def __init__(self, world: World, late_s: float) -> None:
        self._world, self._late_ns = world, round(late_s * NS_PER_S)
        self._faults = FaultPicker(world, frozenset(self.FAULTS))
        self._rng = np.random.default_rng(world.seed + self.SEED)
        self.counters = {"commands": 0, "samples": 0, "ignored": 0}
        self._idle()

    @property
    def wakeup_ns(self) -> int:
        """Return when `poll` has something to send, ns."""
        return min(self._queue[0][0] if self._queue else NEVER_NS, self._next_sample_ns)

    @abstractmethod
    def power_cycle(self, t_ns: int) -> None:
        """Switch off and on at `t_ns`, ns."""

    @abstractmethod
    def _sample(self, t_ns: int) -> None:
        """Measure at `t_ns`, ns, and send it by `_send_sample`."""

    @property
    @abstractmethod
    def _period_ns(self) -> int:
        """Return the time from sample to sample, ns."""

    def poll(self, now_ns: int) -> list[CanFrame]:
        """Give the frames whose time has come; of a stream that was not asked for long at most the last `BACKLOG` samples."""
        if self._next_sample_ns <= now_ns:
            if not (self._faults.any and self._broken(now_ns)):
                self._stream(now_ns)
            elif self._next_sample_ns != NEVER_NS:  # Silent, not restarted: it goes on measuring.
                self._next_sample_ns = now_ns + self._period_ns
        out: list[CanFrame] = []
        while self._queue and self._queue[0][0] <= now_ns:
            out.append(heappop(self._queue)[2])
        return out

    def _idle(self) -> None:
        """Forget what was to be sent, the stream, and what it measured last."""
        self._queue, self._sent, self._next_sample_ns = [], 0, NEVER_NS
        self._last: Array = np.zeros(6)

    def _stream(self, now_ns: int) -> None:
        backlog = (now_ns - self._next_sample_ns) // self._period_ns
        self._next_sample_ns += max(0, backlog - BACKLOG + 1) * self._period_ns
        while self._next_sample_ns <= now_ns:
            self._sample(self._next_sample_ns)
            self._next_sample_ns += self._period_ns

    def _broken(self, t_ns: int) -> bool:
        """Return whether it does nothing now; a restart is carried out."""
        if self._faults.begins("ft.reset"):
            self.power_cycle(t_ns)
            return True
        return self._faults.strikes("ft.silent")

    def _saturated(self) -> set[int]:
        """Return the axes that a fault holds at their limit."""
        return {number or 0 for number in self._faults.hits("ft.saturated")}

    def _noisy(self, exact: Array) -> Array:
        """Add a fault's noise to (6,) counts."""
        for sigma in self._faults.hits("ft.noise"):
            exact = exact + self._rng.standard_normal(6) * (20 if sigma is None else sigma)
        return exact

    def _held(self, exact: Array, *, repeat: bool = False) -> list[int]:
        """Return (6,) whole counts in 16 bits, of which a fault may hold some; `repeat`: of the last sample."""
        stuck = sorted({number or 0 for number in self._faults.hits("ft.stuck_axis")})
        exact[stuck] = self._last[stuck]
        if not repeat and not self._faults.strikes("ft.stuck"):
            self._last = exact
        counts: list[int] = np.clip(np.rint(self._last), -0x8000, 0x7FFF).astype(int).tolist()
        return counts

    def _send_sample(self, t_ns: int, first: CanFrame, second: CanFrame) -> None:
        """Send a sample through the faults."""
        if not self._faults.any:
            self._send(t_ns, first, second)
            return
        strikes = self._faults.strikes
        before = [CanFrame(0x080)] if strikes("ft.foreign") else []
        if not strikes("ft.lost_first"):
            before.append(first)
        after = [] if strikes("ft.lost_second") else [second]
        if strikes("ft.short"):
            after = [CanFrame(second.arbitration_id, second.data[: self.SHORT])]
        if strikes("ft.doubled"):
            after += [*before, *after]
        self._send(t_ns, *before)
        self._send(t_ns + (self._late_ns if strikes("ft.late") else 0), *after)

    def _send(self, t_ns: int, *frames: CanFrame) -> None:
        for frame in frames:
            self._sent += 1
            heappush(self._queue, (t_ns, self._sent, frame))

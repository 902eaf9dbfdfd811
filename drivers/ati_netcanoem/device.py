"""ATI force/torque sensor on a NETCANOEM board (9105-NETCANOEM), polled over CAN; manual 9610-05-1030.

Frames are in `ati_codec`, the questions of the start in `ati_start`; `ati_sampler` says why no sample is a wrong one.
"""

from typing import Final

import numpy as np
import numpy.typing as npt

from galen_hw.clock import NS_PER_S, TimeBase
from galen_hw.drivers.ati_netcanoem import codec
from galen_hw.drivers.ati_netcanoem.codec import BOTH, COUNTERS, ECHOING, REPLY_LENGTHS, SATURATED_COUNTS
from galen_hw.drivers.ati_netcanoem.sampler import Pair
from galen_hw.drivers.ati_netcanoem.start import AtiIdentity, AtiSettings, fence, identify, new_sampler
from galen_hw.drivers.ati_netcanoem.status import StatusWord
from galen_hw.drivers.ati_netcanoem.zero import told
from galen_hw.drivers.device import CanFrame, Output
from galen_hw.drivers.dialogue import Dialogue, DialogueError
from galen_hw.drivers.host_bias import HostBias
from galen_hw.drivers.host_biased import HostBiasedSensor
from galen_hw.drivers.wrench_sensor import Phase
from galen_hw.messages import Vector3, WrenchRaw


class AtiNetcanoem(HostBiasedSensor[CanFrame, AtiIdentity]):
    """Publishes `wrench/raw` in the sensor frame about its origin, N and N m, stamped when its second frame was read.

    Requests: `zero` {samples}: average the gauges and subtract them from now on; `unzero`; `restart`.
    """

    Settings = AtiSettings

    def __init__(self, name: str, settings: AtiSettings, time_base: TimeBase) -> None:
        self._settings = settings
        self._id0 = settings.base_id << 4
        super().__init__(
            name,
            f"{name} (ATI NETCANOEM, CAN ids 0x{self._id0:X} to 0x{self._id0 + 15:X})",
            time_base,
            asked_rate_hz=settings.rate_hz,
            retry_s=settings.retry_s,
            counters=COUNTERS,
            silent_todo=_TODO_SILENT,
            bias=HostBias(name, settings.zero_samples, settings.rate_hz, told),
            zero_kept_s=settings.zero_kept_s,
        )
        self._fence = fence(settings)
        self._sampler = new_sampler(settings, self._fence, {}, self._counters)
        self._status = StatusWord(settings.bus_error_s)
        self._barren = ""
        self._matrix: npt.NDArray[np.float64] = np.zeros((6, 6))
        self._rows = [[0.0] * 7] * 6
        """Of the matrix, each with what the bias takes off behind it: in plain floats, for numpy's way to a product of six
        numbers is several times as long."""

    def poll(self, now_ns: int) -> tuple[list[CanFrame], list[Output]]:
        """Sample requests by the schedule, time-outs, and the status once a second."""
        wires: list[CanFrame] = []
        if self._phase is Phase.RUNNING:
            if now_ns >= self._sampler.due_ns:
                wires = self._sampler.poll(now_ns)
                self._watch(now_ns)
            if self._gauges.is_due:  # here, and not where the last sample was taken: that one must not wait for it
                self._judge_gauges(now_ns)
        elif self._phase is not Phase.OFF:
            wires = self._converse(now_ns)
        if now_ns >= self._bias.deadline_ns:
            self._outbox += self._bias.expire()
        if now_ns >= self._reporter.status_due_ns:
            self._outbox.append(self._report(now_ns))
        return wires, self._take_outbox()

    def feed(self, wire: CanFrame, t_ns: int) -> list[Output]:
        """Take one frame; a sample comes out with the second frame of its pair."""
        opcode, data = wire.arbitration_id - self._id0, wire.data
        if not 0 <= opcode <= 0xF:
            self._counters["foreign"] += 1
            return []
        if self._phase is Phase.RUNNING and data and (len(data) > 1 or opcode not in ECHOING):
            pair = self._sampler.feed(opcode, data, t_ns)
            if pair is not None:
                return self._sample(pair)
            if opcode > 1:
                self._watch(t_ns)
        else:
            self._feed_beside(wire, opcode, t_ns)
        return self._take_outbox() if self._outbox else []

    def stop(self, now_ns: int) -> list[CanFrame]:
        """Ask for nothing any more; the board is silent when it is not asked."""
        self._switch_off()
        return []

    @property
    def wakeup_ns(self) -> int:
        """When `poll` wants to be called next."""
        due = self._sampler.due_ns if self._phase is Phase.RUNNING else self._start_due_ns
        return min(due, self._reporter.status_due_ns, self._bias.deadline_ns)

    def _new_dialogue(self, now_ns: int) -> Dialogue[AtiIdentity]:
        self._status = StatusWord(self._settings.bus_error_s)
        return Dialogue(
            identify(self._settings, lambda: self._counters["echoes"] > 0),
            timeout_ns=round(self._settings.start_timeout_s * NS_PER_S),
            tries=self._settings.tries,
            fence=self._fence,
            due_ns=now_ns,
        )

    def _identified(self, identity: AtiIdentity, now_ns: int) -> list[CanFrame]:
        self._matrix = identity.matrix[:, codec.WIRE_ORDER]
        self._bias_for(identity, codec.GAUGES, now_ns)
        self._sampler = new_sampler(self._settings, self._fence, identity.answers, self._counters)
        self._sampler.start(now_ns)
        return self._sampler.poll(now_ns)

    def _watch(self, now_ns: int) -> None:
        """What the sampler found out about the board: gone, or another one."""
        if self._sampler.gone:
            self._fail(now_ns, DialogueError("the sensor does not answer any more", ""))
        elif self._sampler.replaced:
            what = "another board answers, or this one was changed: it is identified again"
            self._outbox += self._reporter.fault(now_ns, "replaced", what, "zero the sensor if it was exchanged")
            self._begin(now_ns)
        elif self._sampler.barren:
            self._flowing = False
            self._barren = "the board answers, but no sample is whole: one of its two frames is missing"
            self._outbox += self._reporter.fault(now_ns, "barren", self._barren, _TODO_HALVES)
            self._give_up(self._barren)

    def _feed_beside(self, wire: CanFrame, opcode: int, t_ns: int) -> None:
        """Frames that are no sample: answers of the start, our own requests shown by the wire, and strays."""
        dialogue = self._dialogue if self._phase is Phase.STARTING else None
        if dialogue is not None and wire.data and dialogue.feed(wire, t_ns):
            return
        if not wire.data or opcode in ECHOING:
            self._counters["echoes"] += 1
        elif len(wire.data) != REPLY_LENGTHS.get(opcode, len(wire.data)):
            self._counters["short"] += 1
        else:
            self._counters["late"] += 1

    def _sample(self, pair: Pair) -> list[Output]:
        """The message of a pair that is known to answer the last request."""
        first, second, t_ns = pair
        status, u, v, w, x, y, z = BOTH.unpack(first + second)
        counts = (u, v, w, x, y, z)
        saturated = max(counts) >= SATURATED_COUNTS or min(counts) <= -SATURATED_COUNTS
        critical = self._status.critical if status == self._status.word else self._new_status(status, t_ns)
        self._gauges.take(counts)
        if saturated or self._bias.active or self._restart_id is not None:
            self._beside_sample(counts, t_ns, saturated=saturated)
        self._counters["samples"] += 1
        self._flowing, self._barren = self._phase is Phase.RUNNING, ""
        fx, fy, fz, tx, ty, tz = [
            a * u + b * v + c * w + d * x + e * y + f * z - bias for a, b, c, d, e, f, bias in self._rows
        ]
        identity = self._identity
        message = WrenchRaw(
            timestamp=self._time_base.timestamp(t_ns),
            t_ns=t_ns,
            seq=self._reporter.next_seq("wrench/raw"),
            valid=not (saturated or critical or self._broken != ""),
            source=self.name,
            force=Vector3(fx, fy, fz),
            torque=Vector3(tx, ty, tz),
            status=status,
            saturated=saturated,
            serial_number=identity.serial_number if identity is not None else "",
            zeroings=self._bias.zeroings,
        )
        return [("wrench/raw", message), *self._take_outbox()] if self._outbox else [("wrench/raw", message)]

    def _new_status(self, status: int, t_ns: int) -> bool:
        """Take a status word that differs from the last; whether the sample that brought it is unusable."""
        restarted = self._status.take(status, t_ns)
        for kind, what, todo in self._status.news:
            self._outbox += self._reporter.fault(t_ns, kind, what, todo)
        if restarted:  # the board forgot which calibration was selected
            self._give_up("the board was reset by its watchdog")
            self._begin(t_ns)
            return True
        return self._status.critical

    def _beside_sample(self, gauges: tuple[int, ...], t_ns: int, *, saturated: bool) -> None:
        """What is rare: saturation, the answer to `restart`, zeroing."""
        if saturated:
            self._counters["saturated"] += 1
            self._outbox += self._reporter.fault(t_ns, "saturated", "a strain gauge is at its limit", _TODO_SATURATED)
        self._answer_restart()
        if not self._bias.active:
            return
        if saturated or self._status.critical:
            self._outbox += self._bias.give_up("fault", "a gauge is saturated or the board reports an error")
        else:
            replies = self._bias.add(gauges)
            self._outbox += replies
            self._use_bias()
            if replies:
                self._gauges.learn()

    def _gauge_name(self, gauge: int) -> str:
        return f"strain gauge {codec.WIRE_ORDER[gauge]}"

    def _use_bias(self) -> None:
        bias = np.zeros(6) if self._bias.offset is None else self._matrix @ self._bias.offset
        self._rows = np.column_stack((self._matrix, bias)).tolist()

    def _running(self, identity: AtiIdentity, now_ns: int) -> tuple[str, str, str]:
        state, trouble, todo = self._status.state(now_ns)
        if self._barren:
            state, trouble, todo = "fault", self._barren, _TODO_HALVES
        return state, "; ".join(filter(None, (trouble, identity.described, self._zeroed))), todo


_TODO_SILENT: Final = "check its power, CAN wiring and termination, base id and bit rate"
_TODO_HALVES: Final = "look for another device that uses its identifiers, and at filters of the adapter"
_TODO_SATURATED: Final = "take the load off; if it stays, the cable or the sensor is broken"

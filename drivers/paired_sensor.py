"""Run CAN force/torque sensors that stream by themselves, each sample in two frames: start, samples, silence, end.

Which frames are one sample is decided in `drivers/pairing.py`; how the sensor is asked at the start, what its bytes mean and how
it is zeroed is the device's own. With a zero of the host's a device derives from `HostBiasedSensor` too, behind this class.
"""

from abc import abstractmethod
from collections.abc import Generator
from dataclasses import dataclass
from typing import Any, Final, NamedTuple

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from galen_hw.clock import NS_PER_S, TimeBase
from galen_hw.drivers.device import CanFrame, Output
from galen_hw.drivers.dialogue import Dialogue, DialogueError, Query
from galen_hw.drivers.host_bias import Floats
from galen_hw.drivers.pairing import Pairer, PairLayout
from galen_hw.drivers.reporting import FAR_NS
from galen_hw.drivers.wrench_sensor import Found, Phase, WrenchSensor
from galen_hw.messages import Vector3, WrenchRaw

AXES: Final = ("Fx", "Fy", "Fz", "Tx", "Ty", "Tz")
COUNTERS: Final = (
    "samples",  # published
    "lost",  # of which a frame is missing
    "timeouts",
    "late",  # frames nobody waited for, or that had piled up
    "doubled",  # frames that came twice
    "short",  # frames of a wrong length
    "foreign",  # frames of another device, or of a kind that is not used here
    "echoes",  # commands, ours or another host's, shown to us by the wire
    "saturated",  # samples with an axis or a channel at its limit
    "restarts",
)


class PairedSettings(BaseModel):
    """Hold the keys that such devices share.

    Args:
        serial_number: refuse any other sensor; none accepts what answers.
        pair_window_s: the second frame of a sample comes within this time of the first (at most half a period).
        stall_s: after a silence this long, what had piled up on the way is dropped: its times are not known.
        sample_timeout_s: a stream silent for this long is started anew.
        reply_timeout_s, tries, retry_s: patience with the questions of the start.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    serial_number: str | None = None
    pair_window_s: float = Field(default=0.005, gt=0.0)
    stall_s: float = Field(default=0.02, gt=0.0)
    sample_timeout_s: float = Field(default=0.5, gt=0.0)
    reply_timeout_s: float = Field(default=0.1, gt=0.0, le=10.0)
    tries: int = Field(default=3, ge=1, le=100)
    retry_s: float = Field(default=1.0, gt=0.0, le=60.0)

    @property
    @abstractmethod
    def period_ns(self) -> int:
        """Return the time from sample to sample, ns."""

    def require(self, serial_number: str) -> None:
        """Refuse a sensor that is not the configured one.

        Raises:
            DialogueError: another `serial_number` is configured.
        """
        if self.serial_number not in (None, serial_number):
            raise DialogueError(
                f"sensor {serial_number} answers, but sensor {self.serial_number} is configured",
                "connect the right sensor or change its serial_number in the configuration",
            )


@dataclass(frozen=True)
class Traffic:
    """Describe the traffic between host and sensor.

    Args:
        layout: of the samples.
        command_id: CAN identifier of commands to the sensor.
        answer_ids: CAN identifiers of answers, besides those of the samples.
        begin, end: commands that start and stop the stream.
    """

    layout: PairLayout
    command_id: int
    answer_ids: frozenset[int]
    begin: CanFrame
    end: CanFrame


class Reading(NamedTuple):
    """Hold what the bytes of a sample say.

    Args:
        counts: of Fx, Fy, Fz, Tx, Ty, Tz, (6,); N and N m by the identity's scaling.
        status: as the sensor gives it.
        saturated: an axis or a channel is at its limit.
        repeated: the counts are those of an earlier sample.
    """

    counts: tuple[int, ...]
    status: int
    saturated: bool
    repeated: bool = False


class PairedSensor(WrenchSensor[CanFrame, Found]):
    """Publish `wrench/raw` in the sensor frame about its origin, N and N m, stamped when its second frame was read.

    Args:
        settings: of the device; traffic: on its wire; the other arguments are those of `WrenchSensor`.
    """

    def __init__(
        self, name: str, where: str, time_base: TimeBase, *, settings: PairedSettings, traffic: Traffic, **sensor: Any
    ) -> None:
        super().__init__(name, where, time_base, retry_s=settings.retry_s, counters=COUNTERS, **sensor)
        self._paired, self._traffic = settings, traffic
        self._first_id, self._second_id = traffic.layout.first_id, traffic.layout.second_id
        self._patience_ns = round(settings.sample_timeout_s * NS_PER_S) + 2 * settings.period_ns
        self._silent_ns, self._lost_before = FAR_NS, 0
        self._wires: list[CanFrame] = []
        """What the next `poll` sends."""
        self._pairer = self._new_pairer()
        self._scale = [0.0] * 6
        """N and N m a count."""
        self._offset = [0.0] * 6
        """What is subtracted, N and N m."""

    def poll(self, now_ns: int) -> tuple[list[CanFrame], list[Output]]:
        """Carry on the start, notice a stream that went silent, report once a second; see `Device.poll`."""
        wires, self._wires = self._wires, []
        if self._phase is Phase.RUNNING and now_ns >= self._silent_ns:
            self._counters["timeouts"] += 1
            halves = self._counters["lost"] - self._lost_before > 1
            what = "no whole samples come: one of their two frames is missing" if halves else "no samples come"
            self._fail(now_ns, DialogueError(what, ""))
        elif self._phase in (Phase.STARTING, Phase.FAILED):
            wires += self._converse(now_ns)
        if now_ns >= self._zeroing.deadline_ns:
            self._outbox += self._zeroing.expire()
        if now_ns >= self._reporter.status_due_ns:
            self._outbox.append(self._report(now_ns))
        return wires, self._take_outbox()

    def feed(self, wire: CanFrame, t_ns: int) -> list[Output]:
        """Take one frame that was read at `t_ns`, ns; a sample comes out with the second frame of its pair."""
        identifier, running = wire.arbitration_id, self._phase is Phase.RUNNING
        if running and identifier == self._second_id:
            pair = self._pairer.second(wire.data, t_ns)
            if pair is not None:
                return self._sample(pair, t_ns)
        elif running and identifier == self._first_id:
            self._pairer.first(wire.data, t_ns)
        else:
            self._feed_beside(wire, t_ns)
        return self._take_outbox() if self._outbox else []

    def stop(self, now_ns: int) -> list[CanFrame]:
        """End the stream."""
        was_on, self._wires = self._phase is not Phase.OFF, []
        self._switch_off()
        return [self._traffic.end] if was_on else []

    @property
    def wakeup_ns(self) -> int:
        """Return when `poll` wants to be called next, ns."""
        if self._wires:
            return 0
        due = self._silent_ns if self._phase is Phase.RUNNING else self._start_due_ns
        return min(due, self._reporter.status_due_ns, self._zeroing.deadline_ns)

    @abstractmethod
    def _questions(self, now_ns: int) -> Generator[Query, bytes, Found]:
        """Ask what the start asks; what a start forgets is forgotten here."""

    @abstractmethod
    def _take_up(self, identity: Found, now_ns: int) -> list[float]:
        """Take up what the start found; return N and N m a count, (6,)."""

    @abstractmethod
    def _decode(self, pair: bytes) -> Reading:
        """Decode the bytes of both frames."""

    @abstractmethod
    def _tell_limit(self, status: int, t_ns: int) -> str:
        """Tell what is at its limit; return why such a sample is of no use for a zero."""

    @abstractmethod
    def _add_to_zero(self, wrench: tuple[float, ...], t_ns: int) -> None:
        """Take a good sample, (6,) N and N m with no offset subtracted, for the zero that is under way."""

    def _new_pairer(self) -> Pairer:
        period_ns = self._paired.period_ns
        window_ns = min(round(self._paired.pair_window_s * NS_PER_S), period_ns // 2)
        stall_ns = round(self._paired.stall_s * NS_PER_S)
        return Pairer(self._traffic.layout, period_ns, window_ns, stall_ns, self._counters)

    def _new_dialogue(self, now_ns: int) -> Dialogue[Found]:
        timeout_ns = round(self._paired.reply_timeout_s * NS_PER_S)
        return Dialogue(self._questions(now_ns), timeout_ns, self._paired.tries, due_ns=now_ns)

    def _identified(self, identity: Found, now_ns: int) -> list[CanFrame]:
        self._scale = self._take_up(identity, now_ns)
        self._pairer = self._new_pairer()
        self._silent_ns, self._lost_before = now_ns + self._patience_ns, self._counters["lost"]
        return [self._traffic.begin]

    def _feed_beside(self, wire: CanFrame, t_ns: int) -> None:
        """Take a frame that is no sample's: an answer of the start, a command that the wire shows to us, or a stray."""
        identifier, layout = wire.arbitration_id, self._traffic.layout
        in_stream = identifier in (self._first_id, self._second_id)
        if in_stream or identifier in self._traffic.answer_ids:
            dialogue = self._dialogue if self._phase is Phase.STARTING else None
            if dialogue is None or not dialogue.feed(wire, t_ns):
                self._counters["short" if in_stream and len(wire.data) not in layout.lengths else "late"] += 1
        elif identifier == self._traffic.command_id:
            self._counters["echoes"] += 1
        else:
            self._counters["foreign"] += 1

    def _sample(self, pair: bytes, t_ns: int) -> list[Output]:
        """Return the message of a pair, then what came with it."""
        reading = self._decode(pair)
        counts, status, saturated, repeated = reading
        self._counters["samples"] += 1
        self._lost_before = self._counters["lost"]
        self._flowing, self._silent_ns = True, t_ns + self._patience_ns
        if not repeated and self._gauges.take(counts):
            self._judge_gauges(t_ns)
        if saturated or self._zeroing.active or self._restart_id is not None:
            self._beside_sample(reading, t_ns)
        values = zip(counts, self._scale, self._offset, strict=True)
        fx, fy, fz, tx, ty, tz = [count * scale - offset for count, scale, offset in values]
        message = WrenchRaw(
            timestamp=self._time_base.timestamp(t_ns),
            t_ns=t_ns,
            seq=self._reporter.next_seq("wrench/raw"),
            valid=not saturated and not self._broken,
            source=self.name,
            force=Vector3(fx, fy, fz),
            torque=Vector3(tx, ty, tz),
            status=status,
            saturated=saturated,
            serial_number=self._identity.serial_number if self._identity is not None else "",
            zeroings=self._zeroing.zeroings,
        )
        return [("wrench/raw", message), *self._take_outbox()] if self._outbox else [("wrench/raw", message)]

    def _beside_sample(self, reading: Reading, t_ns: int) -> None:
        """Do what is rare: a limit, the answer to `restart`, zeroing."""
        obstacle = ""
        if reading.saturated:
            self._counters["saturated"] += 1
            obstacle = self._tell_limit(reading.status, t_ns)
        self._answer_restart()
        if obstacle:
            self._outbox += self._zeroing.give_up("fault", obstacle)
        elif self._zeroing.active:
            wrench = tuple(count * scale for count, scale in zip(reading.counts, self._scale, strict=True))
            self._add_to_zero(wrench, t_ns)

    def _gauge_name(self, gauge: int) -> str:
        return f"axis {AXES[gauge]}"


def told(wrenches: Floats) -> dict[str, Any]:
    """Tell of the samples, (n, 6), that made or showed a zero: mean and scatter, N and N m."""
    mean, std = wrenches.mean(axis=0), np.std(wrenches, axis=0)
    return {
        "samples": len(wrenches),
        "mean_force_n": mean[:3].tolist(),
        "mean_torque_nm": mean[3:].tolist(),
        "std_force_n": std[:3].tolist(),
        "std_torque_nm": std[3:].tolist(),
    }

"""Read an IIT F/T sensor with a STRAIN or STRAIN2 board, streaming over CAN; sources in `codec.py`.

- A sample is certain if its force and torque are a pair (`drivers/pairing.py`): the protocol numbers nothing.
- It is valid unless a channel of the converter is at its limit: such frames repeat the last good numbers, and have a byte more.
- `zero` is the host's bias, in N and N m. The board has one of its own, which is lost with the power and is not used.
- When the board restarts its stream ends; it is asked and started anew, and the host's zero stays if it is the same sensor.

Positive is what the part on the thin cover's side (+z) does to the other side, as the maker calibrates it: the tool goes there.
"""

from typing import Any, Final

import numpy as np

from galen_hw.clock import NS_PER_S, TimeBase
from galen_hw.drivers.device import CanFrame, Output
from galen_hw.drivers.dialogue import Dialogue, DialogueError
from galen_hw.drivers.host_bias import Floats, HostBias
from galen_hw.drivers.host_biased import HostBiasedSensor
from galen_hw.drivers.iit_strain import codec
from galen_hw.drivers.iit_strain.codec import AXES, Command, Stream
from galen_hw.drivers.iit_strain.start import IitStrainIdentity, IitStrainSettings, identify
from galen_hw.drivers.pairing import Pairer
from galen_hw.drivers.reporting import FAR_NS
from galen_hw.drivers.wrench_sensor import Phase
from galen_hw.messages import Vector3, WrenchRaw

COUNTERS: Final = (
    "samples",  # published
    "lost",  # of which a frame is missing
    "timeouts",
    "late",  # frames nobody waited for, or that had piled up
    "doubled",  # frames that came twice
    "short",  # frames of a wrong length
    "foreign",  # frames of another device, or of a kind that is not used here
    "echoes",  # commands, ours or another host's, shown to us by the wire
    "saturated",  # samples with a channel at its limit
    "restarts",
)


class IitStrain(HostBiasedSensor[CanFrame, IitStrainIdentity]):
    """Publishes `wrench/raw` in the sensor frame about its origin, N and N m, stamped when its torque was read.

    Requests: `zero` {samples}: average and subtract from now on; `unzero`; `restart`.
    """

    Settings = IitStrainSettings

    def __init__(self, name: str, settings: IitStrainSettings, time_base: TimeBase) -> None:
        self._settings = settings
        self._ids = {
            codec.stream_id(settings.address, Stream.FORCE): self._force,
            codec.stream_id(settings.address, Stream.TORQUE): self._torque,
        }
        rate_hz = 1000.0 / settings.period_ms
        super().__init__(
            name,
            f"{name} (IIT STRAIN, CAN address {settings.address})",
            time_base,
            asked_rate_hz=rate_hz,
            retry_s=settings.retry_s,
            counters=COUNTERS,
            silent_todo=_TODO_SILENT,
            bias=HostBias(name, settings.zero_samples, rate_hz, _told),
            zero_kept_s=settings.zero_kept_s,
        )
        self._silent_ns, self._lost_before = FAR_NS, 0
        self._pairer = self._new_pairer()
        self._scale = [0.0] * 6
        """N and N m a count."""
        self._offset = [0.0] * 6
        """What is subtracted, N and N m."""

    def poll(self, now_ns: int) -> tuple[list[CanFrame], list[Output]]:
        """Carry on the start, notice a stream that went silent, report once a second; see `Device.poll`."""
        wires: list[CanFrame] = []
        if self._phase is Phase.RUNNING and now_ns >= self._silent_ns:
            self._counters["timeouts"] += 1
            halves = self._counters["lost"] - self._lost_before > 1
            what = "no whole samples come: one of their two frames is missing" if halves else "no samples come"
            self._fail(now_ns, DialogueError(what, ""))
        elif self._phase in (Phase.STARTING, Phase.FAILED):
            wires += self._converse(now_ns)
        if now_ns >= self._bias.deadline_ns:
            self._outbox += self._bias.expire()
        if now_ns >= self._reporter.status_due_ns:
            self._outbox.append(self._report(now_ns))
        return wires, self._take_outbox()

    def feed(self, wire: CanFrame, t_ns: int) -> list[Output]:
        """Take one frame; a sample comes out with the torque of its pair."""
        taken = self._ids.get(wire.arbitration_id)
        if taken is not None:
            if self._phase is Phase.RUNNING:
                taken(wire.data, t_ns)
            else:
                self._counters["short" if len(wire.data) not in codec.LENGTHS else "late"] += 1
        elif wire.arbitration_id == codec.answer_id(self._settings.address):
            starting = self._phase is Phase.STARTING and self._dialogue is not None
            self._counters["late"] += not (starting and self._dialogue is not None and self._dialogue.feed(wire, t_ns))
        elif wire.arbitration_id == codec.command_id(self._settings.address):
            self._counters["echoes"] += 1
        else:
            self._counters["foreign"] += 1
        return self._take_outbox() if self._outbox else []

    def stop(self, now_ns: int) -> list[CanFrame]:
        """End the stream."""
        was_on = self._phase is not Phase.OFF
        self._switch_off()
        off = codec.command(self._settings.address, Command.SET_TRANSMISSION, codec.TRANSMIT_NOTHING)
        return [off] if was_on else []

    @property
    def wakeup_ns(self) -> int:
        """When `poll` wants to be called next."""
        due = self._silent_ns if self._phase is Phase.RUNNING else self._start_due_ns
        return min(due, self._reporter.status_due_ns, self._bias.deadline_ns)

    def _new_pairer(self) -> Pairer:
        period_ns = self._settings.period_ns
        window_ns = min(round(self._settings.pair_window_s * NS_PER_S), period_ns // 2)
        stall_ns = round(self._settings.stall_s * NS_PER_S)
        return Pairer(period_ns, window_ns, stall_ns, self._counters, codec.LENGTHS)

    def _new_dialogue(self, now_ns: int) -> Dialogue[IitStrainIdentity]:
        timeout_ns = round(self._settings.reply_timeout_s * NS_PER_S)
        return Dialogue(identify(self._settings), timeout_ns, self._settings.tries, due_ns=now_ns)

    def _identified(self, identity: IitStrainIdentity, now_ns: int) -> list[CanFrame]:
        self._scale = [scale / codec.ZERO for scale in identity.full_scales]
        self._bias_for(identity, len(AXES), now_ns)
        self._pairer = self._new_pairer()
        self._silent_ns, self._lost_before = now_ns + self._patience_ns, self._counters["lost"]
        return [codec.command(self._settings.address, Command.SET_TRANSMISSION, codec.TRANSMIT_CALIBRATED)]

    @property
    def _patience_ns(self) -> int:
        return round(self._settings.sample_timeout_s * NS_PER_S) + 2 * self._settings.period_ns

    def _force(self, data: bytes, t_ns: int) -> None:
        self._pairer.first(data, t_ns)

    def _torque(self, data: bytes, t_ns: int) -> None:
        pair = self._pairer.second(data, t_ns)
        if pair is not None:
            self._sample(pair, t_ns)

    def _sample(self, pair: bytes, t_ns: int) -> None:
        half = len(pair) // 2
        (force, force_limits), (torque, torque_limits) = (
            codec.decode_vector(pair[:half]),
            codec.decode_vector(pair[half:]),
        )
        counts, status = (*force, *torque), torque_limits << 8 | force_limits
        saturated = half == max(codec.LENGTHS)
        wrench = [k * count for k, count in zip(self._scale, counts, strict=True)]
        fx, fy, fz, tx, ty, tz = (value - bias for value, bias in zip(wrench, self._offset, strict=True))
        self._counters["samples"] += 1
        self._lost_before = self._counters["lost"]
        self._flowing, self._silent_ns = True, t_ns + self._patience_ns
        if not saturated and self._gauges.take(counts):
            self._judge_gauges(t_ns)
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
            zeroings=self._bias.zeroings,
        )
        self._outbox.append(("wrench/raw", message))
        if saturated or self._bias.active or self._restart_id is not None:
            self._beside_sample(tuple(wrench), status, t_ns, saturated=saturated)

    def _beside_sample(self, wrench: tuple[float, ...], status: int, t_ns: int, *, saturated: bool) -> None:
        """Do what is rare: saturation, the answer to `restart`, zeroing."""
        if saturated:
            self._counters["saturated"] += 1
            channels = codec.limited(status & 0xFF) + [f"{3 + int(n[0])}{n[1:]}" for n in codec.limited(status >> 8)]
            what = f"the converter is at its limit (channel {', '.join(channels) or 'not said'})"
            self._outbox += self._reporter.fault(
                t_ns, "saturated", what, "take the load off; if it stays, the sensor is broken"
            )
        self._answer_restart()
        if self._bias.active and saturated:
            self._outbox += self._bias.give_up("fault", "the converter is at its limit")
        elif self._bias.active:
            replies = self._bias.add(wrench)
            self._outbox += replies
            if replies:
                self._use_bias()
                self._gauges.learn()

    def _use_bias(self) -> None:
        self._offset = [0.0] * 6 if self._bias.offset is None else self._bias.offset.tolist()

    def _gauge_name(self, gauge: int) -> str:
        return f"axis {AXES[gauge]}"

    def _running(self, identity: IitStrainIdentity, now_ns: int) -> tuple[str, str]:
        del now_ns
        return "ready", f"{identity.described}, {self._zeroed}"


def _told(wrenches: Floats) -> dict[str, Any]:
    """Tell of the samples (n, 6) that made a zero: mean and scatter, N and N m."""
    mean, std = wrenches.mean(axis=0), np.std(wrenches, axis=0)
    return {
        "samples": len(wrenches),
        "mean_force_n": mean[:3].tolist(),
        "mean_torque_nm": mean[3:].tolist(),
        "std_force_n": std[:3].tolist(),
        "std_torque_nm": std[3:].tolist(),
    }


_TODO_SILENT: Final = "check its power, CAN wiring and termination, its address and the bit rate (1 Mbit/s)"
